"""Greatest torque by limit under any timing of a step's envelope, from one configuration and a bound.

The configuration is that in the middle. With w the joints' ways, S their sum up to a joint and r the
levers of a mass m: J_j = z_j x (c - o_j) has |J_j| <= r_j and |J_j'| <= r_j S_(j-1) + sum_(k >= j) r_k w_k, and the
first three derivatives of the mass are those of any body. What holds the arm is sum m g J_j, what s'' asks is
sum m J_j . p', what s' squared asks is sum m J_j . p'', and each changes by no more than the product rule says.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.search.kernel.arithmetic.bending import FIRST, SECOND, THIRD
from pep.pit.search.kernel.arithmetic.compilation import compiled
from pep.pit.search.kernel.arithmetic.joint_torques import torques
from pep.pit.search.kernel.step_envelope import JOINTS, STRONGEST, TURNING

if TYPE_CHECKING:
    from pep.pit.search.kernel.arithmetic.body_poses import Floats
    from pep.pit.search.kernel.step_envelope import Envelope, Ready

SPUN: Final = 6.0  # turning inertia: the third derivative's terms come to 5.9 of the cube of all joints' ways


@compiled
def torque_bound(ready: Ready, way: Envelope, bends: Floats) -> float:
    """Greatest torque by limit under any timing of the way."""
    joints, mass, reach, link, delta = ready.joints, ready.mass, ready.arm.reach, ready.arm.link, way.delta
    q, dq, ddq = np.empty((1, JOINTS)), np.empty((1, JOINTS)), np.zeros((1, JOINTS))
    sums = np.zeros(JOINTS + 1)
    for k in range(JOINTS):
        q[0, k], dq[0, k] = way.q[k] + 0.5 * delta[k], delta[k]
        sums[k + 1] = sums[k] + abs(delta[k])
    hold, push, swing = torques(ready.masses, q, dq, ddq)
    lift = ready.masses.lift
    gravity = math.sqrt(lift[0] ** 2 + lift[1] ** 2 + lift[2] ** 2)
    change = np.zeros((JOINTS, 3))  # by s: of the torque at rest, per s'' and per s' squared
    for body in range(mass.shape[0]):
        kilos = mass[body]
        if not kilos > 0.0:
            continue
        first, second, third = bends[FIRST, body], bends[SECOND, body], bends[THIRD, body]
        outer = 0.0  # sum of levers times ways from joint j outwards
        for j in range(link[body] - 1, -1, -1):
            lever = reach[body, j]
            outer += lever * abs(delta[j])
            turned = lever * sums[j] + outer
            change[j, 0] += kilos * gravity * turned
            change[j, 1] += kilos * (turned * first + lever * second)
            change[j, 2] += kilos * (turned * second + lever * third)
    turning, whole, square = 0.0, sums[JOINTS], way.rate * way.rate
    worst = 0.0
    for j in range(JOINTS - 1, -1, -1):
        turning += joints[TURNING, j]
        held = change[j, 0]
        pushed = change[j, 1] + 2.0 * turning * whole**2
        swung = change[j, 2] + SPUN * turning * whole**3  # third power: third derivative
        rest, moving = hold[0, j], hold[0, j] + square * swing[0, j]
        most = max(abs(rest), abs(moving)) + abs(push[0, j]) * way.push
        most += 0.5 * (held + pushed * way.push + swung * square)
        worst = max(worst, most / joints[STRONGEST, j])
        if not most <= math.inf:
            return math.inf
    return worst
