"""Certificates of lines, held tool speeds, servo targets and paths (PHY-44 to PHY-48): true ones verify, others do not."""

import json
import math
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio
import pytest
from pep.pit.assessment.dispatch import drive_of
from pep.pit.checker.arm import GRID
from pep.pit.checker.piece import Lever, Piece, contraction
from pep.pit.checker.question import obstacles_of
from pep.pit.checker.robot import robot_of
from pep.pit.base.errors import UnprovenError
from pep.pit.proof.course_proof import Recorded
from pep.pit.proof.proof_document import document, question_digest
from pep.pit.proof.row_proofs import order_of
from pep.pit.robot.twist import tool_pose
from pep.pit.scene.pairs import pairs_of
from pep.pit.search.course_limits import Effort
from pep.pit.search.question import view_around
from pep.pit.search.stream_course import speed_drive
from pep.pit.search.timed_course import TimedCourse, line_drive
from tests.pep.pit.checker.corruption_courses import EXPECTED, KINDS, Unfit, corrupted, made
from tests.pep.pit.checker.courses import (
    FORMS,
    PATIENT,
    UNPROVEN,
    courses_of,
    random_question,
    shifted,
    short_line,
    written,
)
from tests.pep.pit.checker.test_checker import STRANGE, places, replaced
from policies.evidence.evidence import ImpactFault
from tests.pep.pit.corruption import all_refused, seal
from tests.pep.pit.lines import MODEL, marched, placed, pose_of, random_hold, random_line, random_start, tool_jacobian
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, SEED, empty, with_glass, with_person
from tests.pep.pit.search.test_uneven_limits import HIGH, at
from tests.pep.pit.search.test_uneven_limits import ROBOT as UNEVEN

from pep.pit import (
    Box,
    JointLeg,
    JointPath,
    LineLeg,
    LinePath,
    MoveL,
    Person,
    PitError,
    Region,
    Robot,
    SpeedL,
    Sphere,
    Thing,
    assess,
)  # fmt: skip
from pep.pit.checker import (
    Code,
    Unverified,
    Verified,
    check,
    joint_limit,
    leg,
    rows,
    stance,
    trace_pieces,
    twist,
    verdict,
    verify,
)

pytestmark = pytest.mark.long

EACH = 2  # documents of each form


def asked(motion, scene=None, **more):
    return {
        "robot": ROBOT, "scene": empty() if scene is None else scene, "motion": motion, "cell": PATIENT,
        "perception_age_s": 0.1, "touch": NOTHING,
    } | more  # fmt: skip


@cache
def documents_of(form):
    """The first questions of this form that have an answer, with their proofs."""
    found = []
    for k in range(20 * EACH):
        one = written(random_question(np.random.default_rng([4711, *form.encode(), k]), form))
        if one is not None:
            found.append(one)
        if len(found) == EACH:
            return found
    raise AssertionError(form)


@pytest.fixture(scope="module")
def genuine():
    return {form: documents_of(form) for form in FORMS}


@pytest.fixture(scope="module")
def texts(genuine):
    return [each.text for form in genuine.values() for each in form]


def refused(top):
    said = verify(seal(top))
    assert isinstance(said, Unverified), said
    return said.code


# ---- what is true is verified


@pytest.mark.parametrize("form", FORMS)
def test_every_form_verifies(form):
    for each in documents_of(form):
        said = verify(each.text)
        assert isinstance(said, Verified), (said, each.question["motion"])
        assert (said.index, said.tier) == (each.answer.index, each.answer.tier)
        assert (said.model, said.scene) == (each.question["robot"].model_digest, each.answer.scene_digest)
        assert said.question == question_digest(**each.question)
        assert sorted(each.answer.violations) == each.top["answer"]["violations"]
        assert document(each.answer, **each.question) == each.text


