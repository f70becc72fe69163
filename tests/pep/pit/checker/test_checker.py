"""Independent checker: true documents are verified, corrupted ones refused, and no code is the writer's."""

import ast
import hashlib
import json
import math
import shutil
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import rfc8785
from pep.pit.base.errors import UnprovenError
from pep.pit.base.motion import profile_of
from pep.pit.base.tier import TIE
from pep.pit.geometry.clearance import core_distance
from pep.pit.geometry.solids import cores_of
from pep.pit.path.straight_path import GRID
from pep.pit.proof.proof_document import document, question_digest
from pep.pit.proof.row_proofs import order_of
from pep.pit.scene.contact_limits import harm_speed_m_s
from pep.pit.scene.obstacles import PairKind
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.separation import stopping
from pep.pit.scene.view import view_of
from pep.pit.search.question import as_run, view_around
from tests.model.pit.demands import Demands
from tests.model.pit.path import NumpyPath as JointPath
from tests.model.pit.path import bending
from tests.pep.pit import twin
from tests.pep.pit.checker.corruption_courses import EXPECTED as OF_COURSES
from tests.pep.pit.corruption import KINDS, all_refused, corrupted, seal
from tests.pep.pit.robot.test_calibration import ARMS, spelled
from tests.pep.pit.robot.test_calibration import robot_of as robot_of_rows
from tests.pep.pit.robot.test_urdf import arm_of
from tests.pep.pit.scenes import (
    CELL,
    HOME,
    NOTHING,
    ROBOT,
    SEED,
    aged,
    empty,
    random_bounds,
    random_move,
    random_scene,
    random_shape,
    sweep,
    tcp,
    with_convex,
    with_glass,
    with_person,
)
from tests.pep.pit.urdfs import random_arm

import pep.pit.checker
from pep.pit import (
    Assessment,
    Box,
    Capsule,
    CellParameters,
    Contact,
    GrippedObject,
    GripperMove,
    MoveJ,
    OutputSet,
    Person,
    PitError,
    Region,
    Robot,
    SpeedJ,
    Sphere,
    Thing,
    Workspace,
    Zone,
    assess,
)
from pep.pit.checker import (
    Code,
    Unverified,
    Verified,
    arm,
    check,
    distances,
    laws,
    leg,
    motion,
    question,
    robot,
    rows,
    verdict,
    verify,
)

pytestmark = pytest.mark.long

AGE = 0.1
STICK = GrippedObject("stick", Capsule((0.0, 0.0, 0.16), (0.0, 0.0, 0.24), 0.015), 0.3, blunt=True)
SPEEDS = {0.25: 0.8, 0.5: 1.0, 1.05: 1.4, 2.0: 3.0, 3.0: 5.0}
SCENES = {"C0": empty(), "C1": with_glass(), "C2": with_person()}


def asked(scene, motion, *, robot=ROBOT, cell=CELL, age=AGE, touch=NOTHING):
    return {
        "robot": robot, "scene": scene, "motion": motion, "cell": cell, "perception_age_s": age, "touch": touch,
    }  # fmt: skip


def answered(question):
    return assess(**question, seed=SEED)


def proven(question):
    """The answer, its document as JSON, and the text."""
    answer = answered(question)
    assert isinstance(answer, Assessment), answer
    text = document(answer, **question)
    return answer, json.loads(text), text


def verified(question):
    """The same, with the verdict, which has to be the answer's."""
    answer, top, text = proven(question)
    verdict = verify(text)
    assert isinstance(verdict, Verified), (verdict, answer.index, answer.violations)
    assert (verdict.index, verdict.tier) == (answer.index, answer.tier)
    assert (verdict.model, verdict.scene) == (question["robot"].model_digest, answer.scene_digest)
    assert verdict.question == question_digest(**question)
    assert verdict.rows == sum(map(len, top["proof"]["cover"]))
    return answer, top, text


def refused(top):
    verdict = verify(seal(top))
    assert isinstance(verdict, Unverified), verdict
    return verdict.code


# ---- what is true is verified


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("speed", SPEEDS)
def test_the_papers_cells_verify(name, speed):
    question = asked(SCENES[name], sweep(speed, SPEEDS[speed]))
    _, top, text = verified(question)
    assert rfc8785.dumps(json.loads(text)) == text
    assert len(text) < 12_000
    assert document(answered(question), **question) == text
    assert all(top["proof"]["cover"])


def random_question(rng):
    """Anything that may be asked of a straight joint motion."""
    scene = random_scene(
        rng, things=int(rng.integers(0, 6)), regions=int(rng.integers(0, 5)), zones=int(rng.integers(0, 3))
    )
    scene = random_bounds(rng, scene, 0.3)
    if rng.random() < 0.1:
        scene = replace(scene, complete=False)
    move = random_move(rng, amplitude=float(rng.choice([0.05, 0.3, 1.0, 2.0])))
    if rng.random() < 0.25:
        move = replace(move, speed_rad_s=0.2)
    if rng.random() < 0.2:
        speeds = tuple(float(x) for x in rng.uniform(-0.6, 0.6, 6))
        move = SpeedJ(move.start, speeds, float(rng.uniform(0.5, 3)), float(rng.uniform(0.05, 1)))
    arm_, cell, touch = ROBOT, CELL, NOTHING
    if rng.random() < 0.25:
        part = Capsule((0.0, 0.0, 0.18), (0.0, 0.05, 0.2), 0.03)
        mass = None if rng.random() < 0.1 else 0.4
        arm_ = ROBOT.holding(GrippedObject("part", part, mass, blunt=bool(rng.random() < 0.5)))
    if rng.random() < 0.2:
        cell = replace(cell, payload_kg=1.0, stop_deceleration_rad_s2=4.0, person_speed_m_s=2.0, rigid_band_m=0.05)
    if rng.random() < 0.4 and scene.objects:
        contacts = tuple(Contact(o.id, str(rng.choice(["tool", "payload"]))) for o in scene.objects)
        cell, touch = replace(cell, contacts=contacts), frozenset(o.id for o in scene.objects)
        if isinstance(move, MoveJ) and rng.random() < 0.6:
            move = replace(move, speed_rad_s=0.03)
    age = None if rng.random() < 0.1 else float(rng.choice([0.05, 0.1, 0.4, 0.7]))
    return asked(scene, move, robot=arm_, cell=cell, age=age, touch=touch)


