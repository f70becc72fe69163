"""Bound of one step of a stream at one look: all that it allows, as one interval.

The interval has three configurations. On the whole of an envelope each body's clearance and speed have the bounds of
any interval (`pep.pit.geometry.clearance`, `pep.pit.path.course`); with the fastest that the joints may go they bound
each pair's index.

A value that is no number, out of its range, or not proven leaves the step open: then another judgement is needed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from pep.pit.base.pair_columns import (
    AROUND,
    BAND,
    BODY,
    BRAKE,
    CENTER,
    CONTACT_SPEED,
    INTRUSION,
    KIND,
    PENETRATION_BAND,
    PERSON,
    PERSON_SPEED,
    PLANE,
    RADII,
    REACTION,
    SHAPE,
    TRAVEL,
    UNCERTAINTY,
    VIOLATED_BELOW,
    WARN_BAND,
)
from pep.pit.base.tier import HIGHEST, MEANT, MOVING, TIE
from pep.pit.search.arm_limits import ELBOW, MOMENTUM, TOOL
from pep.pit.search.certify import RESOLUTION
from pep.pit.search.kernel.arithmetic import bending
from pep.pit.search.kernel.arithmetic.bending import rough_stray, rush_on, sag_on
from pep.pit.search.kernel.arithmetic.body_poses import no_nodes, place_all, pose
from pep.pit.search.kernel.arithmetic.compilation import compiled, entry
from pep.pit.search.kernel.arithmetic.core_distance import core_gap, interval_gap
from pep.pit.search.kernel.arithmetic.index_law import blow_of, pair_index, ratio_index
from pep.pit.search.kernel.step_envelope import (
    AGE_LIMIT,
    CARRIED,
    DECELERATION,
    DELAY,
    DEPTH,
    FASTEST,
    FURTHEST,
    GENTLE,
    HARDEST,
    JOINTS,
    LOWEST,
    REACT,
    SERVO,
    SIGHTED,
    STEP,
    THROUGH,
    TOOL_LIMIT,
    UNKNOWN,
    WALKING,
    WARNED,
    WATCH_AGE,
    servo_envelope,
    speed_envelope,
)
from pep.pit.search.kernel.torque_bound import torque_bound

if TYPE_CHECKING:
    from pep.pit.search.kernel.arithmetic.body_poses import Floats
    from pep.pit.search.kernel.step_envelope import Envelope, Ready

NODES: Final = 3  # both ends and the middle
MIDDLE: Final = 1  # of them
ROUNDING: Final = 1.0 + 1e-12  # of ratios and speeds: far above the error of sums of a few numbers


class Settled(NamedTuple):
    """Bounds proven for a step.

    Attributes:
        proven: whether anything was; otherwise no other number says anything.
        upper: bound on the index of all that follows.
        tool: speed of the tool point, m/s.
        contact: speed by limit speed of any body region that could be met.
    """

    proven: bool
    upper: float
    tool: float
    contact: float


class Swept(NamedTuple):
    """Bodies on the whole of an envelope.

    Attributes:
        ends: (NODES, bodies, 2, 3): at its nodes, m.
        centers: (bodies, 3): of the balls around their axes in the middle, m.
        speeds: (bodies,): surface speed at most, m/s.
        strays: (bodies,): how far any part of the axis is from that centre at most, m.
        sags: (bodies,): how far the axis leaves the chords between nodes at most, m.
        tool, elbow, momentum: by their limits.
    """

    ends: Floats
    centers: Floats
    speeds: Floats
    strays: Floats
    sags: Floats
    tool: float
    elbow: float
    momentum: float


@compiled
def _open() -> Settled:
    return Settled(False, HIGHEST, math.inf, math.inf)  # noqa: FBT003 - a named tuple's


@compiled
def _arm_asks(ready: Ready, way: Envelope) -> tuple[bool, float, float]:
    """(all joints stay in range, speed of the fastest, worst ratio of one joint); the speed is in rad/s."""
    joints, hardest = ready.joints, ready.rules[HARDEST]
    q, delta, stray, rate = way.q, way.delta, way.stray, way.rate
    leading = ratio = 0.0
    inside = True
    for k in range(JOINTS):
        for end in range(2):
            at = q[k] + end * delta[k]
            inside = inside and joints[LOWEST, k] <= at - stray[k] and at + stray[k] <= joints[FURTHEST, k]
        speed = (abs(delta[k]) + stray[k]) * rate * ROUNDING
        leading = max(leading, speed)
        ratio = max(ratio, speed / joints[FASTEST, k], abs(delta[k]) * way.push * ROUNDING / hardest)
    return inside, leading, ratio


@compiled
def _bends(ready: Ready, way: Envelope) -> Floats:
    """Bends of each body off a chord of the envelope, or off the envelope, at most: (BENDS, bodies)."""
    held = np.zeros((1, bending.HELD, JOINTS))
    for k in range(JOINTS):
        held[0, bending.ONE, k] = abs(way.delta[k])
        held[0, bending.STRAYS, k] = held[0, bending.HURRIES, k] = way.stray[k]
    return bending.bends_of(ready.arm, held)[0]


@compiled
def _swept(ready: Ready, way: Envelope, bends: Floats) -> Swept:
    """Bodies at the nodes, with their bounds in between."""
    arm, q, delta, rate = ready.arm, way.q, way.delta, way.rate
    bodies = arm.link.shape[0]
    nodes, there = no_nodes(NODES, bodies), np.empty(JOINTS)
    for node in range(NODES):
        for k in range(JOINTS):
            there[k] = q[k] + 0.5 * node * delta[k]
        pose(nodes, node, arm, there, delta)
        place_all(nodes, node, arm, ready.bodies)
    speeds, strays, sags, centers = np.empty(bodies), np.empty(bodies), np.empty(bodies), np.empty((bodies, 3))
    node_speed, node_spin, ends = nodes.speed, nodes.spin, nodes.ends
    radius, half, shares = arm.radius, arm.half, ready.shares
    tool = elbow = momentum = 0.0
    for body in range(bodies):
        speed = max(node_speed[0, body], node_speed[1, body], node_speed[2, body])
        spin = max(node_spin[0, body], node_spin[1, body], node_spin[2, body])
        speed = rush_on(bends, body, 1.0, speed, spin, radius[body]) * rate * ROUNDING
        speeds[body], sags[body] = speed, sag_on(bends, body, 1.0)
        strays[body] = rough_stray(bends, body, 1.0) + half[body]
        for i in range(3):
            centers[body, i] = 0.5 * (ends[MIDDLE, body, 0, i] + ends[MIDDLE, body, 1, i])
        tool += shares[TOOL, body] * speed
        elbow += shares[ELBOW, body] * speed
        momentum += shares[MOMENTUM, body] * speed
    return Swept(ends, centers, speeds, strays, sags, tool, elbow, momentum)


@compiled
def _law(ready: Ready, reaction: float, leading: float) -> Floats:
    """Law of the step's end, as the laws of pairs need it."""
    rules, law = ready.rules, np.empty(CONTACT_SPEED + 1)
    braking = leading / rules[DECELERATION]
    law[REACTION], law[BRAKE], law[TRAVEL] = reaction, rules[DELAY] + braking, rules[DELAY] + 0.5 * braking
    law[PERSON_SPEED], law[WARN_BAND], law[PENETRATION_BAND] = rules[WALKING], rules[WARNED], rules[THROUGH]
    law[CONTACT_SPEED] = rules[GENTLE]
    return law


