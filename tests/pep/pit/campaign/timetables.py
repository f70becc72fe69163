"""Random timed trajectories, and an arm that does one: the plan, a servo's lag behind it, and a stop.

The curve between two points is written down once more here, point by point; the arm that follows it is a first-order lag
behind targets in steps, as the simulated controller's servo is.
"""

from __future__ import annotations

import numpy as np
from tests.pep.pit.lines import random_start

from pep.pit import JointTrajectory

STEP_S = 0.001
TARGETS_S = 0.004
"""Time between two targets of the servo."""
LAG_S = 0.03
POINTS_MOST = 9
FARTHEST_RAD = np.array([6.0, 6.0, 2.8, 6.0, 6.0, 6.0])
STOP_RAD_S2 = 8.0
HALF_SHARES = np.array([0.25, 0.75])


def random_trajectory(rng):
    """Points at uneven times, from rest to rest, with speeds or without, inside the range of every joint."""
    while True:
        found = _drawn(rng)
        if (np.abs(np.array(found.points)) < FARTHEST_RAD).all():
            return found


def _drawn(rng):
    count = int(rng.integers(2, POINTS_MOST))
    steps = rng.uniform(0.1, 0.8, count - 1)
    times = np.concatenate([[0.0], np.cumsum(steps)])
    largest = rng.choice([0.2, 0.6, 1.2])
    ways = rng.uniform(-largest, largest, (count - 1, 6)) * steps[:, None]
    if rng.integers(0, 2):  # one way on, as planners go, rather than about a place
        ways = np.abs(ways) * np.sign(ways[0])
    points = np.array(random_start(rng)) + np.concatenate([np.zeros((1, 6)), np.cumsum(ways, axis=0)])
    speeds = ()
    if rng.integers(0, 2):
        inner = (points[2:] - points[:-2]) / (times[2:] - times[:-2])[:, None] * rng.uniform(0.6, 1.1)
        speeds = tuple(map(tuple, np.concatenate([np.zeros((1, 6)), inner, np.zeros((1, 6))]).tolist()))
    return JointTrajectory(tuple(times.tolist()), tuple(map(tuple, points.tolist())), speeds)


def planned(motion, times):
    """Joint angles at these times: from each point to the next in two halves, each with one acceleration (PHY-64)."""
    at, points, speeds = np.array(motion.times_s), np.array(motion.points), _speeds(motion)
    found = []
    for t in np.clip(times, 0, at[-1]):
        k = min(int(np.searchsorted(at, t, side="right")) - 1, len(at) - 2)
        h, on = at[k + 1] - at[k], t - at[k]
        v, w = speeds[k], speeds[k + 1]
        u = 2 * (points[k + 1] - points[k]) / h - (v + w) / 2
        if on <= h / 2:
            found.append(points[k] + v * on + (u - v) / h * on * on)
        else:
            back = h - on
            found.append(points[k + 1] - w * back + (w - u) / h * back * back)
    return np.array(found)


def _speeds(motion):
    if motion.speeds:
        return np.array(motion.speeds)
    at, points = np.array(motion.times_s), np.array(motion.points)
    mean = (points[1:] - points[:-1]) / (at[1:] - at[:-1])[:, None]
    found = np.zeros_like(points)
    for k in range(1, len(at) - 1):
        for j in range(6):
            a, b = mean[k - 1, j], mean[k, j]
            found[k, j] = 2 / (1 / a + 1 / b) if a * b > 0 else 0.0
    return found


def served(motion, rng):
    """Ways of doing it, each as joint angles and speeds at every millisecond.

    The plan itself; the arm of a servo behind its targets, to the end; and that arm stopped at some time.
    """
    until = motion.times_s[-1]
    times = np.arange(0, until + STEP_S, STEP_S)
    plan = planned(motion, times)
    yield plan, np.gradient(plan, STEP_S, axis=0)
    q, qd = _followed(motion, np.arange(0, until + 10 * LAG_S, STEP_S))
    yield q, qd
    at = int(rng.integers(1, len(times)))
    lead = float(np.abs(qd[at]).max())
    if lead > 1e-6:
        left = 1 - np.arange(0, lead / STOP_RAD_S2, STEP_S) / (lead / STOP_RAD_S2)
        gone = lead * (1 - left**2) / (2 * STOP_RAD_S2)
        yield (
            np.concatenate([q[: at + 1], q[at] + gone[:, None] * qd[at]]),
            np.concatenate([qd[: at + 1], left[:, None] * qd[at]]),
        )


def _followed(motion, times):
    """A first-order lag behind targets that stand for `TARGETS_S`, solved exactly from step to step."""
    targets = planned(motion, np.floor(times / TARGETS_S + 1e-9) * TARGETS_S)
    fades = np.exp(-STEP_S / LAG_S)
    q, places, speeds = targets[0], [], []
    for target in targets:
        places.append(q)
        speeds.append((target - q) / LAG_S)
        q = target + (q - target) * fades
    return np.array(places), np.array(speeds)
