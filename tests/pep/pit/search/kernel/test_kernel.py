"""The compiled engine beside the numpy engine: the same rows to rounding, the same answers inside the resolution."""

import numpy as np
import pytest
from pep.pit.base.motion import profile_of
from pep.pit.base.tier import TIE
from pep.pit.path.straight_path import GRID
from pep.pit.scene.adult_body import standing_adult
from pep.pit.scene.obstacles import PairKind
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.scene import Box, Capsule, Scene, Sphere, Thing, Workspace, Zone
from pep.pit.scene.separation import stopping
from pep.pit.search.certify import RESOLUTION
from pep.pit.search.engine import chosen
from pep.pit.search.kernel.arithmetic.body_poses import no_nodes, pose, put
from pep.pit.search.kernel.arithmetic.joint_torques import torques
from pep.pit.search.kernel.compiled_path import arm_of, blocks
from pep.pit.search.kernel.loads import laid_out
from pep.pit.search.torques import masses_with
from tests.model.pit.engine import NUMPY

from pep.pit import CellParameters, MoveJ, Robot
from pep.pit.search.kernel import broad_phase
from pep.pit.search.kernel.arithmetic import body_poses as arm_module

pytestmark = pytest.mark.version

ROBOT, CELL = Robot.load("ur3e"), CellParameters()
KERNEL = chosen()
FINER = 8  # times that a row is halved
NEARLY = 2e-4  # of an index: so fine rows resolve it; `test_coupling` holds each leaf to its own nodes, to rounding


def ready():
    return None


def drawn(rng):
    """A scene with everything in it, and a move through it."""

    def point(least=0.2, most=0.9):
        out, turn = rng.uniform(least, most), rng.uniform(-np.pi, np.pi)
        return tuple(map(float, (out * np.cos(turn), out * np.sin(turn), rng.uniform(-0.1, 0.8))))

    def thing(k):
        center, kind = point(), "fragile" if rng.random() < 0.5 else "rigid"
        turned = rng.normal(size=4)
        shape = (
            Sphere(center, float(rng.uniform(0.02, 0.1))),
            Capsule(center, tuple(map(float, np.array(center) + rng.uniform(-0.2, 0.2, 3))), 0.04),
            Box(
                center,
                tuple(map(float, rng.uniform(0.02, 0.15, 3))),
                tuple(map(float, turned / np.linalg.norm(turned))),
            ),
        )[k % 3]
        return Thing(f"thing{k}", kind, shape, 0.015)

    people = tuple(
        standing_adult(*point(0.4, 1.8)[:2], facing_rad=float(rng.uniform(-3, 3)), name=f"person{k}")
        for k in range(rng.integers(0, 3))
    )
    zones = (
        Zone("hard", Sphere(point(), 0.1), None),
        Zone("tiered", Box(point(), (0.1, 0.1, 0.1)), int(rng.integers(1, 5))),
    )
    room = Workspace((-0.8, -0.8, -0.2), (0.8, 0.8, 1.0)) if rng.random() < 0.5 else None
    scene = Scene(
        people=people,
        objects=tuple(thing(k) for k in range(rng.integers(1, 12))),
        zones=zones[: rng.integers(0, 3)],
        workspace=room,
    )
    start = rng.uniform(-2, 2, 6)
    way = rng.uniform(-1.5, 1.5, 6) * (rng.random(6) < rng.choice([0.3, 1.0]))
    way[0] += 0.1
    speed = float(rng.choice([0.1, 0.25, 0.5, 1.05, 2.0]))
    return scene, MoveJ(tuple(map(float, start)), tuple(map(float, start + way)), speed, 1.4)


class Asked:
    """One question, and both engines' paths for it."""

    def __init__(self, scene, move):
        self.move, self.profile = move, profile_of(move)
        self.pairs = pairs_of(ROBOT, scene, CELL, grown_m=0.0)
        self.rows = np.arange(len(self.pairs))
        self.stop = stopping(CELL, perception_age_s=0.1, joint_speed_rad_s=self.profile.peak_rad_s)
        self.kernel, self.numpy = KERNEL.path(ROBOT, move), NUMPY.path(ROBOT, move)

    def certified(self, engine, floor=1.0):
        path = self.kernel if engine is KERNEL else self.numpy
        return path.certify(self.pairs, self.profile, self.stop, rows=self.rows, floor=floor, check_time=ready)

    def proven(self, low, high, pair, index):
        """True where the numpy engine, with worst clearance and worst speed, proves it on finer rows."""
        for _ in range(FINER):
            rows = self.numpy.examine(self.pairs, low, high, pair)
            rate = self.profile.highest_rate(low / GRID, high / GRID)
            over = self.pairs.index(pair, rows.clear_m, rows.rush * rate, self.stop) > index + NEARLY
            if not over.any():
                return True
            low, high, pair, index = (np.repeat(each[over], 2) for each in (low, high, pair, index))
            low[1::2] = high[::2] = (low[::2] + high[::2]) // 2
        return False


