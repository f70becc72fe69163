"""The benchmark of capability tokens: every peer, scope and depth in one run."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

from evaluation.harness.bench import Bench, LineUp, Row, installed, ratio
from evaluation.harness.tables import figure, pivot, table
from evaluation.harness.timing import FULL, QUICK, Cell
from evaluation.tokens.cell import Kind, TokenKey
from evaluation.tokens.peers import lending, ours, tenuo
from evaluation.tokens.peers.act_token import ActToken
from evaluation.tokens.peers.aip import Aip
from evaluation.tokens.peers.bare_biscuit import BareBiscuit
from evaluation.tokens.peers.macaroons import Macaroons
from evaluation.tokens.picture import draw
from evaluation.tokens.workload import DEPTHS, DIGITAL, REALISTIC, WORKLOADS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from rich.table import Table

    from evaluation.harness.bench import Result
    from evaluation.harness.timing import Plan
    from evaluation.tokens.cell import Peer
    from evaluation.tokens.workload import Workload

PEERS: Final[dict[str, Callable[[], Peer]]] = {
    tenuo.NAME: tenuo.Tenuo,
    "aip": Aip,
    "biscuit": BareBiscuit,
    "macaroons": Macaroons,
    "pyjwt-act": ActToken,
}
"""Peers by name; each needs its package only when it is called."""
RATIOS: Final = {
    "warm_proof_d3": (REALISTIC, Kind.WARM, Kind.WARM, 3),
    "warm_proof_d8": (REALISTIC, Kind.WARM, Kind.WARM, 8),
    "warm_proof_d3_digital": (DIGITAL, Kind.WARM, Kind.WARM, 3),
    "stream_d3": (REALISTIC, Kind.STREAM, Kind.WARM, 3),  # Tenuo has no session: each sample is a call with a proof
    "cold_proof_d3": (REALISTIC, Kind.COLD, Kind.COLD, 3),
    # Tenuo remembers nothing of limits: its cold call is its novel one.
    "novel_proof_d3": (REALISTIC, Kind.NOVEL, Kind.COLD, 3),
    "first_proof_d3": (REALISTIC, Kind.FIRST, Kind.FIRST, 3),
}
BYTES_DEPTH: Final = 3


@dataclass(frozen=True, slots=True)
class Size:
    """Bytes of a token on the wire, before any base64; None when there is no such token."""

    peer: str
    scope: str
    depth: int
    bytes: int | None


def line_up(
    plan: Plan,
    *,
    seed: int,  # noqa: ARG001 - nothing is drawn
    told: Callable[[str], None],
    workloads: Sequence[Workload] = WORKLOADS,
    depths: Sequence[int] = DEPTHS,
    others: Mapping[str, Callable[[], Peer]] = PEERS,
) -> LineUp[TokenKey]:
    """Cells of all peers; see `Bench.line_up`.

    Args:
        plan: how often.
        seed: of nothing here.
        told: receives the name of each step.
        workloads: which scopes.
        depths: which depths of the chain.
        others: the peers besides ourselves.
    """
    sizes: list[Size] = []
    groups: list[list[Cell[TokenKey]]] = []
    found, unmeasured = installed(others, TokenKey)
    with lending.elsewhere() as lend:
        peers: list[Peer] = [ours.OurTokens(lend), *found]
        for workload in workloads:
            for depth in depths:
                told(f"making tokens: {workload.name}, depth {depth}")
                cells: list[Cell[TokenKey]] = []
                for peer in peers if not workload.words else [each for each in peers if each.words]:
                    prepared = peer.prepare(workload, depth, plan.calls)
                    sizes.append(Size(peer.name, workload.name, depth, prepared.bytes))
                    cells += [cell for cell in prepared.cells if isinstance(cell, Cell)]
                    unmeasured += [row for row in prepared.cells if isinstance(row, Row)]
                # Cells that forget before each call must not disturb others: they are a group of their own.
                first = [cell for cell in cells if cell.of.kind is Kind.FIRST]
                groups += [[cell for cell in cells if cell.of.kind is not Kind.FIRST], first]
    versions = {peer.name: peer.version for peer in peers}
    return LineUp(groups, unmeasured, versions, more={"sizes": [asdict(size) for size in sizes]})


def ratios(rows: Sequence[Row[TokenKey]], more: Mapping[str, Any], name: str) -> dict[str, float | None]:
    """Ours over Tenuo's, with proof; None where one of the two was not measured."""
    took = {row.of: getattr(row, name) for row in rows}
    sizes = {(size["peer"], size["depth"]): size["bytes"] for size in more["sizes"] if size["scope"] == REALISTIC.name}

    def of(peer: str, scope: Workload, kind: Kind, depth: int) -> float | None:
        return took.get(TokenKey(peer, scope.name, depth, kind, proof=True))

    found = {
        key: ratio(of(ours.NAME, scope, mine, depth), of(tenuo.NAME, scope, theirs, depth))
        for key, (scope, mine, theirs, depth) in RATIOS.items()
    }
    mine, theirs = (sizes.get((peer, BYTES_DEPTH)) for peer in (ours.NAME, tenuo.NAME))
    return {**found, f"bytes_d{BYTES_DEPTH}": ratio(mine, theirs)}


def tables(result: Result[TokenKey]) -> Iterator[Table]:
    """One table of durations for each scope, one of the checks of each row, one of sizes."""
    order = list(Kind)

    def place(row: Row[TokenKey]) -> tuple[int, bool, str, int]:
        return order.index(row.of.kind or Kind.FIRST), bool(row.of.proof), row.of.peer, row.of.depth or 0

    measured = sorted((row for row in result.rows if row.of.scope is not None), key=place)
    for scope in dict.fromkeys(row["scope"] for row in result.more["sizes"]):
        texts = {
            (_words(row.of), f"depth {row.of.depth}"): figure(row.p50_us, row.p99_us, row.why, row.overruns)
            for row in measured
            if row.of.scope == scope
        }
        yield pivot(f"{scope} scope: median, µs (99th percentile)", ("what", "proof", "peer"), texts)
    checks = {_words(row.of): row.checks for row in measured if row.checks}
    yield table(
        "what a decision rests on", ("what", "proof", "peer", "checks"), rows=((*k, c) for k, c in checks.items())
    )
    sizes = {
        ((size["scope"], size["peer"]), f"depth {size['depth']}"): f"{size['bytes']:,}" if size["bytes"] else "-"
        for size in result.more["sizes"]
    }
    yield pivot("token bytes, before base64", ("scope", "peer"), sizes)


def _words(of: TokenKey) -> tuple[str, str, str]:
    return str(of.kind), "yes" if of.proof else "no", of.peer


def _absent(result: Result[TokenKey]) -> Iterable[str]:
    return (f"{row.of.peer}: {row.why}" for row in result.rows if row.of.scope is None)


BENCH: Final = Bench(
    line_up,
    FULL,
    QUICK,
    ratios,
    f"{ours.NAME}/{tenuo.NAME}, {REALISTIC.name} scope but for the named",
    tables,
    draw,
    remarks=_absent,
    more=lambda rows, more: {"ratios_of_minima": ratios(rows, more, "min_us")},
)
