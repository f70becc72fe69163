"""One run of `ztpm eval coverage`: each cell's scenarios in its four compositions, as far as they can show it."""

from __future__ import annotations

import tempfile
import time
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from evaluation.coverage.cells import BASE, ONLY, WHOLE, WITHOUT, off_in
from evaluation.coverage.choosing import chosen
from evaluation.coverage.result import CoverageResult
from evaluation.coverage.theatre import Theatre
from evaluation.coverage.verdicts import executed, shown
from evaluation.harness.machine import code, commit, machine
from evaluation.redteam import ledger
from evaluation.redteam.playing import Setting
from evaluation.redteam.run import Red
from evaluation.redteam.scenario import scenarios

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from evaluation.coverage.cells import CoverageCell
    from evaluation.redteam.playing import Judge
    from evaluation.redteam.record import RunRecord
    from evaluation.redteam.scenario import Scenario

Wanted = dict[str, set[str]]
"""Ids of scenarios to play, by composition."""


@dataclass(frozen=True, slots=True)
class CoverageRequest:
    """Coverage that is asked for.

    Attributes:
        sample: cells of each attack class that are drawn; 0 for all.
        seed: of every draw.
        only: names of primitives; empty for all.
        ledger: file that keeps the runs, or None for none.
    """

    sample: int
    seed: int
    only: tuple[str, ...]
    ledger: Path | None


def coverage(
    request: CoverageRequest, judge: Judge, told: Callable[[str], None], *, theatre: Theatre | None = None
) -> CoverageResult:
    """Result of a run.

    Args:
        request: what is asked for.
        judge: the referee.
        told: of the progress, by a short sentence.
        theatre: where everything is played.

    Raises:
        evaluation.redteam.scenario.ScenarioError: a scenario file is wrong.
        evaluation.redteam.ledger.LedgerError: the file has other runs.
    """
    begun_s, where, every = time.monotonic(), machine(), scenarios()
    cells = chosen(every, sample=request.sample, seed=request.seed)
    cells = {cell: ids for cell, ids in cells.items() if not request.only or cell.primitive in request.only}
    of = ledger.campaign(every, commit=commit(), code=code())
    with ExitStack() as place:
        file = request.ledger or Path(place.enter_context(tempfile.TemporaryDirectory(prefix="ztpm-cov-"))) / "runs"
        runs = place.enter_context(ledger.Ledger.open(file, of))
        stage = place.enter_context(closing(theatre or Theatre()))
        red = Red(runs, judge, told, arena=stage.arena)
        by_id = {one.id: one for one in every}
        unplayed = _played(red, by_id, first_pass(cells))
        known = {(run.scenario, run.mode): run for run in runs.runs.values()}
        unplayed += _played(red, by_id, second_pass(cells, known))
        known = {(run.scenario, run.mode): run for run in runs.runs.values()}
    return CoverageResult(
        shown={cell: shown(cell, ids, known) for cell, ids in cells.items()},
        runs=[run for (_, mode), run in sorted(known.items()) if mode in _names(cells)],
        unplayed=unplayed,
        seed=request.seed,
        campaign=of,
        seconds=time.monotonic() - begun_s,
        machine=where,
    )


def first_pass(cells: Mapping[CoverageCell, Sequence[str]]) -> Wanted:
    """Every scenario with everything on, and with identity alone."""
    ids = {id_ for several in cells.values() for id_ in several}
    return {WHOLE: ids, BASE: set(ids)}


def second_pass(cells: Mapping[CoverageCell, Sequence[str]], runs: Mapping[tuple[str, str], RunRecord]) -> Wanted:
    """Scenarios that execute with identity alone, with one primitive beside it; those that are stopped, without it.

    Args:
        cells: with their scenarios.
        runs: of the first pass, by scenario and composition.
    """
    wanted: Wanted = {}
    for cell, ids in cells.items():
        for id_ in ids:
            whole, base = runs.get((id_, WHOLE)), runs.get((id_, BASE))
            if base is not None and executed(cell, base):
                wanted.setdefault(ONLY + cell.primitive, set()).add(id_)
            if whole is not None and not executed(cell, whole):
                wanted.setdefault(WITHOUT + cell.primitive, set()).add(id_)
    return wanted


def _played(red: Red, by_id: Mapping[str, Scenario], wanted: Wanted) -> list[tuple[str, str, str]]:
    """Plays what the ledger has not, one composition after the other; what did not come about, with its cause."""
    order = sorted(wanted, key=lambda name: (len(off_in(name)), name))
    work = [(Setting(name, approver=False), [by_id[id_] for id_ in sorted(wanted[name])]) for name in order]
    return red.settings(work)


def _names(cells: Mapping[CoverageCell, Sequence[str]]) -> set[str]:
    return {name for cell in cells for name in cell.compositions}
