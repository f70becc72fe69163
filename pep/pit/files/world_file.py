"""A world file of any use: its use, its situation, and all of its faults."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final

from pep.pit.base.errors import ModelError
from pep.pit.files import world_forms as forms
from pep.pit.files.cell_draft import BACKDATED_S, MALFORMED, statement_of
from pep.pit.files.faults import Fault
from pep.pit.files.old_files import OLD_SCENE, renewed_draft, renewed_scene, renewed_shown
from pep.pit.files.plain_file import FileError, formed
from pep.pit.files.scene_file import Situation, body_of, cell_of, shape_in, situation_of
from pep.pit.files.shown_file import shown_of
from pep.pit.robot.robot import Robot
from pep.pit.scene.cell import CellParameters
from pep.pit.scene.remarks import remarks
from pep.pit.scene.scene import Thing

if TYPE_CHECKING:
    from pep.pit.scene.remarks import Remark

SHOWN_AT_FIRST: Final = "sensor"
"""Source of what a simulated sensor shows."""


class Use(StrEnum):
    """Use of a world file."""

    DRAFT = "draft of a cell file"
    SCENE = "scene of a question"
    SHOWN = "scene of a simulated sensor"


@dataclass(frozen=True, slots=True)
class Checked:
    """Result of a check: faults, for which the file is refused, and remarks, for which it is not.

    Attributes:
        situation: what stands and is seen, or None where a fault hides it.
    """

    use: Use
    faults: tuple[Fault, ...]
    remarks: tuple[Remark, ...]
    situation: Situation | None


def use_of(value: object) -> Use:
    """Use of a file, by the parts that it has; without any it is a draft."""
    if not isinstance(value, dict):
        return Use.DRAFT
    if "cell" in value:
        return Use.SCENE if value.keys() & {"view", "held", "touch"} or value.get("form") == OLD_SCENE else Use.DRAFT
    shown = "view" in value or (value and "form" not in value and value.keys() <= {"people", "objects"})
    return Use.SHOWN if shown else Use.DRAFT


def renewed(value: object) -> object:
    """The value in the words of the world file, if it is of an earlier form.

    Raises:
        FileError: an old draft of mixed units.
    """
    use = use_of(value)
    return (renewed_scene if use is Use.SCENE else renewed_shown if use is Use.SHOWN else renewed_draft)(value)


def situation_in(value: object) -> Situation:
    """Situation in a file of any use.

    Raises:
        FileError: as the reader of that use; a draft only has to have its form.
    """
    use = use_of(value)
    if use is Use.SCENE:
        return situation_of(value)
    if use is Use.SHOWN:
        view = shown_of(value)
        things = tuple(Thing(each.id, each.kind, shape_in(each), 0.0, SHOWN_AT_FIRST) for each in view.objects)
        people = tuple(replace(body_of(each), source=SHOWN_AT_FIRST) for each in view.people)
        cell = CellParameters(objects=())
        return Situation(cell, replace(cell.surveyed, people=people, objects=things), 0.0, None, frozenset())
    stated: Any = formed(forms.DRAFT, renewed_draft(value), place="file", elsewhere=forms.BELONGS)
    cell = cell_of(stated.cell)
    wrong = cell.defect()
    if wrong is not None:
        raise FileError(MALFORMED, "cell", wrong)
    return Situation(cell, None, None, None, frozenset(), stated.cell.robot)


def checked(value: object) -> Checked:
    """Everything that is wrong with a file for its use, and everything that looks odd."""
    use, found, situation = use_of(value), list[Fault](), None
    try:
        if use is Use.DRAFT:
            statement_of(value, at=BACKDATED_S, days=1)
    except FileError as error:
        found += error.faults
    try:
        situation = situation_in(value)
    except FileError as error:
        found += () if use is Use.DRAFT else error.faults
    seen = None if situation is None else situation.scene or situation.cell.surveyed
    if situation is not None and situation.robot is not None:
        found += _robot_faults(situation.robot, situation.cell.tool)
    return Checked(use, tuple(found), () if seen is None else tuple(remarks(seen)), situation)


def _robot_faults(name: str, tool: str) -> list[Fault]:
    """Faults of a shipped model's name and tool.

    A model file is not looked into.
    """
    if "." in name:
        return []
    try:
        Robot.load(name)
    except ModelError as error:
        return [Fault(MALFORMED, "cell.robot", error.detail)]
    tools = [each.name for each in Robot.load(name).model.tools]
    if tool in tools:
        return []
    return [Fault(MALFORMED, "cell.tool", f"'{tool[:48]}': no tool of {name}; there are {', '.join(tools)}")]
