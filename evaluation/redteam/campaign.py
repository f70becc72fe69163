"""Campaign of the red team, from what the command line asks to its result."""

from __future__ import annotations

import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from evaluation.harness.machine import code, commit, machine
from evaluation.redteam import ledger
from evaluation.redteam.judging import judge_of
from evaluation.redteam.referee import RefereeError
from evaluation.redteam.result import MODES, RedResult
from evaluation.redteam.run import Red
from evaluation.redteam.scenario import sampled, scenarios

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from evaluation.redteam.scenario import Scenario

MESHES: Final = Path("..", "shared", "data", "ur3e")
"""Place of the vendor's description beside a checkout."""


class RequestError(ValueError):
    """Campaign that cannot be run as it is asked for; the text says why."""


@dataclass(frozen=True, slots=True)
class RedRequest:
    """Campaign that is asked for.

    Attributes:
        sample: scenarios of each class, hazardous and benign; 0 for all.
        seed: of the sample.
        only: ids; empty for all.
        modes: to play; empty for all four.
        cells: number of arenas beside each other.
        meshes: folder of the vendor's description of the arm, or None for that beside the checkout.
        ledger: file that keeps the runs, or None for none.
    """

    sample: int
    seed: int
    only: tuple[str, ...]
    modes: tuple[str, ...]
    cells: int
    meshes: Path | None
    ledger: Path | None


def campaign(request: RedRequest, told: Callable[[str], None]) -> RedResult:
    """Result of a campaign.

    Args:
        request: what is asked for.
        told: of the progress, by a short sentence.

    Raises:
        RequestError: an id or a mode is unknown, or the vendor's meshes are missing or wrong.
        evaluation.redteam.scenario.ScenarioError: a scenario file is wrong.
        evaluation.redteam.ledger.LedgerError: the file has other runs.
        evaluation.harness.absent.AbsentError: without MuJoCo.
    """
    begun_s = time.monotonic()
    where, every = machine(), scenarios()
    chosen = _chosen(every, request)
    if strange := sorted(set(request.modes) - MODES.keys()):
        raise RequestError(f"{', '.join(strange)}: no mode has this name; there are {', '.join(MODES)}")
    of = ledger.campaign(every, commit=commit(), code=code())
    try:
        judge = judge_of(request.meshes or MESHES)
    except RefereeError as error:
        raise RequestError(f"{error}; name the folder by --meshes") from error
    with ExitStack() as place:
        file = request.ledger or Path(place.enter_context(tempfile.TemporaryDirectory(prefix="ztpm-red-"))) / "runs"
        runs = place.enter_context(ledger.Ledger.open(file, of))
        played = Red(runs, judge, told).play(chosen, cells=request.cells, modes=request.modes)
    return RedResult(
        scenarios=chosen,
        played=played,
        seed=request.seed if request.sample else None,
        campaign=of,
        seconds=time.monotonic() - begun_s,
        machine=where,
    )


def _chosen(every: Sequence[Scenario], request: RedRequest) -> Sequence[Scenario]:
    unknown = sorted(set(request.only) - {one.id for one in every})
    if unknown:
        raise RequestError(f"{', '.join(unknown)}: no scenario has this id")
    some = [one for one in every if not request.only or one.id in request.only]
    return sampled(some, request.sample, request.seed) if request.sample else some
