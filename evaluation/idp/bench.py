"""Result of a run: each operation of the provider beside the bare endpoint, by database and number of workers."""

from __future__ import annotations

import statistics
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

from evaluation.harness.tables import table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rich.table import Table

BARE: Final = "bare"
BARS: Final = {"issue": 0.5, "introspect": 0.5, "revoke": 0.5, "delegate": 0.25}
"""Least share of the bare endpoint's rate that we allow ourselves, by operation."""
HORIZON_BAR_MS: Final = 1_000
OPERATIONS: Final = ("nonce", *BARS)
"""Operations in their order; a nonce has no bar: `issue` and `delegate` each need one before."""


@dataclass(frozen=True, slots=True)
class OperationRow:
    """One operation on one database with so many workers.

    Attributes:
        database, workers, operation: what was measured; the operation `bare` is the peer's.
        n: timed requests.
        per_s: median over the rounds of the requests answered in a second.
        ratio: median over the rounds of that rate to the bare endpoint's of the same round; None for the peer.
        p50_ms, p99_ms: of one request, with all clients asking.
        cpu_ms: processor time of all workers for one request.
        why: why there are no figures, or empty.
    """

    database: str
    workers: int
    operation: str
    n: int = 0
    per_s: float | None = None
    ratio: float | None = None
    p50_ms: float | None = None
    p99_ms: float | None = None
    cpu_ms: float | None = None
    why: str = ""


@dataclass(frozen=True, slots=True)
class PlaceRow:
    """The rest that is known of one database with so many workers.

    Attributes:
        database, workers: what was measured.
        agents: that were registered.
        revocation_p50_ms, revocation_p99_ms: from the answer to who revoked until a follower had read it.
        followers: of the feed.
        memory_mib: of all workers at the end.
        memory_slope_kib: growth for a thousand requests, by a straight line through the ends of the rounds.
        why: why there are no figures, or empty.
    """

    database: str
    workers: int
    agents: int
    revocation_p50_ms: float | None = None
    revocation_p99_ms: float | None = None
    followers: int = 0
    memory_mib: float | None = None
    memory_slope_kib: float | None = None
    why: str = ""


@dataclass(frozen=True, slots=True)
class IdpResult:
    """Result of a run.

    Attributes:
        operations, places: rows.
        clients: that ask at a time.
        seconds: how long all of it took.
        machine: that of the run.
    """

    operations: Sequence[OperationRow]
    places: Sequence[PlaceRow]
    clients: int
    seconds: float
    machine: Mapping[str, Any]

    @property
    def ratios(self) -> dict[str, float | None]:
        """Smallest ratio of each operation over all databases and numbers of workers; None where it has none."""
        found: dict[str, float | None] = {}
        for operation in BARS:
            ratios = [row.ratio for row in self.operations if row.operation == operation and row.ratio is not None]
            found[operation] = min(ratios, default=None)
        return found

    def to_json(self) -> dict[str, Any]:
        """Plain JSON of the result."""
        p99 = [row.revocation_p99_ms for row in self.places if row.revocation_p99_ms is not None]
        slopes = [row.memory_slope_kib for row in self.places if row.memory_slope_kib is not None]
        return {
            "ok": True,
            "ratios": self.ratios,
            "bars": BARS,
            "revocation_ms": {"p99": max(p99, default=None), "bar": HORIZON_BAR_MS},
            "memory_slope_kib": max(slopes, default=None),
            "agents": max((row.agents for row in self.places), default=0),
            "clients": self.clients,
            "rows": [*map(asdict, self.operations), *map(asdict, self.places)],
            "machine": dict(self.machine),
            "seconds": round(self.seconds, 1),
        }


def percentile(values: Sequence[float], percent: int) -> float:
    """The value below which so many percent of `values` lie; of few values the greatest counts."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, len(ordered) * percent // 100)]


def slope(points: Sequence[tuple[float, float]]) -> float:
    """Slope of the straight line through points, by least squares; 0 through one."""
    xs, ys = [x for x, _ in points], [y for _, y in points]
    if len(set(xs)) < len(points) or len(points) == 1:
        return 0.0
    return statistics.linear_regression(xs, ys).slope


def tables(result: IdpResult) -> tuple[Table, ...]:
    """Rates of the operations, and revocation and memory."""
    told = [
        (
            row.database,
            str(row.workers),
            row.operation,
            *_figures(row.why, row.per_s, row.cpu_ms, row.p50_ms, row.p99_ms),
            "" if row.ratio is None else f"{row.ratio:.2f}",
        )
        for row in result.operations
    ]
    places = [
        (
            row.database,
            str(row.workers),
            *_figures(row.why, row.revocation_p50_ms, row.revocation_p99_ms, row.memory_mib, row.memory_slope_kib),
        )
        for row in result.places
    ]
    return (
        table(
            f"{result.clients} clients",
            ("database", "workers", "operation"),
            ("a second", "CPU ms", "p50 ms", "p99 ms", "of bare"),
            told,
        ),
        table(
            "Revocation until a follower knows; memory of all workers",
            ("database", "workers"),
            ("p50 ms", "p99 ms", "MiB", "KiB in 1000 requests"),
            places,
        ),
    )


def _figures(why: str, *figures: float | None) -> tuple[str, ...]:
    if why:
        return (why, *("",) * (len(figures) - 1))
    return tuple("" if figure is None else f"{figure:.1f}" for figure in figures)


def last_line(result: IdpResult) -> str:
    """The ratios in one line."""
    said = result.to_json()
    told = (
        f"{operation} {'none' if ratio is None else format(ratio, '.2f')} (bar {BARS[operation]})"
        for operation, ratio in said["ratios"].items()
    )
    return f"of the bare endpoint's rate: {', '.join(told)}; revocation p99 {said['revocation_ms']['p99']} ms"
