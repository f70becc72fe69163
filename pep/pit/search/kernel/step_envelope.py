"""Steps of a stream in the kernel: numbers of robot, cell and view, and the envelope of one step.

An envelope is a straight way of the joints with an allowed stray: everywhere that a step may take the arm until a stop
after it has ended, and how fast.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from pep.pit.search.kernel.arithmetic.compilation import compiled
from pep.pit.search.question import LEAST_RATE
from pep.pit.search.stream_course import LOOKAHEAD_LEAST_S, STILL_RAD_S

if TYPE_CHECKING:
    from pep.pit.search.kernel.arithmetic.body_poses import Arm, Floats, Whole
    from pep.pit.search.kernel.arithmetic.joint_torques import Masses
    from pep.pit.search.kernel.arithmetic.pair_rows import Field

JOINTS: Final = 6

SERVO: Final = 0
SPEED: Final = 1

# Rows of a step: where the arm is, how it moves, where it is to go; of a set of speeds the second alone.
START, NOW, TARGET, TIMES = range(4)
STEP: Final = 4

# Columns of the numbers of cell and view.
DELAY, DECELERATION, WATCH_AGE, REACT, WALKING, WARNED, THROUGH, GENTLE, DEPTH = range(9)
PATIENCE, AGE_LIMIT, UNKNOWN, SIGHTED, HARDEST, CARRIED, TOOL_LIMIT = range(9, 16)
RULES: Final = 16

# Rows of each joint's limits.
LOWEST, FURTHEST, FASTEST, STRONGEST, TURNING = range(5)


class Ready(NamedTuple):
    """Part of the question that is the same for every step in one view.

    Attributes:
        arm, bodies, masses: the robot, all its bodies by number, and what is carried with it.
        field: the pairs.
        touchable: (pairs,), which may be touched on purpose.
        joints: (5, 6): lowest and highest angle, limits of speed and torque, largest inertia of the link.
        mass: (bodies,), of those that are points with a mass, kg.
        shares: (3, bodies), as `pep.pit.search.arm_limits.speed_shares`.
        rules: (RULES,), numbers of the cell and of the view.
    """

    arm: Arm
    bodies: Whole
    masses: Masses
    field: Field
    touchable: Any
    joints: Floats
    mass: Floats
    shares: Floats
    rules: Floats


class Envelope(NamedTuple):
    """All motion that a step allows.

    Attributes:
        q, delta: (6,): its straight way.
        stray: (6,): how far a joint may be beside it, rad; its speed differs by as much per unit of s.
        rate: greatest ds/dt, 1/s.
        push: greatest second derivative of s that speeds up or slows down, 1/s2.
    """

    q: Floats
    delta: Floats
    stray: Floats
    rate: float
    push: float


@compiled
def servo_envelope(ready: Ready, step: Floats, reaction: float) -> tuple[bool, Envelope]:
    """Envelope of a servo target (law: `pep.pit.search.stream_course.servo_drive`); true where an arm can follow it."""
    rules, joints = ready.rules, ready.joints
    period, lookahead = step[TIMES, 0], max(step[TIMES, 1], LOOKAHEAD_LEAST_S)
    q, delta, stray = np.empty(JOINTS), np.empty(JOINTS), np.empty(JOINTS)
    followed = period >= LEAST_RATE and step[TIMES, 1] >= LEAST_RATE
    fastest = 0.0
    for k in range(JOINTS):
        jump = step[TARGET, k] - step[START, k]
        followed = followed and abs(jump) <= joints[FASTEST, k] * (period + lookahead)
        q[k], delta[k], stray[k] = step[START, k], step[NOW, k], jump / lookahead
        fastest = max(fastest, abs(step[NOW, k]), abs(stray[k]))
    if not fastest > STILL_RAD_S:
        return followed, Envelope(q, delta, stray, 0.0, 0.0)
    braking = rules[DECELERATION] / fastest
    seconds = reaction + period + rules[DELAY] + 0.5 / braking
    for k in range(JOINTS):
        now, asked = delta[k], stray[k]
        delta[k], stray[k] = seconds * 0.5 * (now + asked), seconds * 0.5 * abs(now - asked)
    return followed, Envelope(q, delta, stray, 1.0 / seconds, braking / seconds)


@compiled
def speed_envelope(ready: Ready, step: Floats) -> tuple[bool, Envelope]:
    """Envelope of joint speeds under way; true where they are possible.

    Law: `pep.pit.search.speed_envelope.stream_envelope`.
    """
    rules = ready.rules
    acceleration, duration = step[TIMES, 0], step[TIMES, 1]
    q, delta, stray = np.empty(JOINTS), np.empty(JOINTS), np.zeros(JOINTS)
    leading = 0.0
    for k in range(JOINTS):
        leading = max(leading, abs(step[NOW, k]))
    meant = acceleration >= LEAST_RATE and duration >= LEAST_RATE and (leading == 0.0 or leading >= LEAST_RATE)
    if not leading > 0.0:
        return meant, Envelope(q, delta, stray, 0.0, 0.0)
    stop = rules[DECELERATION]
    ramp = max(acceleration, stop)
    behind = 0.5 * leading / ramp
    seconds = behind + duration + rules[PATIENCE] + rules[DELAY] + 0.5 * leading / stop
    for k in range(JOINTS):
        delta[k] = seconds * step[NOW, k]
        q[k] = step[START, k] - behind * step[NOW, k]
    return meant, Envelope(q, delta, stray, 1.0 / seconds, ramp / leading / seconds)
