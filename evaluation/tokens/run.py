"""The whole benchmark: every peer, scope and depth in one run."""

from __future__ import annotations

import random
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from evaluation.harness import timing
from evaluation.harness.absent import AbsentError
from evaluation.harness.machine import machine
from evaluation.tokens.bench import Result, Row, Size
from evaluation.tokens.cell import Cell, Kind, Peer, Unmeasured
from evaluation.tokens.peers import lending as tokens
from evaluation.tokens.peers.act_token import ActToken
from evaluation.tokens.peers.aip import Aip
from evaluation.tokens.peers.bare_biscuit import BareBiscuit
from evaluation.tokens.peers.macaroons import Macaroons
from evaluation.tokens.peers.ours import Ours
from evaluation.tokens.peers.tenuo import Tenuo
from evaluation.tokens.workload import DEPTHS, WORKLOADS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from evaluation.harness.timing import Plan, Series
    from evaluation.tokens.workload import Workload

PEERS: Final[dict[str, Callable[[], Peer]]] = {
    "tenuo": Tenuo,
    "aip": Aip,
    "biscuit": BareBiscuit,
    "macaroons": Macaroons,
    "pyjwt-act": ActToken,
}
"""By name; each needs its package only when it is called."""


def run(
    plan: Plan,
    *,
    seed: int,
    told: Callable[[str], None],
    workloads: Sequence[Workload] = WORKLOADS,
    depths: Sequence[int] = DEPTHS,
    others: dict[str, Callable[[], Peer]] = PEERS,
) -> Result:
    """All cells, measured in turns.

    Args:
        plan: how often.
        seed: of the order of turns.
        told: is told what happens now.
        workloads: which scopes.
        depths: which depths of the chain.
        others: the peers besides ourselves.

    Raises:
        WrongAnswerError: when a cell does not answer what it must.
    """
    began = time.monotonic()
    rows: list[Row] = []
    sizes: list[Size] = []
    groups: list[list[Cell]] = []
    with tokens.elsewhere() as lend:
        peers: list[Peer] = [Ours(lend)]
        for name, make in others.items():
            try:
                peers.append(make())
            except AbsentError as absent:
                rows.append(Row(name, None, None, None, None, why=str(absent)))
        for workload in workloads:
            for depth in depths:
                told(f"making tokens: {workload.name}, depth {depth}")
                cells: list[Cell] = []
                for peer in peers:
                    prepared = peer.prepare(workload, depth, plan.calls)
                    sizes.append(Size(peer.name, workload.name, depth, prepared.bytes))
                    cells += [cell for cell in prepared.cells if isinstance(cell, Cell)]
                    rows += [_unmeasured(cell) for cell in prepared.cells if isinstance(cell, Unmeasured)]
                # What is forgotten before each call of one cell must not be missed by another: a group of its own.
                groups += [[c for c in cells if c.kind is not Kind.FIRST], [c for c in cells if c.kind is Kind.FIRST]]
    told("asking each cell for right and for wrong")
    for group in groups:
        for cell in group:
            timing.prove(cell)
    told("measuring")
    found = timing.measure(groups, plan, clock_ns=time.perf_counter_ns, order=random.Random(seed))  # noqa: S311 - turns
    for group, series in zip(groups, found, strict=True):
        rows += [_row(cell, one) for cell, one in zip(group, series, strict=True)]
    return Result(
        rows=tuple(rows),
        sizes=tuple(sizes),
        versions={peer.name: peer.version for peer in peers},
        machine=machine(),
        plan=plan,
        seconds=time.monotonic() - began,
    )


def _unmeasured(cell: Unmeasured) -> Row:
    return Row(cell.peer, cell.scope, cell.depth, str(cell.kind), cell.proof, why=cell.why)


def _row(cell: Cell, series: Series) -> Row:
    row = Row(cell.peer, cell.scope, cell.depth, str(cell.kind), cell.proof, overruns=series.overruns)
    if not series.count:
        return replace(row, why="it gave up in every call for its own limit of time")
    figures = series.figures()
    return replace(
        row,
        p50_us=round(figures["p50_us"], 2),
        min_us=round(figures["min_us"], 2),
        p99_us=round(figures["p99_us"], 2),
        n=series.count,
        checks=cell.checks,
    )
