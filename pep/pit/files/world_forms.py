"""Forms of the world file: one set of words for cells, views, held objects and objects to touch.

A world file has parts: `cell` is what a person signs, `view` is what a sensor shows, `held` and `touch` belong to one
question. Each use takes its parts, and names those of the others when it refuses them (PHY-68).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal

from pydantic import Field, TypeAdapter, create_model

from pep.pit.base.strict import STRICT
from pep.pit.scene.cell import CellParameters, Contact, Output, Part, StaticObject, StaticZone
from pep.pit.scene.scene import (
    PEOPLE_LIMIT,
    REGIONS_LIMIT,
    SIGHTING_AGE_LIMIT_S,
    THINGS_LIMIT,
    Box,
    Capsule,
    Convex,
    Region,
    Sphere,
    Workspace,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pydantic import ConfigDict

FORM: Final = "ztpm-world/1"
NAME_LIMIT: Final = 128  # ours: fits on a screen
SHAPES: Final = ("box", "capsule", "convex", "sphere")
UNKNOWN: Final = "unknown"
"""Word for a held mass that nobody knows: it counts as the robot's whole payload."""
OUTPUTS_LIMIT: Final = 18  # U12: as of the pins
Name = Annotated[str, Field(min_length=1, max_length=NAME_LIMIT)]
Length = Annotated[float, Field(ge=0)]
Sighted = Annotated[float, Field(ge=0, le=SIGHTING_AGE_LIMIT_S)]


@dataclass(frozen=True, slots=True)
class StandingAdult:
    """A large adult whose body axis stands at (x, y), looking along `facing_rad` (about z, from x)."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    x_m: float
    y_m: float
    facing_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class AdultAtDistance:
    """The same adult facing the base: `surface_m` from the base's axis to the body, in the direction `bearing_rad`."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    surface_m: Length
    bearing_rad: float


@dataclass(frozen=True, slots=True)
class ShownPerson:
    """Person whom a simulated sensor shows: a standing adult, who can be told to walk."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    id: Name
    standing_adult: StandingAdult | None = None
    adult_at_distance: AdultAtDistance | None = None


@dataclass(frozen=True, slots=True)
class ShownObject:
    """Loose object with its one shape."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    id: Name
    kind: Literal["fragile", "rigid"]
    box: Box | None = None
    convex: Convex | None = None
    capsule: Capsule | None = None
    sphere: Sphere | None = None


@dataclass(frozen=True, slots=True)
class SeenRegion:
    """A body region and its one shape."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    region: Region
    capsule: Capsule | None = None
    sphere: Sphere | None = None


@dataclass(frozen=True, slots=True)
class SeenPerson(ShownPerson):
    """A person: body regions, or a standing adult in their place.

    `sensor` says so where it is not the view's own source, and last saw them `age_s` before the view.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    sensor: Name | None = None
    age_s: Sighted = 0.0
    regions: Annotated[tuple[SeenRegion, ...], Field(min_length=1, max_length=REGIONS_LIMIT)] | None = None


@dataclass(frozen=True, slots=True)
class SeenObject(ShownObject):
    """Object that a sensor sees, with its one shape.

    The cell's uncertainty counts where none is given; the rest is as for people.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    uncertainty_m: Length | None = None
    sensor: Name | None = None
    age_s: Sighted = 0.0


@dataclass(frozen=True, slots=True)
class Source:
    """Origin of a view. A view that no registered sensor signed must not be believed."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    sensor: Name
    signed: bool


@dataclass(frozen=True, slots=True)
class SeenView:
    """View of a sensor, `age_s` before the command; `complete` when it covers all of the watched space."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    source: Source
    age_s: Length
    complete: bool
    people: Annotated[tuple[SeenPerson, ...], Field(max_length=PEOPLE_LIMIT)]
    objects: Annotated[tuple[SeenObject, ...], Field(max_length=THINGS_LIMIT)]


@dataclass(frozen=True, slots=True)
class ShownView:
    """Everybody and every loose thing that a simulated sensor shows."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    people: Annotated[tuple[ShownPerson, ...], Field(max_length=PEOPLE_LIMIT)] = ()
    objects: Annotated[tuple[ShownObject, ...], Field(max_length=THINGS_LIMIT)] = ()


