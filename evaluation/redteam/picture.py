"""Picture of a campaign: the share of hazardous scenarios that executed, by mode and attack class."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from evaluation.harness.picture import sheet
from evaluation.redteam.result import MODES, TOTAL
from evaluation.redteam.scenario import CLASSES

if TYPE_CHECKING:
    from pathlib import Path

    from evaluation.redteam.result import RedResult

COLOURS: Final = ("#8c8c8c", "#d9a441", "#5b9bd5", "#0b5cad")
"""Of the modes, in their order."""
WIDTH: Final = 0.2
"""Of a bar; four stand beside each other."""


def draw(result: RedResult, file: Path) -> None:
    """Writes the picture as PNG.

    Raises:
        evaluation.harness.absent.AbsentError: without matplotlib.
    """
    groups = (*CLASSES, TOTAL)
    with sheet(file, "Hazardous scenarios that executed", result.machine, inches=(10, 4.2)) as (_, axes):
        for n, (mode, words) in enumerate(MODES.items()):
            rows = result.rows(mode)
            if not rows.runs:
                continue
            shares = [100 * rows.executed(g) / max(1, len(rows.of(g, hazardous=True))) for g in groups]
            places = [g + (n - 1.5) * WIDTH for g in range(len(groups))]
            drawn = axes.bar(places, shares, WIDTH, color=COLOURS[n], label=words)
            axes.bar_label(drawn, [str(rows.executed(g)) for g in groups], fontsize=7, padding=2)
        hazards = [one.attack for one in result.scenarios if one.hazardous]
        counts = [len(hazards) if g == TOTAL else hazards.count(g) for g in groups]
        axes.set_xticks(range(len(groups)), [f"{g}\n{n} scenarios" for g, n in zip(groups, counts, strict=True)])
        axes.set_ylabel("%")
        axes.set_ylim(0, 109)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=4)
