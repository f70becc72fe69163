"""Stops as a table, as rows for a file and as a picture."""

from __future__ import annotations

import importlib
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rich.table import Table

from ztpm.stage.stopping import model_rad

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from evaluation.stops.measure import Report


def rows(reports: Sequence[Report]) -> list[dict[str, Any]]:
    """Every stop as it was measured."""
    return [{"kind": report.kind, **asdict(stop)} for report in reports for stop in report.stops]


def table(reports: Sequence[Report]) -> Table:
    """Spreads of the three figures of each kind of stop."""
    table = Table(box=None, pad_edge=False)
    for heading in ("", "stops", "what", "p50", "p90", "p99", "max", "beyond the model", "bar"):
        table.add_column(heading, justify="right" if heading[:1] == "p" or heading == "max" else "left")
    for report in reports:
        figures = report.figures()
        for n, (key, what) in enumerate(
            (("reaction_ms", "t1 - t0, ms"), ("braking_ms", "t2 - t1, ms"), ("travel_mrad", "travel from t0, mrad"))
        ):
            spread = figures[key]
            first = (report.kind, str(figures["count"])) if n == 0 else ("", "")
            last = (str(figures["beyond_model"]), "met" if report.ok else "missed") if n == 0 else ("", "")
            table.add_row(*first, what, *(f"{spread[p]:.1f}" for p in ("p50", "p90", "p99", "max")), *last)
    return table


def plot(reports: Sequence[Report], file: Path) -> None:
    """Travel against speed, with the model's curve; nothing without matplotlib."""
    try:
        matplotlib = importlib.import_module("matplotlib")
    except ModuleNotFoundError:
        return
    matplotlib.use("Agg")
    plots = importlib.import_module("matplotlib.pyplot")
    figure, (travel, reaction) = plots.subplots(1, 2, figsize=(10, 4))
    speeds = [n / 100 for n in range(101)]
    travel.plot(speeds, [model_rad(speed) for speed in speeds], color="black", label="model")
    for report in reports:
        travel.scatter(
            [s.speed_rad_s for s in report.stops], [s.braking_rad for s in report.stops], s=8, label=report.kind
        )
        reaction.hist([s.reaction_s * 1000 for s in report.stops], bins=30, alpha=0.6, label=report.kind)
    travel.set(xlabel="speed of the leading axis, rad/s", ylabel="travel from t1, rad")
    reaction.set(xlabel="t1 - t0, ms", ylabel="stops")
    travel.legend()
    reaction.legend()
    figure.savefig(file, dpi=150)
