"""Curve through the points of a trajectory: between two of them each joint's speed changes evenly, twice.

A joint goes from one point's speed to that of the middle of the time, and from there to the next point's, each with one
acceleration. The middle's speed is the one that makes the way come out, so the curve meets every point at its time and
speed. Without stated speeds a point has the harmonic mean of the speeds to both sides, and none where these differ in
sign: then no joint leaves the angles of its two points in between. This is what the gateway sends, and no other curve
is assessed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats, JointTrajectory


@dataclass(frozen=True, slots=True, eq=False)
class TimedCurve:
    """Joint angles and speeds by time, between nodes at which the acceleration changes.

    Attributes:
        t: times of the nodes, (n,), s, rising from 0.
        q, v: joint angles and speeds there, (n, 6), rad and rad/s.
        a: accelerations between two nodes, (n - 1, 6), rad/s2.
    """

    t: Floats
    q: Floats
    v: Floats
    a: Floats

    @property
    def duration_s(self) -> float:
        """Time of the last point."""
        return float(self.t[-1])

    @property
    def fastest_rad_s(self) -> float:
        """Greatest speed of any joint."""
        return float(np.abs(self.v).max())

    @property
    def hardest_rad_s2(self) -> float:
        """Greatest acceleration of any joint."""
        return float(np.abs(self.a).max())

    def at(self, t_s: float) -> tuple[Floats, Floats]:
        """Joint angles and speeds at a time, (6,) each; before the first point those of it, likewise after the last."""
        t = min(max(t_s, 0.0), self.duration_s)
        k = min(max(int(np.searchsorted(self.t, t, side="right")) - 1, 0), len(self.a) - 1)
        on = t - float(self.t[k])
        return self.q[k] + on * (self.v[k] + 0.5 * on * self.a[k]), self.v[k] + on * self.a[k]


def curve_of(motion: JointTrajectory) -> TimedCurve:
    """The curve through the points."""
    times, points = np.array(motion.times_s), np.array(motion.points)
    step = np.diff(times)[:, None]
    mean = np.diff(points, axis=0) / step
    speeds = np.array(motion.speeds) if motion.speeds else _even(mean)
    middle = 2 * mean - 0.5 * (speeds[:-1] + speeds[1:])
    first, second = (middle - speeds[:-1]) / (0.5 * step), (speeds[1:] - middle) / (0.5 * step)
    halfway = points[:-1] + 0.25 * step * (speeds[:-1] + middle)  # half of the time at the mean of two speeds
    return TimedCurve(
        t=_between(times[:, None], times[:-1, None] + 0.5 * step)[:, 0],
        q=_between(points, halfway),
        v=_between(speeds, middle),
        a=np.stack([first, second], axis=1).reshape(-1, points.shape[1]),
    )


def _even(mean: Floats) -> Floats:
    """Speeds at the points of a curve from rest to rest, from the mean speeds between them."""
    before, after = mean[:-1], mean[1:]
    both = before + after
    same = before * after > 0
    inner = np.where(same, 2 * before * after / np.where(same, both, 1.0), 0.0)
    still = np.zeros((1, mean.shape[1]))
    return np.concatenate([still, inner, still])


def _between(outer: Floats, inner: Floats) -> Floats:
    """Rows of `outer` with those of `inner`, which is one shorter, between them."""
    rows = np.empty((len(outer) + len(inner), outer.shape[1]))
    rows[::2], rows[1::2] = outer, inner
    return rows
