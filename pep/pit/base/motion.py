"""Motions of the arm as path and profile: straight joint motions with a trapezoid of speed, and the others.

A joint move with blend 0 is a straight segment in joint space, so what it sweeps does not depend on its timing; a joint
speed held for a while is one too, and ends where the stop after it ends. The path parameter s runs from 0 to 1; the
profile gives the rate of s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, TypeAlias, assert_never

import numpy as np
from numpy.typing import NDArray

Joints: TypeAlias = tuple[float, float, float, float, float, float]
Pose: TypeAlias = tuple[float, float, float, float, float, float]
"""Of the tool in the base frame: position, m, then rotation vector, rad."""
Floats: TypeAlias = NDArray[np.float64]

STILL_RAD: Final = 1e-9  # below the controller's resolution: such a move is none


@dataclass(frozen=True, slots=True)
class MoveJ:
    """A straight move in joint space; the axis with the longest way leads, all arrive together.

    Attributes:
        start, target: joint angles, rad.
        speed_rad_s: greatest speed of the leading axis.
        acceleration_rad_s2: of the leading axis, also for braking at the end.
    """

    start: Joints
    target: Joints
    speed_rad_s: float
    acceleration_rad_s2: float


@dataclass(frozen=True, slots=True)
class GripperMove:
    """A move of the fingers while the arm rests at `q`.

    Attributes:
        q: joint angles, rad.
        width_m: opening asked for.
        speed_m_s: of the fingers.
        force_n: of the grip.
    """

    q: Joints
    width_m: float
    speed_m_s: float
    force_n: float


@dataclass(frozen=True, slots=True)
class SpeedJ:
    """Joint speeds held for a while: a ramp up, the hold, and the cell's own stop at the end.

    Attributes:
        start: joint angles, rad.
        qd_rad_s: the six speeds.
        acceleration_rad_s2: of the leading axis, up to its speed.
        duration_s: from the first movement until the stop is sent, ramp included.
    """

    start: Joints
    qd_rad_s: Joints
    acceleration_rad_s2: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class MoveL:
    """A straight line of the tool, which turns evenly about one axis meanwhile; from rest to rest.

    Attributes:
        start: joint angles, rad.
        target: pose of the tool at the end.
        speed_m_s: greatest speed of the tool point.
        acceleration_m_s2: of the tool point, also for braking at the end.
        stated_start: pose that the robot says its tool has at `start`, or None when it says nothing.
    """

    start: Joints
    target: Pose
    speed_m_s: float
    acceleration_m_s2: float
    stated_start: Pose | None = None


@dataclass(frozen=True, slots=True)
class JointLeg:
    """One leg of a joint path.

    Its end (rad), speed and acceleration of the leading axis, and blend at the end.
    """

    target: Joints
    speed_rad_s: float
    acceleration_rad_s2: float
    blend_m: float = 0.0


@dataclass(frozen=True, slots=True)
class LineLeg:
    """One leg of a linear path.

    Its end, speed and acceleration of the tool point, and blend at the end.
    """

    target: Pose
    speed_m_s: float
    acceleration_m_s2: float
    blend_m: float = 0.0


@dataclass(frozen=True, slots=True)
class JointPath:
    """Joint moves one after the other, each from rest to rest.

    Attributes:
        start: joint angles, rad.
        legs: in order, at least one.
    """

    start: Joints
    legs: tuple[JointLeg, ...]


@dataclass(frozen=True, slots=True)
class LinePath:
    """Lines of the tool one after the other, each from rest to rest.

    Attributes:
        start: joint angles, rad.
        legs: in order, at least one.
    """

    start: Joints
    legs: tuple[LineLeg, ...]


@dataclass(frozen=True, slots=True)
class JointTrajectory:
    """Joint angles at stated times, gone through without a stop at each; from rest to rest.

    Attributes:
        times_s: of the points, rising from 0; two at least.
        points: joint angles at each time, rad.
        speeds: joint speeds at each time, rad/s; none where the points state none.
    """

    times_s: tuple[float, ...]
    points: tuple[Joints, ...]
    speeds: tuple[Joints, ...] = ()

    @property
    def start(self) -> Joints:
        """Joint angles of the first point."""
        return self.points[0]


@dataclass(frozen=True, slots=True)
class BlendedPath:
    """Joint moves and lines in any order, each of its own speed; corners with a blend are cut.

    Attributes:
        start: joint angles, rad.
        legs: in order, at least one; the last has no blend.
    """

    start: Joints
    legs: tuple[JointLeg | LineLeg, ...]


@dataclass(frozen=True, slots=True)
class SpeedL:
    """A tool velocity held for a while: a ramp up, the hold, and the cell's own stop at the end.

    Attributes:
        start: joint angles, rad.
        twist: velocity of the tool point, m/s, then of its turning, rad/s, in the base frame.
        acceleration_m_s2: of the largest of the six, up to its speed.
        duration_s: from the first movement until the stop is sent, ramp included.
    """

    start: Joints
    twist: Pose
    acceleration_m_s2: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class ServoJ:
    """One target of a stream of joint angles, sent while the arm may be moving.

    Attributes:
        start: measured joint angles, rad.
        qd_rad_s: measured joint speeds.
        target: joint angles to follow, rad.
        period_s: until the next target is due.
        lookahead_s: within which the controller makes for the target.
    """

    start: Joints
    qd_rad_s: Joints
    target: Joints
    period_s: float
    lookahead_s: float


@dataclass(frozen=True, slots=True)
class OutputSet:
    """Switching a digital output: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool."""

    pin: int
    value: bool


@dataclass(frozen=True, slots=True)
class Run:
    """Straight joint motion from rest to rest, in one form for all commands.

    Attributes:
        start, target: joint angles, rad; both ends are at rest.
        speed_rad_s: greatest speed of the leading axis.
        acceleration_rad_s2, braking_rad_s2: of the leading axis, at the start and at the end.
    """

    start: Joints
    target: Joints
    speed_rad_s: float
    acceleration_rad_s2: float
    braking_rad_s2: float


Driven: TypeAlias = MoveL | SpeedL | ServoJ
"""Motions of the whole arm that are no straight run."""
Paths: TypeAlias = JointPath | LinePath | BlendedPath
"""Motions of several legs."""
Motion: TypeAlias = MoveJ | SpeedJ | Driven | Paths | JointTrajectory | GripperMove | OutputSet
Straight: TypeAlias = MoveJ | Run


def run_of(motion: MoveJ | SpeedJ, *, stop_delay_s: float, stop_deceleration_rad_s2: float) -> Run:
    """The motion as a run.

    A held speed goes on until its stop takes hold, and over that stop's way.
    """
    match motion:
        case MoveJ(start, target, speed, acceleration):
            return Run(start, target, speed, acceleration, acceleration)
        case SpeedJ(start, qd, acceleration, duration):
            leading = max(abs(each) for each in qd)
            if not leading > 0:
                return Run(start, start, 0.0, acceleration, stop_deceleration_rad_s2)
            held_s = duration + stop_delay_s
            ramp_s = min(leading / acceleration, held_s)
            peak = min(leading, acceleration * ramp_s)
            way = peak * (held_s - 0.5 * ramp_s) + 0.5 * peak * peak / stop_deceleration_rad_s2
            a, b, c, d, e, f = (q + v / leading * way for q, v in zip(start, qd, strict=True))
            return Run(start, (a, b, c, d, e, f), leading, acceleration, stop_deceleration_rad_s2)
        case _:
            assert_never(motion)


@dataclass(frozen=True, slots=True)
class Profile:
    """The trapezoid of a motion, in closed form: of the leading axis of a straight joint motion, in radians.

    Of a line of the tool it is the trapezoid of the tool point, and its lengths are metres.

    Attributes:
        way_rad: way of the leading axis, more than 0.
        speed_rad_s: the commanded speed.
        acceleration_rad_s2: the commanded acceleration.
        braking_rad_s2: of the end; that of the start when not given.
        peak_rad_s: speed that the leading axis reaches: a short motion never gets to the commanded one.
    """

    way_rad: float
    speed_rad_s: float
    acceleration_rad_s2: float
    braking_rad_s2: float = math.nan
    peak_rad_s: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Takes the acceleration as the braking where no braking is given."""
        up, down = self.acceleration_rad_s2, self.braking_rad_s2
        if math.isnan(down):
            down = up
            object.__setattr__(self, "braking_rad_s2", up)
        peak = min(self.speed_rad_s, math.sqrt(2 * self.way_rad * up * (down / (up + down))))
        object.__setattr__(self, "peak_rad_s", peak)

    @property
    def duration_s(self) -> float:
        """Time from rest to rest."""
        peak = self.peak_rad_s
        return self.way_rad / peak + 0.5 * peak / self.acceleration_rad_s2 + 0.5 * peak / self.braking_rad_s2

    @property
    def top(self) -> float:
        """Path parameter at which the peak is reached first."""
        return min(0.5 * self.peak_rad_s**2 / self.acceleration_rad_s2 / self.way_rad, 1.0)

    def rate(self, s: Floats) -> Floats:
        """ds/dt at path parameter `s`, 1/s.

        It rises with the root of the way so far, and falls by the same law.
        """
        up = np.sqrt(2 * self.acceleration_rad_s2 * self.way_rad * np.maximum(s, 0))
        down = np.sqrt(2 * self.braking_rad_s2 * self.way_rad * np.maximum(1 - s, 0))
        return np.asarray(np.minimum(self.peak_rad_s, np.minimum(up, down)) / self.way_rad)

    def highest_rate(self, low: Floats, high: Floats) -> Floats:
        """Supremum of ds/dt on [low, high]: the rate rises until the peak and never rises again."""
        top = self.top
        spanned = (low <= top) & (top <= high)
        nearest = np.minimum(np.maximum(top, low), high)
        return np.asarray(np.where(spanned, self.peak_rad_s / self.way_rad, self.rate(nearest)))

    def at(self, t_s: float) -> tuple[float, float]:
        """(s, ds/dt) at time `t_s` after the start, by the time domain; shares only the peak with `rate`."""
        peak, duration = self.peak_rad_s, self.duration_s
        ramp, fall = peak / self.acceleration_rad_s2, peak / self.braking_rad_s2
        t = min(max(t_s, 0.0), duration)
        if t < ramp:
            return 0.5 * self.acceleration_rad_s2 * t * t / self.way_rad, self.acceleration_rad_s2 * t / self.way_rad
        if t <= duration - fall:
            return peak * (t - 0.5 * ramp) / self.way_rad, peak / self.way_rad
        left = duration - t
        return 1 - 0.5 * self.braking_rad_s2 * left * left / self.way_rad, self.braking_rad_s2 * left / self.way_rad

    def time_of(self, s: float) -> float:
        """Time at which path parameter `s` is reached, s."""
        peak = self.peak_rad_s
        rise_way, fall_way = 0.5 * peak**2 / self.acceleration_rad_s2, 0.5 * peak**2 / self.braking_rad_s2
        way = min(max(s, 0.0), 1.0) * self.way_rad
        if way <= rise_way:
            return math.sqrt(2 * way / self.acceleration_rad_s2)
        if way <= self.way_rad - fall_way:
            return peak / self.acceleration_rad_s2 + (way - rise_way) / peak
        return self.duration_s - math.sqrt(2 * max(self.way_rad - way, 0.0) / self.braking_rad_s2)


def profile_of(move: Straight, speed_rad_s: float | None = None) -> Profile | None:
    """Profile of the move (at another commanded speed, when one is given); None for a move without way.

    A held speed at a lower speed covers less way; on the way of the higher one the profile is still a bound of it.
    """
    way = max(abs(b - a) for a, b in zip(move.start, move.target, strict=True))
    if not way > STILL_RAD:
        return None
    speed = move.speed_rad_s if speed_rad_s is None else speed_rad_s
    braking = move.braking_rad_s2 if isinstance(move, Run) else move.acceleration_rad_s2
    return Profile(way, speed, move.acceleration_rad_s2, braking)
