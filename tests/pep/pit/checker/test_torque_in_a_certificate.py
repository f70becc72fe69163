"""Torque is recomputed by the checker: an answer that it decides cannot be resealed as a lower one."""

import json
from dataclasses import replace

import numpy as np
import pinocchio
import pytest
from pep.pit import MoveJ, MoveL, Robot, assess
from pep.pit.checker import Code, Unverified, Verified, verify
from pep.pit.checker.question import cell_of
from pep.pit.checker.robot import robot_of
from pep.pit.checker.torque import TorquePlace, torque_ratio
from pep.pit.proof.proof_document import document
from pep.pit.robot.gripped_object import GrippedObject
from pep.pit.scene.scene import Capsule
from tests.pep.pit.corruption import seal
from tests.pep.pit.lines import pose_of
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, SEED, empty

STICK = GrippedObject("stick", Capsule((0.02, 0.0, 0.18), (0.0, 0.08, 0.25), 0.01), 1.5, blunt=True)
FAR_OUT = (0.0, -0.6, 0.8, -0.3, -1.57, 0.0)  # which takes much torque to hold
HEAVY = replace(CELL, time_limit_s=60.0, payload_kg=1.5)
MOTIONS = {
    "joint move": MoveJ(FAR_OUT, (0.0, -0.9, 1.0, -0.3, -1.57, 0.0), 0.3, 20.0),
    "line": MoveL(
        FAR_OUT, (*(np.array(pose_of(FAR_OUT)[:3]) + (0, 0, -0.08)).tolist(), *pose_of(FAR_OUT)[3:]), 0.1, 8.0
    ),
}


def asked(motion, acceleration):
    name = "acceleration_rad_s2" if isinstance(motion, MoveJ) else "acceleration_m_s2"
    return {
        "robot": ROBOT, "scene": replace(empty(), objects=()), "motion": replace(motion, **{name: acceleration}),
        "cell": HEAVY, "perception_age_s": 0.1, "touch": NOTHING,
    }  # fmt: skip


def decided_by_torque(motion):
    """The question with the gentlest acceleration whose torque alone is too much, and its answer."""
    for acceleration in np.geomspace(1.0, 39.0, 60):
        question = asked(motion, float(acceleration))
        answer = assess(**question, seed=SEED)
        ratios = {c.kind: c.index_milli for c in answer.contributions}
        if ratios.get("torque") == 4000:
            others = max((index for kind, index in ratios.items() if kind != "torque"), default=1000)
            assert others < 4000, ratios
            return question, answer
    raise AssertionError("no acceleration asks too much of a joint")


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_a_tier_that_torque_decides_cannot_be_resealed_as_a_lower_one(motion):
    question, answer = decided_by_torque(motion)
    text = document(answer, **question)
    assert verify(text).index == answer.index == 4.0
    top = json.loads(text)
    assert "torque" not in top["answer"]
    for tier in (1, 2, 3):
        top["answer"] |= {"index": float(tier).hex(), "tier": tier}
        assert verify(seal(top)) == Unverified(Code.FLOOR_EXCEEDS, "torque")
    top["answer"]["torque"] = (0.0).hex()
    assert verify(seal(top)).code is Code.MEMBER_WRONG


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_a_torque_inside_its_limit_is_verified(motion):
    question = asked(motion, 1.0)
    answer = assess(**question, seed=SEED)
    assert answer.index < 4
    assert isinstance(verify(document(answer, **question)), Verified)


@pytest.mark.parametrize("held", [None, STICK, replace(STICK, mass_kg=None)])
@pytest.mark.parametrize("payload", [0.0, 1.2, None])
@pytest.mark.parametrize("tool", [tool.name for tool in ROBOT.model.tools])
def test_torques_are_pinocchios(held, payload, tool):
    """Every joint's, at any configuration, rate and acceleration, with what is carried as a point at the tool."""
    rng = np.random.default_rng(44)
    robot = Robot.load("ur3e", tool=tool).holding(held)
    answer = assess(robot, empty(), MoveJ(HOME, HOME, 1.0, 1.0), replace(HEAVY, payload_kg=payload, tool=tool),
                    perception_age_s=0.1, touch=NOTHING, seed=SEED)  # fmt: skip
    question = json.loads(document(
        answer, robot=robot, scene=empty(), motion=MoveJ(HOME, HOME, 1.0, 1.0), perception_age_s=0.1, touch=NOTHING,
        cell=replace(HEAVY, payload_kg=payload, tool=tool),
    ))["question"]  # fmt: skip
    ours, cell = robot_of(question["model"]), cell_of(question["cell"])
    model = pinocchio.Model(robot.pinocchio)
    kilos = robot.model.payload_limit_kg if payload is None else payload
    model.inertias[6] += pinocchio.Inertia(kilos, np.array(robot.tool.tcp_m), np.zeros((3, 3)))
    scratch, limits = model.createData(), robot.torque_limits_nm
    for _ in range(20):
        q, dq, ddq = rng.uniform(-3, 3, (3, 6))
        rate, forward, backward = rng.uniform(0, 5), rng.uniform(0, 9), rng.uniform(0, 9)
        most = 0.0
        for speed in (0.0, rate):
            for push in (forward, -backward):
                needed = pinocchio.rnea(model, scratch, q, dq * speed, dq * push + ddq * speed**2)
                most = max(most, float((np.abs(needed) / limits).max()))
        place = TorquePlace(tuple(q.tolist()), tuple(dq.tolist()), tuple(ddq.tolist()), rate)
        found = torque_ratio(ours, cell, [place], forward=forward, backward=backward)
        assert found == pytest.approx(most, rel=1e-9)
