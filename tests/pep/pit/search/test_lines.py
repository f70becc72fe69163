"""Lines of the tool: the certified answer against dense sampling by an engine that shares nothing with it."""

import math
import os
from dataclasses import replace

import numpy as np
import pinocchio
import pytest
from pep.pit.assessment.course_assessment import CourseCertificate
from pep.pit.base.motion import Profile
from pep.pit.path.line_trace import FINEST, CutShort, LineTrace
from pep.pit.path.straight_path import GRID
from pep.pit.robot.inverse_kinematics import stance
from pep.pit.robot.twist import Twist, turn_of, turned_by
from pep.pit.scene.pairs import pairs_of
from pep.pit.search.certify import RESOLUTION
from pep.pit.search.course_limits import Effort
from pep.pit.search.kernel.compiled_course import CompiledCourse
from pep.pit.search.timed_course import line_drive
from policies.evidence.evidence import ImpactFault
from policies.words.reason_table import Reason
from tests.model.pit.course import NumpyCourse
from tests.model.pit.line import trace
from tests.pep.pit.lines import MODEL, Sampled, marched, placed, pose_of, random_line
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, SEED, empty, random_scene, with_glass, with_person

from pep.pit import MoveL, Sphere, Thing, Workspace, assess

pytestmark = pytest.mark.long

NAN, INF = math.nan, math.inf
LINES = int(os.environ.get("ZTPM_LINES", "40"))  # a campaign asks for 200 and more
BATCH = 20
ANY = np.full(6, np.inf)


PATIENT = replace(CELL, time_limit_s=60.0)  # a loaded machine that runs other tests meanwhile


def ask(motion, scene=None, cell=PATIENT, age=0.1, robot=ROBOT):
    scene = empty() if scene is None else scene
    return assess(robot, scene, motion, cell, perception_age_s=age, touch=NOTHING, seed=SEED)


def unhurried():
    return None


def drive_for(move, robot=ROBOT):
    return line_drive(
        robot,
        move.start,
        move.target,
        speed_m_s=move.speed_m_s,
        acceleration_m_s2=move.acceleration_m_s2,
        check_time=unhurried,
    )


def shifted(by=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0), start=HOME, speed=0.25, acceleration=1.2):
    position, rotation = placed(start)
    target = pinocchio.log3(pinocchio.exp3(np.array(turn)) @ rotation)
    return MoveL(start, (*(position + by).tolist(), *target.tolist()), speed, acceleration)


# ---- the geometry by itself