def any_question(rng):
    """The same, where polytopes stand around, too, or what sensors show was not seen for a while."""
    question_ = random_question(rng)
    scene = question_["scene"]
    if rng.random() < 0.2:
        scene = with_convex(rng, scene)
    if rng.random() < 0.2:
        scene = aged(rng, scene)
    return question_ | {"scene": scene}


@pytest.mark.parametrize("seed", range(6))
def test_300_random_motions_and_scenes_verify(seed):
    met = Counter()
    for k in range(50):
        answer, top, _ = verified(any_question(np.random.default_rng([9000, seed, k])))
        met.update(map(str, answer.violations))
        met.update(name for name in ("meant", "retreating", "met") if top["proof"][name])
        met[f"tier {answer.tier}"] += 1
    assert met["meant"] > 0
    assert met["met"] > 0
    assert met["tier 3"] > 0
    assert met["tier 4"] > 0


@pytest.mark.parametrize("seed", range(4))
def test_other_arms_verify(seed):
    """Another tool, an arm's own calibration, and URDF arms whose joints turn farther one way verify."""
    rng = np.random.default_rng([9100, seed])
    hand = Robot.load("ur3e", tool="robotiq_hande")
    own = robot_of_rows(spelled(ARMS[sorted(ARMS)[seed % len(ARMS)]]))
    for arm_ in (hand, own):
        question_ = random_question(rng)
        cell = replace(question_["cell"], tool=arm_.tool.name)
        verified(question_ | {"robot": arm_, "cell": cell})
    strange = arm_of(random_arm(rng))
    low, high = strange.position_ranges_rad
    for share in (0.2, 0.9, 1.1):
        move = MoveJ(tuple((share * low).tolist()), tuple((share * high).tolist()), 0.5, 1.0)
        verified(asked(random_scene(rng), move, robot=strange, cell=replace(CELL, tool="stick")))


def test_a_retreat_is_verified_and_only_when_it_is_one():
    """The tip is inside a person by a little; up leads away."""
    x, y, z = tcp()
    scene = replace(empty(), people=(Person("p", ((Region.HAND, Sphere((x, y, z - 0.05), 0.06)),)),))
    up = MoveJ(HOME, (0.0, HOME[1] - 0.1, *HOME[2:]), 0.2, 1.0)
    answer, top, _ = verified(asked(scene, up))
    assert (answer.tier, answer.violations) == (3, ())
    assert top["proof"]["retreating"]
    # The same left-out pairs on a way that leads further in, or fast.
    into = json.loads(json.dumps(top))
    into["question"]["motion"]["target"][1] = (HOME[1] + 0.1).hex()
    assert refused(into) is Code.RETREAT_UNPROVEN
    fast = json.loads(json.dumps(top))
    fast["question"]["motion"] |= {"speed_rad_s": (1.5).hex(), "acceleration_rad_s2": (30.0).hex()}
    assert refused(fast) is Code.RETREAT_UNPROVEN
    low = json.loads(json.dumps(top))
    low["answer"] |= {"index": (2.5).hex()}
    assert refused(low) is Code.FLOOR_EXCEEDS
    covered = json.loads(json.dumps(top))
    covered["proof"]["cover"][top["proof"]["retreating"][0]] = "0"
    assert refused(covered) is Code.COVER_WRONG
    both = json.loads(json.dumps(top))
    both["answer"]["violations"], both["proof"]["met"] = ["person"], [[top["proof"]["retreating"][0], 0]]
    assert refused(both) is Code.VIOLATION_UNFOUNDED


def test_a_way_back_from_beyond_a_joint_limit():
    beyond = (6.30, *HOME[1:])
    slow = MoveJ(beyond, HOME, 0.2, 0.5)
    answer, top, _ = verified(asked(empty(), slow))
    assert (answer.index, answer.violations) == (3.0, ())
    answer, fast, _ = verified(asked(empty(), replace(slow, speed_rad_s=1.0)))
    assert answer.violations == ("joint_limit",)
    fast["answer"]["violations"] = []
    assert refused(fast) is Code.VIOLATION_UNFOUNDED
    top["answer"] |= {"index": (2.0).hex(), "tier": 2}
    assert refused(top) is Code.FLOOR_EXCEEDS


@pytest.mark.parametrize(
    ("start", "target", "index"),
    [
        (HOME, (0.0, *HOME[1:]), 0.0),
        (HOME, (7.0, *HOME[1:]), 4.0),
        ((6.4, *HOME[1:]), (6.5, *HOME[1:]), 4.0),
        ((6.4, *HOME[1:]), (-6.35, *HOME[1:]), 4.0),
    ],
)
def test_a_way_that_is_none_and_a_way_through_a_limit_have_one_answer(start, target, index):
    answer, top, _ = verified(asked(with_person(), MoveJ(start, target, 1.0, 1.0)))
    assert (answer.index, top["proof"]["cover"]) == (index, [])
    for other in (2.0, 4.0 - index):
        wrong = top | {"answer": top["answer"] | {"index": other.hex(), "tier": int(other)}}
        assert refused(wrong) is Code.ANSWER_WRONG
    for name, value in (
        ("cover", ["0"]),
        ("met", [[0, 0]]),
        ("retreating", [0]),
        ("cut", "00"),
        ("cut", "11"),
        ("cut", 1),
        ("cut", True),
    ):
        assert refused(top | {"proof": top["proof"] | {name: value}}) is Code.ANSWER_WRONG


