"""Survey of a cell before a person signs it: out of a world file, or of the embedded cell."""

from __future__ import annotations

from pathlib import PurePath
from typing import Final

from capabilities.statements import cell
from capabilities.statements.observation import Box, Sphere
from capabilities.values.scope import Tier

DAY_S: Final = 86_400
DAYS: Final = 365
"""A cell file's usual life; the longest is `capabilities.statements.cell.LIFETIME_S`."""
BACKDATED_S: Final = 60
"""A file is in force from a minute before it was signed, since two machines' clocks differ a little."""
UPRIGHT: Final = (1_000_000, 0, 0, 0)


def draft(text: str, *, at: int, days: int) -> cell.Cell:
    """Cell that a world file's text spells (TOML), ready to be signed.

    Raises:
        FileError: as `pep.pit.files.cell_draft.statement_of`, and for a text that is not TOML.
    """
    from pep.pit.files.cell_draft import statement_of
    from pep.pit.files.plain_file import value_of

    return statement_of(value_of(text.encode(), PurePath("draft.toml")), at=at, days=days)


def embedded(*, audience: str, author: str, sensor: str, at: int) -> cell.Cell:
    """Survey of the embedded cell: a table that may be touched, a fixture and a charger to avoid.

    Both zones keep 0.15 m away from the sweep between q0 = -0.6 and 0.6 rad (a test measures it). Turning the base on
    to q0 = -1.4 rad and beyond leads into the fixture, to 2.4 rad and beyond into the charger.

    Args:
        audience: canonical URL of the cell's tool server.
        author: the person who signs.
        sensor: the sensor that sees the cell.
        at: seconds since the epoch.
    """
    return cell.Cell(
        name="embedded",
        author=author,
        audience=audience,
        tool="robotiq_2f85",
        payload_g=0,
        workspace=cell.Workspace((-1_000_000, -1_000_000, -300_000), (1_000_000, 1_000_000, 1_200_000)),
        # in front of the arm, 1 m x 1 m, its top 10 mm below the flange of the base
        objects=(cell.Surveyed("table", "rigid", Box((-300_000, 0, -60_000), (500_000, 500_000, 50_000), UPRIGHT)),),
        zones=(
            cell.Zone("fixture", Tier.SAFETY_CRITICAL, Sphere((-85_000, 308_000, 140_000), 90_000)),
            cell.Zone("charger", None, Sphere((398_000, -37_000, 140_000), 90_000)),
        ),
        contacts=(
            cell.Contact("table", "tool", observed=False),
            cell.Contact("table", "payload", observed=False),
            cell.Contact("part-1", "tool", observed=True),
        ),
        outputs=(cell.Output(0, "lamp", Tier.REVERSIBLE), cell.Output(4, "clamp", Tier.CONSEQUENTIAL)),
        sensors=(sensor,),
        not_before=at - BACKDATED_S,
        not_after=at - BACKDATED_S + DAYS * DAY_S,
    )
