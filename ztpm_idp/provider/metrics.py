"""Figures of one application, counted as it works (`figures` reads those of its store).

Each application has a registry of its own. No label is a path, an id or a name that a caller chose: values of labels
are routes, commands and codes of this release.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    GCCollector,
    Histogram,
    PlatformCollector,
    ProcessCollector,
)

if TYPE_CHECKING:
    from collections.abc import Callable

REQUEST_S: Final = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0)
"""Buckets of requests, seconds: a verification takes 1 ms, a delegation 10; beyond 1 s a revocation is late."""
STORE_S: Final = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 1.0, 5.0)
"""Buckets of transactions, seconds: a synced commit takes about 1 ms, a waiting writer gives up after 5 s."""
METHODS: Final = frozenset({"GET", "POST", "HEAD", "OPTIONS", "PUT", "PATCH", "DELETE"})
NO_ROUTE: Final = "none"
OTHER: Final = "other"
DONE, REFUSED, FAILED = "done", "refused", "failed"
"""Ends of a command."""
TAKEN: Final = "taken"
"""End of a push that its webhook took."""
COUNTER, GAUGE, HISTOGRAM = "counter", "gauge", "histogram"


@dataclass(frozen=True, slots=True)
class Figure:
    """Row of the table of figures, which docs/operation.md repeats."""

    name: str
    kind: str
    labels: tuple[str, ...]
    meaning: str


FIGURES: Final = (
    Figure("ztpm_requests_total", COUNTER, ("route", "method", "status"), "Requests answered, by class of status."),
    Figure("ztpm_request_seconds", HISTOGRAM, ("route", "method"), "Time from a request to the end of its answer."),
    Figure("ztpm_requests_open", GAUGE, (), "Requests that are being answered, streams of events included."),
    Figure("ztpm_commands_total", COUNTER, ("command", "result"), "Commands by result: `done`, `refused` or `failed`."),
    Figure("ztpm_refusals_total", COUNTER, ("code",), "Refused commands by reason code."),
    Figure(
        "ztpm_commands_repeated_total", COUNTER, ("cause",), "Commands begun again: `conflict`, or `locks` too few."
    ),
    Figure("ztpm_store_transactions_total", COUNTER, ("end",), "Writing transactions by end."),
    Figure("ztpm_store_transaction_seconds", HISTOGRAM, (), "Time of a writing transaction, its wait included."),
    Figure(
        "ztpm_pushes_total", COUNTER, ("outcome",), "Tries to push a question or latch: `taken`, or the reason code."
    ),
    Figure("ztpm_store_up", GAUGE, (), "1 when the figures below could be read of the store just now."),
    Figure("ztpm_heartbeat_age_seconds", GAUGE, (), "Time since a commit of this process let it send a heartbeat."),
    Figure("ztpm_revocation_epoch", GAUGE, (), "Epoch of the revocation index."),
    Figure("ztpm_registry_version", GAUGE, (), "Version of the registry."),
    Figure("ztpm_restoring", GAUGE, (), "1 while a restored store waits for its enforcement points."),
    Figure("ztpm_ledger_entries", GAUGE, (), "Entries of the ledger."),
    Figure("ztpm_ledger_unfollowed_entries", GAUGE, (), "Entries that tree and index do not hold yet."),
    Figure("ztpm_points", GAUGE, ("state",), "Enforcement points: `connected` or `silent`."),
    Figure("ztpm_points_behind", GAUGE, (), "Connected points that have not confirmed the newest epoch."),
    Figure("ztpm_points_behind_epochs", GAUGE, (), "Epochs by which the last of the connected points is behind."),
    Figure("ztpm_platform_keys_age_seconds", GAUGE, (), "Time since the oldest key set of a platform was taken."),
    Figure("ztpm_setting_faults", GAUGE, (), "Files and addresses of the settings that are not acted on."),
    Figure("ztpm_trust_ends_seconds", GAUGE, (), "Time until the trust bundle ends; absent where it never does."),
)
"""Every figure of our own; those of process and interpreter are the client library's."""
ROWS: Final = {figure.name: figure for figure in FIGURES}


class Metrics:
    """Figures of one application.

    Args:
        clock: monotonic, seconds.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self.clock = clock
        self.registry = CollectorRegistry(auto_describe=False)
        self._requests = self._counter("ztpm_requests_total")
        self._request_s = self._histogram("ztpm_request_seconds", REQUEST_S)
        self.open = self._gauge("ztpm_requests_open")
        self._commands = self._counter("ztpm_commands_total")
        self._refusals = self._counter("ztpm_refusals_total")
        self._repeated = self._counter("ztpm_commands_repeated_total")
        self._pushes = self._counter("ztpm_pushes_total")
        self._transactions = self._counter("ztpm_store_transactions_total")
        self._transaction_s = self._histogram("ztpm_store_transaction_seconds", STORE_S)
        self.store_up = self._gauge("ztpm_store_up")
        ProcessCollector(registry=self.registry)
        PlatformCollector(registry=self.registry)
        GCCollector(registry=self.registry)

    def _counter(self, name: str) -> Counter:
        row = ROWS[name]
        return Counter(name, row.meaning, row.labels, registry=self.registry)

    def _gauge(self, name: str) -> Gauge:
        row = ROWS[name]
        return Gauge(name, row.meaning, row.labels, registry=self.registry)

    def _histogram(self, name: str, buckets: tuple[float, ...]) -> Histogram:
        row = ROWS[name]
        return Histogram(name, row.meaning, row.labels, buckets=buckets, registry=self.registry)

    def request(self, route: str | None, method: str, status: int, seconds: float) -> None:
        """Counts an answered request.

        Args:
            route: the template of its path; None where there is none.
            method: one of `METHODS`, or `OTHER`.
            status: of the answer.
            seconds: that it took.
        """
        labels = route or NO_ROUTE, method
        self._requests.labels(*labels, f"{status // 100}xx").inc()
        self._request_s.labels(*labels).observe(seconds)

    def command(self, name: str, end: str) -> None:
        """Counts a command.

        Args:
            name: of its class.
            end: `DONE`, `FAILED`, or the code of its refusal.
        """
        refused = end not in {DONE, FAILED}
        self._commands.labels(name, REFUSED if refused else end).inc()
        if refused:
            self._refusals.labels(end).inc()

    def repeated(self, cause: str) -> None:
        """Counts a command that is begun again, for a `conflict` or `locks` too few."""
        self._repeated.labels(cause).inc()

    def pushed(self, outcome: str) -> None:
        """Counts a try to push a question: `TAKEN`, or the code of its reason."""
        self._pushes.labels(outcome).inc()

    def transaction(self) -> Callable[[str], None]:
        """Notes that a writing transaction begins; the result takes its end, once."""
        begun = self.clock()

        def ended(end: str) -> None:
            self._transactions.labels(end).inc()
            self._transaction_s.observe(self.clock() - begun)

        return ended
