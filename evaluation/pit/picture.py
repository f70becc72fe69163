"""A run as one picture: a bar for each workload and answerer, the controller's cycle as a line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from evaluation.harness.absent import package
from evaluation.pit.bench import CYCLE_US
from evaluation.pit.cells import ASSESS, KERNEL, RULER

if TYPE_CHECKING:
    from pathlib import Path

    from evaluation.pit.bench import Result

_COLOURS: Final = {KERNEL: "#0b5cad", RULER: "#3d85c6", ASSESS: "#6fa8dc"}
_OTHERS: Final = "#8c8c8c"
_BAR_INCH: Final = 0.28


def plot(result: Result, file: Path) -> None:
    """The picture of a run, written to `file` as PNG.

    Raises:
        AbsentError: without matplotlib.
    """
    matplotlib, _ = package("matplotlib", "matplotlib")
    matplotlib.use("Agg")
    plots, _ = package("matplotlib.pyplot", "matplotlib")
    rows = [row for row in result.rows if row.p50_us is not None and row.p99_us is not None][::-1]
    figure, axes = plots.subplots(figsize=(10, 1.5 + _BAR_INCH * len(rows)), constrained_layout=True)
    medians = [row.p50_us / 1_000 for row in rows if row.p50_us is not None]
    tails = [row.p99_us / 1_000 for row in rows if row.p99_us is not None]
    places = range(len(rows))
    axes.barh(places, medians, color=[_COLOURS.get(row.peer, _OTHERS) for row in rows])
    axes.plot(tails, places, "|", color="#444444", markersize=9, label="99th percentile")
    axes.axvline(CYCLE_US / 1_000, color="#c8441b", linewidth=1, label="one cycle of 2 ms")
    axes.set_xscale("log")
    axes.set_xlabel("median, ms")
    axes.set_yticks(places, [f"{row.load}: {row.peer}" for row in rows], fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8, loc="lower right")
    machine = result.machine
    axes.set_title(
        f"Certified physics and sampling\n{machine['processor']}, {machine['cores']} cores, Python {machine['python']}",
        fontsize=11,
    )
    figure.savefig(file, dpi=150)
    plots.close(figure)