@compiled
def _pairs(
    ready: Ready, swept: Swept, law: Floats, grown: float, index: float, limit: float
) -> tuple[bool, float, float]:
    """(no pair is above `limit` or violated, highest index of any pair, or `index`, and that of a contact)."""
    numbers, whole, touchable = ready.field.numbers, ready.field.whole, ready.touchable
    ends, centers, speeds, strays, sags = swept.ends, swept.centers, swept.speeds, swept.strays, swept.sags
    depth, gentle, warned = ready.rules[DEPTH], law[CONTACT_SPEED], law[WARN_BAND]
    reaction, travel = law[REACTION], law[TRAVEL]
    approach = law[PERSON_SPEED] * (reaction + law[BRAKE])
    contact = 0.0
    for pair in range(whole.shape[0]):
        body, shape, kind = whole[pair, BODY], whole[pair, SHAPE], whole[pair, KIND]
        speed, below = speeds[body], numbers[pair, VIOLATED_BELOW]
        walked = grown if kind == PERSON else 0.0
        if shape != PLANE:
            x, y = centers[body, 0] - numbers[pair, CENTER], centers[body, 1] - numbers[pair, CENTER + 1]
            z = centers[body, 2] - numbers[pair, CENTER + 2]
            apart, around = x * x + y * y + z * z, numbers[pair, AROUND] + numbers[pair, RADII] + strays[body]
            # Most are so far away that they cannot raise the index: nothing is asked of their law then.
            far = around + numbers[pair, UNCERTAINTY] + speed * travel
            if kind == PERSON:
                far += walked + approach + numbers[pair, INTRUSION] + speed * reaction
                far += warned * max(2.0 - index, 0.0)
            else:
                far += numbers[pair, BAND]
            if apart >= far * far:
                continue
            clear = math.sqrt(apart) - around
            near = pair_index(kind, numbers, pair, clear - walked, speed, law)
            blow = blow_of(numbers, pair, clear - walked, speed, law) if kind == PERSON else 0.0
            if clear >= below and near <= index and blow <= contact:
                continue
        gap = core_gap(ends, MIDDLE, body, numbers, pair, shape)
        clear = interval_gap(ends, 0, 1, 2, body, numbers, pair, shape, gap, sags[body])
        near = pair_index(kind, numbers, pair, clear - walked, speed, law)
        if touchable[pair] and speed <= gentle and clear >= -depth:
            near, below = min(near, MEANT), -math.inf
        if not (clear >= below and near <= limit):
            return False, index, contact
        if kind == PERSON:
            contact = max(contact, blow_of(numbers, pair, clear - walked, speed, law))
        index = max(index, near)
    return True, index, contact


