"""Picture of a run: the paper's box plot, and the speeds that were executed before the gate beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from evaluation.harness.picture import OTHERS, OURS, sheet
from evaluation.paper.result import MODES
from evaluation.paper.traces import CONDITIONS, paper_traces

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from evaluation.paper.result import PaperResult

COLOURS: Final = (OTHERS, OURS)
BOUND: Final = "#c8441b"
WIDTH: Final = 0.32
"""Of a box; two stand beside each other in one condition."""


def draw(result: PaperResult, file: Path) -> None:
    """Writes the picture as PNG.

    Raises:
        evaluation.harness.absent.AbsentError: without matplotlib.
    """
    panels: dict[str, Mapping[tuple[str, str], Sequence[float]]] = {"asked for, as in the paper": _asked()}
    for mode in list(MODES)[1:] if result.replayed else ():
        panels[f"executed: {MODES[mode]}"] = {
            (model, condition): result.speeds(mode, model, condition)
            for model in result.models
            for condition in CONDITIONS
        }
    title = "Mean actuation speed of the paper's traces"
    with sheet(file, title, result.machine, inches=(5 * len(panels), 4.6), columns=len(panels)) as (_, drawn):
        for n, (axes, (name, speeds)) in enumerate(zip(_each(drawn), panels.items(), strict=True)):
            _panel(axes, speeds, result.models)
            axes.set_title(name, fontsize=10)
            if n > 0:
                _bounds(axes, result, approved="yes" in name)
        _each(drawn)[0].set_ylabel("rad/s")
        _each(drawn)[-1].legend(frameon=False, fontsize=8, loc="lower left")


def _each(drawn: Any) -> list[Any]:
    return list(drawn) if hasattr(drawn, "__len__") else [drawn]


def _asked() -> dict[tuple[str, str], list[float]]:
    speeds: dict[tuple[str, str], list[float]] = {}
    for trace in paper_traces():
        speeds.setdefault((trace.model, trace.condition), []).append(trace.speed_rad_s)
    return speeds


def _panel(axes: Any, speeds: Mapping[tuple[str, str], Sequence[float]], models: Sequence[str]) -> None:
    for m, model in enumerate(models):
        places = [n + (m - 0.5) * (WIDTH + 0.06) for n in range(len(CONDITIONS))]
        for place, condition in zip(places, CONDITIONS, strict=True):
            of = speeds[model, condition]
            if not of:
                axes.text(place, 0.02, "none", ha="center", fontsize=7, color=COLOURS[m])
                continue
            box = axes.boxplot([of], positions=[place], widths=WIDTH, patch_artist=True, manage_ticks=False)
            for part in ("boxes", "whiskers", "caps", "medians", "fliers"):
                for line in box[part]:
                    line.set(color="#222222" if part == "medians" else COLOURS[m], linewidth=1)
            box["boxes"][0].set(facecolor=COLOURS[m], alpha=0.35)
            axes.plot([place] * len(of), of, ".", color=COLOURS[m], markersize=3)
        axes.plot([], [], "s", color=COLOURS[m], label=model)
    axes.set_xticks(range(len(CONDITIONS)), list(CONDITIONS))
    axes.set_xlim(-0.6, len(CONDITIONS) - 0.4)
    axes.set_ylim(0, 0.6)
    axes.spines[["top", "right"]].set_visible(False)


def _bounds(axes: Any, result: PaperResult, *, approved: bool) -> None:
    """A line at the bound of each scene that has one in the picture."""
    label = "bound of the scene"
    for n, condition in enumerate(CONDITIONS):
        bound = result.bounds[condition]
        highest = bound.approved if approved else bound.alone
        if highest is None or highest > axes.get_ylim()[1]:
            continue
        axes.hlines(highest, n - 0.45, n + 0.45, color=BOUND, linewidth=1.2, label=label)
        label = "_"