def test_a_meant_contact_is_verified_and_only_where_it_is_gentle():
    above = (0.0, -1.6595, 1.8752, -1.7865, -1.57, 0.0)  # fingers 88 mm above the table
    down = (0.0, -1.486, 2.164, -2.2488, -1.57, 0.0)  # on it
    cell = replace(CELL, contacts=(Contact("table", "tool"),))
    gentle = asked(empty(), MoveJ(above, down, 0.15, 0.5), cell=cell, touch=frozenset({"table"}))
    answer, top, _ = verified(gentle)
    assert (answer.index, bool(top["proof"]["meant"])) == (2.0, True)
    ungranted = json.loads(json.dumps(top))
    ungranted["question"]["touch"] = []
    assert refused(ungranted) is Code.MEANT_UNPROVEN
    undeclared = json.loads(json.dumps(top))
    undeclared["question"]["cell"]["contacts"] = [["table", "payload"]]
    assert refused(undeclared) is Code.MEANT_UNPROVEN
    rough = json.loads(json.dumps(top))
    rough["question"]["motion"]["speed_rad_s"] = (1.0).hex()
    rough["answer"] |= {"index": (3.5).hex(), "tier": 4}
    assert refused(rough) is Code.MEANT_UNPROVEN
    # Nobody's arm is a table: a person stays one, whatever is granted.
    x, y, z = tcp(down)
    beside = replace(empty(), people=(Person("table", ((Region.HAND, Sphere((x, y, z - 0.04), 0.04)),)),))
    answer, top, _ = verified(gentle | {"scene": beside})
    assert answer.violations == ("person",)
    first = next(k for k, cover in enumerate(top["proof"]["cover"]) if cover)
    top["proof"]["meant"] = sorted({first, *top["proof"]["meant"]})
    assert refused(top) is Code.MEANT_UNPROVEN


def test_a_violation_is_shown_where_it_is_met():
    x, y, _ = tcp()
    scene = replace(empty(), people=(Person("p", ((Region.TORSO, Sphere((x, y, 0.2), 0.05)),)),))
    answer, top, _ = verified(asked(scene, sweep()))
    assert answer.violations == ("person",)
    assert len(top["proof"]["met"]) == 1
    elsewhere = json.loads(json.dumps(top))
    elsewhere["proof"]["met"][0][1] = 0  # there the arm is well beside the person
    assert refused(elsewhere) is Code.VIOLATION_UNFOUNDED
    hidden = json.loads(json.dumps(top))
    hidden["answer"]["violations"] = hidden["proof"]["met"] = []
    assert refused(hidden) is Code.VIOLATION_HIDDEN


@pytest.mark.parametrize("kind", ["fragile", "rigid"])
@pytest.mark.parametrize("shape", ["ball", "block"])
def test_a_way_through_a_thing_is_shown_and_cannot_be_hidden(kind, shape):
    x, y, z = map(float, tcp())
    solid = Sphere((x, y, z), 0.06) if shape == "ball" else Box((x, y, z), (0.05, 0.05, 0.05))
    scene = replace(empty(), objects=(*empty().objects, Thing("it", kind, solid, 0.01)))
    answer, top, _ = verified(asked(scene, sweep()))
    assert answer.violations == (kind,)
    elsewhere = json.loads(json.dumps(top))
    elsewhere["proof"]["met"][0][1] = 0
    assert refused(elsewhere) is Code.VIOLATION_UNFOUNDED
    hidden = json.loads(json.dumps(top))
    hidden["answer"]["violations"] = hidden["proof"]["met"] = []
    assert refused(hidden) is Code.VIOLATION_HIDDEN
    # A cell in which bodies may be deeper in each other is another one, but an axis is in the thing in any.
    lenient = replace(CELL, overlap_limit_m=0.09)
    answer, top, _ = verified(asked(scene, sweep(), cell=lenient))
    assert answer.violations == (kind,)


def test_a_way_out_of_a_thing_is_verified_and_only_when_it_is_one():
    x, y, z = map(float, tcp())
    scene = replace(empty(), objects=(*empty().objects, Thing("it", "rigid", Sphere((x, y, z - 0.005), 0.06), 0.01)))
    up = MoveJ(HOME, (0.0, HOME[1] - 0.1, *HOME[2:]), 0.2, 1.0)
    answer, top, _ = verified(asked(scene, up))
    assert (answer.tier, answer.violations) == (3, ())
    assert top["proof"]["retreating"]
    top["question"]["motion"]["target"][1] = (HOME[1] + 0.1).hex()
    assert refused(top) is Code.RETREAT_UNPROVEN


# ---- what is corrupted is refused


def documents():
    """A dozen documents of every sort."""
    found = [proven(asked(scene, sweep(v, a)))[2] for scene in SCENES.values() for v, a in ((0.25, 0.8), (3.0, 5.0))]
    rng = np.random.default_rng(77)
    found += [proven(random_question(rng))[2] for _ in range(12)]
    return found


@pytest.fixture(scope="module")
def genuine():
    return documents()


@pytest.mark.parametrize("seed", range(4))
def test_corrupted_documents_are_refused(genuine, seed):
    assert len(all_refused(genuine, corrupted, 4242, seed, count=50)) > 15


