"""The bound that takes clearance and speed at the same place: above all that is met there, and often tighter (PHY-9)."""

import math

import numpy as np
import pytest

from pep.pit.kernel import arm, coupling, gap, law
from pep.pit.kernel.arm import bends_of, no_nodes, pose, put
from pep.pit.kernel.columns import BODY, KIND, SHAPE
from pep.pit.kernel.engine import arm_of, law_of, packed, timing_of
from pep.pit.kernel.known import table_of
from pep.pit.path import CHORD, GRID
from tests.pit.test_kernel import ROBOT, Asked, drawn

DENSE = 16
MOST = 40  # pairs of one span
SLACK = 1e-9


@pytest.fixture(autouse=True)
def plain(monkeypatch):
    """All that is asked here is Python."""
    inner = {
        arm: ("squares",),
        coupling: ("ahead", "support", "pair_index", "tangent"),
        gap: ("_box", "_clip", "_directed", "_out", "_segment", "plane_gap"),
        law: ("_share",),
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
        away = gap.core_gap.py_func(nodes.ends, 1, body, numbers, pair, shape)
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
