"""Result of `ztpm eval coverage`: the paper's table, each cell with what was seen of it."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from evaluation.coverage.cells import BEYOND, DEFENCES
from evaluation.coverage.verdicts import run_id
from evaluation.harness.tables import table
from evaluation.redteam import ledger

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rich.table import Table

    from evaluation.coverage.cells import CoverageCell
    from evaluation.coverage.verdicts import Shown
    from evaluation.redteam.record import RunRecord


@dataclass(frozen=True, slots=True)
class CoverageResult:
    """Result of a run.

    Attributes:
        shown: verdict by cell.
        runs: that they rest on.
        unplayed: scenario, composition and cause of each run that did not come about.
        seed: of every draw.
        campaign: commit, and digests of code and scenarios.
        seconds: how long it took, without earlier parts.
        machine: that of the run.
    """

    shown: Mapping[CoverageCell, Shown]
    runs: Sequence[RunRecord]
    unplayed: Sequence[tuple[str, str, str]]
    seed: int
    campaign: ledger.RedCampaign
    seconds: float
    machine: Mapping[str, Any]

    @property
    def ok(self) -> bool:
        """True where every run came about: a cell that is not shown is a finding alone."""
        return not self.unplayed

    def to_json(self) -> dict[str, Any]:
        """Plain JSON of the result."""
        cells: dict[str, dict[str, dict[str, Any]]] = defaultdict(lambda: {defence: {} for defence in DEFENCES})
        for cell, seen in self.shown.items():
            cells[cell.attack][cell.defence][cell.primitive] = seen.to_json()
        return {
            "ok": self.ok,
            "cells": dict(cells),
            "beyond": [list(claim) for claim in BEYOND],
            "unplayed": [list(each) for each in self.unplayed],
            "seed": self.seed,
            "commit": self.campaign.commit,
            "code": self.campaign.code,
            "scenarios": self.campaign.scenarios,
            "runs": [
                {
                    "id": run_id(run), "end": run.end.value, "harm": [harm.kind for harm in run.harm],
                    "primitives": list(run.primitives), "digest": ledger.digest(run),
                }
                for run in self.runs
            ],
            "machine": dict(self.machine),
            "seconds": round(self.seconds, 1),
        }  # fmt: skip


def tables(result: CoverageResult) -> tuple[Table, ...]:
    """The cells: what was seen of each, and what was not."""
    rows = [
        (
            f"{cell.attack} {cell.defence}",
            cell.primitive,
            *("yes" if each else "-" for each in (seen.fires, seen.sufficient, seen.necessary)),
            str(len(seen.runs)),
            seen.absent or "",
        )
        for cell, seen in sorted(result.shown.items())
    ]
    columns = ("attack", "primitive", "fires", "sufficient", "necessary", "runs", "not seen")
    return (table("Coverage of the attacks", columns, rows=rows),)


def last_line(result: CoverageResult) -> str:
    """The result in one sentence."""
    whole = sum(seen.absent is None for seen in result.shown.values())
    return f"{whole} of {len(result.shown)} cells are shown by {len(result.runs)} runs."
