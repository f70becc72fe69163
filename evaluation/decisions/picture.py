"""A run as one picture: a group of bars for each case."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from evaluation.decisions.ours import NAME as OURS
from evaluation.decisions.ours import RECORDED
from evaluation.harness.absent import package

if TYPE_CHECKING:
    from pathlib import Path

    from evaluation.decisions.bench import Result

_COLOURS: Final = {OURS: "#0b5cad", RECORDED: "#6fa8dc"}
_OTHERS: Final = ("#c8441b", "#e59866", "#8c8c8c", "#3f8f5b")
_WIDTH: Final = 0.8
"""Of a group of bars; the distance between two groups is 1."""


def plot(result: Result, file: Path) -> None:
    """The picture of a run, written to `file` as PNG.

    Raises:
        AbsentError: without matplotlib.
    """
    matplotlib, _ = package("matplotlib", "matplotlib")
    matplotlib.use("Agg")
    plots, _ = package("matplotlib.pyplot", "matplotlib")
    figure, axes = plots.subplots(figsize=(10, 4.8), constrained_layout=True)
    rows = [row for row in result.rows if row.case is not None]
    first = next(row.beside for row in rows)
    rows = [row for row in rows if row.beside in (row.peer, first)]  # of ours, those beside the first of the others
    peers, named = (list(dict.fromkeys(getattr(row, of) for row in rows)) for of in ("peer", "case"))
    others = iter(_OTHERS)
    for n, peer in enumerate(peers):
        took = {row.case: row.p50_us for row in rows if row.peer == peer}
        at = [place - _WIDTH / 2 + _WIDTH * (n + 0.5) / len(peers) for place in range(len(named))]
        bars = axes.bar(
            at,
            [took[case] for case in named],
            width=_WIDTH / len(peers),
            color=_COLOURS.get(peer) or next(others, "#444444"),
            label=f"{peer} {result.versions[peer]}",
        )
        axes.bar_label(bars, fmt="%.0f", fontsize=7, padding=2)
    axes.set_yscale("log")
    axes.set_ylabel("median, µs")
    axes.set_xticks(range(len(named)), named)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.08))
    machine = result.machine
    axes.set_title(
        f"One decision, {result.rules} rules\n"
        f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}",
        fontsize=11,
    )
    figure.savefig(file, dpi=150)
    plots.close(figure)
