"""What a run found: rows, and the ratios between us and each engine."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from rich.table import Table

from evaluation.decisions.casbin_abac import NAME as CASBIN
from evaluation.decisions.cedar import GROUPED
from evaluation.decisions.cedar import NAME as CEDAR
from evaluation.decisions.ours import NAME as OURS
from evaluation.decisions.ours import RECORDED
from evaluation.decisions.rego import NAME as REGO

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from evaluation.harness.timing import Plan


@dataclass(frozen=True, slots=True)
class Row:
    """One case at one engine, or why there are no figures.

    Attributes:
        peer, case: what it is of; the case is None for an engine that is not installed.
        beside: the engine with which we took turns, in the very calls that this row is of.
        p50_us: median over all calls.
        min_us: smallest median of a pass.
        p99_us: 99th percentile over all calls.
        n: calls.
        checks: what the answer rests on, and what it does not say.
        why: why there are no figures, or empty.
    """

    peer: str
    case: str | None
    beside: str = ""
    p50_us: float | None = None
    min_us: float | None = None
    p99_us: float | None = None
    n: int = 0
    checks: str = ""
    why: str = ""


RATIOS: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {
        "vs_cedarpy": (OURS, CEDAR),
        "vs_cedarpy_two_rules": (OURS, GROUPED),
        "vs_casbin": (OURS, CASBIN),
        "vs_regopy": (OURS, REGO),
        "recorded_vs_cedarpy": (RECORDED, CEDAR),
    }
)
"""Whose time is divided by whose."""


@dataclass(frozen=True, slots=True)
class Result:
    """A whole run.

    Attributes:
        rows: of every engine and case.
        versions: of the engines.
        rules: how many rules the other engines were given.
        agreed: in how many cases all engines gave the same answer before anything was timed.
        machine, plan, seconds: where, how often, how long.
    """

    rows: tuple[Row, ...]
    versions: Mapping[str, str]
    rules: int
    agreed: int
    machine: Mapping[str, Any]
    plan: Plan
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Everything, as one JSON object."""
        return {
            "ok": True,
            "ratios": worst(ratios(self.rows, "p50_us")),
            "ratios_of_minima": worst(ratios(self.rows, "min_us")),
            "ratios_by_case": ratios(self.rows, "p50_us"),
            "rows": [asdict(row) for row in self.rows],
            "versions": dict(self.versions),
            "rules": self.rules,
            "agreed": self.agreed,
            "machine": dict(self.machine),
            "plan": asdict(self.plan),
            "seconds": round(self.seconds, 1),
        }


def ratios(rows: Sequence[Row], figure: str) -> dict[str, dict[str, float]]:
    """Ours over each engine's in each case, from the calls in which the two took turns.

    Args:
        rows: of one run.
        figure: "p50_us" or "min_us".
    """
    took: dict[tuple[str, str, str], float] = {
        (row.peer, row.beside, row.case): getattr(row, figure) for row in rows if row.case is not None
    }
    return {
        key: {
            case: round(took[mine, theirs, case] / took[theirs, theirs, case], 3)
            for peer, _, case in took
            if peer == theirs and (mine, theirs, case) in took
        }
        for key, (mine, theirs) in RATIOS.items()
    }


def worst(by_case: Mapping[str, Mapping[str, float]]) -> dict[str, float | None]:
    """Each ratio in the case that is worst for us; None for an engine that was not measured."""
    return {key: max(of.values(), default=None) for key, of in by_case.items()}


def ratios_line(found: Mapping[str, float | None]) -> str:
    """The ratios in one line."""
    said = ", ".join(f"{name} {'-' if value is None else f'{value:.2f}'}" for name, value in found.items())
    return f"{OURS} over each, in its worst case: {said}"


def tables(result: Result) -> Iterator[Table]:
    """Durations, and what each engine's answer rests on."""
    measured = [row for row in result.rows if row.case is not None]
    named = dict.fromkeys(row.case for row in measured)
    durations = Table(title="median, µs (99th percentile)", title_justify="left", box=None, pad_edge=False)
    durations.add_column("engine")
    durations.add_column("in turns with")
    for case in named:
        durations.add_column(str(case), justify="right")
    rests = Table(title="what an answer rests on", title_justify="left", box=None, pad_edge=False)
    rests.add_column("engine")
    rests.add_column("checks", overflow="fold")
    for peer, beside in dict.fromkeys((row.peer, row.beside) for row in measured):
        of = {row.case: row for row in measured if (row.peer, row.beside) == (peer, beside)}
        other = beside if peer != beside else OURS
        durations.add_row(peer, other, *(f"{of[case].p50_us:.0f} ({of[case].p99_us:.0f})" for case in named))
    for peer, checks in {row.peer: row.checks for row in measured}.items():
        rests.add_row(peer, checks)
    yield durations
    yield rests
