"""Record of a curved motion, read: a course with its timing, or a fixed answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pep.pit.checker.robot import JOINTS
from pep.pit.checker.stance import stance
from pep.pit.checker.trace_pieces import PLACE
from pep.pit.checker.verdict import Code, need

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit.checker.course import CheckerCourse
    from pep.pit.checker.motion import Timing
    from pep.pit.checker.robot import CheckerRobot
    from pep.pit.checker.stance import CheckerStance, Six

RECORD: Final = ("doubt", "edges", "second", "third", "nodes", "until", "ahead", "angles", "seconds")
NOT_TRACED: Final[dict[str, Any]] = {
    "doubt": None, "edges": [], "second": [], "third": [], "nodes": [], "until": 0, "ahead": None, "angles": [],
    "seconds": None,
}  # fmt: skip
"""Record of a motion that needs no course."""
NONE: Final[tuple[float, ...]] = (0.0,) * JOINTS


@dataclass(frozen=True, slots=True)
class FixedAnswer:
    """Motion with a fixed answer: no motion at all, one beyond a joint limit, or one without trace.

    Attributes:
        index: of it; the view's floor counts beside it where it moves at all.
        violations: of it.
        doubt: reason why nothing of it is proven, or None when it is no motion.
    """

    index: float
    violations: tuple[str, ...]
    doubt: str | None


@dataclass(frozen=True, slots=True)
class CheckerTimedCourse:
    """A course with its timing.

    Attributes:
        course: path of the joints.
        timing: its timing.
        push: the greatest s'' that the motion itself asks for, 1/s^2.
        tool_speed: that is commanded for the tool point, m/s.
        doubt: reason why it is not proven to its end, or None.
        end: joint angles where it ends, when it is proven to there.
    """

    course: CheckerCourse
    timing: Timing
    push: float
    tool_speed: float
    doubt: str | None
    end: Six


def fixed(row: dict[str, Any], index: float, violations: tuple[str, ...], doubt: str | None) -> FixedAnswer:
    """Fixed answer, for which nothing is recorded.

    Raises:
        Refusal: something is.
    """
    need(row == NOT_TRACED | {"doubt": doubt} and type(row["until"]) is int, Code.ANSWER_WRONG, PLACE)
    return FixedAnswer(index, violations, doubt)


def beyond(robot: CheckerRobot, q: Sequence[float], around: Sequence[float] = NONE) -> bool:
    """True where a joint may be beyond its range when each is within `around` of `q`, rad."""
    rows = zip(q, around, robot.ranges, strict=True)
    return not all(low <= angle - room and angle + room <= high for angle, room, (low, high) in rows)


def standing(robot: CheckerRobot, q: Six) -> CheckerStance:
    """Course of an arm that stands.

    Raises:
        Refusal: no joint rates make its tool go as it likes there.
    """
    here = stance(robot, q)
    need(here is not None, Code.NODE_OFF, "where the arm stands: singular")
    assert here is not None
    return here
