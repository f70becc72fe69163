"""Compiled engine: answers the costly questions of a motion, straight or curved."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from pep.pit.search.kernel import compiled_course, compiled_path
from pep.pit.search.kernel import compiled_limits as demands

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit.base.motion import Straight
    from pep.pit.path.course import Cells
    from pep.pit.path.course_angles import Track
    from pep.pit.path.line_trace import CutShort, LineTrace
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.search.kernel.compiled_course import CompiledCourse
    from pep.pit.search.kernel.compiled_limits import Demands
    from pep.pit.search.kernel.compiled_path import CompiledPath


@dataclass(frozen=True, slots=True)
class Engine:
    """Costly questions of motions, answered in one way. Tests put a slow twin in its place.

    Attributes:
        name: in every assessment and record.
        path: a straight path of one robot.
        demands: demands of a move on such a path.
        trace: the joints' path under a line of the tool.
        course: a course of one robot, from its cells and where exactly it is.
    """

    name: str
    path: Callable[[Robot, Straight], CompiledPath]
    demands: Callable[[CompiledPath, CellParameters], Demands]
    trace: Callable[..., LineTrace | CutShort]
    course: Callable[[Robot, Cells, Track], CompiledCourse]


@cache
def chosen() -> Engine:
    """The engine. Its first call compiles it, or reads earlier compilations."""
    compiled_path.compile_all()
    demands.compile_all()
    compiled_course.compile_all()
    return Engine(
        name="numba-1",
        path=compiled_path.CompiledPath,
        demands=demands.Demands,
        trace=compiled_course.trace,
        course=compiled_course.CompiledCourse,
    )
