"""The motion as a straight joint path with a trapezoid of speed (PHY-9, PHY-16)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pep.pit.checker.robot import JOINTS
from pep.pit.checker.text import exact, listed, table, word
from pep.pit.checker.verdict import Code, Refusal, need

if TYPE_CHECKING:
    from pep.pit.checker.question import Cell

STILL_RAD: Final = 1e-9  # a way this short is none: below the controller's resolution
LEAST_RATE: Final = 1e-6  # the least speed, acceleration or time that a request can spell, SI
ANGLE_MOST_RAD: Final = 1e4  # no joint turns farther
MOVE_J: Final = ("form", "start", "target", "speed_rad_s", "acceleration_rad_s2")
SPEED_J: Final = ("form", "start", "qd_rad_s", "acceleration_rad_s2", "duration_s")

Joints = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Run:
    """From rest at `start` to rest at `target`; speed, acceleration and braking are those of the leading axis."""

    start: Joints
    target: Joints
    speed: float
    acceleration: float
    braking: float

    @property
    def ways(self) -> Joints:
        """How far each joint turns, rad."""
        return tuple(b - a for a, b in zip(self.start, self.target, strict=True))


def run_of(value: Any, cell: Cell) -> Run:
    """The run that a motion of the document is in this cell.

    A path of another form is refused by `FORM_UNKNOWN`: a straight line of the tool is no straight joint path, and has
    to record its nodes. Its reader belongs here, its nodes beside `arm.Sweep`.

    Raises:
        Refusal: no such form, or not of it.
    """
    place = "question.motion"
    need(type(value) is dict, Code.MEMBER_WRONG, place)
    match word(value.get("form"), place):
        case "move_j":
            row = table(value, place, MOVE_J)
            acceleration = _rate(row["acceleration_rad_s2"])
            return Run(_six(row["start"]), _six(row["target"]), _rate(row["speed_rad_s"]), acceleration, acceleration)
        case "speed_j":
            row = table(value, place, SPEED_J)
            start, speeds = _six(row["start"]), _six(row["qd_rad_s"])
            return _held_speed(start, speeds, _rate(row["acceleration_rad_s2"]), _rate(row["duration_s"]), cell)
        case _:
            raise Refusal(Code.FORM_UNKNOWN, place)


def _held_speed(start: Joints, speeds: Joints, acceleration: float, duration_s: float, cell: Cell) -> Run:
    """PHY-16: ramp, hold, the delay until the stop takes hold, and the stop's own way."""
    leading = max(abs(speed) for speed in speeds)
    if leading == 0:
        return Run(start, start, 0.0, acceleration, cell.stop_deceleration_rad_s2)
    time = duration_s + cell.stop_delay_s
    if leading >= acceleration * time:  # the ramp fills all of it
        peak = acceleration * time
        way = 0.5 * peak * time
    else:
        peak = leading
        way = peak * time - 0.5 * peak * peak / acceleration
    way += 0.5 * peak * peak / cell.stop_deceleration_rad_s2
    target = tuple(q + speed / leading * way for q, speed in zip(start, speeds, strict=True))
    return Run(start, target, leading, acceleration, cell.stop_deceleration_rad_s2)


def _six(value: Any) -> Joints:
    items = listed(value, "question.motion", least=JOINTS, most=JOINTS)
    return tuple(exact(item, "question.motion", low=-ANGLE_MOST_RAD, high=ANGLE_MOST_RAD) for item in items)


def _rate(value: Any) -> float:
    return exact(value, "question.motion", low=LEAST_RATE)


class Timing:
    """How fast the path parameter s, from 0 to 1, runs: up with the root of the way, a plateau, down likewise."""

    def __init__(self, run: Run) -> None:
        """The trapezoid of a run that goes somewhere."""
        self.way = max(abs(way) for way in run.ways)
        up, down = run.acceleration, run.braking
        # v^2/2a + v^2/2b = way: the speed at which speeding up and braking fill the way.
        self.peak = min(run.speed, math.sqrt(2 * self.way / (1 / up + 1 / down)))
        self._up, self._down = 2 * up / self.way, 2 * down / self.way
        self.plateau = self.peak / self.way
        self._rises_until = min(self.plateau**2 / self._up, 1.0)
        self._falls_from = max(1 - self.plateau**2 / self._down, 0.0)

    def highest(self, low: float, high: float) -> float:
        """The highest ds/dt on [low, high], 1/s."""
        if high < self._rises_until:
            return min(self.plateau, math.sqrt(self._up * high))
        if low > self._falls_from:
            return min(self.plateau, math.sqrt(self._down * (1 - low)))
        return self.plateau