EXPECTED = {
    "truncated": {Code.NOT_JSON}, "something_behind": {Code.NOT_JSON}, "noise": {Code.NOT_JSON},
    "another_byte": None, "two_bytes_swapped": None, "no_utf8": {Code.NOT_JSON},
    "key_twice": {Code.KEY_REPEATS}, "inner_key_twice": {Code.KEY_REPEATS}, "not_a_number": {Code.NOT_JSON},
    "huge_number": {Code.NOT_JSON, Code.DIGEST_WRONG}, "too_large": {Code.TOO_LARGE},
    "deep": {Code.NOT_JSON, Code.NOT_CANONICAL, Code.DIGEST_WRONG}, "deep_and_open": {Code.NOT_JSON},
    "half_a_surrogate": {Code.NOT_CANONICAL}, "edited_digest": {Code.DIGEST_WRONG},
    "edited_without_a_seal": {Code.DIGEST_WRONG}, "other_version": {Code.VERSION_UNKNOWN},
    "member_gone": {Code.MEMBER_WRONG, Code.VERSION_UNKNOWN}, "member_more": {Code.MEMBER_WRONG}, "other_type": None,
    "no_real_number": {Code.MEMBER_WRONG}, "unknown_form": {Code.FORM_UNKNOWN},
    "lowered_index": {Code.ROW_EXCEEDS, Code.FLOOR_EXCEEDS, Code.ANSWER_WRONG},
    "swapped_tier": {Code.TIER_WRONG}, "no_such_index": {Code.MEMBER_WRONG},
    "edited_model_digest": {Code.DIGEST_WRONG}, "edited_scene_digest": {Code.DIGEST_WRONG},
    "hidden_violation": {Code.VIOLATION_HIDDEN, Code.VIOLATION_UNFOUNDED, Code.ANSWER_WRONG},
    "invented_violation": {Code.VIOLATION_UNFOUNDED}, "weaker_arm": {Code.FLOOR_EXCEEDS},
    "shrunk_robot": {Code.DIGEST_WRONG}, "link_without_a_body": {Code.MEMBER_WRONG},
    "shrunk_obstacle": {Code.DIGEST_WRONG}, "obstacle_moved_away": {Code.DIGEST_WRONG},
    "obstacle_moved_onto_the_arm": {Code.ROW_EXCEEDS, Code.MEANT_UNPROVEN},
    "person_appears": {Code.ROW_EXCEEDS, Code.VIOLATION_HIDDEN}, "object_gone": {Code.COVER_WRONG, Code.MEANT_UNPROVEN,
    Code.MEMBER_WRONG, Code.VIOLATION_UNFOUNDED, Code.RETREAT_UNPROVEN},
    "faster": {Code.FLOOR_EXCEEDS, Code.RETREAT_UNPROVEN, Code.ANSWER_WRONG},
    "beyond_a_limit": {Code.ANSWER_WRONG}, "older_view": {Code.FLOOR_EXCEEDS}, "long_unseen": {Code.FLOOR_EXCEEDS},
    "dropped_pair": {Code.COVER_WRONG, Code.MEMBER_WRONG}, "pair_more": {Code.COVER_WRONG}, "no_cover": {Code.COVER_WRONG},
    "gap": {Code.COVER_WRONG}, "overlap": {Code.COVER_WRONG}, "other_depth": {Code.COVER_WRONG},
    "no_depth": {Code.COVER_WRONG}, "coarser_rows": {Code.ROW_EXCEEDS, Code.VIOLATION_HIDDEN, Code.MEANT_UNPROVEN},
    "retreat_claimed": {Code.RETREAT_UNPROVEN, Code.FLOOR_EXCEEDS}, "touch_claimed": {Code.MEANT_UNPROVEN},
    "no_such_pair": {Code.MEMBER_WRONG}, "no_such_cut": {Code.COVER_WRONG, Code.ANSWER_WRONG},
}  # fmt: skip
"""Codes that refuse each kind; None where they depend on the changed place."""


def test_each_kind_of_corruption_is_refused_for_its_own_reason(genuine):
    assert EXPECTED.keys() == KINDS.keys()
    for name, codes in EXPECTED.items():
        fit = 0
        for k, text in enumerate(genuine):
            rng = np.random.default_rng([31, k])
            try:
                bad = KINDS[name](text, rng)
            except Exception as error:  # noqa: BLE001
                assert type(error).__name__ == "Unfit", (name, error)
                continue
            if bad == text:
                continue
            fit += 1
            verdict = verify(bad)
            assert isinstance(verdict, Unverified), (name, k)
            assert codes is None or verdict.code in codes, (name, k, verdict)
        assert fit > 0, name


def test_every_code_but_the_last_is_given(genuine):
    """CHECKER_FAILED is for what nobody thought of; every other code has a corruption here or of a course."""
    given = {code for codes in (EXPECTED | OF_COURSES).values() if codes for code in codes}
    assert given == {*Code} - {Code.CHECKER_FAILED}


def replaced(value, path, new):
    if not path:
        return new
    copied = dict(value) if isinstance(value, dict) else list(value)
    copied[path[0]] = replaced(value[path[0]], path[1:], new)
    return copied


def places(value, path=()):
    yield path
    if isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(inner, (*path, key))


STRANGE = [None, True, False, 0, -1, 1, 7, 2**53 - 1, -(2**53) + 1, "", "0", "0x0.0p+0", "0x1.0p+0", "x" * 300, [], {}, [[]], {"a": 1},
           "0x1.fffffffffffffp+1023", "-0x0.0p+0", "0x0.0000000000001p-1022", "nan", "\x00", "🙂"]  # fmt: skip


