"""Torques by pinocchio: the slow twin of `pep.pit.search.kernel.arithmetic.joint_torques`."""

import numpy as np
import pinocchio


def by_pinocchio(model, q, dq, ddq):
    """To hold, per unit of s'', and per s' squared: each (n, 6), N m."""
    scratch, still = model.createData(), np.zeros(model.nv)
    rows = list(zip(q, dq, ddq, strict=True))
    hold = np.array([pinocchio.rnea(model, scratch, here, still, still) for here, _, _ in rows])
    push = np.array([pinocchio.rnea(model, scratch, here, still, first) for here, first, _ in rows])
    swing = np.array([pinocchio.rnea(model, scratch, here, first, second) for here, first, second in rows])
    return hold, push - hold, swing - hold