def asked(seed, count):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield Asked(*drawn(rng))


def tier(index):
    return np.ceil(index - TIE)


def test_the_kernel_is_what_decides_here():
    assert (KERNEL.name, NUMPY.name) == ("numba-1", "numpy-1")


def test_p12_rows_are_the_same_to_rounding():
    rng = np.random.default_rng(31)
    for each in asked(30, 25):
        count = 400
        exponent = rng.integers(0, 12, count)
        width = GRID >> exponent
        low = rng.integers(0, 1 << exponent) * width
        pair = rng.integers(0, len(each.pairs), count)
        ours = each.kernel.examine(each.pairs, low, low + width, pair)
        theirs = each.numpy.examine(each.pairs, low, low + width, pair)
        for name in ("clear_m", "rush", "clear_mid_m", "rush_mid"):
            assert np.allclose(getattr(ours, name), getattr(theirs, name), rtol=0, atol=1e-9), name
        ours, theirs = (path.rush(low[:20], low[:20] + width[:20]) for path in (each.kernel, each.numpy))
        seen = np.array([body.reference == 0 for body in ROBOT.bodies])
        assert np.allclose(ours[:, seen], theirs[:, seen], atol=1e-9)
        assert (ours[:, ~seen] >= theirs[:, ~seen] - 1e-9).all()
        key = int(rng.integers(0, GRID + 1))
        assert np.allclose(
            each.kernel.clearance_at(each.pairs, key, pair), each.numpy.clearance_at(each.pairs, key, pair), atol=1e-9
        )
        assert np.allclose(
            each.kernel.rush_at(each.pairs, key, pair), each.numpy.rush_at(each.pairs, key, pair), atol=1e-9
        )


