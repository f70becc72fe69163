"""Which engine answers for curved motions: the compiled one where numba is installed, else the numpy engine.

The twin of `pep.pit.search.engine`, which chooses for straight joint motions; both choose alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Final

from pep.pit.path.course import Course
from pep.pit.path.line_trace import pose_exists, trace
from pep.pit.search import engine
from pep.pit.search.blow import blow_ratio
from pep.pit.search.certify import certify, fits

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit.path.course import Cells
    from pep.pit.path.course_angles import Track
    from pep.pit.path.line_trace import Trace
    from pep.pit.robot.robot import Robot
    from pep.pit.robot.twist import Twist
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.scene import Scene
    from pep.pit.search.certify import Certified, Fit


@dataclass(frozen=True, slots=True)
class Curved:
    """The dear questions of a curved motion, answered in one way.

    Attributes:
        name: in every assessment and record.
        trace: as `pep.pit.path.line_trace.trace`.
        pose_exists: as `pep.pit.path.line_trace.pose_exists`.
        course: a course of one robot, from its cells and where exactly it is.
        certify, fits, blow_ratio: as the functions of these names in `pep.pit.search.certify` and
            `pep.pit.search.blow`.
    """

    name: str
    trace: Callable[..., Trace]
    pose_exists: Callable[[Robot, Twist, int], bool]
    course: Callable[[Robot, Cells, Track], Course]
    certify: Callable[..., Certified]
    fits: Callable[..., Fit]
    blow_ratio: Callable[..., float]


NUMPY: Final = Curved(engine.NUMPY.name, trace, pose_exists, Course, certify, fits, blow_ratio)


def chosen() -> Curved:
    """The engine of this installation. The first call compiles it, or reads what was compiled before."""
    straight = engine.chosen()
    return NUMPY if straight is engine.NUMPY else _compiled(straight.name)


def chosen_for(scene: Scene | None, cell: CellParameters) -> Curved:
    """The engine for questions about this scene, or without one about the bare cell, as `engine.chosen_for`."""
    return NUMPY if engine.chosen_for(scene, cell) is engine.NUMPY else chosen()


@cache
def _compiled(name: str) -> Curved:
    from pep.pit.search.kernel.compiled_course import CompiledCourse, pose_exists, trace

    course = CompiledCourse
    return Curved(name, trace, pose_exists, course, course.certify, course.fits, course.blow_ratio)
