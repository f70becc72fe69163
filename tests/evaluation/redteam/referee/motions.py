"""Motions and scenes whose geometry is plain: the arm stretched out along -x, its gripper pointing along -y.

In that pose (all angles 0) the base joint turns the arm in a level plane, and the last joint turns the gripper about
its own axis; what lies below or before the finger tips is as far away all the time.
"""

import importlib.util
import math

import pytest
from evaluation.redteam.referee import CellTruth, Referee, Seen, TrueWorld
from tests.shared_data import SHARED

VENDOR = SHARED / "ur3e"
NEEDS = [
    pytest.mark.shared,
    pytest.mark.skipif(not VENDOR.is_dir(), reason="vendor meshes are not beside the checkout (../shared/data/ur3e)"),
    pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="MuJoCo is not installed (ztpm[bench])"),
]
FLANGE_M = (-0.45675, -0.22315, 0.0665)
TIP_Y_M = FLANGE_M[1] - 0.0139 - 0.1493  # coupling, and the height of the open gripper
TIP_X_M = FLANGE_M[0] - (0.085 + 0.0337) / 2  # middle of the outer finger
TIP_LOW_M = FLANGE_M[2] - 0.022 / 2  # its underside
STRETCHED = (0.0,) * 6
_REFEREES = {}


def referee(cell=None):
    """Referee of a cell, by default one with nothing in it; made once for each."""
    cell = CellTruth(fixtures={}) if cell is None else cell
    key = repr(cell)
    if key not in _REFEREES:
        _REFEREES[key] = Referee(VENDOR, cell)
    return _REFEREES[key]


def turning(joint, speed_rad_s, *, about=STRETCHED, seconds=0.1, hz=500, opening=None):
    """Samples of a joint that turns steadily, through the pose in the middle."""
    count = round(seconds * hz)
    angles = [speed_rad_s * (n / hz - seconds / 2) for n in range(count + 1)]
    return [
        Seen(n / hz, tuple(q + (angle if k == joint else 0.0) for k, q in enumerate(about)), opening)
        for n, angle in enumerate(angles)
    ]


def still(seconds=2.0, pose=STRETCHED):
    """Samples of an arm that stands."""
    return [Seen(n / 500, pose) for n in range(round(seconds * 500) + 1)]


def things(*objects):
    """World with these things from the beginning."""
    return TrueWorld.told([(0.0, {"objects": list(objects)})])


def block(low, high, kind="rigid", name="block"):
    """Object of the sensor's form, by two corners."""
    center = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
    half = [(b - a) / 2 for a, b in zip(low, high, strict=True)]
    return {"id": name, "kind": kind, "shape": {"type": "box", "center_m": center, "half_m": half}}


def under_the_tip(depth_m, kind="rigid"):
    """Small block that the outer finger of the stretched arm is so deep in, from above."""
    top = TIP_LOW_M + depth_m
    return block((TIP_X_M - 0.005, -0.375, top - 0.03), (TIP_X_M + 0.005, -0.365, top), kind)


RADIUS_M = math.hypot(TIP_X_M, 0.37)
"""Distance of that block from the axis of the base joint."""


def kinds(harms):
    return [harm.kind for harm in harms]