@pytest.mark.parametrize("count", [8, 16, 64])
def test_places_side_by_side_are_to_the_last_bit_what_each_is_alone(count):
    """Speeds and torques that the demands rest on, beside the searches' own speeds and the torques of any places."""
    edges, masses = np.arange(count + 1, dtype=np.int64) * (GRID // count), masses_with(ROBOT, 1.0)
    seen = np.array([body.reference == 0 for body in ROBOT.bodies])
    for each in asked(40, 4):
        path = each.kernel
        equal, bears = laid_out(*blocks(ROBOT), masses, path.asked, edges)
        assert (equal[:, seen] == path.rush(edges[:-1], edges[1:])[:, seen]).all()
        q = path.start + (edges / GRID)[:, None] * path.delta
        every = torques(masses, q, np.tile(path.delta, (count + 1, 1)), np.zeros_like(q))
        assert (bears == np.stack(every)).all()


@pytest.fixture
def plain(monkeypatch):
    """Makes the callees of `put` and the broad phase Python as well."""
    squares = arm_module.squares.py_func
    for module in (arm_module, broad_phase):
        monkeypatch.setattr(module, "squares", squares)


@pytest.mark.usefixtures("plain")
def test_first_and_second_derivatives_of_the_ends_are_those_of_where_they_are():
    """`pose` and `put`, as Python, beside central differences: world bodies and those seen from the arm itself."""
    rng, arm, step = np.random.default_rng(38), arm_of(ROBOT), 1e-4
    bodies = range(len(ROBOT.bodies))
    for _ in range(5):
        nodes = no_nodes.py_func(3, len(ROBOT.bodies))
        q, delta = rng.uniform(-3, 3, 6), rng.uniform(-2, 2, 6)
        for at in range(3):
            pose.py_func(nodes, at, arm, q + (at - 1) * step * delta, delta)
            for body in bodies:
                put.py_func(*nodes, arm.link, arm.reference, arm.ends, at, body)
        before, there, after = nodes.ends
        first = np.linalg.norm((after - before) / (2 * step), axis=2).max(axis=1)
        second = np.linalg.norm((after - 2 * there + before) / step**2, axis=2).max(axis=1)
        assert np.allclose(nodes.speed[1], first, rtol=1e-5, atol=1e-5)
        assert np.allclose(nodes.swerve[1], second, rtol=1e-4, atol=1e-4)


@pytest.mark.usefixtures("plain")
def test_the_broad_phase_knows_of_all_bodies_what_is_put_of_each():
    rng, arm, bodies = np.random.default_rng(39), arm_of(ROBOT), np.arange(len(ROBOT.bodies))
    first, count = 2, 3  # nodes before these are not looked at
    nodes = no_nodes.py_func(first + broad_phase.FIRST, len(bodies))
    for at in range(first, first + broad_phase.FIRST):
        pose.py_func(nodes, at, arm, rng.uniform(-3, 3, 6), rng.uniform(-2, 2, 6))
        for body in bodies:
            put.py_func(*nodes, arm.link, arm.reference, arm.ends, at, body)
    swept = broad_phase.swept.py_func(nodes, first, broad_phase.FIRST, arm, bodies).reshape(
        len(bodies), -1, broad_phase.FIRST
    )
    there = slice(first, first + broad_phase.FIRST)
    assert np.allclose(swept[:, :count].transpose(2, 0, 1), nodes.ends[there].mean(axis=2), rtol=0, atol=1e-12)
    for column, numbers in enumerate((nodes.speed, nodes.swerve, nodes.spin), start=count):
        assert np.allclose(swept[:, column].T, numbers[there], rtol=0, atol=1e-12), column


@pytest.mark.long
def test_p12_answers_are_the_same_inside_the_resolution():
    for each in asked(32, 60):
        ours, theirs = each.certified(KERNEL), each.certified(NUMPY)
        assert tier(ours.upper) == tier(theirs.upper), (ours.upper, theirs.upper)
        assert abs(ours.upper - theirs.upper) <= RESOLUTION + 1e-9
        assert ours.attained <= theirs.upper + 1e-9
        assert theirs.attained <= ours.upper + 1e-9
        assert set(ours.violated) == set(theirs.violated)
        slower = profile_of(each.move, 0.5 * each.move.speed_rad_s)
        bound = np.floor(theirs.upper)
        leaves = ours.leaves.take(ours.leaf_index > bound)
        fit = each.kernel.fits(each.pairs, slower, each.stop, leaves, index=bound, check_time=ready)
        plain = each.numpy.fits(each.pairs, slower, each.stop, theirs.leaves, index=bound, check_time=ready)
        if fit.proven != plain.proven:  # one of them halved no more: the other's answer must then be true
            worst = each.numpy.certify(each.pairs, slower, each.stop, rows=each.rows, floor=1.0, check_time=ready)
            assert worst.attained <= bound + RESOLUTION
        ratios = [
            path.blow_ratio(each.pairs, each.profile, each.stop, check_time=ready)
            for engine, path in ((KERNEL, each.kernel), (NUMPY, each.numpy))
        ]
        assert abs(ratios[0] - ratios[1]) <= 0.01 + 1e-9


def test_every_obstacle_that_raises_the_index_has_a_witness_that_is_true():
    for each in asked(33, 40):
        ours, theirs = each.certified(KERNEL), each.certified(NUMPY)
        known = {each.pairs.group[w.pair]: w for w in ours.witnesses}
        for witness in theirs.witnesses:
            if witness.index > 1.3:
                assert each.pairs.group[witness.pair] in known, each.pairs.name_of(witness.pair)
        for witness in ours.witnesses:
            clearance = each.numpy.clearance_at(each.pairs, witness.key, np.array([witness.pair]))
            speed = each.numpy.rush_at(each.pairs, witness.key, np.array([witness.pair]))
            rate = each.profile.rate(np.array([witness.s]))
            assert abs(clearance[0] - witness.clearance_m) <= 1e-9
            assert abs(speed[0] * rate[0] - witness.speed_m_s) <= 1e-9


def test_the_proof_covers_the_path_for_every_pair_and_holds_when_the_other_engine_examines_them():
    for each in asked(34, 20):
        found = each.certified(KERNEL)
        proof = found.proof
        order = np.lexsort((proof.low, proof.pair))
        low, high, pair = proof.low[order], proof.high[order], proof.pair[order]
        first = np.flatnonzero(np.r_[True, pair[1:] != pair[:-1]])
        last = np.r_[first[1:] - 1, len(pair) - 1]
        assert (pair[first] == each.rows).all()
        assert (low[first] == 0).all()
        assert (high[last] == GRID).all()
        inside = np.ones(len(pair), dtype=bool)
        inside[first] = False
        assert (low[inside] == high[np.flatnonzero(inside) - 1]).all()
        assert each.proven(proof.low, proof.high, proof.pair, proof.index)
        assert proof.index.max() <= found.upper + 1e-12


def test_a_floor_settles_what_lies_below_it():
    for each in asked(35, 10):
        plain, floored = each.certified(KERNEL), each.certified(KERNEL, floor=4.0)
        assert floored.upper == 4.0
        assert len(floored.leaves) <= len(plain.leaves)


def test_meant_contact_and_clear_room_follow_the_same_law():
    """Codes of the kinds that have a law of their own."""
    rng = np.random.default_rng(36)
    for _ in range(20):
        each = Asked(*drawn(rng))
        rigid = np.flatnonzero(each.pairs.kind == each.pairs.code_of(PairKind.RIGID))
        each.pairs = each.pairs.meant(rigid)
        assert tier(each.certified(KERNEL).upper) == tier(each.certified(NUMPY).upper)


def test_too_many_rows_are_a_fault_in_both(monkeypatch):
    from pep.pit.base.errors import WorkLimitError

    rng = np.random.default_rng(37)
    scene, move = drawn(rng)
    many = tuple(Thing(f"ball{k}", "rigid", Sphere((0.5, 0.0, 0.001 * k), 0.01), 0.0) for k in range(2_000))
    each = Asked(Scene(objects=many), move)
    for engine in (KERNEL, NUMPY):
        with pytest.raises(WorkLimitError):
            each.certified(engine)
