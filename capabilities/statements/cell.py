"""The signed cell file: what a person says stands in a cell, and what may happen there.

Everything in it that makes authority wider (objects that may be touched, zones and their tiers, the workspace, outputs
that may be switched, the sensors that must see) comes from here and from nowhere else. Numbers of the physics engine
are parameters, not statements.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from capabilities.statements import observation, statement_form
from capabilities.statements.claims import Claims, malformed, unique
from capabilities.values.scope import Tier

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from capabilities.keys.keys import PrivateKey
    from capabilities.statements.observation import Point, Shape
    from capabilities.values.caps import Caps

KIND: Final = "cell"
OBJECTS: Final = 64
ZONES: Final = 64
"""Most surveyed objects and zones: with the objects of one full frame they are as many as physics takes on (256)."""
CONTACTS: Final = 64
OUTPUTS: Final = 18
"""Standard (8), configurable (8) and tool (2) digital outputs of a UR e-Series controller."""
SENSORS: Final = 64
PAYLOAD_G: Final = 100_000
"""Heaviest payload that can be written, far above any cobot's."""
LIFETIME_S: Final = 366 * 86_400
"""Longest life of a cell file: a year. A cell is surveyed again before it is forgotten."""
TOUCHING: Final = frozenset({"tool", "payload"})


@dataclass(frozen=True, slots=True)
class Surveyed:
    """An object that stands there whatever a sensor says: "fragile" or "rigid"."""

    name: str
    kind: str
    shape: Shape


@dataclass(frozen=True, slots=True)
class Zone:
    """A part of space: entering it has `tier`, or is a violation (None: hard)."""

    name: str
    tier: Tier | None
    shape: Shape


@dataclass(frozen=True, slots=True)
class Workspace:
    """The box that no part of the moving arm may leave, corner to corner."""

    low_um: Point
    high_um: Point


@dataclass(frozen=True, slots=True)
class Contact:
    """An object that `by` ("tool" or "payload") may touch on purpose.

    Attributes:
        object: a surveyed object; with `observed`, the id under which sensors show it.
        by: what may touch it.
        observed: whether it is such an id. No person is an object.
    """

    object: str
    by: str
    observed: bool


@dataclass(frozen=True, slots=True)
class Output:
    """A digital output that may be switched at all: its number, and the tier that switching it has."""

    number: int
    name: str
    tier: Tier


@dataclass(frozen=True, slots=True)
class Cell:
    """One cell, as a person surveyed it.

    Attributes:
        name: of the cell.
        author: id of the person who signs.
        audience: canonical URL of the enforcement point that it is for.
        tool: the mounted tool, by the name of its model.
        payload_g: held by default in grams; None is unknown and counts as the robot's whole payload.
        workspace: None for no such limit.
        objects, zones: no two things of a cell have one name.
        contacts: each (object, by) once.
        outputs: each number once.
        sensors: ids of those that must see the cell, at least one, each once.
        not_before, not_after: seconds since the epoch.
    """

    name: str
    author: str
    audience: str
    tool: str
    payload_g: int | None
    workspace: Workspace | None
    objects: tuple[Surveyed, ...]
    zones: tuple[Zone, ...]
    contacts: tuple[Contact, ...]
    outputs: tuple[Output, ...]
    sensors: tuple[str, ...]
    not_before: int
    not_after: int


_NAMES: Final = tuple(Cell.__dataclass_fields__)


def sign(cell: Cell, key: PrivateKey) -> str:
    """The cell file, signed by the person."""
    return statement_form.sign(KIND, to_claims(cell), key)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Cell:  # noqa: A001 - read as cell.open
    """The cell, signed by one of these keys, every member of its form and each name once.

    Raises:
        StatementError: as `sealed.open`.
    """
    return from_claims(statement_form.open(KIND, text, keys, caps))


