"""Bound that takes clearance and speed at one place: above all values there, and often tighter (PHY-9)."""

import math

import numpy as np
import pytest
from pep.pit.base.motion import Profile
from pep.pit.base.pair_columns import (
    BAND,
    BODY,
    BRAKE,
    DECLARED,
    HARM_SPEED,
    INTRUSION,
    KIND,
    NUMBERS,
    PENETRATION_BAND,
    PERSON,
    PERSON_SPEED,
    PLANE,
    RADII,
    REACTION,
    SHAPE,
    TRAVEL,
    UNCERTAINTY,
    WARN_BAND,
    ZONE,
)
from pep.pit.base.tier import person_index, thing_index, zone_index
from pep.pit.base.travel import Stopping
from pep.pit.path.straight_path import CHORD, GRID
from pep.pit.scene.obstacles import CODE, PairKind
from pep.pit.search.kernel.arithmetic.body_poses import bends_of, no_nodes, pose, put
from pep.pit.search.kernel.compiled_path import arm_of, law_of, packed, timing_of
from pep.pit.search.kernel.search_columns import RADIUS, SECOND, SPIN_SECOND, TABLE, THIRD, table_of
from tests.pep.pit.search.kernel.test_kernel import KERNEL, ROBOT, Asked, drawn

from pep.pit.search.kernel import coupling
from pep.pit.search.kernel.arithmetic import body_poses, core_distance, index_law

DENSE = 16
MOST = 40  # pairs of one span
SLACK = 1e-9


@pytest.fixture(autouse=True)
def plain(monkeypatch):
    """All that is asked here is Python."""
    inner = {
        body_poses: ("squares",),
        coupling: ("ahead", "support", "pair_index", "tangent"),
        core_distance: ("_box", "_clip", "_directed", "_nearest", "_out", "_segment", "plane_gap"),
        index_law: ("_share",),
    }
    for module, names in inner.items():
        for name in names:
            monkeypatch.setattr(module, name, getattr(module, name).py_func)


