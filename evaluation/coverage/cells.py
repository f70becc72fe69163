"""Cells of the paper's coverage table, the text's claims beyond it, and the compositions that show a cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from evaluation.redteam.composition import ALL
from policies.primitives.catalog import CATALOG

DETECTION: Final = "detection"
PREVENTION: Final = "prevention"
CONTAINMENT: Final = "containment"
DEFENCES: Final = (DETECTION, PREVENTION, CONTAINMENT)
IDENTITY: Final = frozenset({"AID-1", "AID-2", "AID-3", "AID-5"})
"""Primitives that only say who asks, by whose leave and whether that still holds; AID-4 counters an attack itself."""
BEYOND: Final = (
    ("AC-2", PREVENTION, "CII-2"),
    ("AC-2", PREVENTION, "CII-6"),
    ("AC-4", PREVENTION, "TEA-1"),
    ("AC-4", PREVENTION, "TEA-2"),
)
"""Claims of the paper's text that its table does not have."""

WHOLE: Final = "whole"
BASE: Final = "identity"
ONLY: Final = "only "
WITHOUT: Final = "without "


@dataclass(frozen=True, slots=True, order=True)
class CoverageCell:
    """One claim.

    Attributes:
        attack: "AC-1" to "AC-5".
        defence: of `DEFENCES`.
        primitive: id.
    """

    attack: str
    defence: str
    primitive: str

    @property
    def name(self) -> str:
        """Name by which a scenario says that it shows the cell, beside its own attack: "CII-4 detection"."""
        return f"{self.primitive} {self.defence}"

    @property
    def compositions(self) -> tuple[str, str, str, str]:
        """Compositions that show it: everything on, only identity, only it beside identity, everything but it."""
        return WHOLE, BASE, ONLY + self.primitive, WITHOUT + self.primitive


CELLS: Final = tuple(
    sorted(
        {CoverageCell(str(attack), str(defence), row.id) for row in CATALOG for attack, defence in row.counters}
        | {CoverageCell(*claim) for claim in BEYOND}
    )
)
"""Every claim, in the order of attack, defence and primitive."""


def off_in(composition: str) -> frozenset[str]:
    """Primitives that are off in a composition.

    Physics is computed in each of them: as evidence of what is on. What it would enforce is TEA-4's and TEA-6's.

    Args:
        composition: one of `CoverageCell.compositions`.
    """
    if composition == WHOLE:
        return frozenset()
    if composition == BASE:
        return ALL - IDENTITY
    if composition.startswith(ONLY):
        return ALL - IDENTITY - {composition.removeprefix(ONLY)}
    return frozenset({composition.removeprefix(WITHOUT)})
