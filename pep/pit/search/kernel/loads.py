"""Loads of a straight joint move on the arm, at all its places (`pep.pit.search.surface_speeds`, `.torques`).

What does not depend on the timing is computed once: how fast every body goes per unit of ds/dt on equal intervals, and
what each joint bears at their ends. Any timing is then a pass over these numbers, and a slower speed that would do is
found without going back to Python.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base.pair_columns import ACCELERATION, BRAKING, PEAK, PROFILE, TOP, WAY
from pep.pit.base.tier import CALM_RATIO, TIE
from pep.pit.path.straight_path import CHORD, GRID
from pep.pit.search.certify import DEPTH, SPEED_STEPS
from pep.pit.search.kernel.arithmetic.body_poses import arm_in, bends_of
from pep.pit.search.kernel.arithmetic.compilation import compiled, entry, lent
from pep.pit.search.kernel.arithmetic.copying import copy_into
from pep.pit.search.kernel.arithmetic.index_law import highest_rate, rate_at, ratio_index
from pep.pit.search.kernel.arithmetic.joint_torques import JOINTS, bears
from pep.pit.search.kernel.arithmetic.span_speeds import rush_on
from pep.pit.search.kernel.search_columns import NOBODY
from pep.pit.search.surface_speeds import CUTS_MOST, INDEX_WITHIN, RATIO_WITHIN

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.search.kernel.arithmetic.body_poses import Arm
    from pep.pit.search.kernel.arithmetic.joint_torques import Masses

    Whole = NDArray[np.int64]

QUANTITIES: Final = ("joint_speed", "acceleration", "tcp_speed", "elbow_speed", "momentum", "torque", "payload")
JOINT_SPEED, HARDEST, TOOL_SPEED, FIRST_SHARE, TORQUE, CARRIED = 0, 1, 2, 2, 5, 6
SHARES: Final = 3  # quantities that are sums of speeds: of the tool, of the elbow, momentum

# Columns of the arm's limits, after the speeds and torques of its joints.
ACCELERATION_LIMIT, TOOL_LIMIT, CARRIED_RATIO = 2 * JOINTS, 2 * JOINTS + 1, 2 * JOINTS + 2


@lent
def _timed(timing: Floats, speed: float, profile: Floats) -> None:
    """The profile of the way at this commanded speed (`pep.pit.base.motion.Profile`)."""
    way, up, down = timing[0], timing[2], timing[3]
    peak = min(speed, math.sqrt(2.0 * way * up * (down / (up + down))))
    profile[WAY], profile[PEAK], profile[ACCELERATION], profile[BRAKING] = way, peak, up, down
    profile[TOP] = min(0.5 * (peak * peak) / up / way, 1.0)


@lent
def _sum(share: Floats, speeds: Floats) -> float:
    total = 0.0
    for body in range(speeds.shape[0]):
        total += share[body] * speeds[body]
    return total


@lent
def _slack(shares: Floats, most: Floats, met: Floats, slack: Floats) -> None:
    """Slack of each body's bound over the attained value (PHY-7)."""
    slack[:] = math.inf
    for quantity in range(SHARES):
        share = shares[quantity]
        upper, lower = _sum(share, most), _sum(share, met)
        if not upper > CALM_RATIO:
            continue
        above, below = ratio_index(upper), ratio_index(lower)
        same = math.ceil(above - TIE) == math.ceil(below - TIE)
        for body in range(most.shape[0]):
            if share[body] > 0.0 and not same:
                slack[body] = 0.0
            elif share[body] > 0.0 and above - below > INDEX_WITHIN:
                slack[body] = min(slack[body], RATIO_WITHIN / share.sum())


@lent
def _raise(most: Floats, rush: Floats, rate: float) -> None:
    for body in range(most.shape[0]):
        most[body] = max(most[body], rush[body] * rate)


@lent
def _calm(shares: Floats, most: Floats) -> bool:
    """True where no quantity comes near its limit."""
    calm = True
    for quantity in range(SHARES):
        calm = calm and not _sum(shares[quantity], most) > CALM_RATIO
    return calm


