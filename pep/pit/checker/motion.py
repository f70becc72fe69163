"""Motion of a question in its forms, and its trapezoid of speed (PHY-9, PHY-16, PHY-18 to PHY-21)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

from pep.pit.checker.robot import JOINTS
from pep.pit.checker.text import exact, listed, table, word
from pep.pit.checker.verdict import Code, Refusal, need

if TYPE_CHECKING:
    from pep.pit.checker.question import Cell

STILL_RAD: Final = 1e-9  # a way this short is none: below the controller's resolution
LEAST_RATE: Final = 1e-6  # the least speed, acceleration or time that a request can spell, SI
ANGLE_MOST_RAD: Final = 1e4  # no joint turns farther
LARGEST: Final = 200.0  # m, m/s, m/s2, s: about a tool
TURN_MOST_RAD: Final = 2 * math.pi  # of a rotation vector; a longer one is another pose than it says
LEGS_MOST: Final = 256  # of one path
POINTS_MOST: Final = 256  # of one trajectory
DURATION_MOST_S: Final = 120.0  # of one trajectory
CLOSEST_S: Final = 0.001 * (1 - 1e-9)  # between two of its points
MOVE_J: Final = ("form", "start", "target", "speed_rad_s", "acceleration_rad_s2")
SPEED_J: Final = ("form", "start", "qd_rad_s", "acceleration_rad_s2", "duration_s")
MOVE_L: Final = ("form", "start", "target", "speed_m_s", "acceleration_m_s2", "stated_start")
SPEED_L: Final = ("form", "start", "twist", "acceleration_m_s2", "duration_s")
SERVO_J: Final = ("form", "start", "qd_rad_s", "target", "period_s", "lookahead_s")
PATH: Final = ("form", "start", "legs")
JOINT_LEG: Final = ("target", "speed_rad_s", "acceleration_rad_s2")
TRAJECTORY: Final = ("form", "times_s", "points", "speeds")
LINE_LEG: Final = ("target", "speed_m_s", "acceleration_m_s2")

Joints = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class CheckerRun:
    """From rest at `start` to rest at `target`; speed, acceleration and braking are those of the leading axis."""

    start: Joints
    target: Joints
    speed: float
    acceleration: float
    braking: float

    @property
    def ways(self) -> Joints:
        """Turn of each joint, rad."""
        return tuple(b - a for a, b in zip(self.start, self.target, strict=True))


@dataclass(frozen=True, slots=True)
class CheckerLine:
    """A straight line of the tool to the pose `target` (m, rotation vector in rad), from rest to rest.

    Attributes:
        speed, acceleration: of the tool point, m/s and m/s2.
        stated: place of the tool at the start by the robot's word, or None.
    """

    target: Joints
    speed: float
    acceleration: float
    stated: Joints | None


@dataclass(frozen=True, slots=True)
class CheckerHeldSpeed:
    """Tool velocity (m/s, then rad/s), reached and then held.

    `acceleration` is of its largest part; it is held for `duration_s`.
    """

    velocity: Joints
    acceleration: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class CheckerServo:
    """One target of a stream.

    Measured joint rates, joint angles to follow, time until the next target, and the lookahead.
    """

    rates: Joints
    target: Joints
    period_s: float
    lookahead_s: float


@dataclass(frozen=True, slots=True)
class CheckerTimedPiece:
    """A piece of a trajectory: even joint rates from `start` for `seconds`, and what differs from them at most.

    Attributes:
        start, speed: joint angles at its beginning, rad, and the even rates, rad/s.
        seconds: how long it lasts.
        tube, hurry: difference of the arm's angles and rates, rad and rad/s.
        acceleration: of each joint, the greatest either way, rad/s2.
    """

    start: Joints
    seconds: float
    speed: Joints
    tube: Joints
    hurry: Joints
    acceleration: Joints


@dataclass(frozen=True, slots=True)
class CheckerTrajectory:
    """Joint angles at rising times from 0, with joint rates at each or none; from rest to rest."""

    times: Joints
    points: tuple[Joints, ...]
    speeds: tuple[Joints, ...]


Curved = CheckerLine | CheckerHeldSpeed | CheckerServo | CheckerTimedPiece


@dataclass(frozen=True, slots=True)
class CheckerMotion:
    """Motion of a question, leg by leg; one that is no path has one leg.

    Attributes:
        start: joint angles where the first leg begins, rad; every other begins where the one before ends.
        legs: all straight joint motions, or none.
        path: whether it is one of legs.
        timed: the trajectory that its legs are pieces of; the proof says where these end. None for any other.
    """

    start: Joints
    legs: tuple[CheckerRun | Curved, ...]
    path: bool
    timed: CheckerTrajectory | None = None


def motion_of(value: Any, cell: Cell) -> CheckerMotion:
    """The motion of the document, in this cell.

    Raises:
        Refusal: no such form, or not of it.
    """
    place = "question.motion"
    need(type(value) is dict, Code.MEMBER_WRONG, place)
    match word(value.get("form"), place):
        case "move_j" | "speed_j":
            run = run_of(value, cell)
            return CheckerMotion(run.start, (run,), path=False)
        case "move_l":
            row = table(value, place, MOVE_L)
            stated = None if row["stated_start"] is None else _pose(row["stated_start"])
            line = CheckerLine(_pose(row["target"]), _tool(row["speed_m_s"]), _tool(row["acceleration_m_s2"]), stated)
            return CheckerMotion(_six(row["start"]), (line,), path=False)
        case "speed_l":
            row = table(value, place, SPEED_L)
            held = CheckerHeldSpeed(
                _six(row["twist"], LARGEST), _tool(row["acceleration_m_s2"]), _tool(row["duration_s"])
            )
            return CheckerMotion(_six(row["start"]), (held,), path=False)
        case "servo_j":
            row = table(value, place, SERVO_J)
            servo = CheckerServo(
                _six(row["qd_rad_s"]), _six(row["target"]), _tool(row["period_s"]), _tool(row["lookahead_s"])
            )
            return CheckerMotion(_six(row["start"]), (servo,), path=False)
        case "joint_path":
            return _joint_path(table(value, place, PATH))
        case "line_path":
            row = table(value, place, PATH)
            legs = [table(leg, place, LINE_LEG) for leg in listed(row["legs"], place, least=1, most=LEGS_MOST)]
            lines = (
                CheckerLine(_pose(leg["target"]), _tool(leg["speed_m_s"]), _tool(leg["acceleration_m_s2"]), None)
                for leg in legs
            )
            return CheckerMotion(_six(row["start"]), tuple(lines), path=True)
        case "joint_trajectory":
            timed = _trajectory(table(value, place, TRAJECTORY))
            return CheckerMotion(timed.points[0], (), path=True, timed=timed)
        case _:
            raise Refusal(Code.FORM_UNKNOWN, place)


def _trajectory(row: dict[str, Any]) -> CheckerTrajectory:
    place = "question.motion"
    points = tuple(_six(each) for each in listed(row["points"], place, least=2, most=POINTS_MOST))
    speeds = tuple(_six(each) for each in listed(row["speeds"], place, least=0, most=POINTS_MOST))
    times = tuple(
        exact(each, place, low=0, high=DURATION_MOST_S)
        for each in listed(row["times_s"], place, least=len(points), most=len(points))
    )
    need(len(speeds) in (0, len(points)) and times[0] == 0, Code.MEMBER_WRONG, place)
    need(all(b - a >= CLOSEST_S for a, b in pairwise(times)), Code.MEMBER_WRONG, place)
    for rest in (speeds[0], speeds[-1]) if speeds else ():
        need(max(map(abs, rest)) <= LEAST_RATE, Code.MEMBER_WRONG, place)
    return CheckerTrajectory(times, points, speeds)


def _joint_path(row: dict[str, Any]) -> CheckerMotion:
    place = "question.motion"
    start = at = _six(row["start"])
    legs: list[CheckerRun] = []
    for each in listed(row["legs"], place, least=1, most=LEGS_MOST):
        leg = table(each, place, JOINT_LEG)
        acceleration = _rate(leg["acceleration_rad_s2"])
        target = _six(leg["target"])
        legs.append(CheckerRun(at, target, _rate(leg["speed_rad_s"]), acceleration, acceleration))
        at = target
    return CheckerMotion(start, tuple(legs), path=True)


def run_of(value: dict[str, Any], cell: Cell) -> CheckerRun:
    """Straight run of a joint motion of the document, in this cell.

    Raises:
        Refusal: no such form, or not of it.
    """
    place = "question.motion"
    match word(value.get("form"), place):
        case "move_j":
            row = table(value, place, MOVE_J)
            acceleration = _rate(row["acceleration_rad_s2"])
            return CheckerRun(
                _six(row["start"]), _six(row["target"]), _rate(row["speed_rad_s"]), acceleration, acceleration
            )
        case "speed_j":
            row = table(value, place, SPEED_J)
            start, speeds = _six(row["start"]), _six(row["qd_rad_s"])
            return _held_speed(start, speeds, _rate(row["acceleration_rad_s2"]), _rate(row["duration_s"]), cell)
        case _:
            raise Refusal(Code.FORM_UNKNOWN, place)


def _held_speed(start: Joints, speeds: Joints, acceleration: float, duration_s: float, cell: Cell) -> CheckerRun:
    """PHY-16: ramp, hold, the delay before the stop begins, and the stop's own way."""
    leading = max(abs(speed) for speed in speeds)
    if leading == 0:
        return CheckerRun(start, start, 0.0, acceleration, cell.stop_deceleration_rad_s2)
    time = duration_s + cell.stop_delay_s
    if leading >= acceleration * time:  # the ramp fills all of it
        peak = acceleration * time
        way = 0.5 * peak * time
    else:
        peak = leading
        way = peak * time - 0.5 * peak * peak / acceleration
    way += 0.5 * peak * peak / cell.stop_deceleration_rad_s2
    target = tuple(q + speed / leading * way for q, speed in zip(start, speeds, strict=True))
    return CheckerRun(start, target, leading, acceleration, cell.stop_deceleration_rad_s2)


