"""Lines and courses of the compiled engine beside the numpy engine's: the same pieces, the same rows, the same answers."""

from contextlib import suppress

import numpy as np
import pytest
from pep.pit.assessment.dispatch import drive_of
from pep.pit.base.errors import UnprovenError
from pep.pit.base.tier import TIE
from pep.pit.path.line_trace import CutShort, LineTrace
from pep.pit.path.straight_path import GRID
from pep.pit.robot.twist import Twist
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.separation import stopping
from pep.pit.search.certify import RESOLUTION
from pep.pit.search.engine import chosen
from pep.pit.search.timed_course import TimedCourse
from tests.model.pit.course import NumpyCourse
from tests.model.pit.engine import NUMPY
from tests.model.pit.line import trace
from tests.pep.pit.lines import placed, random_hold, random_line, random_servo, random_start, random_way
from tests.pep.pit.scenes import CELL, HOME, ROBOT, random_scene


pytestmark = pytest.mark.long

KERNEL = chosen()
ANY = np.full(6, np.inf)


def unhurried():
    return None


def twist_from(start, line, turn):
    position, rotation = placed(start)
    return Twist(position, rotation, np.asarray(line, float), np.asarray(turn, float))


def any_line(rng):
    """Any line at all: most end in a singular place, out of reach or at a joint's limit."""
    spread = rng.choice([0.6, 3.0, 6.2])
    start = np.array(random_start(rng, spread))
    if rng.integers(0, 4) == 0:
        start[4] = rng.choice([0.0, 1e-9, 1e-3, np.pi])  # wrist 2: singular, or nearly
    if rng.integers(0, 6) == 0:
        start[2] = rng.choice([0.0, 1e-4])  # stretched
    line, turn = random_way(rng, longest=rng.choice([0.01, 0.3, 1.5]), turn=rng.choice([0.8, 3.14159]))
    if rng.integers(0, 5) == 0:
        line = np.zeros(3)
    return start, twist_from(start, line, turn)


def about_the_base(rng):
    """A line that turns the first joint beyond its limit, soon or later."""
    start = np.array(HOME)
    start[0] = sign = rng.choice([-1, 1])
    start[0] *= rng.uniform(6.0, 6.2)
    x, y, _ = placed(start)[0]
    return start, twist_from(start, 0.25 * sign * np.array([-y, x, 0.0]) / np.hypot(x, y), np.zeros(3))