@compiled
def _most(arm: Arm, asked: Floats, shares: Floats, equal: Floats, profile: Floats) -> tuple[Floats, Whole, Whole]:
    """Proven surface speed of every body on the whole path, (bodies,), and the intervals on which it is proven.

    Where a speed, or a sum of masses times speeds, comes near its limit, a bound on equal intervals alone would decide.
    There the intervals that hold the bound up are halved until it is within `INDEX_WITHIN` of what the nodes attain.
    """
    count, bodies = equal.shape
    step = GRID // count
    most = np.zeros(bodies)
    for n in range(count):
        _raise(most, equal[n], highest_rate(n * step / GRID, (n + 1) * step / GRID, profile))
    if _calm(shares, most):
        return most, np.empty(0, np.int64), np.empty(0, np.int64)  # the equal ones
    low, high, rush = np.empty(CUTS_MOST, np.int64), np.empty(CUTS_MOST, np.int64), np.empty((CUTS_MOST, bodies))
    for n in range(count):
        low[n], high[n] = n * step, (n + 1) * step
    copy_into(rush, equal)
    part_low, part_high, halves = np.empty_like(low), np.empty_like(low), np.empty_like(rush)
    third, least = bends_of(arm, asked[JOINTS:]).third, step >> DEPTH
    met, slack, wide = np.empty(bodies), np.empty(bodies), np.empty(CUTS_MOST, np.int64)
    while True:
        met[:] = 0.0
        for n in range(count):
            # The rate rises once and falls once, so nowhere on an interval is it less than at both of its ends.
            slower = min(rate_at(low[n] / GRID, profile), rate_at(high[n] / GRID, profile))
            bend = ((high[n] - low[n]) / GRID) ** 2 / CHORD
            for body in range(bodies):
                met[body] = max(met[body], (rush[n, body] - third[body] * bend) * slower)
        _slack(shares, most, met, slack)
        split = 0
        for n in range(count):
            rate, open_ = highest_rate(low[n] / GRID, high[n] / GRID, profile), False
            for body in range(bodies):
                open_ |= rush[n, body] * rate > met[body] + slack[body]
            if open_ and high[n] - low[n] > least:
                wide[split] = n
                split += 1
        if split == 0 or count + split > CUTS_MOST:
            return most, low[:count], high[:count]
        for k in range(split):
            n = wide[k]
            middle = (low[n] + high[n]) // 2
            part_low[2 * k], part_high[2 * k] = low[n], middle
            part_low[2 * k + 1], part_high[2 * k + 1] = middle, high[n]
        used = 2 * split
        rush_on(arm, asked, part_low[:used], part_high[:used], halves[:used])
        for k in range(split):  # the second halves stand behind all
            n = wide[k]
            high[n], low[count], high[count] = part_high[2 * k], part_low[2 * k + 1], part_high[2 * k + 1]
            rush[n], rush[count] = halves[2 * k], halves[2 * k + 1]
            count += 1
        most[:] = 0.0
        for n in range(count):
            _raise(most, rush[n], highest_rate(low[n] / GRID, high[n] / GRID, profile))
        if _calm(shares, most):
            return most, low[:count], high[:count]


