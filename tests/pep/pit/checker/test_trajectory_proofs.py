"""Certificates of timed trajectories: true ones verify, and what differs in one number from what was proven does not."""

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from pep.pit.checker.motion import CheckerTrajectory
from pep.pit.checker.robot import robot_of
from pep.pit.checker.timed_piece import pieces
from pep.pit.proof.proof_document import document, question_digest
from pep.pit.search.trajectory_pieces import pieces_of
from tests.pep.pit.campaign.timetables import random_trajectory
from tests.pep.pit.checker.corruption_courses import corrupted
from tests.pep.pit.corruption import seal
from tests.pep.pit.scenes import NOTHING, ROBOT, SEED, empty, with_person
from tests.pep.pit.search.test_trajectories import AGE_S, PATIENT, straight

from pep.pit import JointTrajectory, assess
from pep.pit.checker import Code, Unverified, Verified, verify


OTHER_ROWS = ("coarser_rows", "rows_elsewhere", "rows_joined")
NEAR = with_person(0.95, bearing=0.9)


def proven(motion, scene=NEAR):
    """A question, its answer and the text of its proof."""
    question = dict(
        robot=ROBOT, scene=scene, motion=motion, cell=PATIENT, perception_age_s=AGE_S, touch=NOTHING
    )  # fmt: skip
    said = assess(**question, seed=SEED)
    return question, said, document(said, **question)


@pytest.fixture(scope="module")
def true():
    return proven(straight(count=7))


@pytest.mark.parametrize("scene", [empty(), NEAR], ids=["alone", "near a person"])
@pytest.mark.parametrize("speeds", [True, False])
def test_a_true_one_verifies_and_names_its_question(scene, speeds):
    question, said, text = proven(straight(count=7, speeds=speeds), scene)
    verdict = verify(text)
    assert isinstance(verdict, Verified), verdict
    assert (verdict.index, verdict.tier) == (said.index, said.tier)
    assert verdict.question == question_digest(**question)


def test_one_that_may_meet_a_joint_limit_has_its_answer():
    high = float(ROBOT.position_ranges_rad[1][0])
    ends = [(high - off, *straight().points[0][1:]) for off in (0.2, 1e-3)]
    _, said, text = proven(JointTrajectory((0.0, 1.0), tuple(ends)))
    assert said.violations == ("joint_limit",)
    verdict = verify(text)
    assert isinstance(verdict, Verified) and verdict.index == 4


def changed(text, change):
    top = json.loads(text)
    change(top["question"]["motion"], top["proof"], top)
    return verify(seal(top))


def hexed(text, by):
    return (float.fromhex(text) + by).hex()


def quicker(motion, proof, top):
    motion["times_s"] = [(0.5 * float.fromhex(each)).hex() for each in motion["times_s"]]
    proof["until_s"] = [(0.5 * float.fromhex(each)).hex() for each in proof["until_s"]]


def farther(motion, proof, top):
    motion["points"][3][1] = hexed(motion["points"][3][1], 0.05)


def harder(motion, proof, top):
    motion["speeds"][3][0] = hexed(motion["speeds"][3][0], 0.6)


def not_to_the_end(motion, proof, top):
    proof["until_s"].pop()
    proof["legs"].pop()


def one_leg_fewer(motion, proof, top):
    proof["legs"].pop()