@pytest.mark.parametrize("count", [150, pytest.param(2_000, marks=pytest.mark.campaign)])
def test_no_document_breaks_the_checker(genuine, count):
    """Any value in any place, sealed: a verdict, and never one of the checker's own failure."""
    for k in range(count):
        rng = np.random.default_rng([55, k])
        top = json.loads(genuine[int(rng.integers(len(genuine)))])
        inside = None
        if rng.random() < 0.5:  # inside the texts of the robot and the scene
            inside = str(rng.choice(["model", "scene"]))
            value = json.loads(top["question"][inside])
        else:
            value = top
        where = list(places(value))
        where = where[int(rng.integers(1, len(where)))]
        value = replaced(value, where, STRANGE[int(rng.integers(len(STRANGE)))])
        if inside:
            spelt = json.dumps(value, sort_keys=True, separators=(",", ":"))
            top["question"][inside] = spelt
            top["answer"][inside] = hashlib.sha256(spelt.encode()).hexdigest()
        else:
            top = value
        verdict = verify(seal(top))
        assert isinstance(verdict, Verified | Unverified)
        assert not (isinstance(verdict, Unverified) and verdict.code is Code.CHECKER_FAILED), (k, where, verdict)


def test_what_is_no_bytes_is_refused():
    for text in ("{}", None, 7, bytearray(b"{}"), b"", b"null", b"[]", b"{}", b'"v"', b"\xef\xbb\xbf{}"):
        assert isinstance(verify(text), Unverified)


def test_a_failure_of_the_checker_itself_is_refused(monkeypatch, genuine):
    monkeypatch.setattr(check, "robot_of", lambda text: 1 / 0)
    assert verify(genuine[0]) == Unverified(Code.CHECKER_FAILED, "ZeroDivisionError")


def test_work_is_bounded(monkeypatch, genuine):
    """Rows, pairs and a retreat's intervals: more than any question has is refused before it is computed."""
    x, y, z = tcp()
    scene = replace(empty(), people=(Person("p", ((Region.HAND, Sphere((x, y, z - 0.05), 0.06)),)),))
    _, top, retreat = proven(asked(scene, MoveJ(HOME, (0.0, HOME[1] - 0.1, *HOME[2:]), 0.2, 1.0)))
    assert top["proof"]["retreating"]
    monkeypatch.setattr(leg, "ROWS_MOST", 127)
    assert verify(retreat) == Unverified(Code.TOO_LARGE, "proof.retreating")
    monkeypatch.setattr(leg, "ROWS_MOST", 20)
    assert verify(genuine[0]) == Unverified(Code.TOO_LARGE, "proof.cover")
    monkeypatch.setattr(rows, "PAIRS_MOST", 5)
    assert verify(genuine[0]) == Unverified(Code.TOO_LARGE, "scene")
    monkeypatch.setattr(check, "BYTES_MOST", 100)
    assert verify(genuine[0]) == Unverified(Code.TOO_LARGE, "document")


def test_another_spelling_of_the_same_document_is_refused(genuine):
    top = json.loads(genuine[0])
    for text in (json.dumps(top).encode(), json.dumps(top, sort_keys=True, indent=1).encode(), genuine[0] + b"\n"):
        assert verify(text).code is Code.NOT_CANONICAL


# ---- each number that the checker recomputes is right, by other means


def setting(scene, move, *, held=None, touch=NOTHING, cell=CELL):
    """The room's own pairs and path, and the checker's."""
    arm_ = ROBOT.holding(held)
    view = view_around(arm_, scene, AGE, move.start, cell)
    run = as_run(move, cell)
    ours = pairs_of(arm_, view.scene, cell, grown_m=view.grown_m, touch=touch)
    _, top, _ = proven(asked(scene, move, robot=arm_, cell=cell, touch=touch))
    theirs_robot, theirs_cell = robot.robot_of(top["question"]["model"]), question.cell_of(top["question"]["cell"])
    content, complete = question.scene_of(top["question"]["scene"])
    theirs_view = question.view_of(
        top["question"]["age_s"], theirs_cell, complete=complete, late_s=question.latest_of(content)
    )
    obstacles = question.obstacles_of(content, theirs_cell, theirs_view, touch)
    theirs = rows.pairs_of(theirs_robot, obstacles, theirs_cell)
    sweep_ = arm.Sweep(theirs_robot, motion.run_of(top["question"]["motion"], theirs_cell))
    return JointPath(arm_, run), ours, order_of(arm_, ours), sweep_, theirs, theirs_robot, theirs_cell, theirs_view


def everything(rng):
    scene = random_scene(rng, things=5, regions=5, zones=2)
    zones = (*scene.zones, Zone("hard", random_shape(rng), None))
    return replace(scene, zones=zones, workspace=Workspace((-0.8, -0.8, -0.3), (0.8, 0.8, 1.0)))


