"""One run of `ztpm eval paper`."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from evaluation.harness.machine import machine
from evaluation.paper.replay import replay
from evaluation.paper.result import Margin, PaperResult
from evaluation.paper.sweep import LENT_RAD_S, Sweep
from evaluation.paper.traces import CONDITIONS, paper_traces, spreads
from pep.pit.base.tier import tier_of
from policies.decision.load import load_shipped

if TYPE_CHECKING:
    from collections.abc import Callable


def run(*, each: int, told: Callable[[str], None]) -> PaperResult:
    """Statistics of all traces; bounds; and a replay of the first `each` of every model and condition.

    Args:
        each: 0 to 10; 0 replays none.
        told: of the progress, by a short sentence.

    Raises:
        evaluation.paper.replay.ReplayError: a cell did not do as the replay needs.
        evaluation.paper.sweep.PhysicsError: physics has no answer for a motion of the sweep.
    """
    begun_s = time.monotonic()
    where = machine()
    traces = paper_traces()
    told("bounds of the scenes")
    sweep = Sweep(load_shipped("paper-default").parameters)
    margins = {}
    for condition in CONDITIONS:
        index = sweep.index(condition, max(t.speed_rad_s for t in traces if t.condition == condition))
        margins[condition] = Margin(int(tier_of(index)), index, sweep.index_at_once(condition, LENT_RAD_S))
    replayed = {}
    chosen = [trace for trace in traces if trace.number < each]
    if chosen:
        free, gated = replay(chosen, told)
        replayed = {"unenforced": free, "enforced": [one.unapproved for one in gated], "enforced_approved": gated}
    return PaperResult(
        traces=spreads(traces),
        bounds={condition: sweep.bound(condition) for condition in CONDITIONS},
        margins=margins,
        replayed=replayed,
        seconds=time.monotonic() - begun_s,
        machine=where,
    )
