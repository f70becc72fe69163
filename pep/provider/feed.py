"""Following the identity provider: the signed revocation index, and the signed registry snapshot that it names.

One pull is one question with a fresh nonce. The age of the answer runs on our monotonic clock from the moment the nonce
was sent, so no clock of another machine and no recorded answer can make an old view young. What was accepted only ever
grows: the highest epoch is on disk, and an answer below it is refused.

Beside the pulls one request waits at the provider for the next revocation (`pep.provider.feed_hints`): what its answer
revokes by the feed's own signature is in force at once, and everything else is left to the pulls.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import httpx2

from capabilities.proof.proof import prove
from capabilities.statements import registry, revocation
from capabilities.statements.revocation import NO_BASE
from capabilities.values import strict_json
from capabilities.values.errors import CapabilityError
from pep.base.errors import FeedError, PepFault
from pep.base.ports import RegisteredSensor, RegisteredTool
from pep.provider.conduct_feed import ConductFeed
from pep.provider.feed_confirmation import FeedConfirmation
from pep.provider.feed_hints import HINT_ROOM, HINT_TIMEOUT_S, FeedHints, Heard
from pep.provider.feed_mark import FeedMark, KeptRevocations, signed_marks
from pep.provider.feed_place import PUT_BACK, Place, first_place
from pep.provider.trust_feed import HEADER, TrustFeed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from capabilities.keys.keys import PrivateKey
    from capabilities.keys.trust import TrustBundle
    from capabilities.statements.registry import RegistrySnapshot
    from capabilities.statements.revocation import RevocationIndex, RevocationView
    from capabilities.values.caps import Caps
    from pep.base.ports import Clock, ConductWord
    from pep.provider.feed_mark import FeedMarkFile

PERIOD_S: Final = 0.25
"""Time between pulls: an eighth of the motion lease; a quarter would do."""
MOVING_PERIOD_S: Final = 0.1
"""Time between pulls while something moves: a lost hint costs a tenth of a second of motion, not a quarter."""
TIMEOUT_S: Final = 1.0
"""Longest wait for one answer; two still fit into the motion lease."""
NONCE_BYTES: Final = 24
PROBLEM_BYTES: Final = 4_096
"""Longest refusal that is read."""
TELL_PERIOD_S: Final = 5.0
"""Shortest time between two tellings of the mark to a provider that is being restored."""
TELL_TIMEOUT_S: Final = 10.0
"""Longest wait for the answer to a mark, of at most 256 KiB."""
RESTORING: Final = "RESTORING"
"""Code with which a provider answers that is being restored."""


@dataclass(frozen=True, slots=True)
class AcceptedFeed:
    """Words of the feed accepted so far.

    Attributes:
        line, epoch, head: of the newest index.
        read_ms: monotonic time at which the newest index's nonce was sent.
        snapshot: of the registry.
        suspended: its suspended agents, as (kind, id) pairs: each counts as revoked meanwhile.
    """

    line: int
    epoch: int
    head: str
    read_ms: int
    snapshot: RegistrySnapshot
    suspended: frozenset[tuple[str, str]]


class ProviderFollower:
    """The `RevocationFeed`, `Registry`, `Sensors` and `Approvers` ports over HTTP.

    An index is published only together with the registry version that it names: when one of the two cannot be had,
    neither is, and the view grows old until nothing may move. What it revokes is revoked at once.

    Args:
        http: client of the identity provider.
        issuer: base URL.
        key: of this PEP, which proves its possession where strangers are told nothing.
        audience: this PEP's; only its registry is accepted.
        trust: keys of the feed and of the registry.
        caps: bounds on statements.
        clock: both clocks.
        mark: the high-water mark.
        incident: told about every refused answer.

    Attributes:
        standings: the word on conduct, pulled beside.
        trusts: the trust bundle, followed beside.
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
        mark: FeedMarkFile,
        incident: Callable[[FeedError], None],
        key: PrivateKey,
    ) -> None:
        self._http = http
        self._issuer = issuer
        self._key = key
        self._audience = audience
        self._trust = trust
        self._caps = caps
        self._clock = clock
        self._mark_file = mark
        self._mark = mark.read(issuer)
        self._kept = KeptRevocations(mark.path.with_suffix(".kept"), issuer=issuer, caps=caps, at=clock.wall_s())
        self._incident = incident
        self._known: AcceptedFeed | None = None
        self._sensors: dict[str, RegisteredSensor] = {}
        self._told_ms: int | None = None
        self._moving = False
        self._snapshot_trust = trust.version
        self._loop: asyncio.AbstractEventLoop | None = None
        self._wake = asyncio.Event()
        self._begun = 0
        self._ended = 0
        self._over = asyncio.Event()
        self.trusts = TrustFeed(self._get, trust, caps=caps, clock=clock, incident=incident)
        self.trusts.followers.append(self._trust_newer)
        self._confirmation = FeedConfirmation(self._post_mark, issuer=issuer, key=key, clock=clock)
        self._hints = FeedHints(
            ask=self._hint, hear=self._news, newest=lambda: self._known, pulled=self._next_pull, pull=self._pull_now,
            clock=clock,
        )  # fmt: skip
        self.standings = ConductFeed(
            self._get_proven, issuer=issuer, trust=trust, caps=caps, clock=clock, incident=incident
        )

    def _trust_newer(self, trust: TrustBundle) -> None:
        self._trust = self.standings.trust = trust

    # -- ports

    def view(self) -> RevocationView:
        """The newest verified view, its age taken now."""
        known = self._known  # once: the watch reads it from a thread of its own
        if known is None:
            return revocation.RevocationView.never()
        return revocation.RevocationView(
            epoch=known.epoch,
            age_ms=self._clock.monotonic_ms() - known.read_ms,
            revoked=self._kept.revoked | known.suspended if known.suspended else self._kept.revoked,
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

    def conduct(self) -> ConductWord:
        """The word on agents' conduct, its age taken now."""
        return self.standings.word()

    def sensors(self) -> Mapping[str, RegisteredSensor]:
        """The registered sensors of this audience."""
        return self._sensors

    def approvers(self) -> Mapping[bytes, str]:
        """The registered approvers, by raw key."""
        return {} if self._known is None else {entry.key: entry.id for entry in self._known.snapshot.approvers}

    def passkeys(self) -> Mapping[bytes, str]:
        """The registered approvers, by raw key of a passkey."""
        return {} if self._known is None else {entry.key: entry.id for entry in self._known.snapshot.passkeys}

    def peps(self) -> Mapping[str, bytes]:
        """The registered enforcement points of this audience, by id."""
        return {} if self._known is None else {entry.id: entry.key for entry in self._known.snapshot.peps}

    # -- pulling

    def hurry(self, *, moving: bool) -> None:
        """Shortens the period to `MOVING_PERIOD_S` while something moves; the first pull comes at once. Any thread."""
        started, self._moving = moving and not self._moving, moving
        loop = self._loop
        if started and loop is not None and not loop.is_closed():
            loop.call_soon_threadsafe(self._wake.set)

    async def run(self, *, period_s: float = PERIOD_S) -> None:
        """Pulls for ever; a refused answer is an incident, and the view it would have renewed grows older.

        Pulls never overlap: this loop alone makes them, and a hint only ends its pause.
        """
        self._loop = asyncio.get_running_loop()
        self._wake, self._over = asyncio.Event(), asyncio.Event()  # of this very loop
        confirming = self._confirmation.run(lambda: self._known, self._next_pull)
        parts = self._hints.run(), self.standings.run(), self.trusts.run(), confirming
        beside = [asyncio.create_task(part) for part in parts]
        try:
            while True:
                started = self._clock.monotonic_ms()
                self._wake.clear()  # before the question is sent: a later hint needs another pull
                self._begun += 1
                try:
                    await self.pull()
                except FeedError as error:
                    if error.code is PepFault.FEED_UNTRUSTED:
                        self.trusts.doubt()
                    self._incident(error)
                self._ended = self._begun
                over, self._over = self._over, asyncio.Event()
                over.set()
                await self._pause(period_s, started)
        finally:
            for task in beside:
                task.cancel()
            await asyncio.gather(*beside, return_exceptions=True)

    async def _pause(self, period_s: float, started: int) -> None:
        """Waits until the period is over, or the pull is woken."""
        period_s = min(period_s, MOVING_PERIOD_S) if self._moving else period_s
        left_s = period_s - (self._clock.monotonic_ms() - started) / 1000
        if left_s <= 0:
            await asyncio.sleep(0)
            return
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(left_s):
                await self._wake.wait()

    async def _next_pull(self) -> None:
        await self._over.wait()

    async def _pulled(self, before: int) -> None:
        """Waits until a pull has ended that began after `before` of them had begun."""
        while self._ended <= before:
            await self._over.wait()

    async def _pull_now(self) -> None:
        before = self._begun
        self._wake.set()
        await self._pulled(before)

    async def _hint(self, since: int) -> str:
        most, query = self._caps.statement_bytes + HINT_ROOM, {"since": str(since), "news": "1"}
        return await self._get("/revocations/wait", query, timeout_s=HINT_TIMEOUT_S, most=most)

    def _news(self, text: str, since: int) -> Heard | None:
        """Place up to which news is in force now; None for no whole index after this epoch ([STM-20])."""
        try:
            index = revocation.open(text, self._trust.feed, self._caps)
        except CapabilityError:
            return None  # a pull tells what is wrong
        if index.issuer != self._issuer or index.since != since or index.last != index.epoch:
            return None
        self._kept.hear(index, text, at=self._clock.wall_s())
        return Heard(index.line, index.epoch)

    async def pull(self) -> None:
        """Pulls one answer, accepted whole.

        A provider that was restored is told what this point knows to be revoked ([STM-15]): while it waits for that,
        and before a new line of its feed is accepted.

        Raises:
            FeedError: when the answer is refused or there is none; what was known before still stands, and ages. What
                a verified index revokes counts even so.
        """
        try:
            await self._pull()
        except FeedError as error:
            if error.code is PepFault.FEED_RESTORING and self._knows_something:
                await self._tell_rarely()
            raise

    async def _pull(self) -> None:
        known, before = self._known, self._mark
        sent_ms = self._clock.monotonic_ms()
        # Revocations count also when the rest of the answer fails: the mark that makes the view young comes last.
        index = await self._ask_all(known)
        if index.line > before.line and before != FeedMark.none(self._issuer):
            await self._tell(before)
        # A snapshot counts under the bundle under which it was opened: its key may be withdrawn since.
        under = self._trust.version
        kept = known is not None and known.line == index.line and self._snapshot_trust == under
        snapshot = known.snapshot if known is not None and kept else None
        if snapshot is None or snapshot.version != index.registry_version:
            snapshot = await self._registry(index)
            self._snapshot_trust = under
        mark = FeedMark(self._issuer, index.epoch, snapshot.version, index.line, index.head)
        if mark != self._mark:
            try:
                await asyncio.to_thread(self._mark_file.write, mark)
            except OSError as error:
                raise FeedError(PepFault.STATE_UNREADABLE, "the mark could not be written") from error
            self._mark = mark
        if known is not None and known.line != index.line:
            self.standings.begin_anew()
        if known is None or known.snapshot is not snapshot:
            self._sensors = {s.id: RegisteredSensor(s.id, s.key, s.calibration, s.transit_ms) for s in snapshot.sensors}
        suspended = frozenset((str(revocation.Revoked.AGENT), agent) for agent in snapshot.suspended)
        self._known = AcceptedFeed(index.line, index.epoch, index.head, sent_ms, snapshot, suspended)

    async def _ask_all(self, known: AcceptedFeed | None) -> RevocationIndex:
        """The last index of everything after what is known, page by page; of a new line everything.

        What each page revokes is in force and on disk.
        """
        try:
            if known is not None:
                try:
                    return await self._pages(Place(known.line, known.epoch, known.head))
                except FeedError as error:
                    if error.code not in (PepFault.FEED_ROLLED_BACK, PepFault.FEED_FORKED):
                        raise
            # A first pull, or a store that was restored: all of what it knows that has not ended is asked for.
            index = await self._pages(None)
            if (behind := self._mark.behind(index)) is None:
                return index
            # The base began after the mark: that the line goes on from the mark is shown by what lies between.
            return await self._pages(behind, meets=index.base)
        finally:
            if not self._kept.synced:
                await self._sync()

    async def _pages(self, place: Place | None, *, meets: revocation.RevocationBase = NO_BASE) -> RevocationIndex:
        """The last index of everything after a place; None: from the newest base on.

        Args:
            place: of the chain, which each page goes on from.
            meets: a base that the chain must meet.
        """
        since, base = (0, NO_BASE) if place is None else (place.epoch, meets)
        begun, walk = place is not None, place
        while True:
            nonce = secrets.token_urlsafe(NONCE_BYTES)
            query = {"since": str(since), "nonce": nonce} | ({} if begun else {"base": str(base.epoch)})
            index = self._hear(await self._get("/revocations", query), since=since, nonce=nonce)
            if walk is None:
                base, begun = index.base, index.base == NO_BASE
                walk = first_place(index, self._mark)
            elif not begun and index.base.epoch != base.epoch:
                raise FeedError(PepFault.FEED_WRONG_RANGE, "a page of another base")
            walk = walk.after(index, self._mark, base=base)
            if index.last == index.epoch:
                return index
            if not index.last > since:
                raise FeedError(PepFault.FEED_WRONG_RANGE, "a page that leads nowhere")
            since = index.last

    async def _sync(self) -> None:
        try:
            await asyncio.to_thread(self._kept.sync)
        except OSError as error:
            raise FeedError(PepFault.STATE_UNREADABLE, "what is revoked could not be kept") from error

    def _hear(self, text: str, *, since: int, nonce: str) -> RevocationIndex:
        """The answer to a question. What it revokes is in force even where its history is refused."""
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
        self._kept.hear(index, text, at=self._clock.wall_s())
        if not self._mark.admits(index):
            raise FeedError(
                PepFault.FEED_ROLLED_BACK, f"line {index.line}, epoch {index.epoch} after {self._mark}: {PUT_BACK}"
            )
        return index

    async def _registry(self, index: RevocationIndex) -> RegistrySnapshot:
        text = await self._get_proven("/registry", {"audience": self._audience})
        try:
            snapshot = registry.open(text, self._trust.registry, self._caps)
        except CapabilityError as error:
            raise FeedError(PepFault.FEED_UNTRUSTED, str(error.code)) from error
        if snapshot.issuer != self._issuer:
            raise FeedError(PepFault.FEED_WRONG_ISSUER)
        if snapshot.audience != self._audience:
            raise FeedError(PepFault.REGISTRY_WRONG_AUDIENCE)
        if not snapshot.version >= index.registry_version:
            raise FeedError(PepFault.REGISTRY_ROLLED_BACK, f"version {snapshot.version} after {index.registry_version}")
        return snapshot

    async def _tell_rarely(self) -> None:
        now_ms = self._clock.monotonic_ms()
        if self._told_ms is None or now_ms - self._told_ms >= TELL_PERIOD_S * 1000:
            self._told_ms = now_ms
            await self._tell(self._mark)

    @property
    def _knows_something(self) -> bool:
        """False where nothing was ever accepted here, or all of it is lost: such a point vouches for nothing."""
        return self._mark != FeedMark.none(self._issuer) or bool(self._kept.revoked)

    async def _tell(self, mark: FeedMark) -> None:
        """The provider has taken what this point knows to be revoked.

        Raises:
            FeedError: `FEED_UNREACHABLE` otherwise.
        """
        at, url = int(self._clock.wall_s()), f"{self._issuer}/restoring/marks"
        for text in signed_marks(mark, self._kept.revoked, key=self._key, at=at):
            body = strict_json.canonical({"mark": text})
            await self._post(url, body, {"dpop": self._proof("POST", url, body)})

    async def _post_mark(self, body: bytes) -> None:
        await self._post(f"{self._issuer}/revocations/marks", body, {})  # signed itself, and good again

    async def _post(self, url: str, body: bytes, headers: dict[str, str]) -> None:
        headers = {"content-type": "application/json"} | headers
        try:
            response = await self._http.post(url, content=body, headers=headers, timeout=TELL_TIMEOUT_S)
        except httpx2.HTTPError as error:
            raise FeedError(PepFault.FEED_UNREACHABLE, type(error).__name__) from error
        if response.status_code != 200:
            raise FeedError(PepFault.FEED_UNREACHABLE, f"status {response.status_code} to a mark")

    def _proof(self, method: str, url: str, body: bytes) -> str:
        at, jti = int(self._clock.wall_s()), secrets.token_urlsafe(NONCE_BYTES)
        return prove(self._key, method=method, url=url, body=body, token=None, at=at, jti=jti)

    async def _get_proven(self, path: str, query: dict[str, str]) -> str:
        """Text at a path that strangers do not read."""
        return await self._get(path, query, headers={"dpop": self._proof("GET", f"{self._issuer}{path}", b"")})

    async def _get(
        self,
        path: str,
        query: dict[str, str],
        *,
        timeout_s: float = TIMEOUT_S,
        most: int | None = None,
        headers: dict[str, str] | None = None,
    ) -> str:
        try:
            response = await self._http.get(
                f"{self._issuer}{path}", params=query, headers=headers, timeout=timeout_s, follow_redirects=False
            )
        except httpx2.HTTPError as error:
            raise FeedError(PepFault.FEED_UNREACHABLE, type(error).__name__) from error
        self.trusts.hint(response.headers.get(HEADER))
        if response.status_code == 409:
            raise FeedError(PepFault.FEED_ROLLED_BACK, f"the provider knows less than was asked for: {PUT_BACK}")
        if response.status_code == 503 and _code_of(response) == RESTORING:
            raise FeedError(PepFault.FEED_RESTORING, "it waits for enforcement points and an administrator")
        if response.status_code != 200 or not len(response.content) <= (most or self._caps.statement_bytes):
            raise FeedError(PepFault.FEED_UNREACHABLE, f"status {response.status_code}")
        return response.text


def _code_of(response: httpx2.Response) -> object:
    """The code of a refusal, or None."""
    try:
        return strict_json.parse_object(response.content[:PROBLEM_BYTES]).get("code")
    except CapabilityError:
        return None
