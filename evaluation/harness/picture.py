"""Pictures of a run, drawn by matplotlib: the sheet of each, and the bars of most."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from evaluation.harness.absent import package

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

OURS, OTHERS = "#0b5cad", "#8c8c8c"
_BAR_INCH: Final = 0.28


@contextmanager
def sheet(
    file: Path, title: str, machine: Mapping[str, Any], *, inches: tuple[float, float], columns: int = 1
) -> Iterator[tuple[Any, Any]]:
    """A figure and its axes, one or a row of them, written to `file` as PNG at the end.

    Raises:
        AbsentError: without matplotlib.
    """
    matplotlib, _ = package("matplotlib", "matplotlib")
    matplotlib.use("Agg")
    plots, _ = package("matplotlib.pyplot", "matplotlib")
    figure, axes = plots.subplots(1, columns, figsize=inches, constrained_layout=True)
    yield figure, axes
    where = f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}"
    figure.suptitle(f"{title}\n{where}", fontsize=11)
    figure.savefig(file, dpi=150)
    plots.close(figure)


def bars(
    file: Path,
    title: str,
    machine: Mapping[str, Any],
    rows: Sequence[tuple[str, float, float, str]],
    *,
    unit: str,
    line: tuple[float, str] | None = None,
) -> None:
    """A bar for each row on a logarithmic axis, the first row on top; its 99th percentile is a mark.

    Args:
        file: PNG.
        title: of the picture.
        machine: where it was measured.
        rows: label, median, 99th percentile and colour of each.
        unit: of the figures.
        line: a figure that is drawn across all bars, and its label.

    Raises:
        AbsentError: without matplotlib.
    """
    with sheet(file, title, machine, inches=(10, 1.5 + _BAR_INCH * len(rows))) as (_, axes):
        labels, medians, tails, colours = zip(*reversed(rows), strict=True)
        places = range(len(rows))
        axes.barh(places, medians, color=colours)
        axes.plot(tails, places, "|", color="#444444", markersize=9, label="99th percentile")
        if line is not None:
            axes.axvline(line[0], color="#c8441b", linewidth=1, label=line[1])
        axes.set_xscale("log")
        axes.set_xlabel(f"median, {unit}")
        axes.set_yticks(places, labels, fontsize=8)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, fontsize=8, loc="lower right")
