"""Following the identity provider: the signed revocation index, and the signed registry snapshot that it names.

One pull is one question with a fresh nonce. The age of the answer runs on our monotonic clock from the moment the nonce
was sent, so no clock of another machine and no recorded answer can make an old view young. What was accepted only ever
grows: the highest epoch is on disk, and an answer below it is refused.
"""

from __future__ import annotations

import asyncio
import json
import os
import secrets
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import httpx2

from capabilities.errors import CapabilityError
from capabilities.statements import registry, revocation
from pep.errors import FeedError, PepFault
from pep.ports import RegisteredSensor, RegisteredTool

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from capabilities.caps import Caps
    from capabilities.keys import TrustBundle
    from capabilities.statements.registry import RegistrySnapshot
    from capabilities.statements.revocation import RevocationIndex, RevocationView
    from pep.ports import Clock

PERIOD_S: Final = 0.25
"""Time between pulls: an eighth of the motion lease; a quarter would do."""
TIMEOUT_S: Final = 1.0
"""Longest wait for one answer; two still fit into the motion lease."""
NONCE_BYTES: Final = 24


@dataclass(frozen=True, slots=True)
class Mark:
    """The high-water mark that survives restarts.

    Attributes:
        issuer: whose feed it is; another issuer's mark is no mark.
        epoch: highest accepted.
        registry_version: highest accepted.
    """

    issuer: str
    epoch: int
    registry_version: int


