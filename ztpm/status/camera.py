"""Collector of a cell's picture: its processes, the provider's answers, the gateway's report, its journal.

The gateway's key asks for the registry, and no person's key is used: what only a person may ask the provider, such as
what an ask says, is one link or command away.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any, Final

import httpx2

from capabilities.keys.trust import TrustBundle
from capabilities.statements import registry
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.errors import CapabilityError
from ztpm.base.layout import read_key
from ztpm.cell.cell import PROCESSES
from ztpm.status.decisions import Decisions
from ztpm.status.picture import Known, Part, Snapshot, Told
from ztpm.status.texts import TEXTS
from ztpm_idp.client import ProofAuth, direct_http

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from ztpm.base.processes import Child
    from ztpm.cell.cell import Cell

ANSWER_S: Final = 1.0
"""Longest wait for one part."""
OLD_S: Final = 5.0
"""Greatest age of a picture that is shown while the next one is being taken."""
KEEP_S: Final = 0.5
"""Time for which a picture is shown again, to all requests."""


class SnapshotCollector:
    """Collector of pictures. Any thread.

    Args:
        cell: running.
        restarts: number of restarts of each process.
        wall_s: wall clock, seconds since the epoch.
        clock: monotonic, seconds.
        story: what a story told on the cell has told so far; None where none is told.
        transport: of `httpx2`, for tests.
    """

    def __init__(
        self,
        cell: Cell,
        restarts: Mapping[str, int],
        *,
        wall_s: Callable[[], float],
        clock: Callable[[], float],
        story: Callable[[], Sequence[Told] | None] = lambda: None,
        transport: httpx2.BaseTransport | None = None,
    ) -> None:
        self._cell = cell
        self._restarts = restarts
        self._story = story
        self._wall_s = wall_s
        self._clock = clock
        self._http = direct_http.client(ANSWER_S, transport)
        self._auth = ProofAuth(read_key(cell.layout.gateway_key, cell.passphrase), now=wall_s)
        self._decisions = Decisions(cell.layout.gateway_journal)
        self._lock = threading.Lock()
        self._kept: tuple[float, Snapshot] | None = None

    def picture(self) -> Snapshot:
        """Picture of the cell, half a second old at most, or older while the next one is being taken."""
        kept = self._kept
        if self._lock.locked() and kept is not None and self._clock() - kept[0] <= OLD_S:
            return kept[1]
        with self._lock:
            if self._kept is None or self._clock() - self._kept[0] > KEEP_S:
                taken = self._take()
                self._kept = self._clock(), taken
            return self._kept[1]

    def _take(self) -> Snapshot:
        children, addresses = self._cell.children, self._cell.addresses
        incomplete = []
        gateway = children.get("gateway")
        report = None if gateway is None or not gateway.alive else gateway.ask({"report": True}, timeout_s=ANSWER_S)
        if report is None:
            incomplete.append(TEXTS["incomplete"]["gateway"])
        agents = self._agents()
        answers = {
            "idp": self._answers(f"{addresses.issuer}/readyz"),
            "gateway": report is not None,
            "tools": self._answers(addresses.well_known),
        }
        try:
            self._decisions.follow()
        except OSError as error:
            incomplete.append(TEXTS["incomplete"]["journal"].format(fault=type(error).__name__))
        now, at_ms = self._clock(), int(self._wall_s() * 1000)
        return Snapshot(
            at_ms=at_ms,
            data=str(self._cell.layout.root),
            issuer=addresses.issuer,
            audience=addresses.audience,
            robot_host=addresses.face_host,
            parts=tuple(
                self._part_of(name, children.get(name), answers.get(name), now) for name in self._cell.expected
            ),
            robot=_part(report, "robot"),
            perception=_part(report, "perception"),
            view=_part(report, "view"),
            decisions=self._decisions.newest(),
            asks=self._decisions.open_asks(at_ms=at_ms),
            agents=agents,
            incomplete=tuple(incomplete),
            story=self._story(),
        )

    def _part_of(self, name: str, child: Child | None, answers: bool | None, now: float) -> Part:  # noqa: FBT001
        restarts = self._restarts.get(name, 0)
        if child is None or not child.alive:
            return Part(PROCESSES[name], None, answers=False, up_s=0.0, restarts=restarts)
        return Part(PROCESSES[name], child.popen.pid, answers, now - child.since, restarts)

    def close(self) -> None:
        """Closes its connections."""
        self._http.close()

    def _answers(self, url: str) -> bool:
        try:
            return self._http.get(url).status_code == 200
        except httpx2.HTTPError:
            return False

    def _agents(self) -> tuple[Known, ...] | None:
        try:
            answer = self._http.get(
                f"{self._cell.addresses.issuer}/registry",
                params={"audience": self._cell.addresses.audience},
                auth=self._auth,
            )
            snapshot = registry.open(answer.text, self._registry_keys(), CAPS)
        except (httpx2.HTTPError, CapabilityError, OSError):
            return None
        return tuple(Known(entry.agent, entry.permille) for entry in snapshot.trust)

    def _registry_keys(self) -> frozenset[bytes]:
        """Keys of the registry by the cell's own bundle, which a rotation writes anew."""
        return TrustBundle.from_json(self._cell.layout.trust.read_bytes()).registry


def _part(report: dict[str, Any] | None, name: str) -> dict[str, Any] | None:
    part = None if report is None else report.get(name)
    return part if isinstance(part, dict) else None
