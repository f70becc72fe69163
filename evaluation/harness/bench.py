"""One benchmark: a line-up of cells is proved, measured in turns and told as rows with their ratios."""

from __future__ import annotations

import random
import time
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from evaluation.harness import timing
from evaluation.harness.absent import AbsentError
from evaluation.harness.machine import machine

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from rich.table import Table

    from evaluation.harness.timing import Cell, Plan, Series

K = TypeVar("K")
T = TypeVar("T")
GAVE_UP: Final = "it gave up in every call for its own limit of time"
DIGITS: Final = 2
"""Decimal places of a duration in microseconds."""


@dataclass(frozen=True, slots=True)
class Row(Generic[K]):
    """One measured cell, or why there are no figures.

    Attributes:
        of: its key, a dataclass that names the peer and the question.
        p50_us: median over all calls.
        first_us: median over the calls that began a turn: another cell was asked just before.
        min_us: smallest median of a pass.
        p99_us: 99th percentile over all calls.
        n: calls; with less than 100, the 99th percentile is the slowest of them.
        overruns: calls besides, in which the peer gave up for its own limit of time though it was asked rightly.
        checks: the checks behind an answer.
        why: why there are no figures, or empty.
        more: further columns of the JSON object.
    """

    of: K
    p50_us: float | None = None
    first_us: float | None = None
    min_us: float | None = None
    p99_us: float | None = None
    n: int = 0
    overruns: int = 0
    checks: str = ""
    why: str = ""
    more: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """All columns, those of the key first."""
        told = asdict(self)
        key, more = told.pop("of"), told.pop("more")
        return {**key, **told, **more}


def installed(others: Mapping[str, Callable[[], T]], absent: Callable[[str], K]) -> tuple[list[T], list[Row[K]]]:
    """The peers that are installed, and a row that says why for each that is not.

    Args:
        others: makers by name; each needs its package only when it is called.
        absent: the key of a row, given a name.
    """
    peers, rows = [], []
    for name, make in others.items():
        try:
            peers.append(make())
        except AbsentError as error:
            rows.append(Row(absent(name), why=str(error)))
    return peers, rows


@dataclass(frozen=True, slots=True)
class LineUp(Generic[K]):
    """Line-up: every cell that is measured in one run.

    Attributes:
        groups: cells that take turns with each other.
        unmeasured: rows without figures.
        versions: of the peers, by name.
        more: further members of the JSON object.
        frequent: groups that are asked `often` times more often.
        often: how many times.
    """

    groups: Sequence[Sequence[Cell[K]]]
    unmeasured: Sequence[Row[K]]
    versions: Mapping[str, str]
    more: Mapping[str, Any] = field(default_factory=dict)
    frequent: Sequence[Sequence[Cell[K]]] = ()
    often: int = 1


@dataclass(frozen=True, slots=True)
class Result(Generic[K]):
    """A whole run.

    Attributes:
        rows: of every cell, those without figures first.
        ratios: between peers, by name; None where one of them was not measured.
        versions: of the peers.
        more: further members of the JSON object.
        machine, plan, seconds: where, how often, how long.
    """

    rows: Sequence[Row[K]]
    ratios: Mapping[str, float | None]
    versions: Mapping[str, str]
    more: Mapping[str, Any]
    machine: Mapping[str, Any]
    plan: Plan
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Whole result, as one JSON object."""
        return {
            "ok": True,
            "ratios": dict(self.ratios),
            **self.more,
            "rows": [row.to_json() for row in self.rows],
            "versions": dict(self.versions),
            "machine": dict(self.machine),
            "plan": asdict(self.plan),
            "seconds": round(self.seconds, 1),
        }


@dataclass(frozen=True, slots=True)
class Bench(Generic[K]):
    """Benchmark: its cells, and its report.

    Attributes:
        line_up: makes it, given the plan, `seed` and `told`, which receives the name of each step.
        full, quick: how often each cell is called, and with `--quick`.
        few: further arguments of `line_up` with `--quick`.
        ratios: between peers, of one figure ("p50_us" or "min_us") of the rows; given the line-up's `more` too.
        said: the words before the ratios in the last line.
        tables: for people.
        remarks: further lines for people.
        picture: draws a PNG file; raises `AbsentError` without matplotlib.
        more: further members of the JSON object, out of the rows.
        wanted: a row with further columns.
    """

    line_up: Callable[..., LineUp[K]]
    full: Plan
    quick: Plan
    ratios: Callable[[Sequence[Row[K]], Mapping[str, Any], str], Mapping[str, float | None]]
    said: str
    tables: Callable[[Result[K]], Iterator[Table]]
    picture: Callable[[Result[K], Path], None]
    few: Mapping[str, Any] = field(default_factory=dict)
    remarks: Callable[[Result[K]], Iterable[str]] = lambda _: ()
    more: Callable[[Sequence[Row[K]], Mapping[str, Any]], Mapping[str, Any]] = lambda _rows, _more: {}
    wanted: Callable[[Row[K]], Row[K]] = lambda row: row

    def run(self, plan: Plan, *, seed: int, told: Callable[[str], None], **line_up: Any) -> Result[K]:
        """Measure all cells in turns.

        Args:
            plan: how often.
            seed: of every draw, and of the order of turns.
            told: receives the name of each step.
            line_up: further arguments of `line_up`.

        Raises:
            WrongAnswerError: when a cell gives another answer than it must.
        """
        began = time.monotonic()
        lined_up = self.line_up(plan, seed=seed, told=told, **line_up)
        rows = [self.wanted(row) for row in lined_up.unmeasured]
        told("asking each cell for right and for wrong")
        for group in (*lined_up.groups, *lined_up.frequent):
            for cell in group:
                timing.prove(cell)
        order = random.Random(seed)  # noqa: S311 - turns
        often = replace(plan, rounds=plan.rounds * lined_up.often)
        for groups, each in ((lined_up.groups, plan), (lined_up.frequent, often)):
            told("measuring")
            found = timing.measure(groups, each, clock_ns=time.perf_counter_ns, order=order)
            for group, series in zip(groups, found, strict=True):
                rows += [self.wanted(_row(cell, one)) for cell, one in zip(group, series, strict=True)]
        return Result(
            rows=tuple(rows),
            ratios=self.ratios(rows, lined_up.more, "p50_us"),
            versions=lined_up.versions,
            more={**self.more(rows, lined_up.more), **lined_up.more},
            machine=machine(),
            plan=plan,
            seconds=time.monotonic() - began,
        )

    def last_line(self, ratios: Mapping[str, float | None]) -> str:
        """The ratios in one line."""
        said = ", ".join(f"{name} {'-' if value is None else f'{value:.2f}'}" for name, value in ratios.items())
        return f"{self.said}: {said}"


def _row(cell: Cell[K], series: Series) -> Row[K]:
    row = Row(cell.of, overruns=series.overruns)
    if not series.count:
        return replace(row, why=GAVE_UP)
    figures: dict[str, Any] = {name: round(us, DIGITS) for name, us in series.figures().items()}
    return replace(row, **figures, n=series.count, checks=cell.checks)


def ratio(mine: float | None, theirs: float | None) -> float | None:
    """Mine over theirs; None where one of the two was not measured."""
    return None if mine is None or not theirs else round(mine / theirs, 3)
