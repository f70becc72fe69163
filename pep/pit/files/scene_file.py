"""Scene file: the cell, a sensor's view with its age, the held object, and the objects to touch.

In a running cell each part has an author of its own: a person signs the cell, sensors sign the view, the token grants
the touch. A file has no author; it is for trying out consequences.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal

from pydantic import Field, TypeAdapter

from pep.pit.base.strict import STRICT
from pep.pit.files.plain_file import FileError, formed
from pep.pit.robot.gripped_object import GrippedObject
from pep.pit.scene.adult_body import adult_at_distance, standing_adult
from pep.pit.scene.cell import CellParameters  # noqa: TC001 - pydantic reads the annotation at run time
from pep.pit.scene.scene import (
    PEOPLE_LIMIT,
    REGIONS_LIMIT,
    SIGHTING_AGE_LIMIT_S,
    THINGS_LIMIT,
    Box,
    Capsule,
    Convex,
    Person,
    Region,
    Scene,
    Sphere,
    Thing,
)

if TYPE_CHECKING:
    from pydantic import ConfigDict

    from pep.pit.scene.scene import Shape

FORM: Final = "ztpm-scene/1"
NAME_LIMIT: Final = 128  # ours: fits on a screen
SHAPES: Final = ("box", "capsule", "convex", "sphere")
Name = Annotated[str, Field(min_length=1, max_length=NAME_LIMIT)]
Length = Annotated[float, Field(ge=0)]
Sighted = Annotated[float, Field(ge=0, le=SIGHTING_AGE_LIMIT_S)]


@dataclass(frozen=True, slots=True)
class SeenRegion:
    """A body region and its one shape."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    region: Region
    capsule: Capsule | None = None
    sphere: Sphere | None = None


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
class SeenPerson:
    """A person: body regions, or a standing adult in their place.

    `sensor` says so where it is not the view's own source, and last saw them `age_s` before the view.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    id: Name
    sensor: Name | None = None
    age_s: Sighted = 0.0
    regions: Annotated[tuple[SeenRegion, ...], Field(min_length=1, max_length=REGIONS_LIMIT)] | None = None
    standing_adult: StandingAdult | None = None
    adult_at_distance: AdultAtDistance | None = None


@dataclass(frozen=True, slots=True)
class SeenObject:
    """Object that a sensor sees, with its one shape.

    The cell's uncertainty counts where none is given; the rest is as for people.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    id: Name
    kind: Literal["fragile", "rigid"]
    uncertainty_m: Length | None = None
    sensor: Name | None = None
    age_s: Sighted = 0.0
    box: Box | None = None
    convex: Convex | None = None
    capsule: Capsule | None = None
    sphere: Sphere | None = None


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
class SceneFile:
    """The whole file; lengths in metres in the controller's base frame.

    Without a view nothing is seen.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    form: Literal["ztpm-scene/1"]
    frame: Literal["base"]
    cell: CellParameters
    view: SeenView | None = None
    held: HeldObject | None = None
    touch: Annotated[tuple[Name, ...], Field(max_length=THINGS_LIMIT)] = ()


ADAPTER: Final[TypeAdapter[Any]] = TypeAdapter(SceneFile)
"""The strict form of the whole file."""


@dataclass(frozen=True, slots=True)
class Situation:
    """Situation of a motion: cell, view, held object and objects to touch.

    Attributes:
        cell: objects that stand there, and every number.
        scene: the view of it, or None without one.
        age_s: of the view, or None.
        held: the gripper's held object, or None.
        touch: names of objects that are granted to touch.
    """

    cell: CellParameters
    scene: Scene | None
    age_s: float | None
    held: GrippedObject | None
    touch: frozenset[str]


def situation_of(value: object) -> Situation:
    """The situation that a file's value states.

    Raises:
        FileError: not of the declared form; `FRAMES_MISMATCH` for any frame but the base's; `PERCEPTION_INVALID` for a
            view that nobody signed; else `PARAMETERS_WRONG`, for what contradicts itself too.
    """
    stated: SceneFile = formed(ADAPTER, value, place="scene")
    cell = stated.cell
    _say_objects(value)
    for row, surveyed in enumerate((*cell.objects, *cell.zones)):
        which, at = ("objects", row) if row < len(cell.objects) else ("zones", row - len(cell.objects))
        _only(f"scene.cell.{which}.{at}", {name: getattr(surveyed, name) for name in SHAPES})
    wrong = cell.defect()
    if wrong is not None:
        raise FileError("PARAMETERS_WRONG", "scene.cell", wrong)
    scene = None if stated.view is None else _scene(stated.view, cell)
    known = {thing.id for thing in (cell.surveyed if scene is None else scene).objects}
    for row, contact in enumerate(cell.contacts):
        if contact.object not in known:
            raise FileError("PARAMETERS_WRONG", f"scene.cell.contacts.{row}.object", "no such object")
    for row, name in enumerate(stated.touch):
        if name not in known:
            raise FileError("PARAMETERS_WRONG", f"scene.touch.{row}", "no such object")
    return Situation(
        cell=cell,
        scene=scene,
        age_s=None if stated.view is None else stated.view.age_s,
        held=None if stated.held is None else _held(stated.held),
        touch=frozenset(stated.touch),
    )


def _say_objects(value: Any) -> None:
    """Refuses a cell that does not name its objects: it is not an empty one, and not the demo's either."""
    if "objects" not in value["cell"]:
        raise FileError("PARAMETERS_WRONG", "scene.cell.objects", "say what stands there, or that nothing does: []")