def test_the_documents_are_of_every_sort(genuine):
    met = Counter()
    for each in (one for form in genuine.values() for one in form):
        for proof in courses_of(each.top):
            met[proof["course"]["limit"], proof["course"]["ahead"] is not None] += 1
            met["rows"] += bool(proof["cover"])
            met["met"] += bool(proof["met"])
            met["retreating"] += bool(proof["retreating"])
        met["meant"] += bool(each.question["touch"])
    for sort in ((False, False), (True, False), (True, True), "rows", "met", "meant"):
        assert met[sort] > 0, sort


def test_a_path_is_proven_leg_by_leg():
    for each in documents_of("joint path") + documents_of("line path"):
        legs, motion = each.top["proof"]["legs"], each.question["motion"]
        indices = [float.fromhex(leg["answer"]["index"]) for leg in legs]
        assert max(indices) == each.answer.index
        if isinstance(motion, JointPath):
            assert len(legs) == len(motion.legs)
        elif len(legs) < len(motion.legs):
            assert legs[-1]["proof"]["course"]["limit"] is True


@pytest.mark.parametrize("form", UNPROVEN)
def test_what_cannot_be_followed_to_its_end_has_no_answer_and_no_proof(form):
    told = Counter()
    for k in range(10):
        question = random_question(np.random.default_rng([4712, *form.encode(), k]), form)
        answer = assess(**question, seed=SEED)
        told[answer.reason if isinstance(answer, ImpactFault) else answer.violations] += 1
    assert told["UNPROVEN"] >= 8, told
    assert set(told) <= {"UNPROVEN", ("joint_limit",)}


def test_a_path_of_lines_goes_on_where_a_leg_ends():
    """Only the last node of a leg says where the next begins; moved both, neither is on its line."""
    pose = pose_of(HOME)
    path = LinePath(
        HOME, (LineLeg(shifted(pose, (0.05, 0, 0)), 0.2, 1.0), LineLeg(shifted(pose, (0, 0, 0.05)), 0.2, 1.0))
    )
    one = written(asked(path))
    top = one.top
    nodes = [leg["proof"]["course"]["nodes"] for leg in top["proof"]["legs"]]
    assert nodes[0][-1][1] == nodes[1][0][1]
    nodes[1][0][1] = [(float.fromhex(x) + 1e-12).hex() for x in nodes[1][0][1]]
    assert refused(top) is Code.NODE_OFF
    nodes[0][-1][1] = nodes[1][0][1] = [(float.fromhex(x) + 1e-6).hex() for x in nodes[1][0][1]]
    assert refused(top) is Code.NODE_OFF


def test_a_leg_that_goes_nowhere_and_one_beyond_a_joint_limit():
    start = (6.2, *HOME[1:])
    pose = pose_of(start)
    there = LineLeg(shifted(pose, (0.0, 0.0, 0.04)), 0.2, 1.0)
    x, y, _ = pose[:3]
    round_it = [LineLeg(shifted(pose, (-0.5 * s * y, 0.5 * s * x, 0.04)), 0.2, 1.0) for s in (1, -1)]
    for on in round_it:
        one = written(asked(LinePath(start, (LineLeg(pose, 0.2, 1.0), there, on, there))))
        assert isinstance(verify(one.text), Verified)
        legs = one.top["proof"]["legs"]
        assert float.fromhex(legs[0]["answer"]["index"]) == 0
        if one.answer.violations:
            assert [leg["proof"]["course"]["limit"] for leg in legs] == [False, False, True]
            break
    assert one.answer.violations == ("joint_limit",)


def test_a_retreat_on_a_line():
    """The fingers are in a person's hand by a little; the line leads up and away, slowly."""
    x, y, z = pose_of(HOME)[:3]
    scene = replace(empty(), people=(Person("p", ((Region.HAND, Sphere((x, y, z - 0.05), 0.06)),)),))
    one = written(asked(MoveL(HOME, shifted(pose_of(HOME), (0, 0, 0.03)), 0.05, 0.5), scene))
    assert (one.answer.tier, one.answer.violations) == (3, ())
    top = one.top
    assert top["proof"]["retreating"]
    assert isinstance(verify(one.text), Verified)
    top["question"]["motion"] |= {"speed_m_s": (0.5).hex(), "acceleration_m_s2": (5.0).hex()}
    top["answer"] |= {"index": (4.0).hex(), "tier": 4}
    assert refused(top) is Code.RETREAT_UNPROVEN
    covered = one.top
    covered["proof"]["retreating"] = []
    assert refused(covered) is Code.COVER_WRONG


