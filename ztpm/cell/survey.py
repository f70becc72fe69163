"""Survey of a cell before a person signs it: from a TOML draft, or of the embedded cell."""

from __future__ import annotations

import re
import tomllib
from typing import TYPE_CHECKING, Any, Final

from capabilities.statements import cell
from capabilities.statements.observation import Box, Sphere
from capabilities.values.errors import CapabilityError
from capabilities.values.scope import Tier

if TYPE_CHECKING:
    from collections.abc import Mapping

DAY_S: Final = 86_400
DAYS: Final = 365
"""A cell file's usual life; the longest is `capabilities.statements.cell.LIFETIME_S`."""
BACKDATED_S: Final = 60
"""A file is in force from a minute before it was signed, since two machines' clocks differ a little."""
UPRIGHT: Final = (1_000_000, 0, 0, 0)


PLACE: Final = re.compile(r"([a-z]+)\[(\d+)\]")
"""Place that leads the detail of a fault in a list: `zones[1].tier`."""


class DraftError(ValueError):
    """Draft that makes no cell file. `code` is the reason."""

    def __init__(self, code: str, detail: str) -> None:
        super().__init__(f"{code}: {detail}")
        self.code = code
        self.detail = detail


def draft(text: str, *, at: int, days: int) -> cell.Cell:
    """Cell that a TOML draft spells, ready to be signed.

    The members are those of the signed file (docs/spec.md), without its times. What TOML has no word for is left out:
    no `payload_g` means unknown, no `workspace` no such limit, no `tier` a hard zone, no `quaternion_ppm` upright, no
    `observed` a surveyed object. Lists may be left out.

    Args:
        text: TOML.
        at: seconds since the epoch.
        days: days for which it is in force.

    Raises:
        DraftError: `DRAFT_MALFORMED`, or a code of `pep.pit.SurveyFault` for a draft that contradicts itself.
    """
    from pep.pit import CellParameters, SurveyError, surveyed

    try:
        table = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise DraftError("DRAFT_MALFORMED", f"not TOML: {error}") from error
    try:
        stated = cell.from_claims(_claims(table, at=at, days=days))
        surveyed(stated, CellParameters())
    except CapabilityError as error:
        raise DraftError("DRAFT_MALFORMED", _named(error.detail, table)) from error
    except SurveyError as error:
        raise DraftError(str(error.code), error.detail) from error
    return stated


def _claims(table: Mapping[str, Any], *, at: int, days: int) -> dict[str, object]:
    left_out: dict[str, Any] = {
        "payload_g": None,
        "workspace": None,
        "objects": [],
        "zones": [],
        "contacts": [],
        "outputs": [],
    }
    claims: dict[str, Any] = {**left_out, **table}
    for name in ("not_before", "not_after"):
        if name in claims:
            raise DraftError("DRAFT_MALFORMED", f"{name} is stated when the file is signed")
    for name, member in (("zones", {"tier": None}), ("contacts", {"observed": False})):
        claims[name] = [{**member, **row} if isinstance(row, dict) else row for row in _rows(claims[name], name)]
    for name in ("objects", "zones"):
        claims[name] = [_upright(row) for row in _rows(claims[name], name)]
    return {**claims, "not_before": at - BACKDATED_S, "not_after": at - BACKDATED_S + days * DAY_S}


def _named(detail: str, table: Mapping[str, Any]) -> str:
    """The detail of a fault, with the name of the object, zone or contact whose place leads it."""
    place = PLACE.match(detail)
    rows = table.get(place[1]) if place else None
    if (
        place is None
        or not isinstance(rows, list)
        or int(place[2]) >= len(rows)
        or not isinstance(rows[int(place[2])], dict)
    ):
        return detail
    row = rows[int(place[2])]
    name = row.get("name", row.get("object"))
    return detail if name is None else f"{name!r} in {detail}"


def _rows(value: object, name: str) -> list[Any]:
    if not isinstance(value, list):
        raise DraftError("DRAFT_MALFORMED", f"{name}: no list")
    return value


def _upright(row: Any) -> Any:
    shape = row.get("shape") if isinstance(row, dict) else None
    if not isinstance(shape, dict) or shape.get("form") != "box":
        return row
    return {**row, "shape": {"quaternion_ppm": list(UPRIGHT), **shape}}


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
