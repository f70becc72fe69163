"""What is asked of the arm, as path and profile: straight joint moves with a trapezoid of speed, and gripper moves.

A joint move with blend 0 is a straight segment in joint space, so what it sweeps does not depend on its timing. The
path parameter s runs from 0 to 1; the profile gives the rate of s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

Joints: TypeAlias = tuple[float, float, float, float, float, float]
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


Motion: TypeAlias = MoveJ | GripperMove


@dataclass(frozen=True, slots=True)
class Profile:
    """The trapezoid of a joint move, in closed form.

    Attributes:
        way_rad: way of the leading axis, more than 0.
        speed_rad_s: the commanded speed.
        acceleration_rad_s2: the commanded acceleration.
    """

    way_rad: float
    speed_rad_s: float
    acceleration_rad_s2: float

    @property
    def peak_rad_s(self) -> float:
        """Speed that the leading axis reaches: a short move never gets to the commanded one."""
        return min(self.speed_rad_s, math.sqrt(self.acceleration_rad_s2 * self.way_rad))

    @property
    def duration_s(self) -> float:
        """Time from rest to rest."""
        return self.way_rad / self.peak_rad_s + self.peak_rad_s / self.acceleration_rad_s2

    def rate(self, s: Floats) -> Floats:
        """ds/dt at path parameter `s`, 1/s: speed rises with the root of the way made, and falls likewise."""
        to_end = np.clip(np.minimum(s, 1 - s), 0, None)
        ramp = np.sqrt(2 * self.acceleration_rad_s2 * self.way_rad * to_end)
        return np.asarray(np.minimum(self.peak_rad_s, ramp) / self.way_rad)

    def highest_rate(self, low: Floats, high: Floats) -> Floats:
        """Supremum of ds/dt on [low, high]: the rate rises up to the middle of the path and falls from there."""
        return self.rate(np.clip(0.5, low, high))

    def at(self, t_s: float) -> tuple[float, float]:
        """(s, ds/dt) at time `t_s` after the start, from the time domain: shares nothing with `rate` but the peak."""
        peak, acceleration, duration = self.peak_rad_s, self.acceleration_rad_s2, self.duration_s
        ramp = peak / acceleration
        t = min(max(t_s, 0.0), duration)
        if t < ramp:
            return 0.5 * acceleration * t * t / self.way_rad, acceleration * t / self.way_rad
        if t <= duration - ramp:
            return peak * (t - 0.5 * ramp) / self.way_rad, peak / self.way_rad
        left = duration - t
        return 1 - 0.5 * acceleration * left * left / self.way_rad, acceleration * left / self.way_rad

    def time_of(self, s: float) -> float:
        """Time at which path parameter `s` is reached, s."""
        ramp_way = 0.5 * self.peak_rad_s**2 / self.acceleration_rad_s2
        way = min(max(s, 0.0), 1.0) * self.way_rad
        if way <= ramp_way:
            return math.sqrt(2 * way / self.acceleration_rad_s2)
        if way <= self.way_rad - ramp_way:
            return self.peak_rad_s / self.acceleration_rad_s2 + (way - ramp_way) / self.peak_rad_s
        return self.duration_s - math.sqrt(2 * max(self.way_rad - way, 0.0) / self.acceleration_rad_s2)


def profile_of(move: MoveJ, speed_rad_s: float | None = None) -> Profile | None:
    """The move's profile (at another commanded speed, when one is given), or None when it goes nowhere."""
    way = max(abs(b - a) for a, b in zip(move.start, move.target, strict=True))
    if not way > STILL_RAD:
        return None
    return Profile(way, move.speed_rad_s if speed_rad_s is None else speed_rad_s, move.acceleration_rad_s2)