def test_a_violation_on_a_line_is_shown_where_it_is_met():
    x, y, z = pose_of(HOME)[:3]
    scene = replace(empty(), people=(Person("p", ((Region.HAND, Sphere((x + 0.05, y, z), 0.02)),)),))
    one = written(asked(MoveL(HOME, shifted(pose_of(HOME), (0.1, 0, 0)), 0.2, 1.0), scene))
    assert one.answer.violations == ("person",)
    assert isinstance(verify(one.text), Verified)
    ((pair, low, high),) = one.top["proof"]["met"]
    for ends in ((0, 0), (0, 1), (high, low - 2)):
        top = one.top
        top["proof"]["met"] = [[pair, *ends]]
        assert refused(top) is (Code.VIOLATION_UNFOUNDED if ends == (0, 0) else Code.MEMBER_WRONG)
    hidden = one.top
    hidden["answer"]["violations"] = hidden["proof"]["met"] = []
    assert refused(hidden) is Code.VIOLATION_HIDDEN


def test_a_line_through_a_thing_is_shown_and_cannot_be_hidden():
    x, y, z = pose_of(HOME)[:3]
    for shape in (Sphere((x + 0.05, y, z), 0.06), Box((x + 0.05, y, z + 0.03), (0.02, 0.02, 0.02))):
        scene = replace(empty(), objects=(*empty().objects, Thing("it", "fragile", shape, 0.01)))
        one = written(asked(MoveL(HOME, shifted(pose_of(HOME), (0.1, 0, 0)), 0.2, 1.0), scene))
        assert one.answer.violations == ("fragile",)
        assert isinstance(verify(one.text), Verified)
        hidden = one.top
        hidden["answer"]["violations"] = hidden["proof"]["met"] = []
        assert refused(hidden) is Code.VIOLATION_HIDDEN


@pytest.mark.parametrize("stated", [None, 0.0, 0.0015, 0.003])
def test_where_the_robot_says_its_tool_is(stated):
    move = MoveL(HOME, shifted(pose_of(HOME), (0.03, 0, 0)), 0.2, 1.0)
    where = None if stated is None else shifted(pose_of(HOME), (stated, 0, 0))
    one = written(asked(move if stated == 0.003 else replace(move, stated_start=where)))
    assert isinstance(verify(one.text), Verified)
    if stated == 0.003:  # no answer says so: the room calls it a fault
        top = one.top
        top["question"]["motion"]["stated_start"] = [float(x).hex() for x in where]
        assert refused(top) is Code.ANSWER_WRONG


def test_other_arms_verify():
    """Another tool, and an arm whose joints turn farther one way than the other."""
    move = MoveL(HOME, shifted(pose_of(HOME), (0.05, 0.0, 0.02)), 0.2, 1.0)
    for robot, tool in ((Robot.load("ur3e", tool="robotiq_hande"), "robotiq_hande"), (UNEVEN, CELL.tool)):
        position, rotation = tool_pose(robot, np.array(HOME))
        target = (*(position + (0.04, 0.0, 0.02)).tolist(), *pinocchio.log3(rotation).tolist())
        one = written(asked(replace(move, target=target), with_glass(), robot=robot, cell=replace(PATIENT, tool=tool)))
        assert isinstance(verify(one.text), Verified), tool


def test_an_uneven_joint_limit_on_a_line_is_verified():
    for elbow, violations in ((HIGH - 0.05, ()), (HIGH + 0.1, ("joint_limit",))):
        one = written(asked(MoveL(at(1.4), pose_of(at(elbow)), 0.1, 1.0), robot=UNEVEN))
        assert one.answer.violations == violations
        assert isinstance(verify(one.text), Verified)


