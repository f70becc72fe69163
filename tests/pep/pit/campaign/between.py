"""Bounds on a straight joint motion between two samples, by its greatest bending.

Of a point that the joints carry, and a motion x along a straight way in joint space, u rad of each joint per rad of x:
with S the sum of |u| up to a joint and r its lever, the first three derivatives by x are at most sum(r u),
sum(r (S^2 - S'^2)) and sum(r (S^3 - S'^3)), S' being the sum before the joint. In time x' is the leading speed and x'' the
acceleration, which is constant between two samples. A curve leaves its chord by at most its second derivative times
h^2 / 8; the distance to a convex shape is no less than that to the plane which a nearest point and its direction name.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tests.pep.pit.campaign.laws import FAR_M
from tests.pep.pit.campaign.timing import SHORTEST

CHORD = 8


@dataclass(frozen=True)
class Bounds:
    """Per interval: clearances are no less (columns), speeds no more (columns), the points' speeds no more."""

    clear: np.ndarray
    speed: np.ndarray
    points: np.ndarray


class Between:
    """The derivatives of one straight motion."""

    def __init__(self, stage, run):
        """For all bodies and points of the stage."""
        share = np.abs(run.unit)
        joints = np.arange(len(share))
        carried = (joints >= stage.past[:, None]) & (joints < stage.links[:, None])
        u = np.where(carried, share, 0.0)
        after = np.cumsum(u, axis=1)
        before = after - u
        lever = stage.levers
        self.first = (lever * u).sum(axis=1)
        self.second = (lever * (after**2 - before**2)).sum(axis=1)
        self.third = (lever * (after**3 - before**3)).sum(axis=1)
        nods = np.cumsum(u * before, axis=1) - u * before
        self.spin = after[:, -1]
        self.spin_first = (u * before).sum(axis=1)
        self.spin_second = (u * (before**2 + nods)).sum(axis=1)
        self.stage, self.run = stage, run

    @property
    def speed_most(self):
        """No body or point is faster, m/s."""
        return (self.first + self.stage.radius * self.spin) * self.run.timing.peak

    def bounds(self, world, at):
        """Of the intervals from sample `at` to the next.

        Raises:
            ValueError: an interval with a kink of the motion inside.
        """
        stage, shots, clear = self.stage, world.shots, world.clear
        times, next_ = world.times, at + 1
        h = (times[next_] - times[at])[:, None]
        inside = self.run.timing.kinks_s[:, None]
        nearest = np.minimum(inside - times[at], times[next_] - inside).max(initial=-np.inf)
        if not nearest <= 2 * SHORTEST * self.run.timing.duration_s:
            raise ValueError("a kink between two samples")
        _, lead = self.run.timing.lead(times)
        fast = np.maximum(lead[at], lead[next_])[:, None]
        gain = np.abs(lead[next_] - lead[at])[:, None] / h
        square = h**2 / CHORD
        sag = (self.second * fast**2 + self.first * gain) * square
        swell = self.third * fast**3 + 3 * self.second * fast * gain
        swell += stage.radius * (self.spin_second * fast**3 + 3 * self.spin_first * fast * gain)
        swell *= square
        most = self.first * fast + stage.radius * self.spin * fast
        counted = len(stage.moving) + len(stage.apart)
        speed = np.maximum(shots.speed[at], shots.speed[next_]) + swell[:, :counted]
        points = np.maximum(shots.points[at], shots.points[next_]) + swell[:, counted:]
        # Faces are straight: the nearer end, and the bend. Everything else by the planes of both samples.
        low = np.minimum(clear[at], clear[next_]) - sag[:, world.mover]
        count, planes = len(at), world.around + len(stage.apart)
        unknown = world.reach_m[:planes]
        sides = np.full((count, planes), -np.inf)
        for here, there in ((at, next_), (next_, at)):
            fall = np.empty((count, planes))
            fall[:, : world.around] = fallen(
                shots.thing_way[here], shots.ends[here], shots.ends[there]
            ).reshape(count, -1)  # fmt: skip
            fall[:, world.around :] = fallen(
                shots.own_way[here][:, :, None], shots.own_ends[here], shots.own_ends[there]
            )[..., 0]
            side = clear[here, :planes] + np.minimum(fall, 0) - sag[:, world.mover[:planes]]
            seen = (clear[here, :planes] < FAR_M) & world.sided(here)
            sides = np.where(seen, np.maximum(sides, side), sides)
        # Without a direction: the way that can be made from one to the other is shared between falling and rising.
        ends = np.minimum(clear[at, :planes], unknown) + np.minimum(clear[next_, :planes], unknown)
        sides = np.maximum(sides, (ends - most[:, world.mover[:planes]] * h) / 2)
        low[:, :planes] = np.maximum(sides, world.least_m[:planes])
        return Bounds(low, speed[:, world.mover], points)


def fallen(way, here, there):
    """By how much the nearer end of each axis falls from here to there along the direction: (n, m, t)."""
    x, y, z = way[..., 0], way[..., 1], way[..., 2]

    def nearer(ends):
        one, two = (
            x * ends[:, :, 0, e, None] + y * ends[:, :, 1, e, None] + z * ends[:, :, 2, e, None] for e in (0, 1)
        )
        return np.minimum(one, two)

    return nearer(there) - nearer(here)