def test_turns_are_those_of_pinocchio():
    rng = np.random.default_rng(1)
    for length in (0.0, 1e-14, 1e-9, 1e-3, 1.0, 3.0, math.pi - 1e-6):
        axis = rng.standard_normal(3)
        vector = length * axis / np.linalg.norm(axis)
        assert turned_by(vector) == pytest.approx(pinocchio.exp3(vector), abs=1e-14)
        assert turn_of(turned_by(vector)) == pytest.approx(vector, abs=1e-9)
    for diagonal in ((1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        half = np.diag(np.array(diagonal, dtype=float))
        assert turned_by(turn_of(half)) == pytest.approx(half, abs=1e-12)


def test_the_jacobian_and_its_derivative_are_those_of_differences():
    rng = np.random.default_rng(2)
    for _ in range(20):
        q, dq = rng.uniform(-3, 3, 6), rng.standard_normal(6)
        here, step = stance(ROBOT, q), 1e-5
        position, rotation = placed(q)
        assert here.position == pytest.approx(position, abs=1e-14)
        ahead, behind = placed(q + step * dq), placed(q - step * dq)
        twist = np.concatenate(
            [(ahead[0] - behind[0]) / (2 * step), pinocchio.log3(ahead[1] @ behind[1].T) / (2 * step)]
        )
        assert here.jacobian @ dq == pytest.approx(twist, abs=1e-8)
        bend = (stance(ROBOT, q + step * dq).jacobian - stance(ROBOT, q - step * dq).jacobian) / (2 * step)
        assert here.bend(dq) == pytest.approx(bend, abs=1e-7)


@pytest.mark.parametrize("seed", range(6))
def test_every_cell_bounds_the_three_derivatives_and_the_joints_path_is_the_marched_one(seed):
    """Differences of a march with pinocchio's kinematics, 4000 steps: nowhere above the bound of the cell there."""
    move = random_line(np.random.default_rng(3000 + seed))
    twist = Twist.between(ROBOT, move.start, move.target)
    found = trace(ROBOT, twist, np.array(move.start), fastest=ANY, check_time=unhurried)
    assert isinstance(found, LineTrace)
    cells = found.cells
    assert cells.low[0] == 0
    assert cells.high[-1] == GRID
    assert (cells.low[1:] == cells.high[:-1]).all()
    shares = np.linspace(0, 1, 4001)
    track = marched(move.start, twist.line, twist.turn, shares)
    q, dq = (np.array([place[k] for place in track]) for k in (0, 1))
    ddq = np.gradient(dq, shares, axis=0, edge_order=2)
    third = np.gradient(ddq, shares, axis=0, edge_order=2)
    at = np.array([cells.holding(s * GRID) for s in shares])
    assert (np.abs(dq) <= cells.first[at] * (1 + 1e-9) + 1e-9).all()
    inner = slice(5, -5)
    assert (np.abs(ddq) <= cells.second[at] * (1 + 1e-4) + 1e-4)[inner].all()
    assert (np.abs(third) <= cells.third[at] * 1.02 + 1e-2)[inner].all()
    drive = drive_for(move)
    for k in range(0, 4001, 400):
        here, rate = drive.course.at(float(shares[k]))
        assert here == pytest.approx(q[k], abs=1e-8)
        assert rate == pytest.approx(dq[k], abs=1e-6)


def test_the_second_derivative_of_a_body_is_inside_its_bound():
    rng = np.random.default_rng(4)
    for _ in range(4):
        move = random_line(rng)
        kernel = drive_for(move).course
        course = NumpyCourse(ROBOT, kernel.cells, kernel.track)
        keys = np.arange(0, GRID + 1, GRID // 512)
        at, known = course.nodes(keys)
        ends = known.ends[at]
        h = 1 / 512
        bend = np.linalg.norm(ends[2:] - 2 * ends[1:-1] + ends[:-2], axis=-1).max(axis=-1) / h**2
        low, high = keys[:-2], keys[2:]
        worst = course._worst(low, high)
        assert (bend <= worst.second * (1 + 1e-3) + 1e-6).all()
        rush = kernel.rush(low, high)
        middle = known.speed[at][1:-1] + course.layout.radius * known.spin[at][1:-1]
        assert (middle <= rush * (1 + 1e-12)).all()


# ---- the answer


def sampled(move, scene, samples=120):
    """Dense truth: the march, the trapezoid by its own formula, the leading joint speed that was really met."""
    twist = Twist.between(ROBOT, move.start, move.target)
    profile = Profile(twist.way_m, move.speed_m_s, move.acceleration_m_s2)
    instants = [profile.at(t) for t in np.linspace(0, profile.duration_s, samples)]
    track = marched(move.start, twist.line, twist.turn, [s for s, _ in instants])
    joints = [(q, dq * rate) for (q, dq), (_, rate) in zip(track, instants, strict=True)]
    omega = max(float(np.abs(qd).max()) for _, qd in joints)
    found = Sampled(scene)
    for q, qd in joints:
        found.look(q, qd, omega=omega)
    return found, joints


@pytest.mark.parametrize("batch", range((LINES + BATCH - 1) // BATCH))
def test_p9_no_dense_sample_exceeds_the_certified_answer(batch):
    """40 lines (ZTPM_LINES for more), seeds 40000 + batch; the joint rates are above every sample and mostly near."""
    rng = np.random.default_rng(40000 + batch)
    print(f"seed {40000 + batch}")
    near, doubted = [], 0
    for _ in range(min(BATCH, LINES - batch * BATCH)):
        scene, move = random_scene(rng, things=2, regions=2), random_line(rng)
        answer = ask(move, scene)
        if isinstance(answer, ImpactFault):
            doubted += 1
            assert answer.reason == "UNPROVEN"
            continue
        truth, joints = sampled(move, scene)
        assert answer.index >= max(truth.worst, 1.0) - 1e-9
        assert set(answer.violations) >= truth.violated
        assert answer.speed_m_s >= truth.fastest - 1e-9
        drive = drive_for(move)
        rates = drive.joint_speeds_rad_s(drive.profile).max(axis=0)
        true = np.max([np.abs(qd) for _, qd in joints], axis=0)
        assert (rates >= true - 1e-9).all()
        near.append(rates.max() / true.max())
    assert np.mean(np.array(near) <= 1.5) >= 0.9
    assert doubted <= BATCH // 10


def test_p9_the_certified_answer_is_near_the_dense_one():
    """Not only above: with the proven joint speed in the law, and where geometry decides, within what samples miss."""
    rng = np.random.default_rng(5)
    compared = 0
    for _ in range(8):
        scene, move = random_scene(rng, things=2, regions=2), random_line(rng)
        answer, drive = ask(move, scene), drive_for(move)
        demands = max(r.index for r in Effort(ROBOT, drive, CELL).ratios(drive.profile))
        omega = float(drive.joint_speeds_rad_s(drive.profile).max())
        _, joints = sampled(move, scene, samples=400)
        truth = Sampled(scene)
        for q, qd in joints:
            truth.look(q, qd, omega=omega)
        assert answer.index <= max(truth.worst, demands, 1.0) + RESOLUTION + 0.03
        compared += truth.worst > demands
    assert compared >= 3


def test_the_rows_of_the_proof_cover_every_pair_and_are_found_again_from_the_recorded_nodes():
    """The twin: each row is recomputed on a course of its own, whose configurations are those that the proof records."""
    scene, move = with_glass(), shifted((0.12, -0.1, 0.0))
    answer = ask(move, scene)
    proof = answer.certificate
    assert isinstance(proof, CourseCertificate)
    ends = {}
    for pair, low, high, index in proof.rows:
        assert low == ends.get(pair, 0)
        assert high > low
        assert index <= answer.index + 1e-12
        ends[pair] = high
    pairs = pairs_of(ROBOT, scene, CELL, grown_m=0.0)
    assert set(ends) == set(range(len(pairs)))
    assert set(ends.values()) == {GRID}
    nodes = dict(zip(proof.key.tolist(), proof.q, strict=True))
    twist = Twist.between(ROBOT, move.start, move.target)
    scratch = MODEL.createData()
    for key, q in list(nodes.items())[:200]:
        position, rotation = placed(q, scratch)
        assert position == pytest.approx(twist.at(key / GRID)[0], abs=1e-9)
        assert rotation == pytest.approx(twist.at(key / GRID)[1], abs=1e-9)
    course = drive_for(move).course
    drive = drive_for(move)
    stop_speed = float(drive.joint_speeds_rad_s(drive.profile).max())
    from pep.pit.scene.separation import stopping

    stop = stopping(CELL, perception_age_s=0.1, joint_speed_rad_s=stop_speed)
    leaves = course.examine(pairs, proof.low, proof.high, proof.pair)
    bound = pairs.index(
        proof.pair, leaves.clear_m, leaves.rush * drive.profile.highest_rate(proof.low / GRID, proof.high / GRID), stop
    )
    assert (bound <= proof.index + 1e-9).all()
    for low, mid, high in zip(proof.low, (proof.low + proof.high) // 2, proof.high, strict=True):
        assert {int(low), int(mid), int(high)} <= set(nodes)


def test_faster_nearer_and_more_never_lower():
    rng = np.random.default_rng(6)
    for _ in range(5):
        scene, move = random_scene(rng, things=2, regions=2), random_line(rng)
        plain = ask(move, scene)
        assert ask(replace(move, speed_m_s=1.5 * move.speed_m_s), scene).index >= plain.index - RESOLUTION
        assert ask(replace(move, acceleration_m_s2=2 * move.acceleration_m_s2), scene).index >= plain.index - RESOLUTION
        more = random_scene(rng, things=2, regions=0, zones=0)
        both = replace(scene, objects=(*scene.objects, *(replace(o, id=f"more-{o.id}") for o in more.objects)))
        assert ask(move, both).index >= plain.index - RESOLUTION
        fenced = replace(scene, workspace=Workspace((-0.2, -0.2, 0.0), (0.2, 0.2, 0.3)))
        assert ask(move, fenced).index >= plain.index - RESOLUTION


def test_the_lower_speed_is_proven_to_lower_the_tier():
    scene, move = with_person(1.15), shifted((0.0, -0.15, 0.0), speed=0.5)
    answer = ask(move, scene)
    assert answer.lower_tier_speed is not None
    assert 0 < answer.lower_tier_speed < move.speed_m_s
    slower = ask(replace(move, speed_m_s=answer.lower_tier_speed), scene)
    assert slower.tier < answer.tier
    assert answer.reading().lower_tier_speed == math.floor(answer.lower_tier_speed * 1e6)


def test_a_thing_on_the_line_that_no_straight_joint_move_would_meet():
    """The tool goes straight: a bar under the chord's middle is met although both ends are clear of it."""
    move = shifted((0.0, 0.25, 0.0), start=(0.3, *HOME[1:]))
    middle, _ = placed(marched(move.start, np.array([0, 0.25, 0]), np.zeros(3), [0.5])[0][0])
    bar = replace(empty(), objects=(Thing("bar", "rigid", Sphere(tuple(middle.tolist()), 0.005), 0.0),))
    met = ask(move, bar)
    assert met.index >= 2.9
    aside = replace(bar, objects=(replace(bar.objects[0], shape=Sphere((*middle[:2], middle[2] + 0.9), 0.005)),))
    assert ask(move, aside).index < 2


# ---- what cannot be proven, or is none


def test_a_line_to_where_the_tool_is_has_no_effect():
    answer = ask(shifted(), with_person())
    assert (answer.tier, answer.index, answer.violations) == (0, 0, ())


def test_a_turn_in_place_is_a_motion():
    answer = ask(shifted(turn=(0.0, 0.0, 0.4)))
    assert answer.tier >= 1
    assert answer.tcp_speed_m_s == pytest.approx(0.0, abs=1e-3)
    assert answer.speed_m_s > 0.1


UP = (0.0, -math.pi / 2, 0.0, 0.0, 0.3, 0.0)  # stretched: the elbow is singular
WRIST = (*HOME[:4], 0.0, HOME[5])  # wrist 2 at zero: two axes in one line


@pytest.mark.parametrize(
    ("start", "by", "turn", "why"),
    [
        (HOME, (-2.0, 0.0, 0.0), (0, 0, 0), "unreachable"),
        (HOME, (0.0, 0.0, 1.5), (0, 0, 0), "unreachable"),
        (UP, (0.05, 0.0, 0.0), (0, 0, 0), "singular"),
        (WRIST, (0.05, 0.05, 0.0), (0, 0, 0), "singular"),
        (HOME, (0.05, 0.0, 0.0), (math.pi, 0, 0), "half_turn"),
    ],
)
def test_what_is_not_proven_to_its_end_is_a_fault_with_a_word_of_its_own(start, by, turn, why):
    assert ask(shifted(by, turn, start=start)) == ImpactFault("UNPROVEN", why)


def test_through_a_singular_place_between_good_ones():
    """Wrist 2 goes through zero on the way: the pose exists everywhere, and no bound does."""
    start = (*HOME[:4], 0.15, HOME[5])
    ahead = (*HOME[:4], -0.15, HOME[5])
    move = MoveL(start, pose_of(ahead), 0.1, 1.0)
    assert ask(move) == ImpactFault("UNPROVEN", "singular")


def test_joint_limits_on_the_way():
    start = (6.2, *HOME[1:])
    left, right = (shifted(tuple((0.25 * s * d).tolist()), start=start) for s, d in ((1, TANGENT), (-1, TANGENT)))
    answers = [ask(left), ask(right)]
    assert sorted(a.violations for a in answers) == [(), ("joint_limit",)]
    worst = max(answers, key=lambda a: a.index)
    assert worst.tier == 4
    assert worst.contributions[0].kind == "joint_limit"
    beyond = (6.3, *HOME[1:])
    assert ask(shifted((0.0, 0.1, 0.0), start=beyond)).violations == ("joint_limit",)


_P = placed((6.2, *HOME[1:]))[0]
TANGENT = np.array([-_P[1], _P[0], 0.0]) / math.hypot(_P[0], _P[1])

GOOD = shifted((0.05, 0.0, 0.0))
BAD = [
    *(
        (replace(GOOD, target=(*GOOD.target[:k], bad, *GOOD.target[k + 1 :])), "NOT_FINITE")
        for k in (0, 2, 3, 5)
        for bad in (NAN, INF, -INF)
    ),
    *(
        (replace(GOOD, start=(*GOOD.start[:k], bad, *GOOD.start[k + 1 :])), "NOT_FINITE")
        for k in (0, 5)
        for bad in (NAN, INF)
    ),
    *(
        (replace(GOOD, **{f: bad}), "NOT_FINITE")
        for f in ("speed_m_s", "acceleration_m_s2")
        for bad in (NAN, INF, -INF)
    ),
    *(
        (replace(GOOD, **{f: bad}), "OUT_OF_RANGE")
        for f in ("speed_m_s", "acceleration_m_s2")
        for bad in (0.0, -1.0, 1e-9, 1e6)
    ),
    (replace(GOOD, target=(1e300, *GOOD.target[1:])), "OUT_OF_RANGE"),
    (replace(GOOD, target=(*GOOD.target[:3], 7.0, 0.0, 0.0)), "OUT_OF_RANGE"),
    (replace(GOOD, target=GOOD.target[:5]), "PARAMETERS_WRONG"),
    (replace(GOOD, target=(*GOOD.target, 0.0)), "PARAMETERS_WRONG"),
    (replace(GOOD, start=GOOD.start[:5]), "PARAMETERS_WRONG"),
    (replace(GOOD, target=None), "PHYSICS_FAULT"),
    (replace(GOOD, target=("0",) * 6), "PHYSICS_FAULT"),
    (replace(GOOD, stated_start=(NAN, *pose_of(HOME)[1:])), "NOT_FINITE"),
    (replace(GOOD, stated_start=pose_of(HOME)[:5]), "PARAMETERS_WRONG"),
    (replace(GOOD, stated_start=(pose_of(HOME)[0] + 0.003, *pose_of(HOME)[1:])), "FRAMES_MISMATCH"),
    (replace(GOOD, stated_start=pose_of((HOME[0] + 0.01, *HOME[1:]))), "FRAMES_MISMATCH"),
]


@pytest.mark.parametrize(("motion", "reason"), BAD)
def test_p13_a_line_that_is_none_is_a_fault_with_its_reason(motion, reason):
    answer = ask(motion)
    assert isinstance(answer, ImpactFault)
    assert answer.reason == reason
    assert answer.reason in Reason.__members__


def test_a_stated_pose_that_is_the_models_changes_nothing():
    stated = replace(GOOD, stated_start=pose_of(HOME))
    assert ask(stated).index == ask(GOOD).index
    near = replace(GOOD, stated_start=(pose_of(HOME)[0] + 0.0015, *pose_of(HOME)[1:]))
    assert ask(near).index == ask(GOOD).index


@pytest.mark.parametrize("huge", [1e6, 1e300, -1e18])
def test_joint_angles_beyond_all_sense_are_no_exception(huge):
    answer = ask(replace(GOOD, start=(huge, *HOME[1:])))
    assert answer.violations == ("joint_limit",)
    assert answer.tier == 4


def test_no_view_is_at_least_tier_three():
    answer = assess(ROBOT, None, GOOD, CELL, perception_age_s=None, touch=NOTHING, seed=SEED)
    assert (answer.tier, answer.perception) == (3, "missing")


def test_out_of_time_is_a_fault():
    clock = iter(range(10_000_000))
    answer = assess(
        ROBOT, empty(), GOOD, CELL, perception_age_s=0.1, touch=NOTHING, seed=SEED, clock=lambda: float(next(clock))
    )
    assert (type(answer), answer.reason) == (ImpactFault, "PHYSICS_FAULT")


def test_a_second_engine_that_sees_another_line_is_a_fault(monkeypatch):
    """The compiled engine has its tool a thousandth of a millimetre elsewhere."""
    from pep.pit.search.kernel import compiled_course

    honest = compiled_course._tool_of

    def bent(robot):
        tool = honest(robot)
        return tool._replace(wrist=tool.wrist._replace(tcp=tool.wrist.tcp + np.array([0, 0, 1e-6])))

    monkeypatch.setattr(compiled_course, "_tool_of", bent)
    answer = ask(GOOD)
    assert (type(answer), answer.reason) == (ImpactFault, "ENGINES_DISAGREE")


def test_a_second_engine_that_sees_another_line_than_the_numpy_engine_is_a_fault(monkeypatch):
    from tests.model.pit.engine import NUMPY

    from pep.pit.robot import inverse_kinematics

    honest = inverse_kinematics.link_frames

    def bent(robot, q):
        rotation, origin = honest(robot, q)
        return rotation, origin + np.array([0, 0, 1e-6])

    monkeypatch.setattr("pep.pit.search.timed_course.chosen", lambda: NUMPY)
    assert not isinstance(ask(GOOD), ImpactFault)
    monkeypatch.setattr(inverse_kinematics, "link_frames", bent)
    answer = ask(GOOD)
    assert (type(answer), answer.reason) == (ImpactFault, "ENGINES_DISAGREE")


def test_an_answer_below_what_is_met_at_a_place_that_nobody_foresees_is_a_fault(monkeypatch):
    honest = CompiledCourse.certify

    def lying(*args, **more):
        return replace(honest(*args, **more), upper=1.0, attained=1.0, witnesses=())

    scene = with_person(0.6)
    assert ask(GOOD, scene).index > 1.5
    monkeypatch.setattr(CompiledCourse, "certify", lying)
    answer = ask(GOOD, scene)
    assert (type(answer), answer.reason) == (ImpactFault, "ENGINES_DISAGREE")


def test_no_piece_is_shorter_than_the_finest():
    move = shifted((-2.0, 0.0, 0.0))
    twist = Twist.between(ROBOT, move.start, move.target)
    found = trace(ROBOT, twist, np.array(move.start), fastest=ANY, check_time=unhurried)
    assert isinstance(found, CutShort)
    assert found.stuck == "singular"
    assert 0 < found.reached < GRID
    assert (found.cells.high - found.cells.low).min() >= FINEST


def test_only_in_a_small_box_is_a_configuration_the_only_one():
    """Newton's map contracts near a good configuration, not on a wide box, and not at a singular one."""
    from tests.model.pit.line import _Lever, _on_path

    lever = _Lever(ROBOT.reach[ROBOT.body_index("tcp")])
    good, flat = stance(ROBOT, np.array(HOME)), stance(ROBOT, np.array((*HOME[:4], 1e-4, HOME[5])))
    near = np.full(6, 1e-4)
    assert _on_path(lever, good, good.q, near)
    assert not _on_path(lever, good, good.q, np.full(6, 0.3))
    assert not _on_path(lever, good, good.q + 2e-4, near)
    assert not _on_path(lever, flat, flat.q, near)