@pytest.mark.parametrize("seed", range(3))
def test_pairs_rows_and_indices_are_those_of_the_room(seed):
    """Every pair in the same order; on random intervals the same clearance, speed and index, from other code."""
    rng = np.random.default_rng(8000 + seed)
    scene, move = everything(rng), random_move(rng, amplitude=float(rng.choice([0.3, 1.0, 2.0])))
    cell = replace(CELL, contacts=(Contact("thing0", "tool"), Contact("thing1", "payload")))
    touch = frozenset({"thing0", "thing1"})
    scene = aged(rng, with_convex(rng, scene))
    path, ours, order, sweep_, theirs, their_robot, their_cell, their_view = setting(
        scene, move, held=STICK, touch=touch, cell=cell
    )
    assert len(theirs) == len(ours)
    profile = profile_of(as_run(move, cell))
    stop = stopping(cell, perception_age_s=AGE, joint_speed_rad_s=profile.peak_rad_s)
    timing = motion.Timing.of(
        motion.CheckerRun(move.start, move.target, move.speed_rad_s, *[move.acceleration_rad_s2] * 2)
    )
    their_laws = laws.Laws(their_robot, their_cell, their_view, peak_rad_s=timing.peak)
    assert timing.peak == pytest.approx(profile.peak_rad_s, rel=1e-12)
    touchable = 0
    for at in range(len(theirs)):
        pair, row = theirs[at], order[at]
        assert pair.obstacle.kind == str(ours.kind_of(row))
        assert pair.body.radius + pair.obstacle.radius == pytest.approx(float(ours.radii[row]), abs=1e-15)
        assert pair.obstacle.uncertainty == pytest.approx(float(ours.uncertainty[row]), abs=1e-15)
        below = -math.inf if pair.violated_below is None else pair.violated_below
        assert below == float(ours.violated_below[row])
        assert pair.touchable == bool(ours.touchable[row])
        touchable += pair.touchable
    assert touchable == 4  # three capsules of the tool on the one, what it holds on the other
    picked = rng.integers(len(theirs), size=600).tolist()
    depths = rng.integers(0, 9, size=600).tolist()
    for at, depth in zip(picked, depths, strict=True):
        width = GRID >> depth
        low = int(rng.integers(1 << depth)) * width
        rank = np.array([order[at]])
        leaf = path.examine(ours, np.array([low]), np.array([low + width]), rank)
        near = rows.clearance(sweep_, theirs[at], low, low + width)
        rush = sweep_.rush(theirs[at].body, low, low + width)
        assert near == pytest.approx(float(leaf.clear_m[0]), abs=1e-9)
        assert rush == pytest.approx(float(leaf.rush[0]), rel=1e-9)
        assert rows.attained(sweep_, theirs[at], low + width // 2) == pytest.approx(
            float(leaf.clear_mid_m[0]), abs=1e-9
        )
        rate = timing.highest(low / GRID, (low + width) / GRID)
        assert rate == pytest.approx(float(profile.highest_rate(low / GRID, (low + width) / GRID)), rel=1e-9)
        index = float(ours.index(rank, leaf.clear_m, leaf.rush * rate, stop)[0])
        assert their_laws.index(theirs[at].obstacle, near, rush * rate, meant=False) == pytest.approx(index, abs=1e-7)


def test_rows_hold_against_dense_samples():
    """A row's clearance is below, its speed above what a thousand configurations inside it show."""
    rng = np.random.default_rng(81)
    move = random_move(rng, amplitude=1.5)
    path, _, _, sweep_, theirs, *_ = setting(everything(rng), move, held=STICK)
    tight = 0
    for _ in range(60):
        pair = theirs[int(rng.integers(len(theirs)))]
        depth = int(rng.integers(0, 6))
        width = GRID >> depth
        low = int(rng.integers(1 << depth)) * width
        near, rush = rows.clearance(sweep_, pair, low, low + width), sweep_.rush(pair.body, low, low + width)
        nodes = np.linspace(low, low + width, 100).astype(int).tolist()
        seen = min(rows.attained(sweep_, pair, node) for node in nodes)
        went = [sweep_.pose(pair.body, node) for node in nodes]
        assert near <= seen + 1e-12
        assert rush >= max(speed + pair.body.radius * spin for _, _, speed, spin in went) - 1e-12
        tight += near > seen - 0.01
    assert tight > 20


def test_the_shortest_way_between_segments_and_from_boxes():
    """Against the room's engine, and against points sampled on both; parallel, crossing, touching and single points too."""
    rng = np.random.default_rng(82)

    def segment():
        a, b = rng.uniform(-1, 1, (2, 3))
        return a, (a if rng.random() < 0.1 else b)

    for k in range(600):
        (a, b), (c, d) = segment(), segment()
        if k % 5 == 0:  # parallel, also on one line
            d = c + (b - a) * rng.uniform(-2, 2)
            c, d = (c, d) if k % 2 else (a + (b - a) * rng.uniform(-1, 2), a + (b - a) * rng.uniform(-1, 2))
        gap = np.array(distances.between_segments(*(tuple(map(float, p)) for p in (a, b, c, d))))
        s = np.linspace(0, 1, 60)
        ab, cd = a + s[:, None] * (b - a), c + s[:, None] * (d - c)
        sampled = np.linalg.norm(ab[:, None] - cd[None], axis=2).min()
        assert np.linalg.norm(gap) <= sampled + 1e-12
        ours, direction = core_distance(np.array([[a, b]]), cores_of([Capsule(tuple(c), tuple(d), 0.1)])[0])
        assert np.linalg.norm(gap) == pytest.approx(float(ours[0]), abs=1e-9)
        if ours[0] > 1e-3:
            assert gap / np.linalg.norm(gap) == pytest.approx(direction[0], abs=1e-6)
    for _ in range(400):
        box = random_shape(rng, "b", 0.2, 0.6)
        a, b = segment()
        core, _ = question._shape(
            {"type": "Box", "center_m": [x.hex() for x in box.center_m], "half_m": [x.hex() for x in box.half_m],
             "quaternion": [x.hex() for x in box.quaternion]}, "")  # fmt: skip
        gap = np.array(distances.from_block(tuple(map(float, a)), tuple(map(float, b)), core))
        cores = cores_of([box])[0]
        ours, direction = core_distance(np.array([[a, b]]), cores)
        assert np.linalg.norm(gap) == pytest.approx(float(ours[0]), abs=1e-9)
        if ours[0] > 1e-3:
            n = gap / np.linalg.norm(gap)
            assert n == pytest.approx(direction[0], abs=1e-6)
            corners = [
                cores.a[0] + cores.axes[0] @ (np.array(sign) * cores.half[0])
                for sign in np.stack(np.meshgrid(*[[-1, 1]] * 3), -1).reshape(-1, 3)
            ]
            assert distances.reach(core, tuple(n.tolist())) == pytest.approx(max(c @ n for c in corners), abs=1e-12)