@lent
def _torque(bears: Floats, limits: Floats, profile: Floats) -> float:
    """Worst torque by limit over the places (`pep.pit.search.torques.Torques.ratio`)."""
    forward, backward = profile[ACCELERATION] / profile[WAY], profile[BRAKING] / profile[WAY]
    places, worst = bears.shape[1], 0.0
    for n in range(places):
        rate = rate_at(n * (GRID // (places - 1)) / GRID, profile)
        for joint in range(JOINTS):
            hold, push, swing = bears[0, n, joint], bears[1, n, joint], bears[2, n, joint]
            moving = hold + swing * (rate * rate)
            up, down = abs(hold + push * forward), abs(hold - push * backward)
            faster, slower = abs(moving + push * forward), abs(moving - push * backward)
            if math.isnan(up + down + faster + slower):
                return math.inf  # no number anywhere is the worst of all
            worst = max(worst, max(up, down, faster, slower) / limits[JOINTS + joint])
    return worst


@compiled
def _ratios(
    arm: Arm,
    asked: Floats,
    shares: Floats,
    limits: Floats,
    equal: Floats,
    bears: Floats,
    profile: Floats,
    speed: float,
) -> tuple[Floats, Floats, Whole, Whole]:
    """Every quantity by its limit, in the order of `QUANTITIES`; the proven speeds of all bodies, and where."""
    ratios = np.empty(len(QUANTITIES))
    most, low, high = _most(arm, asked, shares, equal, profile)
    wanted = reached = 0.0
    for joint in range(JOINTS):
        share = abs(asked[JOINTS + joint]) / profile[WAY]
        wanted = max(wanted, share * speed / limits[joint])
        reached = max(reached, share * profile[PEAK] / limits[joint])
    # A short move never reaches a forbidden speed, but asking for one is asking to break the limit.
    ratios[JOINT_SPEED] = wanted if wanted > 1.0 else reached
    ratios[HARDEST] = profile[ACCELERATION] / limits[ACCELERATION_LIMIT]
    for quantity in range(SHARES):
        ratios[FIRST_SHARE + quantity] = _sum(shares[quantity], most)
    for body in range(most.shape[0]):
        if shares[0, body] > 0.0:
            ratios[TOOL_SPEED] = most[body] / limits[TOOL_LIMIT]
    ratios[TORQUE] = _torque(bears, limits, profile)
    ratios[CARRIED] = limits[CARRIED_RATIO]
    return ratios, most, low, high


@lent
def _at_most(ratios: Floats, index: float) -> bool:
    """True where no ratio's index is above this."""
    falls = True
    for quantity in range(ratios.shape[0]):
        falls = falls and ratio_index(ratios[quantity]) <= index
    return falls


@entry
def laid_out(
    arm_numbers: Floats, arm_whole: Whole, masses: Masses, asked: Floats, edges: Whole
) -> tuple[Floats, Floats]:
    """Part of the demands that does not depend on the timing.

    Args:
        arm_numbers, arm_whole: the arm (`arm.blocks_of`).
        masses: its links with what they carry.
        asked: start and way of the joints, side by side, rad.
        edges: ends of equal intervals that tile the path, in 1 / GRID.

    Returns:
        What `surface.rush_on` writes of the intervals, (intervals, bodies).
        Torques at their ends, as `effort.torques` gives them, (3, edges, 6).
    """
    arm, places = arm_in(arm_numbers, arm_whole), edges.shape[0]
    equal, found = np.empty((places - 1, arm.link.shape[0])), np.empty((3, places, JOINTS))
    cosines, sines = rush_on(arm, asked, edges[:-1], edges[1:], equal)
    rates, still = np.empty((places, JOINTS)), np.zeros((places, JOINTS))
    for place in range(places):
        copy_into(rates[place], asked[JOINTS:])
    hold, push, swing = bears(masses, cosines, sines, 2, rates, still)  # between two ends is one middle
    copy_into(found[0], hold)
    copy_into(found[1], push)
    copy_into(found[2], swing)
    return equal, found


@entry
def under(
    arm_numbers: Floats,
    arm_whole: Whole,
    asked: Floats,
    shares: Floats,
    limits: Floats,
    equal: Floats,
    bears: Floats,
    timing: Floats,
    slowest: float,
    index: float,
) -> tuple[Floats, Floats, Whole, Whole, float]:
    """Demands of one timing on the arm, and a slower speed whose demands stay at this index.

    Args:
        arm_numbers, arm_whole, asked: as `laid_out` has them.
        shares: as `pep.pit.search.arm_limits.speed_shares`.
        limits: speeds and torques of the joints, then what `ACCELERATION_LIMIT` and so on name.
        equal, bears: as `laid_out` gives them.
        timing: way, commanded speed, acceleration and braking of the leading axis.
        slowest: a slower one is of no use, rad/s; where it is no slower than the commanded one, none is looked for.
        index: index that no ratio may exceed; at the commanded speed one does.

    Returns:
        Every quantity by its limit at the commanded speed, in the order of `QUANTITIES`.
        The proven speeds of all bodies there, and the ends of the intervals on which they are proven where these are
        not the equal ones.
        The highest commanded speed, to a step of the bisection, at which no ratio's index is above `index`, or else
        `NOBODY`.
    """
    arm, profile, proven, top, speed = arm_in(arm_numbers, arm_whole), np.empty(PROFILE), NOBODY, timing[1], slowest
    _timed(timing, top, profile)
    ratios, most, low, high = _ratios(arm, asked, shares, limits, equal, bears, profile, top)
    if not top > slowest:
        return ratios, most, low, high, proven
    for _ in range(SPEED_STEPS + 1):
        _timed(timing, speed, profile)
        if _at_most(_ratios(arm, asked, shares, limits, equal, bears, profile, speed)[0], index):
            proven = speed
        elif proven == NOBODY:
            break
        else:
            top = speed
        speed = 0.5 * (proven + top)
    return ratios, most, low, high, proven
