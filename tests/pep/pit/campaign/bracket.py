"""Samples of a straight motion until nothing that counts is hidden between them.

What counts: the highest index, with and without the allowances; the least clearance; a violation of a kind that was not
met; a speed beside its limit; whether an allowance holds. Where what can be between two samples (`between`) is worse
than what was sampled by more than is granted, the interval is cut. So what was sampled is that near to what is.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from tests.pep.pit.campaign.between import Bounds
from tests.pep.pit.campaign.dense import LEAST_LAW_M, VIOLATED_BY_M
from tests.pep.pit.campaign.laws import ratio_law

CLOSE = 0.004
"""By how much an index between samples may be above the highest sampled one."""
CLOSE_M = 2e-5
"""By how much a clearance between samples may be below the least sampled one, or below what allows or violates."""
CLOSE_M_S = 2e-4
"""By how much a speed between samples may be above the fastest sampled one, or above what allows."""
CUTS_MOST = 8
SAMPLES_MOST = 3000


def closed(world, *, at_least_m=LEAST_LAW_M):
    """Sample until nothing that counts is hidden: whether that was reached with so many samples."""
    world.place(at_least_m=at_least_m)
    world.more(world.run.first())
    bounds = bounds_of(world, np.arange(len(world.times) - 1))
    while len(world.times) < SAMPLES_MOST:
        cuts = pieces(world, bounds, at_least_m)
        cut = np.flatnonzero(cuts > 1)
        if not len(cut):
            return True
        low, high = world.times[cut], world.times[cut + 1]
        inner = [a + (b - a) * np.arange(1, n) / n for a, b, n in zip(low, high, cuts[cut].tolist(), strict=True)]
        new = world.more(np.concatenate(inner))
        fresh = np.zeros(len(world.times), bool)
        fresh[new] = True
        fresh = fresh[:-1] | fresh[1:]
        bounds = _merged(bounds.taken(cuts <= 1), bounds_of(world, np.flatnonzero(fresh)), fresh)
    return False


@dataclass(frozen=True)
class Worst(Bounds):
    """Bounds, and per interval and column the index that they allow."""

    index: np.ndarray

    def taken(self, which):
        """Those of these intervals."""
        return Worst(*(getattr(self, f.name)[which] for f in fields(self)))


def bounds_of(world, at):
    """Bounds of the intervals from sample `at` to the next."""
    found = world.between.bounds(world, at)
    return Worst(found.clear, found.speed, found.points, world.columns.index(found.clear, found.speed))


def _merged(old, new, fresh):
    def both(name):
        mine, others = getattr(old, name), getattr(new, name)
        whole = np.empty((len(fresh), mine.shape[1]))
        whole[~fresh], whole[fresh] = mine, others
        return whole

    return Worst(*(both(f.name) for f in fields(Worst)))


def pieces(world, bounds, at_least_m):
    """Number of pieces that each interval is cut into, one where it is done: the excess falls with their square."""
    excess = doubts(world, bounds, at_least_m)
    wanted = np.clip(np.ceil(np.sqrt(np.fmax(excess, 1))), 2, CUTS_MOST).astype(int)
    return np.where(excess <= 1, 1, wanted)


def doubts(world, bounds, at_least_m):
    """Excess of each interval's possible index over the sampled one, by the granted tolerance; at most 1 when done."""
    seen, cell = world.seen(), world.cell
    retreats, gentle = world.allowed()
    excess = (bounds.index.max(axis=1, initial=0.0) - seen.high) / CLOSE
    around = bounds.clear[:, : world.around]
    nearest = min(seen.nearest, at_least_m)
    excess = np.maximum(excess, (nearest - around.min(axis=1, initial=np.inf)) / CLOSE_M)
    if retreats.any() or gentle.any():
        index = np.where(retreats, 3.0, np.where(gentle, np.minimum(bounds.index, 2), bounds.index))
        excess = np.maximum(excess, (index.max(axis=1) - seen.low) / CLOSE)
    below = world.columns.below
    unmet = np.isfinite(below) & ~retreats & ~gentle & ~np.isin(world.columns.kinds, list(seen.violated))
    excess = _beyond(excess, (below - VIOLATED_BY_M - bounds.clear)[:, unmet] / CLOSE_M)
    if retreats.any():
        best = np.minimum(below, np.maximum.accumulate(world.clear, axis=0))[:-1, retreats]
        excess = _beyond(excess, (best - cell.retreat_tolerance_m - bounds.clear[:, retreats]) / CLOSE_M)
    if gentle.any():
        clear, speed = bounds.clear[:, gentle], bounds.speed[:, gentle]
        near = (cell.contact_near_m - clear) / CLOSE_M
        fast = (speed - cell.contact_speed_m_s) / CLOSE_M_S
        deep = (-cell.contact_depth_m - clear) / CLOSE_M
        excess = _beyond(excess, np.minimum(near, np.maximum(fast, deep)))
    fastest = world.shots.points.max(axis=0)
    allowed = world.speed_ratios(np.maximum(fastest, bounds.points.max(axis=0)))
    if max(map(ratio_law, allowed.values())) > seen.high + CLOSE:
        excess = _beyond(excess, (bounds.points - fastest) / CLOSE_M_S)
    return excess


def _beyond(excess, more):
    return np.maximum(excess, more.max(axis=1, initial=-np.inf))
