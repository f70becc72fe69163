"""Result of `ztpm eval paper`: statistics of the traces, bounds of the scenes, and what was executed in each mode."""

from __future__ import annotations

import statistics
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

from evaluation.harness.tables import table
from evaluation.paper.traces import CONDITIONS, Spread

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rich.table import Table

    from evaluation.paper.replay import Replayed
    from evaluation.paper.sweep import Bound

MODES: Final = {
    "unenforced": "no gate",
    "enforced": "gate, approver absent",
    "enforced_approved": "gate, approver says yes",
}
EXACT_RAD_S: Final = 0.0005
"""Half a step of the grid of a bound: what a measured speed may be above it."""
DIGITS: Final = 6


@dataclass(frozen=True, slots=True)
class Margin:
    """Nearness of a condition to the next tier.

    Attributes:
        tier: of the fastest trace's sweep in ten motions.
        index: of the same; the tier ends at the whole number.
        at_once: index of the sweep as one motion at 1.05 rad/s, the speed that ur_rtde takes where none is given.
    """

    tier: int
    index: float
    at_once: float


@dataclass(frozen=True, slots=True)
class PaperResult:
    """Result of a run.

    Attributes:
        traces: statistics by model and condition.
        bounds, margins: by condition.
        replayed: traces by mode, each in the same order; empty without a replay.
        seconds: how long all of it took.
        machine: that of the run.
    """

    traces: Mapping[str, Mapping[str, Spread]]
    bounds: Mapping[str, Bound]
    margins: Mapping[str, Margin]
    replayed: Mapping[str, Sequence[Replayed]]
    seconds: float
    machine: Mapping[str, Any]

    def within(self, mode: str) -> int:
        """Number of traces that were executed whole, every motion within the bound of its scene in that mode."""
        return sum(self._inside(one, mode) for one in self.replayed[mode])

    def _inside(self, one: Replayed, mode: str) -> bool:
        bound = self.bounds[one.trace.condition]
        highest = bound.approved if mode == "enforced_approved" else bound.alone
        return one.executed_rad_s is not None and highest is not None and one.fastest_rad_s <= highest + EXACT_RAD_S

    def speeds(self, mode: str, model: str, condition: str) -> list[float]:
        """Executed speeds of the traces that were executed whole, rad/s."""
        return [
            one.executed_rad_s
            for one in self.replayed[mode]
            if (one.trace.model, one.trace.condition) == (model, condition) and one.executed_rad_s is not None
        ]

    def counts(self, mode: str) -> dict[str, int]:
        """Number of traces that were executed whole, deferred and denied."""
        ended = [one.ended_by.partition(" ")[0] for one in self.replayed[mode]]
        return {"executed": ended.count(""), "deferred": ended.count("DEFER"), "denied": ended.count("DENY")}

    def ordering(self, mode: str, model: str) -> str:
        """Conditions by mean executed speed, fastest first; those that executed nothing stand last, in brackets."""
        means = {c: statistics.fmean(s) for c in CONDITIONS if (s := self.speeds(mode, model, c))}
        ordered = sorted(means, key=lambda condition: -means[condition])
        words = ordered[:1]
        for before, after in pairwise(ordered):
            words += ["=" if means[before] - means[after] <= EXACT_RAD_S else ">", after]
        still = [condition for condition in CONDITIONS if condition not in means]
        return " ".join([*words, *(f"({condition})" for condition in still)])

    @property
    def models(self) -> tuple[str, ...]:
        """Models, in their order."""
        return tuple(self.traces)

    @property
    def ok(self) -> bool:
        """True where no approved trace left its bound before the gate, or nothing was replayed."""
        return not self.replayed or self.within("enforced_approved") == len(self.replayed["enforced_approved"])

    def to_json(self) -> dict[str, Any]:
        """Plain JSON of the result; speeds in rad/s."""
        told: dict[str, Any] = {
            "ok": self.ok,
            "statistics": {
                model: {condition: _rounded(asdict(spread)) for condition, spread in row.items()}
                for model, row in self.traces.items()
            },
            "bound_rad_s": {condition: asdict(bound) for condition, bound in self.bounds.items()},
            "margins": {condition: _rounded(asdict(margin)) for condition, margin in self.margins.items()},
        }
        if self.replayed:
            told |= self._replay_json()
        return told | {"machine": dict(self.machine), "seconds": round(self.seconds, 1)}

    def _replay_json(self) -> dict[str, Any]:
        cells = [(mode, model, condition) for mode in MODES for model in self.models for condition in CONDITIONS]
        executed: dict[str, Any] = {}
        deviation: dict[str, Any] = {}
        for mode, model, condition in cells:
            speeds = self.speeds(mode, model, condition)
            mean = round(statistics.fmean(speeds), DIGITS) if speeds else None
            sd = round(statistics.stdev(speeds), DIGITS) if len(speeds) > 1 else None
            executed.setdefault(mode, {}).setdefault(model, {})[condition] = mean
            deviation.setdefault(mode, {}).setdefault(model, {})[condition] = sd
        return {
            "within_bounds": {mode: self.within(mode) for mode in MODES},
            "counts": {mode: self.counts(mode) for mode in MODES},
            "executed_speed": executed,
            "executed_sd": deviation,
            "ordering": {mode: {model: self.ordering(mode, model) for model in self.models} for mode in MODES},
            "traces": [{"mode": mode, **_row(one)} for mode in MODES for one in self.replayed[mode]],
        }