def to_claims(cell: Cell) -> dict[str, object]:
    """The cell as plain JSON, every member present."""
    area = cell.workspace
    return {
        "name": cell.name,
        "author": cell.author,
        "audience": cell.audience,
        "tool": cell.tool,
        "payload_g": cell.payload_g,
        "workspace": None if area is None else {"low_um": list(area.low_um), "high_um": list(area.high_um)},
        "objects": [{"name": o.name, "kind": o.kind, "shape": observation.shape_claims(o.shape)} for o in cell.objects],
        "zones": [
            {
                "name": z.name,
                "tier": None if z.tier is None else int(z.tier),
                "shape": observation.shape_claims(z.shape),
            }
            for z in cell.zones
        ],
        "contacts": [{"object": c.object, "by": c.by, "observed": c.observed} for c in cell.contacts],
        "outputs": [{"number": o.number, "name": o.name, "tier": int(o.tier)} for o in cell.outputs],
        "sensors": list(cell.sensors),
        "not_before": cell.not_before,
        "not_after": cell.not_after,
    }


def from_claims(members: Mapping[str, object]) -> Cell:
    """The cell that these members spell.

    Raises:
        StatementError: `STATEMENT_MALFORMED`.
    """
    claims = Claims(members, *_NAMES)
    objects = claims.each("objects", _surveyed, most=OBJECTS)
    zones = claims.each("zones", _zone, most=ZONES)
    unique((*(thing.name for thing in objects), *(zone.name for zone in zones)), lambda name: name, "a name")
    outputs = unique(claims.each("outputs", _output, most=OUTPUTS), lambda output: output.number, "an output")
    contacts = claims.each("contacts", _contact, most=CONTACTS)
    sensors = claims.each("sensors", lambda value: Claims({"sensor": value}, "sensor").name("sensor"), most=SENSORS)
    if not sensors:
        raise malformed("a cell that no sensor sees")
    cell = Cell(
        name=claims.name("name"),
        author=claims.name("author"),
        audience=claims.url("audience"),
        tool=claims.name("tool"),
        payload_g=_or_none(claims, "payload_g", lambda: claims.integer("payload_g", high=PAYLOAD_G)),
        workspace=_or_none(claims, "workspace", lambda: _workspace(claims.raw("workspace"))),
        objects=objects,
        zones=zones,
        contacts=unique(contacts, lambda contact: (contact.object, contact.by), "a contact"),
        outputs=unique(outputs, lambda output: output.name, "an output"),
        sensors=unique(sensors, lambda sensor: sensor, "a sensor"),
        not_before=claims.integer("not_before"),
        not_after=claims.integer("not_after"),
    )
    if not 0 < cell.not_after - cell.not_before <= LIFETIME_S:
        raise malformed("it ends before it begins, or lives for more than a year")
    return cell


def _or_none(claims: Claims, name: str, read: Any) -> Any:
    return None if claims.raw(name) is None else read()


def _workspace(value: object) -> Workspace:
    claims = Claims(value, "low_um", "high_um")
    low, high = observation.point(claims, "low_um"), observation.point(claims, "high_um")
    if not all(least < most for least, most in zip(low, high, strict=True)):
        raise malformed("a workspace without extent")
    return Workspace(low, high)


def _surveyed(value: object) -> Surveyed:
    claims = Claims(value, "name", "kind", "shape")
    kind = claims.one_of("kind", observation.OBJECT_KINDS)
    return Surveyed(claims.name("name"), kind, observation.shape(claims.raw("shape")))


def _zone(value: object) -> Zone:
    claims = Claims(value, "name", "tier", "shape")
    highest = int(max(Tier))
    tier = _or_none(claims, "tier", lambda: Tier(claims.integer("tier", low=1, high=highest)))
    return Zone(claims.name("name"), tier, observation.shape(claims.raw("shape")))


def _contact(value: object) -> Contact:
    claims = Claims(value, "object", "by", "observed")
    return Contact(claims.name("object"), claims.one_of("by", TOUCHING), claims.boolean("observed"))


def _output(value: object) -> Output:
    claims = Claims(value, "number", "name", "tier")
    tier = Tier(claims.integer("tier", high=int(max(Tier))))
    return Output(claims.integer("number", high=OUTPUTS - 1), claims.name("name"), tier)