class MarkFile:
    """The mark on disk, replaced atomically and synced."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def read(self, issuer: str) -> Mark:
        """The stored mark, or zeros when there is none yet.

        Raises:
            FeedError: `STATE_UNREADABLE` when there is one that cannot be read: starting from zero would accept a
                rolled-back feed.
        """
        try:
            stored = json.loads(self._path.read_bytes())
            mark = Mark(str(stored["issuer"]), int(stored["epoch"]), int(stored["registry_version"]))
        except FileNotFoundError:
            return Mark(issuer, 0, 0)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise FeedError(PepFault.STATE_UNREADABLE, str(self._path)) from error
        return mark if mark.issuer == issuer else Mark(issuer, 0, 0)

    def write(self, mark: Mark) -> None:
        """The mark is on disk.

        Raises:
            OSError: when it could not be made durable.
        """
        content = {"issuer": mark.issuer, "epoch": mark.epoch, "registry_version": mark.registry_version}
        fresh = self._path.with_suffix(".new")
        with fresh.open("wb") as file:
            file.write(json.dumps(content).encode())
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(self._path)
        directory = os.open(self._path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)


@dataclass(frozen=True, slots=True)
class Known:
    """What has been accepted so far.

    Attributes:
        epoch: of the newest index, -1 before the first.
        revoked: (kind, id) pairs of all entries since the beginning.
        read_ms: monotonic time at which the newest index's nonce was sent.
        snapshot: of the registry.
    """

    epoch: int
    revoked: frozenset[tuple[str, str]]
    read_ms: int
    snapshot: RegistrySnapshot


class Follower:
    """The `RevocationFeed`, `Registry` and `Sensors` ports over HTTP.

    An index is published only together with the registry version that it names: when one of the two cannot be had,
    neither is, and the view grows old until nothing may move.

    Args:
        http: client of the identity provider.
        issuer: base URL.
        audience: this PEP's; only its registry is accepted.
        trust: keys of the feed and of the registry.
        caps: bounds on statements.
        clock: both clocks.
        mark: the high-water mark.
        incident: told about every refused answer.
    """

    def __init__(
        self,
        http: httpx2.AsyncClient,
        *,
        issuer: str,
        audience: str,
        trust: TrustBundle,
        caps: Caps,
        clock: Clock,
        mark: MarkFile,
        incident: Callable[[FeedError], None],
    ) -> None:
        self._http = http
        self._issuer = issuer
        self._audience = audience
        self._trust = trust
        self._caps = caps
        self._clock = clock
        self._mark_file = mark
        self._mark = mark.read(issuer)
        self._incident = incident
        self._known: Known | None = None
        self._sensors: dict[str, RegisteredSensor] = {}

    # -- ports

    def view(self) -> RevocationView:
        """The newest verified view, its age taken now."""
        if self._known is None:
            return revocation.RevocationView.never()
        return revocation.RevocationView(
            epoch=self._known.epoch,
            age_ms=self._clock.monotonic_ms() - self._known.read_ms,
            revoked=self._known.revoked,
        )

    def tool(self, name: str) -> RegisteredTool | None:
        """The registered tool, or None."""
        tool = None if self._known is None else self._known.snapshot.tool(name)
        return (
            None if tool is None else RegisteredTool(tool.name, tool.definition_digest, tool.operation, tool.base_tier)
        )

    def trust_permille(self, agent: str) -> int | None:
        """The signed static trust of an agent, or None when nothing is stated."""
        return None if self._known is None else self._known.snapshot.trust_permille(agent)

    def sensors(self) -> Mapping[str, RegisteredSensor]:
        """The registered sensors of this audience."""
        return self._sensors

    # -- pulling

    async def run(self, *, period_s: float = PERIOD_S) -> None:
        """Pull for ever; a refused answer is an incident, and the view it would have renewed grows older."""
        while True:
            started = self._clock.monotonic_ms()
            try:
                await self.pull()
            except FeedError as error:
                self._incident(error)
            spent_s = (self._clock.monotonic_ms() - started) / 1000
            await asyncio.sleep(max(0.0, period_s - spent_s))

    async def pull(self) -> None:
        """One question and its answer, accepted whole.

        Raises:
            FeedError: when the answer is refused or there is none; what was known before still stands, and ages.
        """
        known = self._known
        epoch = 0 if known is None else known.epoch
        sent_ms = self._clock.monotonic_ms()
        index, fresh = await self._ask_all(epoch)
        snapshot = known.snapshot if known is not None else None
        if snapshot is None or snapshot.version != index.registry_version:
            snapshot = await self._registry(least=index.registry_version)
        mark = Mark(self._issuer, index.epoch, snapshot.version)
        if mark != self._mark:
            try:
                await asyncio.to_thread(self._mark_file.write, mark)
            except OSError as error:
                raise FeedError(PepFault.STATE_UNREADABLE, "the mark could not be written") from error
            self._mark = mark
        if known is None or known.snapshot is not snapshot:
            self._sensors = {s.id: RegisteredSensor(s.id, s.key, s.calibration, s.transit_ms) for s in snapshot.sensors}
        before = frozenset() if known is None else known.revoked
        self._known = Known(index.epoch, before | fresh if fresh else before, sent_ms, snapshot)

    async def _ask_all(self, since: int) -> tuple[RevocationIndex, frozenset[tuple[str, str]]]:
        """Everything after `since`, page by page: the last index, and what was revoked."""
        fresh: set[tuple[str, str]] = set()
        while True:
            nonce = secrets.token_urlsafe(NONCE_BYTES)
            text = await self._get("/revocations", {"since": str(since), "nonce": nonce})
            index = self._accept(text, since=since, nonce=nonce)
            fresh.update((entry.kind, entry.id) for entry in index.entries)
            if index.last == index.epoch:
                return index, frozenset(fresh)
            if not index.last > since:
                raise FeedError(PepFault.FEED_WRONG_RANGE, "a page that leads nowhere")
            since = index.last

    def _accept(self, text: str, *, since: int, nonce: str) -> RevocationIndex:
        try:
            index = revocation.open(text, self._trust.feed, self._caps)
        except CapabilityError as error:
            raise FeedError(PepFault.FEED_UNTRUSTED, str(error.code)) from error
        if index.issuer != self._issuer:
            raise FeedError(PepFault.FEED_WRONG_ISSUER)
        if index.nonce != nonce:
            raise FeedError(PepFault.FEED_WRONG_NONCE)
        if index.since != since:
            raise FeedError(PepFault.FEED_WRONG_RANGE)
        if not (index.epoch >= self._mark.epoch and index.registry_version >= self._mark.registry_version):
            raise FeedError(PepFault.FEED_ROLLED_BACK, f"epoch {index.epoch} after {self._mark.epoch}")
        return index

    async def _registry(self, *, least: int) -> RegistrySnapshot:
        text = await self._get("/registry", {"audience": self._audience})
        try:
            snapshot = registry.open(text, self._trust.registry, self._caps)
        except CapabilityError as error:
            raise FeedError(PepFault.FEED_UNTRUSTED, str(error.code)) from error
        if snapshot.issuer != self._issuer:
            raise FeedError(PepFault.FEED_WRONG_ISSUER)
        if snapshot.audience != self._audience:
            raise FeedError(PepFault.REGISTRY_WRONG_AUDIENCE)
        if not snapshot.version >= max(least, self._mark.registry_version):
            raise FeedError(PepFault.REGISTRY_ROLLED_BACK, f"version {snapshot.version} after {least}")
        return snapshot

    async def _get(self, path: str, query: dict[str, str]) -> str:
        try:
            response = await self._http.get(
                f"{self._issuer}{path}", params=query, timeout=TIMEOUT_S, follow_redirects=False
            )
        except httpx2.HTTPError as error:
            raise FeedError(PepFault.FEED_UNREACHABLE, type(error).__name__) from error
        if response.status_code != 200 or not len(response.content) <= self._caps.statement_bytes:
            raise FeedError(PepFault.FEED_UNREACHABLE, f"status {response.status_code}")
        return response.text
