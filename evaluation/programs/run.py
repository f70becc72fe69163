"""One run: each chosen program once, on a cell that stands as its draft says."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from evaluation.harness.machine import machine
from evaluation.programs.bench import bench
from evaluation.programs.catalog import by_cell, chosen
from evaluation.programs.result import ProgramResult, ProgramsResult
from evaluation.programs.verdict import ProgramOutcome, judged
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from evaluation.programs.bench import ProgramBench
    from evaluation.programs.catalog import ProgramRow

TRIES: Final = 3
LATE: Final = frozenset(
    {Reason.VERDICT_EXPIRED, Reason.REVOCATION_VIEW_STALE, Reason.WATCH_LATE, Reason.WATCH_BLIND, Reason.PHYSICS_FAULT}
)
"""Reasons of a machine that is loaded and so is late; the program is run again.

Physics that has no answer in time is a fault of it; one that never has an answer has none in any try.
"""


def run(names: Collection[str], *, told: Callable[[str], None]) -> ProgramsResult:
    """Verdicts on the programs with these names, on all for none.

    Args:
        names: of programs.
        told: receives the progress, a line of text.

    Raises:
        evaluation.programs.catalog.CatalogError: there is no such program, or a file of the catalog is wrong.
        ztpm.base.processes.ChildError, ztpm.stage.stage.StageError: a cell does not come about.
    """
    began, rows = time.monotonic(), chosen(names)
    results: list[ProgramResult] = []
    for cell, its in by_cell(rows).items():
        told(f"a cell: {cell}")
        with bench(cell) as place:
            for row in its:
                told(f"{len(results) + 1} of {len(rows)}: {row.name}")
                results.append(_once(place, row))
    return ProgramsResult(tuple(results), seconds=time.monotonic() - began, machine=machine())


def _once(place: ProgramBench, row: ProgramRow) -> ProgramResult:
    """Verdict on one program; where it failed for a verdict that came too late, it is run again."""
    for tries in range(1, TRIES + 1):
        run_ = place.run(row)
        verdict = judged(row, run_.ended)
        late = any(reason in LATE for reason, _ in run_.ended.told)
        if verdict.outcome is not ProgramOutcome.FAILED or not late or tries == TRIES:
            return ProgramResult(row.name, verdict.outcome, verdict.why, run_.asked, tries, run_.seconds)
    raise AssertionError("no try")
