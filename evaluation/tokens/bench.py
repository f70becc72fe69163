"""What a run found: rows, token sizes and the ratios between us and Tenuo."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

from evaluation.tokens.cell import Kind
from evaluation.tokens.peers import ours, tenuo
from evaluation.tokens.workload import REALISTIC

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from evaluation.harness.timing import Plan


@dataclass(frozen=True, slots=True)
class Row:
    """One measured cell, or why there are no figures.

    Attributes:
        peer, scope, depth, kind, proof: what it is of; all but the peer are None for a peer that is not installed.
        p50_us: median over all calls.
        min_us: smallest median of a pass.
        p99_us: 99th percentile over all calls.
        n: calls; with less than 100, the 99th percentile is the slowest of them.
        overruns: calls besides, in which the peer gave up for its own limit of time though the token was good.
        checks: what a decision of this row rests on.
        why: why there are no figures, or empty.
    """

    peer: str
    scope: str | None
    depth: int | None
    kind: str | None
    proof: bool | None
    p50_us: float | None = None
    min_us: float | None = None
    p99_us: float | None = None
    n: int = 0
    overruns: int = 0
    checks: str = ""
    why: str = ""


@dataclass(frozen=True, slots=True)
class Size:
    """Bytes of a token on the wire, before any base64; None when there is no such token."""

    peer: str
    scope: str
    depth: int
    bytes: int | None


@dataclass(frozen=True, slots=True)
class Result:
    """A whole run."""

    rows: tuple[Row, ...]
    sizes: tuple[Size, ...]
    versions: Mapping[str, str]
    machine: Mapping[str, Any]
    plan: Plan
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Everything, as one JSON object."""
        return {
            "ok": True,
            "ratios": ratios(self.rows, self.sizes, "p50_us"),
            "ratios_of_minima": ratios(self.rows, self.sizes, "min_us"),
            "rows": [asdict(row) for row in self.rows],
            "sizes": [asdict(size) for size in self.sizes],
            "versions": dict(self.versions),
            "machine": dict(self.machine),
            "plan": asdict(self.plan),
            "seconds": round(self.seconds, 1),
        }


_RATIOS: Final = {
    "warm_proof_d3": (Kind.WARM, Kind.WARM, 3),
    "warm_proof_d8": (Kind.WARM, Kind.WARM, 8),
    "stream_d3": (Kind.STREAM, Kind.WARM, 3),  # Tenuo has no session: each sample is a call with a proof
    "cold_proof_d3": (Kind.COLD, Kind.COLD, 3),
    "novel_proof_d3": (Kind.NOVEL, Kind.COLD, 3),  # Tenuo remembers nothing of limits: its cold call is its novel one
    "first_proof_d3": (Kind.FIRST, Kind.FIRST, 3),
}
_BYTES_DEPTH: Final = 3


def ratios(rows: Sequence[Row], sizes: Sequence[Size], figure: str) -> dict[str, float | None]:
    """Ours over Tenuo's in the realistic scope, with proof; None where one of the two was not measured.

    Args:
        rows: of one run.
        sizes: of the same run.
        figure: "p50_us" or "min_us".
    """

    def of(peer: str, kind: Kind, depth: int) -> float | None:
        wanted = (peer, REALISTIC.name, depth, kind, True)
        found = [row for row in rows if (row.peer, row.scope, row.depth, row.kind, row.proof) == wanted]
        return None if not found else getattr(found[0], figure)

    def bytes_of(peer: str) -> float | None:
        wanted = (peer, REALISTIC.name, _BYTES_DEPTH)
        return next((size.bytes for size in sizes if (size.peer, size.scope, size.depth) == wanted), None)

    timed = {
        name: _ratio(of(ours.NAME, mine, depth), of(tenuo.NAME, theirs, depth))
        for name, (mine, theirs, depth) in _RATIOS.items()
    }
    return {**timed, f"bytes_d{_BYTES_DEPTH}": _ratio(bytes_of(ours.NAME), bytes_of(tenuo.NAME))}


def _ratio(mine: float | None, theirs: float | None) -> float | None:
    return None if mine is None or not theirs else round(mine / theirs, 3)


def ratios_line(found: Mapping[str, float | None]) -> str:
    """The ratios in one line."""
    said = ", ".join(f"{name} {'-' if value is None else f'{value:.2f}'}" for name, value in found.items())
    return f"{ours.NAME}/{tenuo.NAME}, {REALISTIC.name} scope: {said}"