def same_trace(ours, theirs):
    assert type(ours) is type(theirs)
    if isinstance(theirs, CutShort):
        assert (ours.stuck, ours.reached) == (theirs.stuck, theirs.reached)
    assert (ours.cells.low == theirs.cells.low).all()
    assert (ours.cells.high == theirs.cells.high).all()
    assert ours.q == pytest.approx(theirs.q, abs=1e-9)
    for name in ("q", "dq", "ddq", "first", "second", "third", "stray", "hurry"):
        a, b = getattr(ours.cells, name), getattr(theirs.cells, name)
        assert a.shape == b.shape
        scale = np.abs(b).max(initial=1.0)
        assert np.allclose(a, b, rtol=1e-6, atol=1e-9 * scale), name
    if len(theirs.cells):
        assert ours.dq == pytest.approx(theirs.dq, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("count", [30, pytest.param(120, marks=pytest.mark.campaign)])
@pytest.mark.parametrize("seed", range(4))
def test_p12_traces_are_the_same_piece_by_piece(seed, count):
    rng = np.random.default_rng(71000 + seed)
    told = []
    for k in range(count):
        start, twist = about_the_base(rng) if k % 10 == 0 else any_line(rng)
        fastest = ANY if rng.integers(0, 2) else np.full(6, 30.0)
        theirs = trace(ROBOT, twist, start, fastest=fastest, check_time=unhurried)
        ours = KERNEL.trace(ROBOT, twist, start, fastest=fastest, check_time=unhurried)
        same_trace(ours, theirs)
        told.append((ours.stuck if isinstance(ours, CutShort) else None, len(ours.cells) > 0))
    assert {(None, True), ("singular", True), ("singular", False), ("joint_limit", True)} <= set(told)


@pytest.mark.parametrize("count", [5, pytest.param(60, marks=pytest.mark.campaign)])
def test_p12_parts_of_a_line_are_the_same_too(count):
    rng = np.random.default_rng(72)
    for _ in range(count):
        start, twist = any_line(rng)
        since, until = 0, GRID // 4 * 3
        asked = {"since": since, "until": until, "pieces": 16, "fastest": ANY, "check_time": unhurried}
        same_trace(KERNEL.trace(ROBOT, twist, start, **asked), trace(ROBOT, twist, start, **asked))
        line = random_line(rng)
        twist = Twist.between(ROBOT, line.start, line.target)
        first = KERNEL.trace(ROBOT, twist, np.array(line.start), until=GRID // 2, fastest=ANY, check_time=unhurried)
        if isinstance(first, LineTrace):
            asked = {"since": GRID // 2, "until": GRID, "pieces": 4, "fastest": ANY, "check_time": unhurried}
            ours, theirs = KERNEL.trace(ROBOT, twist, first.q, **asked), trace(ROBOT, twist, first.q, **asked)
            same_trace(ours, theirs)


def test_p12_only_in_a_small_box_is_a_configuration_the_only_one():
    """Both engines say so of the same boxes, by the way, the turn or the distance."""
    from pep.pit.robot.inverse_kinematics import stance
    from pep.pit.search.kernel.arithmetic.compilation import entry
    from pep.pit.search.kernel.arithmetic.line_piece import on_path
    from tests.model.pit.line import _Lever, _on_path

    @entry
    def compiled(reach, q, inverse, near, within):
        return on_path(reach, q, inverse, near, within, np.empty((6, 2)), np.empty((2, 6)))

    rng = np.random.default_rng(74)
    reach = ROBOT.reach[ROBOT.body_index("tcp")].copy()
    told = []
    for _ in range(400):
        node = stance(ROBOT, np.array(random_start(rng, rng.choice([0.6, 3.0]))))
        inverse = np.linalg.inv(node.jacobian)
        within = 10.0 ** rng.uniform(-5, -1) * rng.uniform(0, 1, 6)
        near = node.q + rng.choice([0.5, 0.99, 1.5]) * within * rng.choice([-1, 1], 6)
        ours = compiled(reach, node.q, inverse, near, within)
        told.append(ours)
        assert ours == _on_path(_Lever(reach), node, near, within)
    assert 0.1 < np.mean(told) < 0.9


# ---- courses


def motions(rng, count):
    for k in range(count):
        yield (random_line, random_hold, random_servo)[k % 3](rng)


class Asked:
    """One question, and both engines' courses for it."""

    def __init__(self, rng, motion):
        self.scene = random_scene(rng, things=4, regions=4)
        self.drive = drive_of(ROBOT, motion, CELL, perception_age_s=0.1, check_time=unhurried)
        assert isinstance(self.drive, TimedCourse)
        self.kernel = self.drive.course
        self.numpy = NumpyCourse(ROBOT, self.kernel.cells, self.kernel.track)
        self.profile = self.drive.profile
        self.pairs = pairs_of(ROBOT, self.scene, CELL, grown_m=0.0)
        self.rows = np.arange(len(self.pairs))
        omega = float(self.drive.joint_speeds_rad_s(self.profile).max())
        self.stop = stopping(CELL, perception_age_s=0.1, joint_speed_rad_s=omega)

    def certified(self, engine, floor=1.0, profile=None):
        course = self.kernel if engine is KERNEL else self.numpy
        timing = self.profile if profile is None else profile
        return course.certify(self.pairs, timing, self.stop, rows=self.rows, floor=floor, check_time=unhurried)


def followed(motion):
    """The motion as a course, or nothing."""
    with suppress(UnprovenError):
        found = drive_of(ROBOT, motion, CELL, perception_age_s=0.1, check_time=unhurried)
        return found if isinstance(found, TimedCourse) else None
    return None


def asked(seed, count):
    rng = np.random.default_rng(seed)
    for motion in motions(rng, count):
        if followed(motion) is not None:
            yield Asked(rng, motion)


def tier(index):
    return np.ceil(index - TIE)


def test_the_kernel_is_what_decides_here():
    assert (KERNEL.name, NUMPY.name) == ("numba-1", "numpy-1")
    assert type(next(asked(80, 1)).kernel) is not NumpyCourse


def test_p12_places_of_a_course_are_the_same():
    for each in asked(81, 8):
        keys = np.unique(np.concatenate([np.arange(0, GRID + 1, GRID // 64), each.kernel.cells.mid]))
        each.kernel.examine(each.pairs, keys[:-1], keys[1:], np.zeros(len(keys) - 1, dtype=int))
        key, q = each.kernel.known
        assert len(key) == len(set(key.tolist())) >= 64
        for k, angles in list(zip(key.tolist(), q, strict=True))[::5]:
            assert angles == pytest.approx(each.numpy.q(k / GRID), abs=1e-9)


def test_p12_rows_of_a_course_are_the_same_to_rounding():
    rng = np.random.default_rng(31)
    for each in asked(82, 12):
        count = 300
        exponent = rng.integers(0, 12, count)
        width = GRID >> exponent
        low = rng.integers(0, 1 << exponent) * width
        pair = rng.integers(0, len(each.pairs), count)
        ours = each.kernel.examine(each.pairs, low, low + width, pair)
        theirs = each.numpy.examine(each.pairs, low, low + width, pair)
        for name in ("clear_m", "rush", "clear_mid_m", "rush_mid"):
            assert np.allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-8, atol=1e-8), name
        ours, theirs = (course.rush(low[:20], low[:20] + width[:20]) for course in (each.kernel, each.numpy))
        seen = np.array([body.reference == 0 for body in ROBOT.bodies])
        assert np.allclose(ours[:, seen], theirs[:, seen], rtol=1e-8, atol=1e-8)
        assert (ours[:, ~seen] >= theirs[:, ~seen] - 1e-8).all()
        key = int(rng.integers(0, GRID + 1))
        for name in ("clearance_at", "rush_at"):
            a, b = (getattr(course, name)(each.pairs, key, pair) for course in (each.kernel, each.numpy))
            assert np.allclose(a, b, atol=1e-8), name


def test_p12_answers_of_courses_are_the_same_inside_the_resolution():
    compared = 0
    for each in asked(83, 24):
        ours, theirs = each.certified(KERNEL), each.certified(NUMPY)
        assert tier(ours.upper) == tier(theirs.upper), (ours.upper, theirs.upper)
        assert abs(ours.upper - theirs.upper) <= RESOLUTION + 1e-6
        assert ours.attained <= theirs.upper + 1e-6
        assert theirs.attained <= ours.upper + 1e-6
        assert set(ours.violated) == set(theirs.violated)
        slower = each.drive.at_speed(0.5 * each.profile.speed_rad_s)
        bound = np.floor(theirs.upper)
        leaves = ours.leaves.take(ours.leaf_index > bound)
        fit = each.kernel.fits(each.pairs, slower, each.stop, leaves, index=bound, check_time=unhurried)
        plain = each.numpy.fits(each.pairs, slower, each.stop, theirs.leaves, index=bound, check_time=unhurried)
        if fit.proven != plain.proven:  # one of them halved no more: the other's answer must then be true
            assert each.certified(NUMPY, profile=slower).attained <= bound + RESOLUTION
        ratios = [
            course.blow_ratio(each.pairs, each.profile, each.stop, check_time=unhurried)
            for engine, course in ((KERNEL, each.kernel), (NUMPY, each.numpy))
        ]
        assert abs(ratios[0] - ratios[1]) <= 0.01 + 1e-6
        compared += ours.upper > 1.05
    assert compared >= 12


def test_leaves_cover_the_course_for_every_pair_and_hold_when_the_other_engine_examines_them():
    for each in asked(84, 12):
        found = each.certified(KERNEL)
        leaves = found.leaves
        order = np.lexsort((leaves.low, leaves.pair))
        low, high, pair = leaves.low[order], leaves.high[order], leaves.pair[order]
        first = np.flatnonzero(np.r_[True, pair[1:] != pair[:-1]])
        last = np.r_[first[1:] - 1, len(pair) - 1]
        assert (pair[first] == each.rows).all()
        assert (low[first] == 0).all()
        assert (high[last] == GRID).all()
        inside = np.ones(len(pair), dtype=bool)
        inside[first] = False
        assert (low[inside] == high[np.flatnonzero(inside) - 1]).all()
        again = each.numpy.examine(each.pairs, leaves.low, leaves.high, leaves.pair)
        rate = each.profile.highest_rate(leaves.low / GRID, leaves.high / GRID)
        bound = each.pairs.index(leaves.pair, again.clear_m, again.rush * rate, each.stop)
        assert (bound <= found.leaf_index + 1e-6).all()
        assert found.leaf_index.max() <= found.upper + 1e-12
        assert (again.clear_m >= leaves.clear_m - 1e-8).all()
        assert (again.rush <= leaves.rush + 1e-8).all()


def test_witnesses_of_a_course_are_true():
    for each in asked(85, 12):
        ours, theirs = each.certified(KERNEL), each.certified(NUMPY)
        known = {each.pairs.group[w.pair] for w in ours.witnesses}
        for witness in theirs.witnesses:
            assert witness.index <= 1.3 or each.pairs.group[witness.pair] in known
        stray = each.kernel.cells.stray.max()
        for witness in ours.witnesses:
            clearance = each.numpy.clearance_at(each.pairs, witness.key, np.array([witness.pair]))
            speed = each.numpy.rush_at(each.pairs, witness.key, np.array([witness.pair]))
            rate = float(each.profile.rate(np.array(witness.s)))
            assert witness.clearance_m <= clearance[0] + 1e-8
            assert witness.speed_m_s >= speed[0] * rate - 1e-8
            if stray < 1e-8:
                assert witness.clearance_m == pytest.approx(clearance[0], abs=1e-6)
                assert witness.speed_m_s == pytest.approx(speed[0] * rate, abs=1e-6)


def test_a_floor_settles_what_lies_below_it():
    for each in asked(86, 6):
        plain, floored = each.certified(KERNEL), each.certified(KERNEL, floor=4.0)
        assert floored.upper == 4.0
        assert len(floored.leaves) <= len(plain.leaves)


def test_a_line_that_is_not_found_again_is_a_fault():
    """The cells of one line, the track of another: no number comes of it."""
    from dataclasses import replace

    from pep.pit.base.errors import MotionError

    each = next(asked(87, 1))
    twist = each.kernel.track.twist
    astray = replace(each.kernel.track, twist=replace(twist, position=twist.position + np.array([0.0, 0.0, 2.0])))
    course = type(each.kernel)(ROBOT, each.kernel.cells, astray)
    for ask in (
        lambda: course.clearance_at(each.pairs, 1, each.rows),
        lambda: course.rush(np.array([0]), np.array([GRID])),
        lambda: course.certify(each.pairs, each.profile, each.stop, rows=each.rows, floor=1.0, check_time=unhurried),
    ):
        with pytest.raises(MotionError) as told:
            ask()
        assert told.value.reason == "PHYSICS_FAULT"