def _scene(view: SeenView, cell: CellParameters) -> Scene:
    if not view.source.signed:
        raise FileError("PERCEPTION_INVALID", "scene.view.source.signed", "a view that no sensor signed")
    known = cell.surveyed
    things = tuple(
        _thing(seen, f"scene.view.objects.{row}", cell, view.source.sensor) for row, seen in enumerate(view.objects)
    )
    scene = replace(
        known,
        people=tuple(
            replace(
                _person(seen, f"scene.view.people.{row}"), source=seen.sensor or view.source.sensor, age_s=seen.age_s
            )
            for row, seen in enumerate(view.people)
        ),
        objects=(*known.objects, *things),
        complete=view.complete,
    )
    names = Counter([p.id for p in scene.people] + [o.id for o in scene.objects] + [z.id for z in scene.zones])
    for name, times in names.items():
        if times > 1:
            raise FileError("PARAMETERS_WRONG", "scene", f"two things are called {name}")
    wrong = scene.defect()
    if wrong is not None:
        raise FileError("PERCEPTION_INVALID", "scene.view", wrong)
    return scene


def _person(seen: SeenPerson, place: str) -> Person:
    given = {
        "regions": seen.regions,
        "standing_adult": seen.standing_adult,
        "adult_at_distance": seen.adult_at_distance,
    }
    match _only(place, given):
        case StandingAdult(x, y, facing):
            return standing_adult(x, y, facing_rad=facing, name=seen.id)
        case AdultAtDistance(surface, bearing):
            return adult_at_distance(surface, bearing_rad=bearing, name=seen.id)
        case _:
            return Person(
                seen.id,
                tuple(
                    (each.region, _round(f"{place}.regions.{row}", each.capsule, each.sphere))
                    for row, each in enumerate(seen.regions or ())
                ),
            )


def _thing(seen: SeenObject, place: str, cell: CellParameters, source: str) -> Thing:
    shape: Shape = _only(place, {name: getattr(seen, name) for name in SHAPES})
    uncertainty = cell.object_uncertainty_m if seen.uncertainty_m is None else seen.uncertainty_m
    return Thing(seen.id, seen.kind, shape, uncertainty, seen.sensor or source, seen.age_s)


def _held(stated: HeldObject) -> GrippedObject:
    shape = _round("scene.held", stated.capsule, stated.sphere)
    return GrippedObject(stated.object, shape, stated.mass_kg, stated.blunt)


def _round(place: str, capsule: Capsule | None, sphere: Sphere | None) -> Capsule | Sphere:
    shape: Capsule | Sphere = _only(place, {"capsule": capsule, "sphere": sphere})
    return shape


def _only(place: str, given: dict[str, Any]) -> Any:
    """The one member that is given."""
    found = [each for each in given.values() if each is not None]
    if len(found) != 1:
        raise FileError("PARAMETERS_WRONG", place, f"exactly one of {', '.join(given)}")
    return found[0]
