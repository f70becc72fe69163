"""The measurement itself: turns, figures, and that a wrong answer is never timed."""

import gc
import random
from itertools import count, pairwise

import pytest
from evaluation.harness.timing import Cell, Plan, Series, Verdict, WrongAnswerError

from evaluation.harness import timing

pytestmark = pytest.mark.long

PLAN = Plan(repeats=3, rounds=5, warm_up=2)


def cell(act, peer="one", **other) -> Cell:
    return Cell(peer, checks="", fresh=lambda: None, act=act, **other)


def allowed(_: object) -> Verdict:
    return Verdict.ALLOWED


def ticking(step: int = 1_000):
    return count(0, step).__next__


def measure(cells, plan=PLAN, clock=None) -> list[Series]:
    (found,) = timing.measure([cells], plan, clock_ns=clock or ticking(), order=random.Random(1))
    return found


def test_every_cell_takes_one_turn_in_every_round():
    turns: list[str] = []
    cells = [cell(lambda _, name=name: (turns.append(name), Verdict.ALLOWED)[1], name) for name in "abc"]
    found = measure(cells)
    assert [series.count for series in found] == [15, 15, 15]
    assert all(len(one) == 5 for series in found for one in series.passes)
    warm, timed = 3 * PLAN.warm_up, 3 * PLAN.rounds
    orders = [
        tuple(turns[at : at + 3])
        for start in range(0, len(turns), warm + timed)
        for at in range(start + warm, start + warm + timed, 3)
    ]
    assert len(orders) == 15
    assert all(sorted(one) == ["a", "b", "c"] for one in orders)
    assert len(set(orders)) > 3, "one fixed order favours somebody"


def test_a_turn_is_a_burst_of_calls_and_its_first_is_told_apart():
    turns: list[str] = []
    now = [0]

    def act(name):
        turns.append(name)
        now[0] += 9_000 if turns[-2:-1] != [name] else 4_000  # whoever was not just asked is slow
        return Verdict.ALLOWED

    cells = [cell(lambda _, name=name: act(name), name) for name in "ab"]
    found = measure(cells, Plan(repeats=2, rounds=3, warm_up=0, burst=4), clock=lambda: now[0])
    assert [series.count for series in found] == [24, 24]
    bursts = {tuple(turns[at : at + 4]) for at in range(0, len(turns), 4)}
    assert bursts == {("a",) * 4, ("b",) * 4}
    assert all(len(series.firsts) == 6 for series in found)
    assert {series.figures()["p50_us"] for series in found} == {4}
    assert all(series.figures()["first_us"] == 9 for series in found)


def test_only_the_call_is_timed():
    now = [0]

    def passes(ns: int, answer=None):
        now[0] += ns
        return answer

    measured = Cell(
        "one",
        checks="",
        fresh=lambda: passes(10**9),
        act=lambda _: passes(7_000, "raw"),
        judge=lambda raw: passes(10**9, Verdict.ALLOWED if raw == "raw" else Verdict.REFUSED),
    )
    (series,) = measure([measured], clock=lambda: now[0])
    assert series.figures() == {"p50_us": 7, "first_us": 7, "min_us": 7, "p99_us": 7}


def test_figures():
    series = Series(passes=[[1_000, 2_000, 9_000], [4_000, 5_000, 6_000], [3_000, 3_000, 100_000]])
    assert series.figures() == {"p50_us": 4, "first_us": 4, "min_us": 2, "p99_us": 100}
    long = Series(passes=[[n * 1_000 for n in range(1, 201)]])
    assert long.figures() == {"p50_us": 100.5, "first_us": 100.5, "min_us": 100.5, "p99_us": 198}


@pytest.mark.parametrize("late", [0, 3, 7, 20])
def test_a_refused_call_ends_the_measurement(late):
    calls = count()
    with pytest.raises(WrongAnswerError):
        measure([cell(lambda _: Verdict.REFUSED if next(calls) == late else Verdict.ALLOWED)])


def test_what_is_no_verdict_is_a_wrong_answer():
    with pytest.raises(WrongAnswerError):
        measure([cell(lambda _: None)])


def test_an_overrun_is_counted_and_not_timed():
    calls = count()
    (series,) = measure([cell(lambda _: Verdict.OVERRUN if next(calls) % 7 == 3 else Verdict.ALLOWED)])
    assert series.count + series.overruns == 15
    assert series.overruns > 0


def test_a_cell_is_asked_for_right_and_for_wrong():
    strict = cell(lambda given: Verdict.REFUSED if given else Verdict.ALLOWED, wrong={"a value": lambda: "wrong"})
    timing.prove(strict)
    with pytest.raises(WrongAnswerError):
        timing.prove(cell(allowed, wrong={"a value": lambda: "wrong"}))
    with pytest.raises(WrongAnswerError):
        timing.prove(cell(lambda _: Verdict.REFUSED))


def test_a_peer_that_gives_up_is_asked_again_but_not_for_ever():
    calls = count()
    timing.prove(cell(lambda _: Verdict.ALLOWED if next(calls) == 5 else Verdict.OVERRUN))
    with pytest.raises(WrongAnswerError):
        timing.prove(cell(lambda _: Verdict.OVERRUN))
    assert timing.TRIES < PLAN.calls


@pytest.mark.parametrize("outcome", [Verdict.ALLOWED, Verdict.REFUSED])
@pytest.mark.parametrize("frozen", [0, 1])
def test_garbage_is_not_collected_meanwhile_and_is_again_afterwards(outcome, frozen, monkeypatch):
    seen, thawed = [], []
    monkeypatch.setattr(gc, "get_freeze_count", lambda: frozen)
    monkeypatch.setattr(gc, "unfreeze", lambda: thawed.append(True))  # the suite's own objects stay frozen

    def act(_: object) -> Verdict:
        seen.append(gc.isenabled())
        return outcome if len(seen) > 9 else Verdict.ALLOWED

    try:
        measure([cell(act)])
    except WrongAnswerError:
        assert outcome is Verdict.REFUSED
    assert set(seen) == {False}
    assert gc.isenabled()
    assert bool(thawed) is not bool(frozen), "as it was before"


def test_a_plan_needs_no_more_inputs_than_it_says():
    asked = count(1)
    last = 0

    def fresh() -> None:
        nonlocal last
        last = next(asked)

    one = Cell("one", checks="", fresh=fresh, act=allowed)
    timing.prove(one)
    measure([one])
    assert last == PLAN.repeats * (PLAN.rounds + PLAN.warm_up) + 1
    assert last <= PLAN.calls


def test_the_clock_is_read_around_each_call_alone():
    stamps: list[int] = []
    clock = ticking()

    def read() -> int:
        stamps.append(clock())
        return stamps[-1]

    (series,) = measure([cell(allowed)], clock=read)
    assert len(stamps) == 2 * series.count
    assert all(b - a == 1_000 for a, b in pairwise(stamps))
