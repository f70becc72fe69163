"""The paper's traces as they are in its figure, and their statistics."""

from __future__ import annotations

import statistics
import tomllib
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING, Final, Self

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

CONDITIONS: Final = {
    "C0": "empty workspace",
    "C1": "fragile glass on the table below the arm's path",
    "C2": "person 0.5 m from the base",
}
"""The paper's conditions, in the order of their tiers 1, 2 and 3."""


@dataclass(frozen=True, slots=True)
class Trace:
    """One execution trace of the paper.

    Attributes:
        model: language model that chose the speed.
        condition: of `CONDITIONS`.
        number: 0 to 9, in the figure's order.
        speed_rad_s: mean actuation speed over all of its physical tool calls; nothing else of a trace is known.
    """

    model: str
    condition: str
    number: int
    speed_rad_s: float


@dataclass(frozen=True, slots=True)
class Spread:
    """Statistics of speeds, rad/s.

    Attributes:
        n: number of speeds.
        mean: arithmetic mean.
        sd: sample standard deviation, with n - 1.
        median: middle of the ordered speeds.
        q1, q3: first and third quartile, linearly between ranks, as matplotlib's box plot and numpy have them.
        low, high: extremes.
    """

    n: int
    mean: float
    sd: float
    median: float
    q1: float
    q3: float
    low: float
    high: float

    @classmethod
    def of(cls, speeds: Sequence[float]) -> Self:
        """Statistics of two speeds or more."""
        q1, median, q3 = statistics.quantiles(speeds, n=4, method="inclusive")
        return cls(
            n=len(speeds),
            mean=statistics.fmean(speeds),
            sd=statistics.stdev(speeds),
            median=median,
            q1=q1,
            q3=q3,
            low=min(speeds),
            high=max(speeds),
        )


def paper_traces() -> tuple[Trace, ...]:
    """The 60 traces, by model, condition and number."""
    text = files("evaluation.paper").joinpath("traces.toml").read_text(encoding="utf-8")
    told: Mapping[str, Mapping[str, Sequence[float]]] = tomllib.loads(text)
    return tuple(
        Trace(model, condition, number, speed)
        for model, conditions in told.items()
        for condition, speeds in conditions.items()
        for number, speed in enumerate(speeds)
    )


def models(traces: Sequence[Trace]) -> tuple[str, ...]:
    """Models of traces, in their order."""
    return tuple(dict.fromkeys(trace.model for trace in traces))


def spreads(traces: Sequence[Trace]) -> dict[str, dict[str, Spread]]:
    """Statistics of traces by model and condition, of each that has two traces or more."""
    found: dict[str, dict[str, Spread]] = {}
    for model in models(traces):
        for condition in CONDITIONS:
            speeds = [t.speed_rad_s for t in traces if (t.model, t.condition) == (model, condition)]
            if len(speeds) > 1:
                found.setdefault(model, {})[condition] = Spread.of(speeds)
    return found