class Span:
    """One span of one question: what is bounded on it, and what is met there."""

    def __init__(self, each, low, high):
        self.each, self.low, self.high = each, low, high
        move, limbs = each.move, arm_of(ROBOT)
        start, delta = np.array(move.start), np.array(move.target) - np.array(move.start)
        self.nodes, bodies = no_nodes.py_func(3, len(ROBOT.bodies)), range(len(ROBOT.bodies))
        for at, key in enumerate((low, (low + high) // 2, high)):
            pose.py_func(self.nodes, at, limbs, start + key / GRID * delta, delta)
            for body in bodies:
                put.py_func(*self.nodes, limbs.link, limbs.reference, limbs.ends, at, body)
        self.table = table_of.py_func(limbs, bends_of(limbs, delta))
        self.field = packed(each.pairs)
        self.profile, self.law = np.array(timing_of(each.profile)), np.array(law_of(each.pairs, each.stop))

    def coupled(self, pair):
        numbers, whole, nodes = self.field.numbers, self.field.whole, self.nodes
        body, shape, width = whole[pair, BODY], whole[pair, SHAPE], (self.high - self.low) / GRID
        away = core_distance.core_gap.py_func(nodes.ends, 1, body, numbers, pair, shape)
        return coupling.in_step_index.py_func(
            nodes.ends, nodes.speed, nodes.spin, self.table, numbers, self.low, self.high, 0, 1, 2, body, pair, shape,
            whole[pair, KIND], away, width * width / CHORD, self.profile, self.law,
        )  # fmt: skip

    def apart(self, rows):
        """The index of these pairs by the least clearance and the highest speed, wherever on the span each is."""
        ends = np.full(len(rows), self.low), np.full(len(rows), self.high)
        leaves = self.each.numpy.examine(self.each.pairs, *ends, rows)
        rate = self.each.profile.highest_rate(ends[0] / GRID, ends[1] / GRID)
        return self.each.pairs.index(rows, leaves.clear_m, leaves.rush * rate, self.each.stop)

    def met(self, rows):
        """The highest index of these pairs at many places, by the numpy engine."""
        each, worst = self.each, np.zeros(len(rows))
        for key in np.linspace(self.low, self.high, DENSE).astype(np.int64).tolist():
            speed = each.numpy.rush_at(each.pairs, key, rows) * each.profile.rate(np.array(key / GRID))
            worst = np.maximum(
                worst, each.pairs.index(rows, each.numpy.clearance_at(each.pairs, key, rows), speed, each.stop)
            )
        return worst


def spans(seed, count):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        each = Asked(*drawn(rng))
        width = GRID >> int(rng.integers(0, 5))
        low = int(rng.integers(0, GRID // width)) * width
        yield Span(each, low, low + width)


def test_no_place_is_above_the_bound_and_the_bound_is_often_tighter():
    tighter, endless = {}, 0
    for span in spans(61, 14):
        rows = np.flatnonzero(span.apart(span.each.rows) > 1)
        rows = rows[:: 1 + len(rows) // MOST]
        if not rows.size:
            continue
        met, apart = span.met(rows), span.apart(rows)
        for row, attained, bound in zip(rows.tolist(), met.tolist(), apart.tolist(), strict=True):
            coupled = span.coupled(row)
            assert attained <= coupled + SLACK, (span.low, row)
            endless += math.isinf(coupled)
            kind = str(span.each.pairs.kind_of(row))
            tighter[kind] = tighter.get(kind, 0) + (coupled < bound - 1e-6)
    assert endless > 0  # people within the arm's own travel
    assert {kind for kind, often in tighter.items() if often > 1} >= {"person", "fragile", "self"}


@pytest.mark.long
def test_every_leaf_has_a_bound_of_its_own_nodes():
    """No leaf's index is below what its own three nodes prove in one of both ways, to rounding.

    `test_kernel` has the plain bound alone prove the same on finer rows, which takes it close to this and no closer.
    """
    rng, told = np.random.default_rng(63), 0
    for _ in range(80):
        each = Asked(*drawn(rng))
        proof = each.certified(KERNEL).proof
        rows = each.numpy.examine(each.pairs, proof.low, proof.high, proof.pair)
        rate = each.profile.highest_rate(proof.low / GRID, proof.high / GRID)
        plain = each.pairs.index(proof.pair, rows.clear_m, rows.rush * rate, each.stop)
        lowered = np.flatnonzero(proof.index < plain - SLACK)
        for ends in np.unique(np.stack([proof.low[lowered], proof.high[lowered]], axis=1), axis=0).tolist():
            span = Span(each, *ends)
            for row in lowered[(proof.low[lowered] == ends[0]) & (proof.high[lowered] == ends[1])].tolist():
                assert proof.index[row] >= span.coupled(proof.pair[row]) - SLACK, (ends, row)
                told += 1
    assert told > 10


# ---- each term of the bound, on ways that it is exactly as large as it has to be for


RADIUS_M, RADII_M, UNCERTAINTY_M, BAND_M, INTRUSION_M = 0.05, 0.12, 0.015, 0.4, 0.1
LAW = np.array([0.2, 0.15, 0.1, 1.6, 0.3, 0.05, 0.05])
STOP = Stopping(reaction_s=LAW[REACTION], brake_s=LAW[BRAKE], travel_s=LAW[TRAVEL], person_speed_m_s=LAW[PERSON_SPEED])
DECLARED_TIER = 3.0
KINDS = {"rigid": CODE[PairKind.RIGID], "person": PERSON, "zone": ZONE}


class Parabola:
    """A quantity of the path whose second derivative by s is the same everywhere."""

    def __init__(self, at, value, slope, bend):
        """Its value and slope at `at`, and its second derivative."""
        self.at, self.value, self.slope, self.bend = at, value, slope, bend

    def __call__(self, s):
        return self.value + self.slope * (s - self.at) + 0.5 * self.bend * (s - self.at) ** 2


def level(value):
    return Parabola(0.0, value, 0.0, 0.0)


class Made:
    """One body before a wall on one span, as the bound sees it: three nodes, and each quantity's bending."""

    def __init__(self, low, high, profile, *, clear, fast, turns, kind):
        self.low, self.high, self.profile = round(low * GRID), round(high * GRID), profile
        self.clear, self.fast, self.turns, self.kind = clear, fast, turns, KINDS[kind]
        self.s = np.array([self.low, (self.low + self.high) // 2, self.high]) / GRID
        self.places = np.linspace(self.s[0], self.s[-1], 65)  # every eighth of both halves among them
        table = np.zeros((1, TABLE))
        table[0, RADIUS], table[0, SECOND] = RADIUS_M, abs(clear.bend)
        table[0, THIRD], table[0, SPIN_SECOND] = abs(fast.bend), abs(turns.bend)
        self.table = table

    def bound(self):
        laws = np.zeros((1, NUMBERS))
        laws[0, RADII], laws[0, UNCERTAINTY], laws[0, BAND] = RADII_M, UNCERTAINTY_M, BAND_M
        laws[0, INTRUSION], laws[0, HARM_SPEED], laws[0, DECLARED] = INTRUSION_M, 1.0, DECLARED_TIER
        ends = np.zeros((3, 1, 2, 3))
        ends[:, 0, :, 2] = (self.clear(self.s) + RADII_M)[:, None]
        width = (self.high - self.low) / GRID
        return coupling.in_step_index.py_func(
            ends, self.fast(self.s)[:, None], self.turns(self.s)[:, None], self.table, laws, self.low, self.high, 0, 1, 2,
            0, 0, PLANE, self.kind, (0.0, 0.0, 0.0, 1.0), width * width / CHORD, np.array(timing_of(self.profile)), LAW,
        )  # fmt: skip

    def met(self):
        """The index at each place, by the laws of the numpy engine."""
        clear = self.clear(self.places)
        speed = (self.fast(self.places) + RADIUS_M * self.turns(self.places)) * self.profile.rate(self.places)
        near = clear - UNCERTAINTY_M
        if self.kind == PERSON:
            return person_index(
                near, clear, speed, harm_speed=np.ones(65), intrusion=np.full(65, INTRUSION_M), stop=STOP,
                warn_band=LAW[WARN_BAND], penetration_band=LAW[PENETRATION_BAND],
            )  # fmt: skip
        if self.kind == ZONE:
            return zone_index(near, speed, band=np.full(65, BAND_M), declared=np.full(65, DECLARED_TIER), stop=STOP)
        return thing_index(near, speed, band=np.full(65, BAND_M), stop=STOP)


FLAT = Profile(1.0, 0.5, 50.0)  # at its peak from 0.0025 of the way on, to as much before its end
RISING = Profile(1.0, 10.0, 2.0)  # rises to the middle: the rate is the root of 4 s
CLEAR_M = {"rigid": 0.3, "person": 0.7, "zone": 0.3}
EXACT = 1e-8  # of an index: what the bound takes off a clearance for rounding


def held_exactly(made):
    """The bound is the met value, and lies where the laws are neither 1 nor at their top."""
    bound, met = made.bound(), made.met().max()
    assert 1.0 < met < 3.0
    assert met <= bound + SLACK
    assert bound == pytest.approx(met, abs=EXACT)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_speed_that_falls_while_the_rate_rises_is_bounded_exactly(kind):
    """With equal products at one half's ends, its middle is above by a quarter of both."""
    low, half = 0.125, 0.125
    rate = float(RISING.rate(np.array(low + 0.5 * half)))
    turn = 0.5 * half * RISING.acceleration_rad_s2 / rate  # of the tangent, from the half's middle to its end
    then = (rate - turn) / (rate + turn)  # speed at the half's end, of that at its start
    fall = Parabola(low, 1.5, 1.5 * (then - 1) / half, 0.0)
    held_exactly(Made(low, low + 2 * half, RISING, clear=level(CLEAR_M[kind]), fast=fall, turns=level(0.0), kind=kind))


@pytest.mark.parametrize("kind", sorted(KINDS))
@pytest.mark.parametrize("of", ["fast", "turns"])
def test_speed_above_its_chord_is_bounded_exactly(kind, of):
    """With equally fast ends, a half's middle is faster by the third derivative's allowance."""
    low, half, bend = 0.25, 0.125, -20.0
    arch = Parabola(low, 4.0, -0.5 * bend * half, bend)
    still = Parabola(low, 0.5, 0.0, 0.0)
    fast, turns = (arch, still) if of == "fast" else (still, arch)
    clear = level(CLEAR_M[kind] + (0.1 if of == "fast" else 0.0))
    held_exactly(Made(low, low + 2 * half, FLAT, clear=clear, fast=fast, turns=turns, kind=kind))


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_clearance_below_its_chord_is_bounded_exactly(kind):
    low, half, bend = 0.25, 0.125, 15.0
    dip = Parabola(low, CLEAR_M[kind], -0.5 * bend * half, bend)
    held_exactly(Made(low, low + 2 * half, FLAT, clear=dip, fast=level(1.0), turns=level(0.0), kind=kind))


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_nothing_is_met_above_the_bound_on_ways_that_bend_as_much_as_is_known(kind):
    rng, told = np.random.default_rng(62), 0
    for _ in range(400):
        width = 0.5 ** rng.integers(1, 6)
        low = width * rng.integers(0, round(1 / width))
        profile = Profile(float(rng.uniform(0.3, 3)), float(rng.uniform(0.2, 3)), *rng.uniform(0.5, 5, 2).tolist())

        clear, fast, turns = (
            Parabola(low, rng.uniform(*value), *rng.normal(0, 1 / width, 2)) for value in ((0, 1.5), (0.2, 2), (0.5, 3))
        )
        made = Made(low, low + width, profile, clear=clear, fast=fast, turns=turns, kind=kind)
        if min(made.fast(made.places).min(), made.turns(made.places).min()) < 0:
            continue  # no speed is less than none
        bound = made.bound()
        told += not math.isinf(bound)
        assert made.met().max() <= bound + SLACK
    assert told > 100
