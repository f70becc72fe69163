"""Joint angles for tool poses, from fixed starts, as of `pep.pit.robot.inverse_kinematics.reaching`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pep.pit.robot.inverse_kinematics import SEARCH_DAMPING, SEARCH_NEAR, SEARCH_STEP_RAD, SEARCH_STEPS
from pep.pit.search.kernel.arithmetic.compilation import compiled, entry
from pep.pit.search.kernel.arithmetic.tool_pose import JOINTS, divided, no_stand, stand_at, turn_between

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats
    from pep.pit.search.kernel.arithmetic.tool_pose import Stand, Wrist


@compiled
def _found(wrist: Wrist, position: Floats, rotation: Floats, stand: Stand, error: Floats, matrix: Floats) -> bool:
    """True where damped steps lead from the joint angles in `stand` to the pose."""
    q, jacobian = stand.q, stand.jacobian
    for _ in range(SEARCH_STEPS):
        stand_at(wrist, stand)
        for i in range(3):
            error[i] = position[i] - stand.position[i]
        turn_between(rotation, stand.rotation, error)
        near = True
        for i in range(JOINTS):
            near = near and abs(error[i]) <= SEARCH_NEAR
        if near:
            return True
        for i in range(JOINTS):
            for j in range(JOINTS):
                whole = SEARCH_DAMPING if i == j else 0.0
                for k in range(JOINTS):
                    whole += jacobian[i, k] * jacobian[j, k]
                matrix[i, j] = whole
        if not divided(matrix, error):
            return False
        for k in range(JOINTS):
            step = 0.0
            for i in range(JOINTS):
                step += jacobian[i, k] * error[i]
            q[k] += min(max(step, -SEARCH_STEP_RAD), SEARCH_STEP_RAD)
    return False


@entry
def reachable(wrist: Wrist, positions: Floats, rotations: Floats, starts: Floats) -> bool:
    """True where some joint angles were found for each pose from `starts` (m, 6).

    Poses are (n, 3) and (n, 3, 3).

    The last pose is asked first: of a line that leaves the arm's reach it is the farthest out.
    """
    stand, error, matrix = no_stand(), np.empty(JOINTS), np.empty((JOINTS, JOINTS))
    for n in range(positions.shape[0] - 1, -1, -1):
        found = False
        for m in range(starts.shape[0]):
            stand.q[:] = starts[m]
            if _found(wrist, positions[n], rotations[n], stand, error, matrix):
                found = True
                break
        if not found:
            return False
    return True
