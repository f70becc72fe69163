"""Sight of pinocchio and coal, in numpy: the slow twin of `pep.pit.second.compiled_sight`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pep.pit.base.tier import MOVING
from pep.pit.second.second_engine import DISTANCE_TOLERANCE_M, Sight, doubted

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats
    from pep.pit.base.travel import Stopping


def look(world, q: Floats, qd: Floats, kernel: Floats, *, stop: Stopping, since: int, upper: float) -> Sight:
    """Sight at these places; coal measures at the first ones.

    Args:
        q: joint angles, (places, 6), rad.
        qd: their speeds, (places, 6), rad/s.
        kernel: the first engine's clearances at the first places, (measured, pairs).
        stop: the stopping of the motion.
        since: the first place whose open pairs count.
        upper: the index that the first engine proved of the motion.
    """
    ends, turns, origins, speed = world._motion(q, qd)
    near, later, pairs = world._unmeasured(ends), slice(len(kernel), None), world.pairs
    near[later, : len(world.radius)] = _balls(world, ends[later], turns[later], origins[later])
    for row, angles in zip(near, q[: len(kernel)], strict=False):
        world._measure(row, angles)
    agrees = bool((np.abs(near[: len(kernel)] - kernel) <= DISTANCE_TOLERANCE_M).all())
    allowed = np.where(np.arange(len(q)) < len(kernel), MOVING, upper)[since:]
    every, speeds = np.tile(np.arange(len(pairs)), len(allowed)), speed[since:, pairs.body].ravel()
    found = doubted(pairs, stop, every, near[since:].ravel(), speeds, upper=allowed.repeat(len(pairs)), violated=())
    place, pair = np.nonzero((found.above | found.below).reshape(-1, len(pairs)))
    return Sight(q, len(kernel), near, speed, agrees, np.stack([place + since, pair], axis=1))


def _balls(world, ends: Floats, turns: Floats, origins: Floats) -> Floats:
    """Clearance of the balls around all bodies' and things' cores, (places, pairs of bodies): at most their own."""
    stage, count = world.stage, world.robot.world_bodies
    centers = 0.5 * (ends[:, :, 0] + ends[:, :, 1])
    away = centers[:, None, :count] - world.centers[:, None]
    apart = np.sqrt(np.einsum("ptbi,ptbi->ptb", away, away)) - world.around[:, None] - stage.half[:count]
    own = np.einsum("pkij,kj->pki", turns[:, stage.own_link], stage.own_center)
    inner = own + origins[:, stage.own_link] - centers[:, stage.own_body]
    apart_own = np.sqrt(np.einsum("pki,pki->pk", inner, inner)) - stage.own_half - stage.half[stage.own_body]
    return np.asarray(np.concatenate([apart.reshape(len(ends), apart[0].size), apart_own], axis=1) - world.radius)
