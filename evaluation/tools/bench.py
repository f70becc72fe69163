"""Result of a run: a guarded act beside the unguarded one, and the parts of what the guard adds."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from evaluation.harness.bench import ratio
from evaluation.harness.tables import figure, table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rich.table import Table

BAR: Final = 1.5
"""Greatest ratio of the medians over HTTP that we allow ourselves."""
MOST_REFUSED: Final = 0.2
"""Share of calls that may be refused although they are right: a decision that its record outlasts is.

Their time counts like any other's. With more, the machine is too busy for figures.
"""


class NotMeasuredError(RuntimeError):
    """A run whose figures would be of something else."""


@dataclass(frozen=True, slots=True)
class ActRow:
    """Calls of one way to the act.

    Attributes:
        way: its name.
        n: timed calls.
        p50_us, p99_us: of them.
        refused: calls among them that were refused, as on a machine that is too busy.
    """

    way: str
    n: int
    p50_us: float
    p99_us: float
    refused: int = 0


def row_of(way: str, took_ns: Sequence[int], refused: int = 0) -> ActRow:
    """Row of the calls that took so long.

    Raises:
        NotMeasuredError: too many of them were refused.
    """
    if refused > MOST_REFUSED * len(took_ns):
        raise NotMeasuredError(f"{way}: {refused} of {len(took_ns)} calls were refused")
    p50, p99 = np.percentile(took_ns, (50, 99)) / 1e3
    return ActRow(way, len(took_ns), round(float(p50), 2), round(float(p99), 2), refused)


@dataclass(frozen=True, slots=True)
class ActResult:
    """Result of a run.

    Attributes:
        guarded, bare: over HTTP, with the SDK's client; in turns.
        enforced, plain: of the function itself, with a proof that is there; in turns.
        parts_us: medians of what the guard consists of, each alone in a loop.
        seconds: how long all of it took.
        machine: that of the run.
    """

    guarded: ActRow
    bare: ActRow
    enforced: ActRow
    plain: ActRow
    parts_us: Mapping[str, float]
    seconds: float
    machine: Mapping[str, Any]

    def to_json(self) -> dict[str, Any]:
        """Plain JSON of the result."""
        return {
            "ok": True,
            "ratios": {
                "guard_http_p50": ratio(self.guarded.p50_us, self.bare.p50_us),
                "guard_http_p99": ratio(self.guarded.p99_us, self.bare.p99_us),
            },
            "added_us": {
                "http_p50": round(self.guarded.p50_us - self.bare.p50_us, 2),
                "http_p99": round(self.guarded.p99_us - self.bare.p99_us, 2),
                "function_p50": round(self.enforced.p50_us - self.plain.p50_us, 2),
                "function_p99": round(self.enforced.p99_us - self.plain.p99_us, 2),
            },
            "parts_us": dict(self.parts_us),
            "rows": [asdict(row) for row in (self.guarded, self.bare, self.enforced, self.plain)],
            "machine": dict(self.machine),
            "seconds": round(self.seconds, 1),
        }


def tables(result: ActResult) -> tuple[Table, ...]:
    """Durations of the four ways, and the parts of the guard."""
    ways = [
        (row.way, str(row.n), figure(row.p50_us, row.p99_us), str(row.refused))
        for row in (result.guarded, result.bare, result.enforced, result.plain)
    ]
    parts = [(name, f"{us:.1f}") for name, us in result.parts_us.items()]
    return (
        table("One act: median, µs (99th percentile)", ("way",), ("calls", "took", "refused"), ways),
        table("Parts of the guard, each alone: median, µs", ("part",), ("took",), parts),
    )


def last_line(result: ActResult) -> str:
    """The ratios in one line."""
    said = result.to_json()
    ratios, added = said["ratios"], said["added_us"]
    return (
        f"guarded/unguarded over HTTP: {ratios['guard_http_p50']:.2f} at p50 (bar {BAR}), "
        f"{ratios['guard_http_p99']:.2f} at p99; a function takes {added['function_p50']:.0f} µs longer"
    )
