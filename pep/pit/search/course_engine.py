"""The compiled engine for curved motions: the one that answers their dear questions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from pep.pit.search import engine
from pep.pit.search.kernel.compiled_course import CompiledCourse, pose_exists, trace

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit.path.course import Cells, Course
    from pep.pit.path.course_angles import Track
    from pep.pit.path.line_trace import Trace
    from pep.pit.robot.robot import Robot
    from pep.pit.robot.twist import Twist
    from pep.pit.search.certify import Certified, Fit


@dataclass(frozen=True, slots=True)
class Curved:
    """The dear questions of a curved motion, answered in one way.

    Attributes:
        name: in every assessment and record.
        trace: as `pep.pit.search.kernel.compiled_course.trace`.
        pose_exists: as `pep.pit.search.kernel.compiled_course.pose_exists`.
        course: a course of one robot, from its cells and where exactly it is.
        certify, fits, blow_ratio: as the methods of these names of `CompiledCourse`.
    """

    name: str
    trace: Callable[..., Trace]
    pose_exists: Callable[[Robot, Twist, int], bool]
    course: Callable[[Robot, Cells, Track], Course]
    certify: Callable[..., Certified]
    fits: Callable[..., Fit]
    blow_ratio: Callable[..., float]


@cache
def chosen() -> Curved:
    """The engine. The first call compiles it, or reads what was compiled before."""
    course = CompiledCourse
    return Curved(engine.chosen().name, trace, pose_exists, course, course.certify, course.fits, course.blow_ratio)