def _six(value: Any, most: float = ANGLE_MOST_RAD) -> Joints:
    items = listed(value, "question.motion", least=JOINTS, most=JOINTS)
    return tuple(exact(item, "question.motion", low=-most, high=most) for item in items)


def _pose(value: Any) -> Joints:
    pose = _six(value, LARGEST)
    need(math.hypot(*pose[3:]) <= TURN_MOST_RAD, Code.MEMBER_WRONG, "question.motion")
    return pose


def _rate(value: Any) -> float:
    return exact(value, "question.motion", low=LEAST_RATE)


def _tool(value: Any) -> float:
    return exact(value, "question.motion", low=LEAST_RATE, high=LARGEST)


class Timing:
    """Rate of the path parameter s over [0, 1]: rising by the root, a plateau, falling likewise.

    Attributes:
        peak: the speed that is reached; a short motion never gets to the commanded one.
        plateau: the highest ds/dt, 1/s.
    """

    def __init__(self, way: float, speed: float, up: float, down: float) -> None:
        """Makes the trapezoid of a way that is more than 0, in its own unit of length."""
        # v^2/2a + v^2/2b = way: the speed at which speeding up and braking fill the way.
        self.peak = min(speed, math.sqrt(2 * way / (1 / up + 1 / down)))
        self._up, self._down = 2 * up / way, 2 * down / way
        self.plateau = self.peak / way
        self._rises_until = min(self.plateau**2 / self._up, 1.0)
        self._falls_from = max(1 - self.plateau**2 / self._down, 0.0)

    @staticmethod
    def of(run: CheckerRun) -> Timing:
        """Timing of a straight run with a way, by its leading axis."""
        return Timing(max(abs(way) for way in run.ways), run.speed, run.acceleration, run.braking)

    def highest(self, low: float, high: float) -> float:
        """The highest ds/dt on [low, high], 1/s."""
        if high < self._rises_until:
            return min(self.plateau, math.sqrt(self._up * high))
        if low > self._falls_from:
            return min(self.plateau, math.sqrt(self._down * (1 - low)))
        return self.plateau