@entry
def settle(ready: Ready, form: int, step: Floats, age: float, limit: float) -> Settled:
    """Bounds of a step that is proven to stay at or below an index, and to violate nothing.

    Args:
        ready: robot, cell and view.
        form: `SERVO` or `SPEED`.
        step: (STEP, 6): angles, speeds, target, and two times (of speeds an acceleration and a time).
        age: of the view, s.
        limit: an index.
    """
    rules = ready.rules
    # 1. Numbers, all of them.
    for row in range(STEP):
        for k in range(JOINTS):
            if not abs(step[row, k]) < math.inf:
                return _open()
    if not 0.0 <= age < math.inf:
        return _open()
    # 2. The way, and a view that is old.
    reaction = max(age, rules[WATCH_AGE]) + rules[REACT]
    able, way = servo_envelope(ready, step, reaction) if form == SERVO else speed_envelope(ready, step)
    if not able:
        return _open()
    if not way.rate > 0.0:
        return Settled(True, 0.0, 0.0, 0.0)  # noqa: FBT003 - a named tuple's
    index, stale = MOVING, age > rules[AGE_LIMIT]
    if stale or not age + rules[SIGHTED] <= rules[AGE_LIMIT]:
        index = max(index, rules[UNKNOWN])
    # 3. What all this asks of the arm.
    inside, leading, ratio = _arm_asks(ready, way)
    if not inside:
        return _open()
    bends = _bends(ready, way)
    swept = _swept(ready, way, bends)
    ratio = max(ratio, swept.tool, swept.elbow, swept.momentum, rules[CARRIED], torque_bound(ready, way, bends))
    index, limit = max(index, ratio_index(ratio)), limit + TIE
    if not index <= limit:
        return _open()
    # 4. Every pair.
    grown = rules[WALKING] * age if stale else 0.0
    proven, index, contact = _pairs(ready, swept, _law(ready, reaction, leading), grown, index, limit)
    # 5. As much above as a search leaves open inside one tier: the whole question would tell no more.
    if index > MOVING:
        index = max(index, min(index + RESOLUTION, math.ceil(index - TIE)))
    # The highest is for a broken limit or a NaN: the whole question tells which.
    if not (proven and index <= limit and index < HIGHEST):
        return _open()
    return Settled(True, index, swept.tool * rules[TOOL_LIMIT], contact)  # noqa: FBT003 - a named tuple's
