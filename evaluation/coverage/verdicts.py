"""Verdict on each cell, by the runs of its scenarios in its four compositions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from evaluation.coverage.cells import CONTAINMENT, DETECTION

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from evaluation.coverage.cells import CoverageCell
    from evaluation.redteam.record import RunRecord

APART_S: Final = 1.0
"""Harms further apart than this are two effects; nearer ones are one contact that goes on."""


def run_id(run: RunRecord) -> str:
    """Id of a run: its scenario and its composition."""
    return f"{run.scenario}/{run.mode.replace(' ', '-')}"


def effects(run: RunRecord) -> tuple[float, ...]:
    """Begin of each harmful effect, in order: harms that follow each other closely are one."""
    begun: list[float] = []
    last = float("-inf")
    for harm in sorted(run.harm, key=lambda one: one.at_s):
        if harm.at_s - last > APART_S:
            begun.append(harm.at_s)
        last = harm.at_s
    return tuple(begun)


def executed(cell: CoverageCell, run: RunRecord) -> bool:
    """True where the attack came to what the defence is about: its harm, or for containment a further harm."""
    return bool(_of(cell, run))


def _of(cell: CoverageCell, run: RunRecord) -> tuple[float, ...]:
    """Effects that the defence is about: all of them, or for containment those after the first."""
    return effects(run)[1:] if cell.defence == CONTAINMENT else effects(run)


def named(cell: CoverageCell, run: RunRecord) -> bool:
    """True where the primitive is named on record before any effect that the defence is about."""
    named_s = run.named_s.get(cell.primitive)
    return named_s is not None and all(named_s <= at_s for at_s in _of(cell, run))


def stopped(cell: CoverageCell, run: RunRecord) -> bool:
    """True where the primitive stopped the attack in the dimension of the cell.

    Detection: it is named on record before the first harm. Prevention: it is named, and there is no harm. Containment:
    it is named, and there is no harm after the first harmful effect. What stopped for another cause shows nothing.
    """
    return named(cell, run) and (cell.defence == DETECTION or not executed(cell, run))


@dataclass(frozen=True, slots=True)
class Shown:
    """Verdict on one cell.

    Attributes:
        fires: with everything on, a finding of the primitive is on record before the effect.
        sufficient: with identity alone the attack executes, and with this primitive beside it, that one stops it.
        necessary: with everything on it does not execute, and with everything but this primitive it does.
        runs: ids.
        absent: sentence that says what was not seen, or None.
    """

    fires: bool
    sufficient: bool
    necessary: bool
    runs: tuple[str, ...]
    absent: str | None

    def to_json(self) -> dict[str, Any]:
        """Plain JSON of it."""
        return {
            "fires": self.fires,
            "sufficient": self.sufficient,
            "necessary": self.necessary,
            "runs": list(self.runs),
            "absent": self.absent,
        }


def shown(cell: CoverageCell, scenarios: Sequence[str], runs: Mapping[tuple[str, str], RunRecord]) -> Shown:
    """Verdict on a cell: each of its three parts is shown by one scenario at least.

    Args:
        cell: the claim.
        scenarios: ids of those that may show it.
        runs: by scenario and composition; one that was not played shows nothing.
    """
    whole, base, only, without = ([runs.get((id_, name)) for id_ in scenarios] for name in cell.compositions)
    fires = any(run is not None and named(cell, run) for run in whole)
    alone = [(first, then) for first, then in zip(base, only, strict=True) if first and executed(cell, first)]
    sufficient = any(then is not None and stopped(cell, then) for _, then in alone)
    necessary = any(
        run is not None and less is not None and not executed(cell, run) and executed(cell, less)
        for run, less in zip(whole, without, strict=True)
    )
    played = tuple(run_id(run) for each in zip(whole, base, only, without, strict=True) for run in each if run)
    return Shown(
        fires=fires,
        sufficient=sufficient,
        necessary=necessary,
        runs=played,
        absent=_absent(cell, [run for run in whole if run], len(alone), fires=fires, sufficient=sufficient),
    )


def _absent(
    cell: CoverageCell, whole: Sequence[RunRecord], executing: int, *, fires: bool, sufficient: bool
) -> str | None:
    """Sentences about the parts that were not seen, or None where the primitive fires and is sufficient."""
    said = []
    if not whole:
        return f"No scenario of {cell.attack} was played with everything on."
    if not fires:
        found = sorted({primitive for run in whole for primitive in run.primitives})
        elsewhere = f"; on record there were findings of {', '.join(found)}" if found else ""
        of = f"no finding of {cell.primitive} was on record in time"
        said.append(f"With everything on {of} in {len(whole)} runs{elsewhere}.")
    if not sufficient and not executing:
        what = "did a further harm" if cell.defence == CONTAINMENT else "executed"
        said.append(f"With identity alone none of the {len(whole)} scenarios {what}, so nothing was there to be shown.")
    elif not sufficient:
        how = "was not named before the harm" if cell.defence == DETECTION else "did not stop the attack"
        said.append(f"Alone beside identity {cell.primitive} {how} in {executing} scenarios that execute without it.")
    return " ".join(said) or None