def _rounded(figures: Mapping[str, Any]) -> dict[str, Any]:
    return {name: round(value, DIGITS) if isinstance(value, float) else value for name, value in figures.items()}


def _row(one: Replayed) -> dict[str, Any]:
    return {
        **asdict(one.trace),
        "executed_rad_s": one.executed_rad_s,
        "ended_by": one.ended_by,
        "motions": [asdict(motion) for motion in one.motions],
    }


def tables(result: PaperResult) -> tuple[Table, ...]:
    """Statistics of the traces, bounds of the scenes, and the modes beside each other."""
    spreads = [
        (model, condition, *(f"{value:.4f}" for value in (s.mean, s.sd, s.median, s.q1, s.q3)))
        for model, row in result.traces.items()
        for condition, s in row.items()
    ]
    scenes = [
        (
            condition,
            words,
            str(result.margins[condition].tier),
            f"{result.margins[condition].index:.3f}",
            f"{result.margins[condition].at_once:.3f}",
            _speed(result.bounds[condition].alone),
            _speed(result.bounds[condition].approved),
        )
        for condition, words in CONDITIONS.items()
    ]
    made = [
        table("The paper's traces, rad/s", ("model", "scene"), ("mean", "SD", "median", "q1", "q3"), spreads),
        table(
            "Bounds, rad/s",
            ("scene", ""),
            ("tier", "index", "at 1.05", "unapproved", "approved"),
            scenes,
        ),
    ]
    if result.replayed:
        made += _replay_tables(result)
    return tuple(made)


def _replay_tables(result: PaperResult) -> list[Table]:
    modes = []
    for mode, words in MODES.items():
        counts = result.counts(mode)
        of = len(result.replayed[mode])
        modes.append((words, *(str(n) for n in counts.values()), f"{result.within(mode)} of {of}"))
    speeds = [
        (
            words,
            model,
            *(_mean(result.speeds(mode, model, condition)) for condition in CONDITIONS),
            result.ordering(mode, model),
        )
        for mode, words in MODES.items()
        for model in result.models
    ]
    return [
        table("Traces", ("mode",), ("executed", "deferred", "denied", "within the bound"), modes),
        table("Executed speed, rad/s: mean and SD", ("mode", "model"), (*CONDITIONS, "fastest first"), speeds),
    ]


def last_line(result: PaperResult) -> str:
    """The figures that count."""
    if not result.replayed:
        return "statistics alone; nothing was replayed"
    told = ", ".join(f"{mode} {result.within(mode)}" for mode in MODES)
    return f"within the bound, of {len(result.replayed['enforced'])}: {told}"


def _speed(of: float | None) -> str:
    return "none" if of is None else f"{of:.3f}"


def _mean(speeds: Sequence[float]) -> str:
    if not speeds:
        return "-"
    sd = f" ± {statistics.stdev(speeds):.3f}" if len(speeds) > 1 else ""
    return f"{statistics.fmean(speeds):.3f}{sd}"
