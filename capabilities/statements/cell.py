"""Cell file, signed by a person: the fixed objects of a cell, and the acts that are allowed there.

Everything in it that makes authority wider (objects that may be touched, zones and their tiers, the workspace, outputs
that may be switched, the sensors that must see) comes from here and from nowhere else. Numbers of the physics engine
are parameters, not statements.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

from msgspec import Meta

from capabilities.statements import observation, statement_form
from capabilities.statements.claims import Name, Url, Whole, malformed, read, unique
from capabilities.statements.observation import Point, Shape
from capabilities.values.form import Form, plain, upto, within, words
from capabilities.values.scope import Tier

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "cell"
OBJECTS: Final = 64
ZONES: Final = 64
"""Most surveyed objects and zones.

With the objects of one full frame they are as many as physics takes on (256).
"""
CONTACTS: Final = 64
OUTPUTS: Final = 18
"""Standard (8), configurable (8) and tool (2) digital outputs of a UR e-Series controller."""
SENSORS: Final = 64
PAYLOAD_G: Final = 100_000
"""Heaviest payload that can be written, far above any cobot's."""
LIFETIME_S: Final = 366 * 86_400
"""Longest life of a cell file: a year. A cell is surveyed again before it is forgotten."""
TOUCHING: Final = frozenset({"tool", "payload"})


class Surveyed(Form, frozen=True):
    """Fixed object that a surveyor placed, independent of every sensor: "fragile" or "rigid"."""

    name: Name
    kind: Annotated[str, words(*observation.OBJECT_KINDS)]
    shape: Shape


class Zone(Form, frozen=True):
    """A part of space: entering it has `tier`, or is a violation (None: hard)."""

    name: Name
    tier: Tier | None
    shape: Shape


class Workspace(Form, frozen=True):
    """The box that no part of the moving arm may leave, corner to corner."""

    low_um: Point
    high_um: Point


class Contact(Form, frozen=True):
    """An object that `by` ("tool" or "payload") may touch on purpose.

    Attributes:
        object: a surveyed object; with `observed`, the id under which sensors show it.
        by: the parts that may touch it.
        observed: whether it is such an id. No person is an object.
    """

    object: Name
    by: Annotated[str, words(*TOUCHING)]
    observed: bool


class Output(Form, frozen=True):
    """A digital output that may be switched at all: its number, and the tier that switching it has."""

    number: Annotated[int, within(0, OUTPUTS - 1)]
    name: Name
    tier: Tier


class Cell(Form, frozen=True):
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

    name: Name
    author: Name
    audience: Url
    tool: Name
    payload_g: Annotated[int, within(0, PAYLOAD_G)] | None
    workspace: Workspace | None
    objects: Annotated[tuple[Surveyed, ...], upto(OBJECTS)]
    zones: Annotated[tuple[Zone, ...], upto(ZONES)]
    contacts: Annotated[tuple[Contact, ...], upto(CONTACTS)]
    outputs: Annotated[tuple[Output, ...], upto(OUTPUTS)]
    sensors: Annotated[tuple[Name, ...], Meta(min_length=1, max_length=SENSORS)]
    not_before: Whole
    not_after: Whole


def sign(cell: Cell, key: PrivateKey) -> str:
    """The cell file, signed by the person."""
    return statement_form.seal(KIND, to_claims(cell), key, from_claims)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Cell:  # noqa: A001 - read as cell.open
    """The cell, signed by one of these keys, every member of its form and each name once.

    Raises:
        StatementError: as `sealed.open`.
    """
    return from_claims(statement_form.open(KIND, text, keys, caps))


def to_claims(cell: Cell) -> dict[str, object]:
    """The cell as plain JSON, every member present."""
    found: dict[str, object] = plain(cell)
    return found


def from_claims(members: Mapping[str, object]) -> Cell:
    """The cell that these members spell.

    Raises:
        StatementError: `STATEMENT_MALFORMED`.
    """
    cell = read(Cell, members)
    unique((*(thing.name for thing in cell.objects), *(zone.name for zone in cell.zones)), lambda name: name, "a name")
    unique(cell.outputs, lambda output: output.number, "an output")
    unique(cell.outputs, lambda output: output.name, "an output")
    unique(cell.contacts, lambda contact: (contact.object, contact.by), "a contact")
    unique(cell.sensors, lambda sensor: sensor, "a sensor")
    for shape in (*(thing.shape for thing in cell.objects), *(zone.shape for zone in cell.zones)):
        observation.check(shape)
    if any(zone.tier is Tier.NO_EFFECT for zone in cell.zones):
        raise malformed("a zone of tier 0")
    area = cell.workspace
    if area is not None and not all(low < high for low, high in zip(area.low_um, area.high_um, strict=True)):
        raise malformed("a workspace without extent")
    if not 0 < cell.not_after - cell.not_before <= LIFETIME_S:
        raise malformed("it ends before it begins, or lives for more than a year")
    return cell