# ---- what is corrupted is refused


@pytest.mark.parametrize("seed", range(4))
def test_corrupted_courses_are_refused(texts, seed):
    assert len(all_refused(texts, corrupted, 4243, seed, count=60)) > 15


@pytest.mark.parametrize("most", [3, pytest.param(1_000, marks=pytest.mark.campaign)])
@pytest.mark.parametrize("name", KINDS)
def test_each_kind_of_corrupted_course_is_refused_for_its_own_reason(texts, name, most):
    assert len(KINDS) >= 25
    fit = 0
    for k, text in enumerate(texts):
        try:
            bad = made(name, text, np.random.default_rng([32, k]))
        except Unfit:
            continue
        if bad == text:
            continue
        fit += 1
        said = verify(bad)
        assert isinstance(said, Unverified), (name, k)
        assert said.code in EXPECTED[name], (name, k, said)
        if fit == most:
            break
    assert fit > 0, name


@pytest.mark.parametrize("count", [120, pytest.param(1_000, marks=pytest.mark.campaign)])
def test_no_course_breaks_the_checker(texts, count):
    """Any value in any place of the proof or motion, sealed, gets a verdict, not the checker's own failure."""
    for k in range(count):
        rng = np.random.default_rng([56, k])
        top = json.loads(texts[int(rng.integers(len(texts)))])
        name = str(rng.choice(["proof", "motion", "answer"]))
        value = top["question"]["motion"] if name == "motion" else top[name]
        where = list(places(value))
        where = where[int(rng.integers(1, len(where)))]
        value = replaced(value, where, STRANGE[int(rng.integers(len(STRANGE)))])
        top = top | {name: value} if name != "motion" else top | {"question": top["question"] | {"motion": value}}
        said = verify(seal(top))
        assert isinstance(said, Verified | Unverified)
        assert not (isinstance(said, Unverified) and said.code is Code.CHECKER_FAILED), (k, where, said)


def test_work_is_bounded(monkeypatch):
    text = documents_of("line")[0].text
    monkeypatch.setattr(trace_pieces, "NODES_MOST", 5)
    assert verify(text).code is Code.TOO_LARGE
    monkeypatch.setattr(trace_pieces, "NODES_MOST", 50_000)
    monkeypatch.setattr(trace_pieces, "PIECES_MOST", 5)
    assert verify(text).code is Code.TOO_LARGE


# ---- each number that the checker recomputes is right, by other means


ARM = robot_of(ROBOT.content)


def test_turns_are_those_of_pinocchio():
    rng = np.random.default_rng(90)
    for angle in (0.0, 1e-13, 1e-7, 0.3, 2.0, 3.1, math.pi - 1e-6):
        axis = rng.standard_normal(3)
        vector = angle * axis / np.linalg.norm(axis)
        matrix = twist.turned_by(tuple(vector.tolist()))
        assert np.array(matrix) == pytest.approx(pinocchio.exp3(vector), abs=1e-12)
        assert twist.turn_of(matrix) == pytest.approx(vector, abs=2e-9)
    half = twist.turn_of(twist.turned_by((0.0, math.pi, 0.0)))
    assert math.hypot(*half) == pytest.approx(math.pi)


def jacobian_at(q, scratch):
    placed(q, scratch)
    return tool_jacobian(q, scratch)