def test_laws_are_those_of_the_tables():
    """Against the slow twin of the tables, which neither shares code with the room."""
    rng = np.random.default_rng(83)
    _, top, _ = proven(asked(with_glass(), sweep()))
    cell, arm_ = question.cell_of(top["question"]["cell"]), robot.robot_of(top["question"]["model"])
    view = question.CheckerView(AGE, 0.0, 0.0)
    mass = ROBOT.moving_mass_kg / 2 + ROBOT.tool.mass_kg
    for _ in range(3000):
        omega, v = float(rng.uniform(0, 3)), float(rng.choice([0.0, rng.uniform(0, 2)]))
        d, z = float(rng.uniform(-0.2, 2.0)), float(rng.uniform(0, 0.1))
        law = laws.Laws(arm_, cell, view, peak_rad_s=omega)

        def index(kind, detail, region=""):
            thing = question.Obstacle(kind, region, distances.Segment((0, 0, 0), (0, 0, 0)), 0.1, z, detail)
            return law.index(thing, d, v, meant=False)

        region = str(rng.choice(list(twin.LIMITS)))
        expected = twin.person(d - z, d, v, twin.harm_speed(region, mass), age=AGE, omega=omega, c=0.85)
        assert index("person", 0.85, region) == pytest.approx(expected, abs=1e-9)
        assert index("fragile", 0.25) == pytest.approx(twin.thing(d - z, v, 0.25, omega=omega), abs=1e-9)
        assert index("self", 0.02) == pytest.approx(twin.thing(d - z, v, 0.02, omega=omega), abs=1e-9)
        tier = int(rng.integers(1, 5))
        assert index("tiered_zone", float(tier)) == pytest.approx(twin.zone(d - z, v, tier, omega=omega), abs=1e-9)


@pytest.mark.parametrize("held", [None, STICK, replace(STICK, mass_kg=None)])
@pytest.mark.parametrize("payload", [0.0, 1.2, None])
def test_ratios_are_those_of_the_room(held, payload):
    """Speeds of joints, tool and elbow, acceleration, torque, momentum with all that is carried, payload."""
    rng = np.random.default_rng(84)
    arm_, cell = ROBOT.holding(held), replace(CELL, payload_kg=payload)
    for _ in range(4):
        move = random_move(rng)
        _, top, _ = proven(asked(empty(), move, robot=arm_, cell=cell))
        question_ = check._question(top["question"])
        run = motion.run_of(top["question"]["motion"], question_.cell)
        timing, sweep_ = motion.Timing.of(run), arm.Sweep(question_.robot, run)
        ends = leg.intervals(top["proof"]["cut"], "proof.cut", most=check.CUT_MOST)
        speeds = leg.CheckerSpeedBounds(sweep_, timing, list(pairwise((0, *ends))))
        found = check._straight_ratios(question_.robot, run, timing) | leg.ratios(question_, speeds, 0.0)
        path = JointPath(arm_, as_run(move, cell))
        known = {each.name: each.ratio for each in Demands(path, cell).ratios(profile_of(as_run(move, cell)))}
        found["torque"] = check._straight_torque(question_, run, timing)
        assert found == pytest.approx(known, rel=1e-9)


@pytest.mark.parametrize("age", [None, 0.0, 0.1, 0.5, 0.51, 3.0])
@pytest.mark.parametrize("complete", [True, False])
def test_views_are_those_of_the_room(age, complete):
    _, top, _ = proven(asked(empty(), sweep()))
    scene = replace(with_person(), complete=complete)
    known = view_of(None if age is None else scene, age, CELL)
    found = question.view_of(
        None if age is None else age.hex(), question.cell_of(top["question"]["cell"]), complete=complete, late_s=0.0
    )
    assert (found.stopping_age_s, found.grown_m, found.floor) == (known.stopping_age_s, known.grown_m, known.floor)


@pytest.mark.parametrize("tool", [tool.name for tool in ROBOT.model.tools])
@pytest.mark.parametrize("held", [None, STICK, replace(STICK, blunt=False), replace(STICK, mass_kg=None)])
@pytest.mark.parametrize("payload", [0.0, 1.2, None])
def test_harm_speeds_are_those_of_the_room(tool, held, payload):
    arm_, cell = Robot.load("ur3e", tool=tool).holding(held), replace(CELL, tool=tool, payload_kg=payload)
    _, top, _ = proven(asked(empty(), sweep(0.3, 0.5), robot=arm_, cell=cell))
    question_ = check._question(top["question"])
    known = {str(region): harm_speed_m_s(region, arm_, cell) for region in Region}
    assert laws.harm_speeds(question_.robot, question_.cell) == pytest.approx(known, rel=1e-12)


