"""Time of each call of cells in turns, once each is known to answer right and wrong as it must."""

from __future__ import annotations

import gc
import math
import statistics
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

if TYPE_CHECKING:
    import random
    from collections.abc import Callable, Iterator, Mapping, Sequence


K = TypeVar("K")
TRIES: Final = 20
"""Most tries of a peer that gives up for its own limit of time."""


class WrongAnswerError(RuntimeError):
    """Wrong answer of a cell: its figure would be of something else."""


class Verdict(Enum):
    """Answer to a timed call."""

    ALLOWED = "allowed"
    REFUSED = "refused"
    OVERRUN = "overrun"
    """The peer gave up for its own limit of time: nothing is known of the answer, and nothing is counted."""


@dataclass(frozen=True, slots=True)
class Cell(Generic[K]):
    """One timed call, and how it is known to be right.

    Attributes:
        of: the key of its row: the peer and the question.
        checks: the checks behind an answer, in a few words.
        fresh: makes an input; a call gets one that no call had before, where that matters. Not timed.
        act: the timed call.
        judge: verdict on the outcome of `act`; not timed.
        wrong: by their fault, makers of inputs that the same `act` must refuse.
    """

    of: K
    checks: str
    fresh: Callable[[], Any]
    act: Callable[[Any], Any]
    judge: Callable[[Any], Verdict] = lambda verdict: verdict
    wrong: Mapping[str, Callable[[], Any]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Plan:
    """Number of calls of each cell.

    Attributes:
        repeats: passes over all groups; each gives a median of its own.
        rounds: turns of each cell in one pass.
        warm_up: calls before those, not counted.
        burst: timed calls in one turn. With one, each finds the processor's caches as another cell left them.
    """

    repeats: int
    rounds: int
    warm_up: int = 3
    burst: int = 1

    @property
    def calls(self) -> int:
        """Inputs that a cell needs at most: those of the passes, and one for the proof that it allows."""
        return self.repeats * (self.rounds * self.burst + self.warm_up) + 1


FULL: Final = Plan(repeats=5, rounds=36)
QUICK: Final = Plan(repeats=2, rounds=2, warm_up=1)


@dataclass(slots=True)
class Series:
    """Durations of one cell, ns, by pass; `firsts` are those of them that began a turn.

    `overruns` are calls in which the peer gave up for its own limit of time.
    """

    passes: list[list[int]] = field(default_factory=list)
    firsts: list[int] = field(default_factory=list)
    overruns: int = 0

    @property
    def count(self) -> int:
        """Timed calls that were answered."""
        return sum(map(len, self.passes))

    def figures(self) -> dict[str, float]:
        """Median of all calls and of those that began a turn, smallest median of a pass, 99th percentile; us."""
        every = sorted(took for one in self.passes for took in one)
        return {
            "p50_us": statistics.median(every) / 1_000,
            "first_us": statistics.median(self.firsts or every) / 1_000,
            "min_us": min(statistics.median(one) for one in self.passes if one) / 1_000,
            "p99_us": every[math.ceil(0.99 * len(every)) - 1] / 1_000,
        }


def prove(cell: Cell[K]) -> None:
    """Checks that the cell allows its right inputs and refuses each of its counter-examples.

    Raises:
        WrongAnswerError: otherwise.
    """
    _demand(cell, _answer(cell, cell.fresh), "a good call", Verdict.ALLOWED)
    for why, given in cell.wrong.items():
        _demand(cell, _answer(cell, given), why, Verdict.REFUSED)


def _answer(cell: Cell[K], given: Callable[[], object]) -> object:
    """The first answer that is one: a peer that gives up for its own limit of time is asked again."""
    verdict: object = Verdict.OVERRUN
    for _ in range(TRIES):
        verdict = cell.judge(cell.act(given()))
        if verdict is not Verdict.OVERRUN:
            break
    return verdict


def measure(
    groups: Sequence[Sequence[Cell[K]]], plan: Plan, *, clock_ns: Callable[[], int], order: random.Random
) -> list[list[Series]]:
    """The durations of every cell, in the shape of `groups`.

    Within a group the cells take turns, in a new random order each round; in its turn a cell is called `plan.burst`
    times. Every timed call must be allowed.

    Raises:
        WrongAnswerError: for a call that is not.
    """
    found = [[Series() for _ in group] for group in groups]
    for _ in range(plan.repeats):
        for group, series in zip(groups, found, strict=True):
            with _quiet():
                _pass(group, series, plan, clock_ns, order)
    return found


def _pass(
    group: Sequence[Cell[K]], series: Sequence[Series], plan: Plan, clock_ns: Callable[[], int], order: random.Random
) -> None:
    for cell in group:
        for _ in range(plan.warm_up):
            _demand(cell, cell.judge(cell.act(cell.fresh())), "a good call", Verdict.ALLOWED, Verdict.OVERRUN)
    for one in series:
        one.passes.append([])
    turns = list(zip(group, series, strict=True))
    for _ in range(plan.rounds):
        order.shuffle(turns)
        for cell, one in turns:
            for k in range(plan.burst):
                given, act = cell.fresh(), cell.act
                began = clock_ns()
                outcome = act(given)
                took = clock_ns() - began
                verdict = cell.judge(outcome)
                _demand(cell, verdict, "a good call", Verdict.ALLOWED, Verdict.OVERRUN)
                if verdict is Verdict.OVERRUN:
                    one.overruns += 1
                    continue
                one.passes[-1].append(took)
                if k == 0:
                    one.firsts.append(took)


def _demand(cell: Cell[K], verdict: object, what: str, *right: Verdict) -> None:
    if verdict not in right:
        raise WrongAnswerError(f"{cell.of}, {what}: {verdict}, not {right[0].value}")


@contextmanager
def _quiet() -> Iterator[None]:
    """Stops garbage collection meanwhile; objects that a program has frozen before stay so afterwards."""
    frozen = gc.get_freeze_count()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        if not frozen:
            gc.unfreeze()