def test_the_arms_stance_is_pinocchios():
    rng = np.random.default_rng(91)
    scratch = MODEL.createData()
    for _ in range(50):
        q, dq = rng.uniform(-2, 2, (2, 6))
        here = stance.stance(ARM, tuple(q.tolist()))
        position, rotation = placed(q, scratch)
        assert here.pose[0] == pytest.approx(position, abs=1e-12)
        assert np.array(here.pose[1]) == pytest.approx(rotation, abs=1e-12)
        jacobian = jacobian_at(q, scratch)
        assert np.array(here.inverse) @ jacobian == pytest.approx(np.eye(6), abs=1e-8)
        step = 1e-6
        bend = (jacobian_at(q + step * dq, scratch) - jacobian_at(q - step * dq, scratch)) / (2 * step)
        assert np.array(here.bend(dq.tolist())) == pytest.approx(bend, abs=1e-7)
        # How far one velocity can go in each joint.
        for _ in range(5):
            way = rng.standard_normal(3)
            way /= np.linalg.norm(way)
            linear, angular = np.abs(here.rates((*way, 0, 0, 0))), np.abs(here.rates((0, 0, 0, *way)))
            assert (linear <= np.array(here.gain)[:, 0] + 1e-12).all()
            assert (angular <= np.array(here.gain)[:, 1] + 1e-12).all()
    assert stance.stance(ARM, (0.0, -1.0, 0.0, -1.0, 0.0, 0.0)) is None  # stretched, and its wrist in line
    assert stance.inverse(tuple((0.0,) * 6 for _ in range(6))) is None


def test_levers_bound_how_a_jacobian_changes():
    """For random rates and weights, by differences of pinocchio's Jacobian; and not ten times too large at their best."""
    rng = np.random.default_rng(92)
    lever, scratch, tight = Lever(ARM.tcp.levers), MODEL.createData(), [0.0, 0.0]
    for _ in range(300):
        q, w, v = rng.uniform(-3, 3, 6), rng.uniform(0, 1, 6), rng.uniform(0, 1, 6)
        dq, ddq, weight = rng.choice([-1, 1], (3, 6)) * np.array([w, rng.uniform(0, 1, 6), v])
        h = 1e-4

        def at(t, q=q, dq=dq, ddq=ddq):
            return jacobian_at(q + t * dq + 0.5 * t * t * ddq, scratch)

        first = (at(h) - at(-h)) / (2 * h) @ weight
        second = (at(h) - 2 * at(0.0) + at(-h)) / (h * h) @ weight
        for k, (found, bound) in enumerate(((first, lever.first(w, v)), (second, lever.second(w, np.abs(ddq), v)))):
            linear, angular = np.linalg.norm(found[:3]), np.linalg.norm(found[3:])
            assert linear <= bound[0] * (1 + 1e-5) + 1e-6
            assert angular <= bound[1] * (1 + 1e-5) + 1e-6
            tight[k] = max(tight[k], linear / bound[0])
    assert min(tight) > 0.1


def pieces_of(move):
    """The pieces of a line as the checker builds them from a document, with the room's drive."""
    drive = line_drive(ROBOT, move.start, move.target, speed_m_s=0.2, acceleration_m_s2=1.0, check_time=lambda: None)
    assert isinstance(drive, TimedCourse)
    way = Recorded(ROBOT, move.start, drive)
    cells = way.cells
    begin = (tuple(drive.twist.position.tolist()), tuple(map(tuple, drive.twist.rotation.tolist())))
    theirs = twist.CheckerTwist(begin, tuple(drive.twist.line.tolist()), tuple(drive.twist.turn.tolist()))
    lever = Lever(ARM.tcp.levers)
    for k in range(len(cells)):
        middle = stance.stance(ARM, tuple(way.q(float(cells.mid[k]) / GRID).tolist()))
        piece = Piece(lever, theirs, middle, int(cells.low[k]), int(cells.high[k]))
        yield piece, tuple(cells.second[k].tolist()), tuple(cells.third[k].tolist())


