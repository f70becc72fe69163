"""Cell of the referee: told by itself, it is the one that the embedded cell's survey tells."""

import pytest
from ztpm.cell.survey import embedded

MICRO = 1e6


def test_zones_and_workspace_are_those_of_the_survey() -> None:
    pytest.importorskip("mujoco")
    from evaluation.redteam.judging import EMBEDDED

    stated = embedded(audience="https://cell.invalid/mcp", author="nobody", sensor="eye", at=0)
    zones = {
        zone.name: (tuple(each / MICRO for each in zone.shape.center_um), zone.shape.radius_um / MICRO)
        for zone in stated.zones
    }
    told = {name: (zone.center_m, zone.shape.radius_m) for name, zone in EMBEDDED.zones.items()}
    assert told == pytest.approx(zones)
    corners = (stated.workspace.low_um, stated.workspace.high_um)
    assert EMBEDDED.workspace == tuple(tuple(each / MICRO for each in corner) for corner in corners)
