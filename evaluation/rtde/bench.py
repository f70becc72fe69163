"""Results of a run: delays of commands through the gateway, and the number that never came."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from evaluation.harness.tables import table
from evaluation.pit.bench import CYCLE_US

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rich.table import Table

BARS: Final = (0.2, 1.0)
"""Greatest delay that a gateway may add at the median and the 99th percentile, ms.

It is measured with policy, without physics and record.
"""


class StreamBrokenError(RuntimeError):
    """A stream that did not go on to its end: its figures would be of something else."""


@dataclass(frozen=True, slots=True)
class StreamRow:
    """Result of one way from the client to the controller.

    Attributes:
        way: its name.
        sent: values of the stream.
        opening: values that came while the first one was decided; the newest of them is sent once it is permitted.
        skipped: number of the later ones that the controller was never given. A client sends the next one over one that
            its own connection had not taken yet, so some are skipped even without a gateway.
        opened_us: from the call of the first value to the controller's port: a whole decision, and its record.
        p50_us, p99_us, most_us: the same of the later ones.
    """

    way: str
    sent: int
    opening: int
    skipped: int
    opened_us: float
    p50_us: float
    p99_us: float
    most_us: float


def row_of(way: str, sent: Sequence[tuple[int, float]], came: Mapping[float, int]) -> StreamRow:
    """Result of one stream.

    Args:
        way: its name.
        sent: time of each call in ns, and its value, in order.
        came: time in ns at which each value came to the controller's port.

    Raises:
        StreamBrokenError: the first value never came, or no other.
    """
    late_us = [(came[value] - sent_ns) / 1e3 if value in came else None for sent_ns, value in sent]
    first = late_us[0] if late_us else None
    second = next((at for at, late in enumerate(late_us) if at and late is not None), None)
    if first is None or second is None:
        raise StreamBrokenError(f"{way}: the stream was not opened")
    later = [late for late in late_us[second:] if late is not None]
    p50, p99 = np.percentile(later, (50, 99))
    skipped = len(late_us) - second - len(later)
    return StreamRow(way, len(sent), second - 1, skipped, first, float(p50), float(p99), max(later))


@dataclass(frozen=True, slots=True)
class StreamResult:
    """Result of a run.

    Attributes:
        rows: direct, relayed by two processes that do nothing else, through the gateway without physics, and whole.
        physics_us: median of one certified step.
        seconds: how long all of it took.
        machine: that of the run.
    """

    rows: tuple[StreamRow, ...]
    physics_us: float
    seconds: float
    machine: dict[str, Any]

    def to_json(self) -> dict[str, Any]:
        """Plain JSON of the result."""
        direct, relayed, policy, whole = self.rows
        return {
            "added_ms": {"p50": _added(policy.p50_us, direct.p50_us), "p99": _added(policy.p99_us, direct.p99_us)},
            "relays_ms": {"p50": _added(relayed.p50_us, direct.p50_us), "p99": _added(relayed.p99_us, direct.p99_us)},
            "added_whole_ms": {"p50": _added(whole.p50_us, direct.p50_us), "p99": _added(whole.p99_us, direct.p99_us)},
            "skipped": max(0, max(policy.skipped, whole.skipped) - direct.skipped),
            "ratios": {"stream_physics_p50": round(self.physics_us / CYCLE_US, 4)},
            "rows": [asdict(row) for row in self.rows],
            "seconds": round(self.seconds, 1),
            "machine": self.machine,
        }


def _added(us: float, direct_us: float) -> float:
    return round((us - direct_us) / 1e3, 4)


def tables(result: StreamResult) -> list[Table]:
    """Tables of the result, for people."""
    headings = ("values", "while it opened", "skipped", "opened, us", "p50, us", "p99, us", "most, us")
    rows = (
        (row.way, *map(str, (row.sent, row.opening, row.skipped)), *(f"{us:.0f}" for us in _durations(row)))
        for row in result.rows
    )
    return [table("A value of a stream, from ur_rtde's call to the controller's port", ("way",), headings, rows)]


def _durations(row: StreamRow) -> tuple[float, ...]:
    return row.opened_us, row.p50_us, row.p99_us, row.most_us


def summary(result: StreamResult) -> str:
    """The figures that have bars."""
    told = result.to_json()
    added, relays, share = told["added_ms"], told["relays_ms"], told["ratios"]["stream_physics_p50"]
    return (
        f"added {added['p50']} ms at p50 (bar {BARS[0]}), {added['p99']} ms at p99 (bar {BARS[1]}); "
        f"two relays that only pass on add {relays['p50']} and {relays['p99']}; "
        f"{told['skipped']} skipped on account of the gateway (bar 0); physics {share} of a cycle (bar 0.1)"
    )
