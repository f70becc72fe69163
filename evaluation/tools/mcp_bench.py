"""Result of a run: a gateway beside FastMCP's proxy and beside the server itself, and a guard over stdio."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

from evaluation.harness.bench import ratio
from evaluation.harness.tables import figure, table

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.table import Table

    from evaluation.tools.bench import ActRow

GATEWAY_BAR: Final = 1.5
"""Greatest ratio of the medians of the gateway and of FastMCP's proxy that we allow ourselves."""
GUARD_BAR: Final = 2.0
"""Likewise of a server with and without a guard over stdio."""


@dataclass(frozen=True, slots=True)
class Fronts:
    """Calls of one server through the gateway, through FastMCP's proxy, and with nothing between; in turns."""

    gateway: ActRow
    proxy: ActRow
    direct: ActRow

    @property
    def rows(self) -> tuple[ActRow, ...]:
        """All rows."""
        return self.gateway, self.proxy, self.direct


@dataclass(frozen=True, slots=True)
class McpResult:
    """Result of a run.

    Attributes:
        http: of a server that is reached over HTTP.
        stdio: of a server that is a process of the one that asks it.
        guarded, bare: over stdio, each a process of the client; in turns.
        record_us: median time of one record before the effect, and of the note after it.
        seconds: how long all of it took.
        machine: that of the run.
        versions: of what was measured beside us.
    """

    http: Fronts
    stdio: Fronts
    guarded: ActRow
    bare: ActRow
    record_us: float
    seconds: float
    machine: Mapping[str, Any]
    versions: Mapping[str, str]

    def to_json(self) -> dict[str, Any]:
        """Plain JSON of the result."""
        ratios: dict[str, float | None] = {}
        for name, fronts in (("http", self.http), ("stdio", self.stdio)):
            gateway = fronts.gateway
            ratios |= {
                f"gateway_{name}_p50": ratio(gateway.p50_us, fronts.proxy.p50_us),
                f"gateway_{name}_p99": ratio(gateway.p99_us, fronts.proxy.p99_us),
                f"gateway_{name}_direct": ratio(gateway.p50_us, fronts.direct.p50_us),
                f"proxy_{name}_direct": ratio(fronts.proxy.p50_us, fronts.direct.p50_us),
            }
        ratios |= {
            "guard_stdio_p50": ratio(self.guarded.p50_us, self.bare.p50_us),
            "guard_stdio_p99": ratio(self.guarded.p99_us, self.bare.p99_us),
        }
        return {
            "ok": True,
            "ratios": ratios,
            "record": {"us": self.record_us, "share_of_guard_stdio_p50": ratio(self.record_us, self.guarded.p50_us)},
            "rows": [asdict(row) for row in self._rows],
            "machine": dict(self.machine),
            "versions": dict(self.versions),
            "seconds": round(self.seconds, 1),
        }

    @property
    def _rows(self) -> tuple[ActRow, ...]:
        return (*self.http.rows, *self.stdio.rows, self.guarded, self.bare)


def tables(result: McpResult) -> tuple[Table, ...]:
    """Durations of each way."""
    told = result.to_json()["rows"]
    ways = [(row["way"], str(row["n"]), figure(row["p50_us"], row["p99_us"]), str(row["refused"])) for row in told]
    return (table("One act: median, µs (99th percentile)", ("way",), ("calls", "took", "refused"), ways),)


def last_line(result: McpResult) -> str:
    """The ratios in one line."""
    said = result.to_json()
    ratios, record = said["ratios"], said["record"]
    return (
        f"gateway/FastMCP's proxy at p50: {ratios['gateway_http_p50']:.2f} over HTTP, "
        f"{ratios['gateway_stdio_p50']:.2f} over stdio (bar {GATEWAY_BAR}); guarded/unguarded over stdio: "
        f"{ratios['guard_stdio_p50']:.2f} (bar {GUARD_BAR}), the records are "
        f"{100 * record['share_of_guard_stdio_p50']:.0f} % of it"
    )
