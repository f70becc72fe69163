"""Choice of the scenarios that show each cell: those whose file says so, else some of its attack class."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING, Final

from evaluation.coverage.cells import CELLS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from evaluation.coverage.cells import CoverageCell
    from evaluation.redteam.scenario import Scenario

OF_CLASS: Final = 3
"""Scenarios of its class that stand for a cell which none says that it shows."""


def candidates(cell: CoverageCell, scenarios: Sequence[Scenario], draw: random.Random) -> tuple[str, ...]:
    """Ids of the scenarios that show a cell, in their order.

    Args:
        cell: the claim.
        scenarios: of every class.
        draw: draws from its class where none says that it shows the cell.
    """
    of_class = [one for one in scenarios if one.hazardous and one.attack == cell.attack]
    said = [one.id for one in of_class if cell.name in one.shows]
    return tuple(said) or tuple(sorted(draw.sample([one.id for one in of_class], min(OF_CLASS, len(of_class)))))


def chosen(scenarios: Sequence[Scenario], *, sample: int, seed: int) -> Mapping[CoverageCell, tuple[str, ...]]:
    """Cells that are tried, with the scenarios for each.

    Args:
        scenarios: of every class.
        sample: cells of each attack class that are drawn, with one scenario for each; 0 for all with all.
        seed: of every draw.
    """
    draw = random.Random(seed)  # noqa: S311 - a draw that can be made again
    known = {cell: candidates(cell, scenarios, draw) for cell in CELLS}
    if not sample:
        return known
    drawn: dict[CoverageCell, tuple[str, ...]] = {}
    for attack in sorted({cell.attack for cell in CELLS}):
        cells = [cell for cell in CELLS if cell.attack == attack]
        for cell in sorted(draw.sample(cells, min(sample, len(cells)))):
            drawn[cell] = (draw.choice(known[cell]),) if known[cell] else ()
    return drawn