def test_what_a_piece_says_is_true_of_all_of_it():
    """Of dense samples by pinocchio's own kinematics: rates, bends and places stay inside what the checker accepts."""
    rng = np.random.default_rng(93)
    close = 0
    for _ in range(3):
        move = random_line(rng)
        position, rotation = placed(move.start)
        goal, turned = np.array(move.target[:3]), pinocchio.exp3(np.array(move.target[3:]))
        shares = np.linspace(0, 1, 4001)
        track = marched(move.start, goal - position, pinocchio.log3(turned @ rotation.T), shares)
        q, dq = (np.array(each) for each in zip(*track, strict=True))
        ddq = np.gradient(dq, shares, axis=0, edge_order=2)
        third = np.gradient(ddq, shares, axis=0, edge_order=2)
        for piece, a, b in pieces_of(move):
            assert all(x <= y for x, y in zip(piece.follows(a), a, strict=True))
            assert all(x <= y for x, y in zip(piece.follows_third(a, b), b, strict=True))
            inside = (shares >= piece.low / GRID) & (shares <= piece.high / GRID)
            assert (np.abs(dq[inside]) <= np.array(piece.rates(a)) + 1e-9).all()
            inner = inside & (shares > 0.002) & (shares < 0.998)
            room = 1e-4 * (1 + np.abs(ddq).max())
            assert (np.abs(ddq[inner]) <= np.array(a) + room).all()
            assert (np.abs(third[inner]) <= np.array(b) + 1e-2 * (1 + np.abs(third).max())).all()
            for s, here in zip(shares[inside], q[inside], strict=True):
                at, within = piece.near(round(s * GRID), a)
                assert (np.abs(here - at) <= np.array(within) + 1e-7).all()
            close += (np.abs(dq[inside]).max(axis=0) > 0.8 * np.array(piece.rates(a))).any()
    assert close > 10


def test_newtons_map_shrinks_by_what_is_said():
    rng = np.random.default_rng(94)
    lever = Lever(ARM.tcp.levers)
    for _ in range(30):
        q = rng.uniform(-2, 2, 6)
        node = stance.stance(ARM, tuple(q.tolist()))
        within = rng.uniform(0, 0.01, 6)
        shrinks = contraction(lever, node, within.tolist())
        if not shrinks < 1:
            continue
        goal = node.pose

        def step(x, node=node, goal=goal):
            position, rotation = placed(x)
            error = np.concatenate([np.array(goal[0]) - position, pinocchio.log3(np.array(goal[1]) @ rotation.T)])
            return x + np.array(node.inverse) @ error

        for _ in range(20):
            a, b = q + rng.uniform(-1, 1, (2, 6)) * 2 * within
            assert np.abs(step(a) - step(b)).max() <= shrinks * np.abs(a - b).max() + 1e-12


def course_of(one):
    """The checker's own course of a document, and its leg."""
    top = one.top
    question = check._question(top["question"])
    motion = check.motion_of(top["question"]["motion"], question.cell)
    drive = check._drive(question, motion.start, motion.legs[0], top["proof"]["course"])
    return question, drive, check._driven(question, drive)