def another_cut(motion, proof, top):
    """The fastest part is in a piece that was proven for a slower one."""
    proof["until_s"][0] = proof["until_s"][len(proof["until_s"]) // 2]


def twice(motion, proof, top):
    proof["until_s"].insert(1, proof["until_s"][0])
    proof["legs"].insert(1, proof["legs"][0])


def lower(motion, proof, top):
    top["answer"]["index"] = hexed(top["answer"]["index"], -0.2)


def lower_everywhere(motion, proof, top):
    most = float.fromhex(top["answer"]["index"]) - 0.05
    top["answer"]["index"] = most.hex()
    for leg in proof["legs"]:
        leg["answer"]["index"] = min(most, float.fromhex(leg["answer"]["index"])).hex()


def backwards(motion, proof, top):
    motion["times_s"][2], motion["times_s"][3] = motion["times_s"][3], motion["times_s"][2]


def begun_late(motion, proof, top):
    motion["times_s"][0] = (0.01).hex()


def moving_at_the_end(motion, proof, top):
    motion["speeds"][-1][0] = (0.3).hex()


def through_a_jump(motion, proof, top):
    motion["points"][3][0] = hexed(motion["points"][3][0], 3.0)


@pytest.mark.parametrize(
    ("change", "codes"),
    [
        (quicker, {Code.ROW_EXCEEDS, Code.FLOOR_EXCEEDS}),
        (farther, {Code.ROW_EXCEEDS, Code.FLOOR_EXCEEDS}),
        (harder, {Code.ROW_EXCEEDS, Code.FLOOR_EXCEEDS}),
        (not_to_the_end, {Code.LEGS_WRONG}),
        (one_leg_fewer, {Code.LEGS_WRONG}),
        (another_cut, {Code.MEMBER_WRONG}),
        (twice, {Code.MEMBER_WRONG}),
        (lower, {Code.LEGS_WRONG, Code.TIER_WRONG}),
        (lower_everywhere, {Code.ROW_EXCEEDS, Code.FLOOR_EXCEEDS, Code.TIER_WRONG}),
        (backwards, {Code.MEMBER_WRONG}),
        (begun_late, {Code.MEMBER_WRONG}),
        (moving_at_the_end, {Code.MEMBER_WRONG}),
        (through_a_jump, {Code.ANSWER_WRONG}),
    ],
    ids=lambda each: getattr(each, "__name__", ""),
)
def test_what_differs_from_what_was_proven_is_refused(true, change, codes):
    verdict = changed(true[2], change)
    assert isinstance(verdict, Unverified)
    assert verdict.code in codes, verdict


def test_pieces_may_be_longer_only_where_the_answer_still_holds(true):
    """Two pieces as one: its tube is wider and its rows are another's."""
    top = json.loads(true[2])
    proof = top["proof"]
    worst = max(range(1, len(proof["legs"])), key=lambda at: float.fromhex(proof["legs"][at]["answer"]["index"]))
    del proof["until_s"][worst - 1], proof["legs"][worst - 1]
    assert isinstance(verify(seal(top)), Unverified)


@pytest.mark.campaign
def test_nothing_that_is_done_to_bytes_claim_or_rows_passes(true):
    """But other rows that prove the very same: on so short a piece they often do."""
    met = Counter()
    for k in range(40):
        bad = corrupted(true[2], np.random.default_rng([64, k]))
        said = verify(bad.text)
        if bad.kind in OTHER_ROWS and isinstance(said, Verified):
            assert replace(said, rows=0) == replace(verify(true[2]), rows=0)
            continue
        assert isinstance(said, Unverified), (k, bad.kind)
        assert said.code is not Code.CHECKER_FAILED, (k, bad.kind)
        met[bad.kind] += 1
    assert len(met) > 4


def test_a_proof_of_another_trajectory_is_of_another_question(true):
    question, _, text = true
    other = question | {"motion": replace(question["motion"], speeds=())}
    assert verify(text).question != question_digest(**other)
    assert np.isfinite(verify(text).index)


@pytest.mark.parametrize("seed", range(6))
def test_checker_and_room_find_the_same_pieces_by_code_of_their_own(seed):
    motion = random_trajectory(np.random.default_rng([65, 1, seed]))
    own = pieces_of(motion)
    hers = pieces(
        robot_of(ROBOT.content),
        CheckerTrajectory(motion.times_s, motion.points, motion.speeds),
        [each.hex() for each in own.ends_s],
    )
    assert len(hers) == len(own.pieces)
    for a, b in zip(own.pieces, hers, strict=True):
        assert b.seconds == pytest.approx(a.until_s - a.since_s)
        for name in ("start", "speed", "tube", "hurry", "acceleration"):
            assert getattr(b, name) == pytest.approx(getattr(a, name), rel=1e-9, abs=1e-11), name