def test_cores_that_meet_are_as_near_as_their_radii_say():
    """There is no direction between them, so nothing better is proven."""
    _, top, _ = proven(asked(empty(), sweep()))
    question_ = check._question(top["question"])
    sweep_ = arm.Sweep(question_.robot, motion.run_of(top["question"]["motion"], question_.cell))
    body = question_.robot.moving[-1]
    a, b, *_ = sweep_.pose(body, GRID // 2)
    middle = tuple((p + q) / 2 for p, q in zip(a, b, strict=True))
    above, below = ((*middle[:2], middle[2] + d) for d in (0.1, -0.1))
    crossing = question.Obstacle("rigid", "", distances.Segment(above, below), 0.02, 0.0, 0.02)
    pair = rows.Pair(body, crossing, None, touchable=False)
    assert rows.clearance(sweep_, pair, 0, GRID) == -(body.radius + 0.02)


def test_a_link_without_a_body_is_refused():
    """A link without geometry would be clear of everything, however the rest of the model is made to fit."""
    _, top, _ = proven(asked(empty(), sweep()))
    for link in range(7):
        model = json.loads(top["question"]["model"])
        gone = {capsule["name"] for capsule in model["capsules"] if capsule["link"] == link}
        model["capsules"] = [capsule for capsule in model["capsules"] if capsule["link"] != link]
        pairs = {a: [b for b in others if b not in gone] for a, others in model["self_pairs"].items() if a not in gone}
        with pytest.raises(verdict.Refusal) as error:
            robot.robot_of(json.dumps(model | {"self_pairs": pairs}))
        assert error.value.verdict == Unverified(Code.MEMBER_WRONG, "model.capsules: a link has none")


def test_a_cover_has_one_spelling():
    """Intervals begin at multiples of their length: the same points covered in another way are not a cover."""
    _, top, _ = proven(asked(empty(), sweep()))
    at = top["proof"]["cover"].index("0")
    for cover, holds in {
        "11": True,
        "122": True,
        "2222": True,
        "212": False,
        "01": False,
        "1": False,
        "n": False,
    }.items():
        top["proof"]["cover"][at] = cover
        if holds:
            assert isinstance(verify(seal(top)), Verified), cover
        else:
            assert refused(top) is Code.COVER_WRONG, cover


def test_bends_are_those_of_the_room():
    _, top, _ = proven(asked(empty(), sweep()))
    theirs = robot.robot_of(top["question"]["model"])
    ways = (0.3, -0.7, 0.2, 1.1, -0.4, 0.9)
    path = JointPath(ROBOT, MoveJ((0.0,) * 6, ways, 1.0, 1.0))
    bounds = bending(ROBOT, path.layout, np.array(ways))
    for k, body in enumerate(theirs.moving):
        second, third, spin = robot.bends(body, ways)
        assert (second, third, spin) == pytest.approx((bounds.second[k], bounds.third[k], bounds.spin_second[k]))


# ---- it stands alone


FOLDER = Path(pep.pit.checker.__file__).parent


def test_it_imports_the_standard_library_and_itself_alone():
    for source in FOLDER.glob("*.py"):
        for node in ast.walk(ast.parse(source.read_text())):
            names = (
                [alias.name for alias in node.names] if isinstance(node, ast.Import)
                else [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            )  # fmt: skip
            for name in names:
                own = name == "pep.pit.checker" or name.startswith("pep.pit.checker.")
                assert own or name.split(".")[0] in sys.stdlib_module_names, (source.name, name)


def test_it_runs_without_anything_installed(tmp_path, genuine):
    """The folder alone, in an interpreter without site packages, gives the same verdicts."""
    package = tmp_path / "pep" / "pit"
    package.mkdir(parents=True)
    for empty_ in (tmp_path / "pep", package):
        (empty_ / "__init__.py").write_text("")
    shutil.copytree(FOLDER, package / "checker", ignore=shutil.ignore_patterns("__pycache__"))
    bad = corrupted(genuine[0], np.random.default_rng(1)).text
    for k, text in enumerate((genuine[0], bad)):
        (tmp_path / f"{k}.json").write_bytes(text)
    program = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "from pathlib import Path\n"
        "from pep.pit.checker import verify\n"
        f"for k in range(2): print(type(verify(Path({str(tmp_path)!r}, f'{{k}}.json').read_bytes())).__name__)\n"
        "print(sorted(m for m in sys.modules if m.split('.')[0] in ('numpy', 'pinocchio', 'pydantic', 'rfc8785')))\n"
    )
    run = subprocess.run([sys.executable, "-I", "-S", "-c", program], capture_output=True, text=True, timeout=60)
    assert run.stdout.split("\n")[:3] == ["Verified", "Unverified", "[]"], run.stderr


# ---- the writer


def test_only_the_answer_to_the_question_is_written_down():
    question_ = asked(with_glass(), sweep())
    answer = answered(question_)
    others = [
        {"scene": with_person()},
        {"robot": ROBOT.holding(STICK)},
        {"motion": replace(sweep(), start=(0.1, *HOME[1:]))},
        {"perception_age_s": 0.2},
        {"perception_age_s": None},
    ]
    for other in others:
        with pytest.raises(PitError) as error:
            document(answer, **question_ | other)
        assert error.value.reason == "PARAMETERS_WRONG"


@pytest.mark.parametrize("motion_", [GripperMove(HOME, 0.05, 0.05, 40.0), OutputSet(0, value=True)])
def test_a_motion_without_a_path_has_no_certificate(motion_):
    question_ = asked(empty(), motion_, cell=CellParameters())
    with pytest.raises(PitError):
        document(answered(question_), **question_)


def test_an_answer_that_is_too_low_cannot_be_written_down():
    question_ = asked(with_glass(), sweep())
    answer = answered(question_)
    with pytest.raises(UnprovenError):
        document(replace(answer, index=answer.index - 0.05), **question_)


def test_no_row_is_finer_than_it_must_be():
    """Joining two neighbours of a pair again would no longer prove the answer: that keeps the text small."""
    _, top, _ = proven(asked(with_glass(), sweep(2.0, 3.0)))
    split = [k for k, cover in enumerate(top["proof"]["cover"]) if len(cover) > 1]
    assert split
    for k in split:
        joined = json.loads(json.dumps(top))
        cover = joined["proof"]["cover"][k]
        at = next(i for i in range(len(cover) - 1) if cover[i] == cover[i + 1])
        depth = int(cover[at], 24)
        start = sum(2 ** -int(digit, 24) for digit in cover[:at])
        if (start * 2**depth) % 2:  # neighbours, but of two parents
            continue
        joined["proof"]["cover"][k] = cover[:at] + f"{depth - 1}" + cover[at + 2 :]
        assert refused(joined) is Code.ROW_EXCEEDS


def test_the_writer_and_the_checker_have_one_tie():
    assert (laws.TIE, check.GRID) == (TIE, GRID)
    assert PairKind.PERSON in check.VIOLABLE
