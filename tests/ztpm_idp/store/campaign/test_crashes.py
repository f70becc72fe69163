"""kill -9 in the midst, on both databases: a slice of `make store-faults`."""

from __future__ import annotations

from random import Random

import pytest
from tests.ztpm_idp.store.campaign.crashes import Found, at_every_point, at_random_instants
from tests.ztpm_idp.store.campaign.scene import Scene

pytestmark = [pytest.mark.xdist_group("postgres"), pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")]


@pytest.mark.parametrize("database", ["sqlite", "postgres"])
def test_nothing_acknowledged_is_lost_and_nothing_is_half_done(tmp_path, database):
    scene, found = Scene(tmp_path, database, many=1), Found()
    try:
        at_every_point(scene, found, step=17, names=frozenset({"delegate"}))
        at_random_instants(scene, found, number=1, random=Random(1))
    finally:
        scene.close()
    assert found.points >= 2 and found.clean, found
