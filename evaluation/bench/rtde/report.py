"""What a run found: how late commands are through the gateway, and how many never came."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Final

from rich.table import Table

from evaluation.bench.pit.report import CYCLE_US

BARS: Final = (0.2, 1.0)
"""What a gateway may add at the median and at the 99th percentile, ms, with policy, without physics and record."""


@dataclass(frozen=True, slots=True)
class Row:
    """One way from the client to the controller.

    Attributes:
        way: which.
        sent: values of the stream.
        skipped: of these, how many the controller was never given. A client sends the next one over one that its own
            connection had not taken yet, so some are skipped without anybody in between.
        p50_us, p99_us, most_us: from the call to the controller's port.
    """

    way: str
    sent: int
    skipped: int
    p50_us: float
    p99_us: float
    most_us: float


@dataclass(frozen=True, slots=True)
class Result:
    """Everything.

    Attributes:
        rows: direct, without physics, and whole.
        physics_us: median of one certified step.
        seconds: how long all of it took.
        machine: what on.
    """

    rows: tuple[Row, ...]
    physics_us: float
    seconds: float
    machine: dict[str, Any]

    def as_json(self) -> dict[str, Any]:
        """For machines."""
        direct, policy, whole = self.rows
        return {
            "added_ms": {"p50": _added(policy.p50_us, direct.p50_us), "p99": _added(policy.p99_us, direct.p99_us)},
            "added_whole_ms": {"p50": _added(whole.p50_us, direct.p50_us), "p99": _added(whole.p99_us, direct.p99_us)},
            "skipped": max(0, max(policy.skipped, whole.skipped) - direct.skipped),
            "ratios": {"stream_physics_p50": round(self.physics_us / CYCLE_US, 4)},
            "rows": [asdict(row) for row in self.rows],
            "seconds": round(self.seconds, 1),
            "machine": self.machine,
        }


def _added(us: float, direct_us: float) -> float:
    return round((us - direct_us) / 1e3, 4)


def tables(result: Result) -> list[Table]:
    """For people."""
    table = Table(title="A value of a stream, from ur_rtde's call to the controller's port")
    for heading in ("way", "values", "skipped", "p50, us", "p99, us", "most, us"):
        table.add_column(heading, justify="left" if heading == "way" else "right")
    for row in result.rows:
        figures = (f"{row.p50_us:.0f}", f"{row.p99_us:.0f}", f"{row.most_us:.0f}")
        table.add_row(row.way, str(row.sent), str(row.skipped), *figures)
    return [table]


def summary(result: Result) -> str:
    """The figures that have bars."""
    told = result.as_json()
    added, share = told["added_ms"], told["ratios"]["stream_physics_p50"]
    return (
        f"added {added['p50']} ms at p50 (bar {BARS[0]}), {added['p99']} ms at p99 (bar {BARS[1]}); "
        f"{told['skipped']} skipped on account of the gateway (bar 0); physics {share} of a cycle (bar 0.1)"
    )
