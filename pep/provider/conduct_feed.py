"""Follower of the identity provider's word on conduct: changes since the last one, with an age of its own.

The age runs on our monotonic clock from the moment the nonce was sent, as that of revocations does; but it is another
view, pulled less often: an identity provider that cannot say how agents behave can still say what is revoked.
"""

from __future__ import annotations

import asyncio
import secrets
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from capabilities.statements import conduct
from capabilities.statements.revocation import NEVER_MS
from capabilities.values.errors import CapabilityError
from pep.base.errors import FeedError, PepFault
from pep.base.ports import ConductWord
from policies.conduct.report import Edge

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from capabilities.keys.trust import TrustBundle
    from capabilities.statements.conduct import AgentEntry, Conduct
    from capabilities.values.caps import Caps
    from pep.base.ports import Clock

PERIOD_S: Final = 1.0
"""Time between pulls: a fifth of the age at which the default policies deny.

Own records count at once.
"""
NONCE_BYTES: Final = 24


class ConductFeed:
    """Word of the identity provider on conduct so far.

    Args:
        fetch: gets the text at a path of the identity provider, with a query; raises `FeedError`.
        issuer: base URL.
        trust: keys of the feed.
        caps: bounds on statements.
        clock: monotonic.
        incident: told about every refused answer.
    """

    def __init__(
        self,
        fetch: Callable[[str, dict[str, str]], Awaitable[str]],
        *,
        issuer: str,
        trust: TrustBundle,
        caps: Caps,
        clock: Clock,
        incident: Callable[[FeedError], None],
    ) -> None:
        self._fetch = fetch
        self._issuer = issuer
        self.trust = trust
        self._caps = caps
        self._clock = clock
        self._incident = incident
        self._version = 0
        self._read_ms: int | None = None
        self._edges: dict[Edge, int] = {}
        self._agents: dict[str, AgentEntry] = {}

    def word(self) -> ConductWord:
        """The whole word, its age taken now."""
        read_ms = self._read_ms
        age_ms = NEVER_MS if read_ms is None else self._clock.monotonic_ms() - read_ms
        return ConductWord(age_ms, MappingProxyType(self._edges), MappingProxyType(self._agents))

    def begin_anew(self) -> None:
        """Forgets the word of a provider that was restored: its versions are others, and it is told whole again."""
        self._version, self._read_ms, self._edges, self._agents = 0, None, {}, {}

    async def run(self, *, period_s: float = PERIOD_S) -> None:
        """Pulls for ever; a refused answer is an incident, and the word it would have renewed grows older."""
        while True:
            try:
                await self.pull()
            except FeedError as error:
                self._incident(error)
            await asyncio.sleep(period_s)

    async def pull(self) -> None:
        """Pulls all since the last word, page by page, accepted whole.

        Raises:
            FeedError: when an answer is refused or there is none; what was known before still stands, and ages.
        """
        sent_ms, since = self._clock.monotonic_ms(), self._version
        edges, agents = dict(self._edges), dict(self._agents)
        while True:
            nonce = secrets.token_urlsafe(NONCE_BYTES)
            said = self._accept(
                await self._fetch("/conduct", {"since": str(since), "nonce": nonce}), since=since, nonce=nonce
            )
            edges |= {Edge(entry.delegator, entry.delegate): entry.score_permille for entry in said.edges}
            agents |= {entry.agent: entry for entry in said.agents}
            if said.through == said.version:
                break
            if not said.through > since:
                raise FeedError(PepFault.FEED_WRONG_RANGE, "a page that leads nowhere")
            since = said.through
        self._edges, self._agents, self._version, self._read_ms = edges, agents, said.version, sent_ms

    def _accept(self, text: str, *, since: int, nonce: str) -> Conduct:
        try:
            said = conduct.open(text, self.trust.feed, self._caps)
        except CapabilityError as error:
            raise FeedError(PepFault.FEED_UNTRUSTED, str(error.code)) from error
        if said.issuer != self._issuer:
            raise FeedError(PepFault.FEED_WRONG_ISSUER)
        if said.nonce != nonce:
            raise FeedError(PepFault.FEED_WRONG_NONCE)
        if said.since != since:
            raise FeedError(PepFault.FEED_WRONG_RANGE)
        return said