@dataclass(frozen=True, slots=True)
class HeldObject:
    """The gripper's held object, in the frame of the flange.

    A missing mass counts as the whole payload.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    object: Annotated[str, Field(max_length=NAME_LIMIT)]
    mass_kg: float | None = None
    blunt: bool = False
    capsule: Capsule | None = None
    sphere: Sphere | None = None


@dataclass(frozen=True, slots=True)
class StatedContact(Contact):
    """Object that may be touched on purpose; with `observed` it is one that sensors show under this id."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    observed: bool = False


_Things = Field(max_length=THINGS_LIMIT)
SURVEYED: Final[dict[str, Any]] = {
    "name": (Name | None, None),
    "author": (Name | None, None),
    "audience": (Annotated[str, Field(min_length=1, max_length=2 * NAME_LIMIT)] | None, None),
    "robot": (Name | None, None),
    "tool": (Name, "robotiq_2f85"),
    "payload_kg": (Length | Literal["unknown"] | None, 0.0),
    "workspace": (Workspace | None, None),
    "objects": (Annotated[tuple[StaticObject, ...], _Things], ...),
    "zones": (Annotated[tuple[StaticZone, ...], _Things], ()),
    "contacts": (Annotated[tuple[StatedContact, ...], _Things], ()),
    "outputs": (Annotated[tuple[Output, ...], Field(max_length=OUTPUTS_LIMIT)], ()),
    "sensors": (Annotated[tuple[Name, ...], _Things], ()),
}
"""Members of a cell that a person states, and `robot`, which the gateway's configuration states."""
_SIGNED: Final = ("name", "author", "audience", "tool", "payload_kg", "sensors")
"""Members that must be stated to be signed: what is left out there is not known."""
_NUMBERS: Final[dict[str, Any]] = {
    "parts": (Annotated[tuple[Part, ...], _Things], ()),
    **{
        each.name: (type(each.default), each.default)
        for each in fields(CellParameters)
        if each.name not in {*SURVEYED, "parts"}
    },
}
"""Numbers of the physics engine, and known parts: a running cell has them in its gateway's configuration."""


def _form(name: str, said: str, members: Mapping[str, Any]) -> Any:
    made: dict[str, Any] = dict(members)
    return create_model(name, __config__=STRICT, __doc__=said, **made)


_HEAD: Final[dict[str, Any]] = {"form": (Literal["ztpm-world/1"], ...), "frame": (Literal["base"], ...)}
_CELL: Final = _form("Cell", "The surveyed cell, with numbers of the physics engine.", SURVEYED | _NUMBERS)
_DRAFT: Final = _form(
    "CellDraft",
    "The surveyed cell, as a person signs it.",
    SURVEYED | {name: (SURVEYED[name][0], ...) for name in _SIGNED},
)
_ASKED: Final[dict[str, Any]] = {
    "cell": (_CELL, ...),
    "view": (SeenView | None, None),
    "held": (HeldObject | None, None),
    "touch": (Annotated[tuple[Name, ...], _Things], ()),
}
SCENE_FILE: Final = _form(
    "SceneFile", "Scene of a question: the cell, what is seen, held and granted to touch.", _HEAD | _ASKED
)
DRAFT_FILE: Final = _form("CellFile", "Draft of the cell file that a person signs.", _HEAD | {"cell": (_DRAFT, ...)})
SHOWN_FILE: Final = _form("ShownFile", "Scene of a simulated sensor.", _HEAD | {"view": (ShownView, ...)})
"""The strict form of each use."""
SCENE: Final[TypeAdapter[Any]] = TypeAdapter(SCENE_FILE)
DRAFT: Final[TypeAdapter[Any]] = TypeAdapter(DRAFT_FILE)
SHOWN: Final[TypeAdapter[Any]] = TypeAdapter(SHOWN_FILE)
BELONGS: Final[Mapping[str, str]] = MappingProxyType(
    {
        **dict.fromkeys(("view", "held", "touch"), "a scene of `ztpm pit`; what is signed is the cell alone"),
        **dict.fromkeys(_NUMBERS, "a scene of `ztpm pit`, or to [cell] of the gateway's configuration"),
        **dict.fromkeys(
            ("cell", "regions", "sensor", "age_s", "uncertainty_m", "source", "complete"), "a scene of `ztpm pit`"
        ),
        **dict.fromkeys(("not_before", "not_after"), "the signature: `ztpm cell sign` states it"),
    }
)
"""Members of other uses, and their use."""
