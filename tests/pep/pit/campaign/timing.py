"""A straight joint motion in time: a trapezoid of the leading axis (docs/physics.md, PHY-9), written down once more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pep.pit import MoveJ

STILL = 1e-9
FIRST_LEAST, FIRST_MOST, FIRST_RAD = 12, 48, 0.15
"""First samples: one for so much way of all joints together."""
EDGE = 1e-4
"""Share of the time beside each end at which there is a sample: at rest nothing is met."""
SHORTEST = 1e-9
"""Samples are no nearer than this share of the time."""


@dataclass(frozen=True)
class Timing:
    """Speeding up at `up` to `peak`, holding it, braking at `down`; rad, s, of the leading axis."""

    up: float
    down: float
    peak: float
    hold_s: float

    @property
    def duration_s(self):
        return self.peak / self.up + self.hold_s + self.peak / self.down

    @property
    def kinks_s(self):
        """Times at which the acceleration changes, seconds."""
        return np.array([0.0, self.peak / self.up, self.peak / self.up + self.hold_s, self.duration_s])

    def lead(self, t):
        """Way made and speed at these times."""
        ramp, braking = self.peak / self.up, self.peak / self.up + self.hold_s
        t = np.clip(t, 0, self.duration_s)
        a, b, c = np.minimum(t, ramp), np.clip(t - ramp, 0, self.hold_s), np.clip(t - braking, 0, None)
        way = self.up * a**2 / 2 + self.peak * b + self.peak * c - self.down * c**2 / 2
        speed = np.where(t < ramp, self.up * t, np.where(t <= braking, self.peak, self.peak - self.down * c))
        return way, np.maximum(speed, 0)


@dataclass(frozen=True)
class Driven:
    """A motion in time: joint angles are `start` plus `unit` times the leading axis' way."""

    start: np.ndarray
    unit: np.ndarray
    timing: Timing

    @property
    def end(self):
        return self.start + self.unit * self.timing.lead(np.array([self.timing.duration_s]))[0]

    def at(self, t):
        """Joint angles and joint speeds at these times, (n, 6) each."""
        way, speed = self.timing.lead(t)
        return self.start + way[:, None] * self.unit, speed[:, None] * self.unit

    def first(self):
        """Times of the first samples: even ones, and when the acceleration changes."""
        whole = self.timing.duration_s
        count = int(np.clip(np.abs(self.end - self.start).sum() / FIRST_RAD, FIRST_LEAST, FIRST_MOST))
        edges = [EDGE * whole, (1 - EDGE) * whole]
        return spaced(np.concatenate([np.linspace(0, whole, count + 1), self.timing.kinks_s, edges]), whole)


def driven(motion, cell):
    """The motion in time, or None when it goes nowhere."""
    start = np.array(motion.start)
    if isinstance(motion, MoveJ):
        delta = np.array(motion.target) - start
        way, up = float(np.abs(delta).max()), motion.acceleration_rad_s2
        if way <= STILL:
            return None
        peak = min(motion.speed_rad_s, (up * way) ** 0.5)
        return Driven(start, delta / way, Timing(up, up, peak, way / peak - peak / up))
    asked = np.array(motion.qd_rad_s)
    leading, up = float(np.abs(asked).max()), motion.acceleration_rad_s2
    if leading == 0:
        return None
    until = motion.duration_s + cell.stop_delay_s
    peak = min(leading, up * until)
    return Driven(start, asked / leading, Timing(up, cell.stop_deceleration_rad_s2, peak, until - peak / up))


def spaced(times, whole):
    """These times in their order, none twice."""
    times = np.sort(np.clip(times, 0, whole))
    return times[np.concatenate([[True], np.diff(times) > SHORTEST * whole])]
