"""A world file as the scene of a question: cell, view with its age, held object, objects to touch.

In a running cell each part has an author of its own: a person signs the cell, sensors sign the view, the token grants
the touch. A file has no author; it is for trying out consequences.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

from pep.pit.files import contradictions
from pep.pit.files import world_forms as forms
from pep.pit.files.old_files import renewed_scene
from pep.pit.files.plain_file import FileError, formed
from pep.pit.robot.gripped_object import GrippedObject
from pep.pit.scene.adult_body import adult_at_distance, standing_adult
from pep.pit.scene.cell import CellParameters, Contact
from pep.pit.scene.scene import Person, Scene, Thing

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pep.pit.files.faults import Fault
    from pep.pit.geometry.shape import Capsule, Shape, Sphere


@dataclass(frozen=True, slots=True)
class Situation:
    """Situation of a motion: cell, view, held object and objects to touch.

    Attributes:
        cell: objects that stand there, and every number.
        scene: the view of it, or None without one.
        age_s: of the view, or None.
        held: the gripper's held object, or None.
        touch: names of objects that are granted to touch.
        robot: the model that the file names, or None.
    """

    cell: CellParameters
    scene: Scene | None
    age_s: float | None
    held: GrippedObject | None
    touch: frozenset[str]
    robot: str | None = None


def situation_of(value: object) -> Situation:
    """The situation that a file's value states.

    Raises:
        FileError: not of the declared form; `FRAMES_MISMATCH` for any frame but the base's; `PERCEPTION_INVALID` for a
            view that nobody signed; else `PARAMETERS_WRONG`, for what contradicts itself too.
    """
    value = renewed_scene(value)
    stated = formed(forms.SCENE, value, place="scene", elsewhere=forms.BELONGS)
    found = tuple(_contradictions(stated))
    if found:
        raise FileError.of(found)
    cell = cell_of(stated.cell)
    wrong = cell.defect()
    if wrong is not None:
        raise FileError("PARAMETERS_WRONG", "scene.cell", wrong)
    scene = None if stated.view is None else _scene(stated.view, cell)
    return Situation(
        cell=cell,
        scene=scene,
        age_s=None if stated.view is None else stated.view.age_s,
        held=None if stated.held is None else _held(stated.held),
        touch=frozenset(stated.touch),
        robot=stated.cell.robot,
    )


def cell_of(stated: Any) -> CellParameters:
    """Parameters of the physics room that a file's cell states."""
    given = {each.name: getattr(stated, each.name) for each in fields(CellParameters) if hasattr(stated, each.name)}
    contacts = tuple(Contact(each.object, each.by) for each in stated.contacts)
    payload = None if stated.payload_kg == forms.UNKNOWN else stated.payload_kg
    return CellParameters(**given | {"contacts": contacts, "payload_kg": payload})


def _contradictions(stated: Any) -> Iterator[Fault]:
    """Contradictions of a scene that has its form, thing by thing."""
    cell, view, held = stated.cell, stated.view, stated.held
    yield from contradictions.of_cell(cell, "scene.cell")
    known = {thing.name for thing in cell.objects}
    if view is not None:
        yield from contradictions.of_view(view, cell, "scene.view")
        known |= {thing.id for thing in view.objects}
    for row, contact in enumerate(cell.contacts):
        if contact.object not in known:
            yield contradictions.nothing(f"scene.cell.contacts.{row}.object", contact.object, known)
    for row, name in enumerate(stated.touch):
        if name not in known:
            yield contradictions.nothing(f"scene.touch.{row}", name, known)
    if held is not None:
        shapes = {"capsule": held.capsule, "sphere": held.sphere}
        yield from contradictions.one_of("scene.held", held.object, shapes)


def _scene(view: forms.SeenView, cell: CellParameters) -> Scene:
    known, source = cell.surveyed, view.source.sensor
    people = (replace(body_of(seen), source=seen.sensor or source, age_s=seen.age_s) for seen in view.people)
    scene = replace(
        known,
        people=tuple(people),
        objects=(*known.objects, *(_thing(seen, cell, source) for seen in view.objects)),
        complete=view.complete,
    )
    wrong = scene.defect()
    if wrong is not None:
        raise FileError("PERCEPTION_INVALID", "scene.view", wrong)
    return scene


def body_of(seen: forms.ShownPerson) -> Person:
    """Body of a person whose form was checked."""
    match seen.standing_adult, seen.adult_at_distance:
        case forms.StandingAdult(x, y, facing), _:
            return standing_adult(x, y, facing_rad=facing, name=seen.id)
        case _, forms.AdultAtDistance(surface, bearing):
            return adult_at_distance(surface, bearing_rad=bearing, name=seen.id)
        case _:
            regions = (seen.regions if isinstance(seen, forms.SeenPerson) else None) or ()
            return Person(seen.id, tuple((each.region, _round(each.capsule, each.sphere)) for each in regions))


def shape_in(thing: Any) -> Shape:
    """The one shape of a thing whose form was checked."""
    shape: Shape = next(found for word in forms.SHAPES if (found := getattr(thing, word)) is not None)
    return shape


def _thing(seen: forms.SeenObject, cell: CellParameters, source: str) -> Thing:
    uncertainty = cell.object_uncertainty_m if seen.uncertainty_m is None else seen.uncertainty_m
    return Thing(seen.id, seen.kind, shape_in(seen), uncertainty, seen.sensor or source, seen.age_s)


def _held(stated: forms.HeldObject) -> GrippedObject:
    return GrippedObject(stated.object, _round(stated.capsule, stated.sphere), stated.mass_kg, stated.blunt)


def _round(capsule: Capsule | None, sphere: Sphere | None) -> Capsule | Sphere:
    shape = sphere if capsule is None else capsule
    if shape is None:
        raise FileError("PARAMETERS_WRONG", "scene", "a body without a shape")  # unchecked
    return shape
