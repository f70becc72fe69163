"""A controller's own word on its kinematics becomes the calibration of its arm, and of no other one."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pep.pit.robot.calibration import Calibration, Placement, calibrated
from pep.pit.robot.controller_kinematics import (
    ControllerKinematics,
    calibration_text,
    same_arm,
    told_calibration,
)
from pep.pit.robot.kinematics import link_frames
from pep.pit.robot.model import Model
from tests.pep.pit.robot.test_calibration import ARMS, spelled
from tests.shared_data import SHARED
from ursim.motion.arm import ROBOTS, Arm

from pep.pit import ModelError, Robot

UR3E = Model.shipped("ur3e")
NAMES = ("ur3e", "ur5e", "ur10e", "ur16e")
ZERO = (0.0,) * 6
SAME = 1e-9


def nominal(name):
    a, d, alpha = Arm.load(ROBOTS / f"{name}.toml").dh
    return ControllerKinematics(ZERO, a, d, alpha)


def frame(offset, rpy):
    roll, pitch, yaw = rpy
    x, y, z = (
        np.array([[1, 0, 0], [0, math.cos(roll), -math.sin(roll)], [0, math.sin(roll), math.cos(roll)]]),
        np.array([[math.cos(pitch), 0, math.sin(pitch)], [0, 1, 0], [-math.sin(pitch), 0, math.cos(pitch)]]),
        np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]]),
    )
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = z @ y @ x, offset
    return found


def denavit(calibration):
    """Denavit-Hartenberg parameters of a chain of placements, by common normals: a controller's own way to say it."""
    axes, at = [], np.eye(4)
    for joint in calibration.joints:
        at = at @ frame(joint.offset_m, joint.rpy_rad)
        axes.append(at)
    rows, here = [], np.eye(4)
    for axis in axes[1:]:
        joint = axes[len(rows)]
        z, n = joint[:3, 2], axis[:3, 2]
        normal = np.cross(z, n)
        assert np.linalg.norm(normal) > 1e-9, "no arm has two axes that are parallel to the last bit"
        x = normal / np.linalg.norm(normal)
        between = axis[:3, 3] - joint[:3, 3]
        along, _, on = np.linalg.solve(np.column_stack((z, x, -n)), between)
        foot, other = joint[:3, 3] + along * z, axis[:3, 3] + on * n
        # here: the frame behind the joint before; its z axis is the joint's
        d = float((foot - here[:3, 3]) @ z)
        theta = math.atan2(float(np.cross(here[:3, 0], x) @ z), float(here[:3, 0] @ x))
        a = float((other - foot) @ x)
        alpha = math.atan2(float(np.cross(z, n) @ x), float(z @ n))
        rows.append((theta, a, d, alpha))
        here = np.eye(4)
        here[:3, :3], here[:3, 3] = np.column_stack((x, np.cross(n, x), n)), other
    last = axes[-1]
    d = float((last[:3, 3] - here[:3, 3]) @ last[:3, 2])
    theta = math.atan2(float(np.cross(here[:3, 0], last[:3, 0]) @ last[:3, 2]), float(here[:3, 0] @ last[:3, 0]))
    rows.append((theta, 0.0, d, 0.0))
    return ControllerKinematics(*(tuple(column) for column in zip(*rows, strict=True)))


def flanges(calibration, turns):
    robot = Robot.from_model(calibrated(UR3E, calibration), tool="robotiq_2f85")
    rotation, origin = link_frames(robot, turns)
    return rotation[:, -1], origin[:, -1]


@pytest.mark.parametrize("name", NAMES)
def test_nominal_kinematics_are_no_calibration_and_have_the_vendors_checksum(name):
    assert told_calibration(Model.shipped(name), nominal(name)) is None
    file = SHARED / name / "default_kinematics.yaml"
    if not file.exists():
        pytest.skip(f"{file} is not there")
    (stated,) = (line.split()[-1] for line in file.read_text().splitlines() if "hash:" in line)
    assert nominal(name).signature == stated


@pytest.mark.parametrize("signature", ARMS)
def test_four_arms_are_told_by_parameters_and_taken_as_their_exports(signature):
    """The flange is where the export has it, at all angles; frames are metres away in the parameters."""
    export = Calibration.from_yaml(spelled(ARMS[signature], signature))
    told = denavit(export)
    assert max(map(abs, told.d_m)) > 1.0, "parallel axes: this is what makes it hard"
    found = told_calibration(UR3E, told)
    turns = np.random.default_rng(5).uniform(-3.0, 3.0, (50, 6))
    for one, other in zip(flanges(found, turns), flanges(export, turns), strict=True):
        assert np.abs(one - other).max() < SAME
    assert same_arm(found, export)
    assert Calibration.from_yaml(calibration_text(found)) == found


def test_no_arm_is_taken_for_another():
    arms = [Calibration.from_yaml(spelled(rows, signature)) for signature, rows in ARMS.items()]
    plain = Calibration(tuple(Placement(joint.offset_m, joint.rpy_rad) for joint in UR3E.joints), "calib_0")
    for at, one in enumerate([*arms, plain]):
        assert [same_arm(one, other) for other in [*arms, plain]] == [other == at for other in range(5)]


def with_value(row, index, value):
    told = nominal("ur3e")
    numbers = list(getattr(told, row))
    numbers[index] = value
    return replace(told, **{row: tuple(numbers)})


@pytest.mark.parametrize(
    "told",
    [
        with_value("a_m", 1, math.nan),
        with_value("d_m", 0, math.inf),
        with_value("d_m", 2, 1e6),
        with_value("a_m", 5, 0.01),
        with_value("alpha_rad", 5, 0.1),
        with_value("alpha_rad", 0, -math.pi / 2),
        replace(nominal("ur3e"), theta_rad=ZERO[:5]),
    ],
    ids=["nan", "infinite", "beyond measure", "flange offset", "flange turn", "another arm", "five joints"],
)
def test_what_no_arm_has_is_refused(told):
    with pytest.raises(ModelError) as refused:
        told_calibration(UR3E, told)
    assert refused.value.reason == "PHYSICS_FAULT"


def test_another_models_parameters_are_beyond_what_a_calibration_may_be():
    found = told_calibration(UR3E, nominal("ur5e"))
    with pytest.raises(ModelError) as refused:
        calibrated(UR3E, found)
    assert refused.value.reason == "PHYSICS_FAULT"