@pytest.mark.parametrize("form", ["line", "hold", "servo", "elsewhere"])
def test_courses_and_ratios_are_those_of_the_room(form):
    """Bends, speeds, clearances' slack, timing and what is asked of the arm, from other code."""
    rng = np.random.default_rng(95)
    compared = 0
    for one in documents_of(form):
        if not one.top["proof"]["cover"]:
            continue
        asked_ = one.question
        robot, cell = asked_["robot"], asked_["cell"]
        age = 0.0 if asked_["perception_age_s"] is None else asked_["perception_age_s"]
        drive = drive_of(robot, asked_["motion"], cell, perception_age_s=age, check_time=lambda: None)
        question, theirs, whole = course_of(one)
        course, profile = drive.course, drive.profile
        view = view_around(robot, asked_["scene"], asked_["perception_age_s"], asked_["motion"].start, cell)
        ours = pairs_of(robot, view.scene, cell, grown_m=view.grown_m, touch=asked_["touch"])
        order = order_of(robot, ours)
        obstacles = obstacles_of(question.scene, question.cell, question.view, question.touch)
        theirs_pairs = rows.pairs_of(question.robot, obstacles, question.cell)
        names = [body.name for body in robot.bodies[: robot.world_bodies]]
        for _ in range(40):
            width = GRID >> int(rng.integers(0, 5))
            low = int(rng.integers(GRID // width)) * width
            rate = theirs.timing.highest(low / GRID, (low + width) / GRID)
            assert rate == pytest.approx(float(profile.highest_rate(low / GRID, (low + width) / GRID)), rel=1e-9)
            try:
                rush = {body.name: theirs.course.rush(body, low, low + width) for body in question.robot.moving}
            except verdict.Refusal as refusal:
                assert refusal.verdict.code is Code.NODE_MISSING  # noqa: PT017
                continue
            known = course.rush(np.array([low]), np.array([low + width]))[0]
            for k, name in enumerate(names):
                assert rush[name] == pytest.approx(float(known[k]), rel=1e-5, abs=1e-7)
            at = int(rng.integers(len(theirs_pairs)))
            row = np.array([order[at]])
            leaf = course.examine(ours, np.array([low]), np.array([low + width]), row)
            near = rows.clearance(theirs.course, theirs_pairs[at], low, low + width)
            assert near == pytest.approx(float(leaf.clear_m[0]), abs=1e-7)
            met = rows.met_at(theirs.course, theirs_pairs[at], low, low + width)
            assert met == pytest.approx(float(leaf.clear_mid_m[0]), abs=1e-7)
            compared += 1
        effort = Effort(robot, drive, cell).ratios(profile)
        speeds = leg.CheckerSpeedBounds(whole.way, whole.timing, whole.cuts)
        found = whole.ratios | leg.ratios(question, speeds, whole.tool_speed)
        known = {each.name: each.ratio for each in effort}
        assert found == pytest.approx(known, rel=1e-6)
        assert whole.peak == pytest.approx(float(drive.joint_speeds_rad_s(profile).max()), rel=1e-6)
    assert compared > 0


def held(move):
    """The held speed as a course, or nothing."""
    with suppress(UnprovenError):
        drive = speed_drive(ROBOT, move, CELL, check_time=lambda: None)
        return drive if isinstance(drive, TimedCourse) else None
    return None


def test_an_early_stop_stays_beside_the_course():
    """An early stop along the tangent is within the stray, no faster than allowed, and over in time.

    It takes hold anywhere in the window. This drives the arm round a bend (PHY-19).
    """
    rng = np.random.default_rng(96)
    bent = 0
    for _ in range(8):
        move = random_hold(rng)
        drive = held(move)
        if drive is None:
            continue
        course, profile = drive.course, drive.profile
        seconds, s_end = profile.way_rad, drive.line_until
        ramp = min(1.0, profile.acceleration_rad_s2 * (move.duration_s + CELL.stop_delay_s))
        up = profile.acceleration_rad_s2
        sent_s = up * min(1 / up, move.duration_s) * (move.duration_s - 0.5 * min(1 / up, move.duration_s)) / seconds
        for s_stop in np.linspace(sent_s, s_end, 7):
            q, dq = course.at(float(s_stop))
            rate = min(ramp, math.sqrt(2 * up * s_stop * seconds)) / seconds
            way = rate**2 * np.abs(dq).max() / (2 * CELL.stop_deceleration_rad_s2)
            assert s_stop + way <= 1 + 1e-9
            for on in np.linspace(0, way, 9):
                s = float(s_stop + on)
                stopped = q + on * dq
                there, _ = course.at(min(s, 1.0))
                cell = course.cells.holding(min(s, 1.0) * GRID)
                assert (np.abs(stopped - there) <= course.cells.stray[cell] + 1e-9).all()
                left = rate * math.sqrt(max(1 - on / way, 0.0)) if way else 0.0
                most = (course.cells.first[cell] + course.cells.hurry[cell]) * profile.highest_rate(s, min(s, 1.0))
                assert (left * np.abs(dq) <= most + 1e-9).all()
            bent += np.abs(q - course.at(s_end)[0]).max() > 1e-3
    assert bent > 5


def test_an_early_stop_on_a_sharp_bend_ends_on_its_course():
    """The joints slow down towards the end of this hold: a stop that takes hold earlier has farther to go."""
    rng = np.random.default_rng(97)
    met = 0
    for _ in range(400):
        start = random_start(rng, 1.0)
        way = rng.standard_normal(3)
        way *= rng.uniform(0.3, 1.0) / np.linalg.norm(way)
        move = SpeedL(start, (*way.tolist(), 0.0, 0.0, 0.0), 5.0, float(rng.uniform(0.1, 0.4)))
        drive = held(move)
        if drive is None:
            continue
        profile, s_end = drive.profile, drive.line_until
        cells = drive.course.cells
        window = cells.high > (s_end - 0.06 / profile.way_rad) * GRID
        quick = 1 / (profile.way_rad**2 * 2 * CELL.stop_deceleration_rad_s2)
        if not quick * cells.second[window].max() > 1:
            continue
        met += 1
        sent = s_end - 0.06 / profile.way_rad
        for s in np.linspace(max(sent, 0.0), s_end, 9):
            assert s + quick * np.abs(drive.course.at(float(s))[1]).max() <= 1 + 1e-9
        if met == 3:
            return
    assert met > 0


# ---- joint limits


def test_a_line_meets_a_limit_where_it_does_and_nowhere_else():
    rng = np.random.default_rng(98)
    for _ in range(5):
        start, way = random_start(rng), rng.uniform(-0.05, 0.05, 3)
        here = stance.stance(ARM, start)
        line_ = twist.CheckerTwist(here.pose, tuple(way.tolist()), (0.0, 0.1, 0.0))
        assert not joint_limit.meets_limit(ARM, line_, here, 0, joint_limit.FINEST)
    here = stance.stance(ARM, HOME)
    out = twist.CheckerTwist(here.pose, (2.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert not joint_limit.meets_limit(ARM, out, here, 0, GRID)
    beside = (6.2831, *HOME[1:])
    there = stance.stance(ARM, beside)
    x, y, _ = there.pose[0]
    ahead, back = (twist.CheckerTwist(there.pose, (-s * y, s * x, 0.0), (0.0, 0.0, 0.0)) for s in (1.0, -1.0))
    assert {joint_limit.meets_limit(ARM, each, there, 0, joint_limit.FINEST) for each in (ahead, back)} == {True, False}


@pytest.mark.parametrize("seed", range(3))
def test_short_lines_verify(seed):
    """Down to the shortest that counts as one: there rounding is as large as the way."""
    rng = np.random.default_rng([99, seed])
    for _ in range(4):
        one = written(asked(short_line(rng)))
        assert isinstance(verify(one.text), Verified), one.question["motion"]


def test_a_motion_of_another_question_is_not_written_down():
    move = MoveL(HOME, shifted(pose_of(HOME), (0.05, 0, 0)), 0.2, 1.0)
    one = written(asked(move, with_person(1.0)))
    others = [
        {"scene": with_glass()},
        {"motion": replace(move, start=(0.1, *HOME[1:]))},
        {"motion": JointPath(HOME, (JointLeg(HOME, 1.0, 1.0),))},
        {"perception_age_s": 0.3},
    ]
    for other in others:
        with pytest.raises(PitError) as error:
            document(one.answer, **(one.question | other))
        assert error.value.reason == "PARAMETERS_WRONG"
    with pytest.raises(UnprovenError):
        document(replace(one.answer, index=one.answer.index - 0.1), **one.question)


def test_a_servo_target_beyond_what_the_joints_can_is_refused():
    top = documents_of("servo")[0].top
    top["question"]["motion"]["target"] = [(3.0).hex()] * 6
    assert verify(seal(top)) == Unverified(Code.ANSWER_WRONG, "question.motion.target")


def test_documents_stay_small(genuine):
    for form, each in genuine.items():
        for one in each:
            assert len(one.text) < 400_000, form
