"""Parts that every enforcement point has: clock, journal, feeds, replay store, authority. No physics is loaded."""

from __future__ import annotations

import asyncio
import contextlib
from functools import partial
from typing import TYPE_CHECKING, Any, Final, TypedDict

import httpx2

from capabilities.proof.freshness import Memory, earliest_iat_s, retention_ms
from capabilities.token.verify import Verifier
from capabilities.values.caps import DEFAULT as CAPS
from pep.base.clock import HeldClock, SystemClock, TimeMark
from pep.base.errors import PepError, PepFault
from pep.journal.file_journal import FileJournal
from pep.journal.replay_cache import ReplayCache
from pep.point.config_text import read_key, read_policies, read_trust
from pep.point.incidents import Incidents
from pep.point.trust_mark import check_mark, keep, newest
from pep.provider.feed import ProviderFollower
from pep.provider.feed_mark import FeedMarkFile
from pep.provider.introspection import Introspection
from pep.provider.journal_shipper import JournalShipper
from pep.request.authority import Authority

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from capabilities.keys.keys import PrivateKey
    from capabilities.keys.trust import TrustBundle
    from pep.point.config_text import PartsConfig
    from pep.request.edge import Edge
    from policies.decision.policy import PolicySet

FIRST_VIEW_S: Final = 30.0
"""Longest wait for the first verified view before it listens anyway, denying everything until it comes."""
TRUST_MARK: Final = "trust.json"
"""Name of the mark of the newest trust bundle, in the state directory."""
ACCEPTED: Final = frozenset({"decision", "stop", "ticket"})
"""Kinds of records that name a proof, or a person's word on a stop, which had an effect."""


class EnforcementInputs(TypedDict):
    """Inputs of an enforcement point besides its configuration: read, verified and in force."""

    trust: TrustBundle
    key: PrivateKey
    policies: PolicySet
    http: httpx2.AsyncClient


def opened(config: PartsConfig) -> EnforcementInputs:
    """Inputs that the configuration names.

    Raises:
        PepError: one of them cannot be had, or must not be believed.
    """
    policies, key, mark = read_policies(config), read_key(config), config.state_dir / TRUST_MARK
    trust = newest(read_trust(config), mark)
    check_mark(trust, mark, at=SystemClock().wall_s(), caps=CAPS)
    # Straight to the provider: no proxy or password of the environment, and its certificates.
    http = httpx2.AsyncClient(transport=httpx2.AsyncHTTPTransport(), trust_env=False)
    return EnforcementInputs(trust=trust, key=key, policies=policies, http=http)


class PointParts:
    """Parts that every enforcement point has, composed.

    Args:
        config: of it.
        trust: the issuer's public keys.
        key: of this PEP.
        http: client of the identity provider.

    Attributes:
        ended: set it to end the process.
    """

    def __init__(self, config: PartsConfig, *, trust: TrustBundle, key: PrivateKey, http: httpx2.AsyncClient) -> None:
        self.config = config
        # Proofs, tokens and statements are judged by a wall time that nobody can set back.
        self.clock = HeldClock(SystemClock(), mark=TimeMark(config.state_dir / "time.json"), skew_s=CAPS.skew_s)
        # Rounded up: a proof counts whole seconds, and one made before the start must not pass for one made after it.
        self.started_s = earliest_iat_s(self.clock.wall_s(), memory=Memory.KEPT, caps=CAPS)
        self.journal = FileJournal.open(config.journal_file, pep_id=config.pep_id, clock=self.clock)
        self.http = http
        self.ended = asyncio.Event()
        self.incidents = Incidents(self.clock)
        self.follower = ProviderFollower(
            self.http,
            issuer=config.issuer,
            key=key,
            audience=config.audience,
            trust=trust,
            caps=CAPS,
            clock=self.clock,
            mark=FeedMarkFile(config.state_dir / "feed.json"),
            incident=self.feed_incident,
        )
        self.shipper = JournalShipper(
            self.journal,
            self.http,
            issuer=config.issuer,
            key=key,
            clock=self.clock,
            incident=lambda error: self.incidents.tell("ledger", error),
        )
        self.access = Introspection(self.http, issuer=config.issuer, key=key, feed=self.follower, clock=self.clock)
        self.replay = ReplayCache(self.clock)
        verifier = Verifier(trust, CAPS)
        self.follower.trusts.followers.append(verifier.renew)
        self.follower.trusts.keep = partial(keep, mark=config.state_dir / TRUST_MARK)
        self.authority = Authority(
            verifier=verifier,
            feed=self.follower,
            replay=self.replay,
            clock=self.clock,
            caps=CAPS,
            audience=config.audience,
            started_s=self.started_s,
        )

    @property
    def edge(self) -> Edge:
        """Leases and records; the gate in a subclass that has one."""
        raise NotImplementedError

    def recover(self) -> None:
        """Remembers proofs that an earlier process accepted, and records a torn journal."""
        earliest_ms = (self.clock.wall_s() * 1000) - retention_ms(CAPS)
        expires_ms = self.clock.monotonic_ms() + retention_ms(CAPS)
        for record in self.journal.records():
            if record["kind"] in ACCEPTED and record["at_ms"] >= earliest_ms and record["body"]["proof"]:
                self.replay.remember(bytes.fromhex(record["body"]["proof"]), expires_ms=expires_ms)
        if self.journal.repaired_bytes:
            self.journal.append("incident", {"what": "torn-tail", "bytes": self.journal.repaired_bytes})

    def beside(self) -> dict[str, Coroutine[Any, Any, None]]:
        """Tasks that run as long as it serves, by name."""
        keeping = self.clock.run(
            failed=lambda error: self.incidents.tell("clock", error), set_back=self._clock_incident
        )
        return {"feed": self.follower.run(), "ledger": self.shipper.run(), "clock": keeping}

    async def first_view(self) -> None:
        """Waits until the first verified views are there and present proofs are accepted, or for long enough."""
        deadline_ms = self.clock.monotonic_ms() + int(FIRST_VIEW_S * 1000)
        while not self.ended.is_set() and self.clock.monotonic_ms() < deadline_ms:
            ages_ms = self.follower.view().age_ms, self.follower.conduct().age_ms
            if max(ages_ms) < FIRST_VIEW_S * 1000 and self.clock.wall_s() >= self.started_s:
                return
            await asyncio.sleep(0.02)

    # -- incidents beside requests

    def feed_incident(self, error: PepError) -> None:
        """Records a refused answer; an unreachable provider is only told."""
        self.incidents.tell("feed", error)
        if error.code is not PepFault.FEED_UNREACHABLE and self.incidents.first("record", error.code):
            self.note({"what": "feed", "fault": str(error.code), "detail": error.detail})

    def _clock_incident(self, held_s: float) -> None:
        self.note({"what": "clock", "fault": str(PepFault.CLOCK_SET_BACK), "held_s": int(held_s)})

    def note(self, body: dict[str, object]) -> None:
        """Records an incident beside the event loop; a failure is told."""
        self.incidents.watched("journal", self.edge.record("incident", body))

    async def release(self) -> None:
        """Keeps the time, writes the last records, and closes journal and client."""
        with contextlib.suppress(OSError):  # the last mark is at most a period old
            await asyncio.to_thread(self.clock.keep)
        self.edge.close()
        await self.http.aclose()
        self.journal.close()
