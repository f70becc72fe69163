"""Tokens of one mandate, one after another: the next is drawn before the last ends."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Final, Protocol

import anyio
import httpx2

from ztpm_idp.client.caller import ClientError
from ztpm_idp.client.denials import Denied
from ztpm_idp.client.signing import ProofAuth

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, Callable, Generator

    from capabilities.keys.keys import PrivateKey
    from ztpm_idp.client.caller import Issued

AHEAD: Final = 4
"""Part of a token's life, one in so many, that is left when the next one is drawn.

So never more than two tokens are live, which is what the identity provider allows.
"""
PAUSE_S: Final = 5.0
"""Shortest pause after a draw that failed while the token at hand still lives."""
UNCERTAIN: Final = frozenset({"UNREACHABLE", "ANSWER_MALFORMED"})
"""Failures that say nothing about the mandate."""


class Drawing(Protocol):
    """Party that draws, as `Agent` does."""

    @property
    def key(self) -> PrivateKey:
        """The agent's private key."""

    def draw(self, mandate_id: str, *, lifetime_s: int) -> Issued:
        """A token from the mandate."""


class Renewal:
    """Tokens that an agent draws from one mandate, safe between threads.

    Args:
        agent: that draws.
        mandate_id: the mandate's.
        lifetime_s: longest life of each token.
        now: wall clock, seconds since the epoch.
    """

    def __init__(
        self, agent: Drawing, mandate_id: str, *, lifetime_s: int, now: Callable[[], float] = time.time
    ) -> None:
        self.mandate_id = mandate_id
        self._agent = agent
        self._lifetime_s = lifetime_s
        self._now = now
        self._lock = threading.Lock()
        self._held: Issued | None = None
        self._due_s = 0.0

    def token(self) -> str:
        """A token that lives: the one at hand, or the next one once that is about to end.

        Raises:
            Denied: the token at hand has ended, and no other is drawn: `MANDATE_REVOKED`, `MANDATE_OVER` and other
                codes of the identity provider.
            ClientError: `UNREACHABLE` or `ANSWER_MALFORMED`, when it has ended.
        """
        with self._lock:
            now = self._now()
            if self._held is not None and now < self._due_s:
                return self._held.token
            try:
                drawn = self._agent.draw(self.mandate_id, lifetime_s=self._lifetime_s)
            except ClientError as error:
                return self._without(error)
            self._held = drawn
            self._due_s = drawn.expires_at - (drawn.expires_at - now) / AHEAD
            return drawn.token

    def _without(self, error: ClientError) -> str:
        """The token at hand while it lives: what the server says of it counts."""
        now = self._now()
        if self._held is not None and now < self._held.expires_at:
            self._due_s = min(now + PAUSE_S, self._held.expires_at)
            return self._held.token
        if error.code in UNCERTAIN:
            raise error
        raise Denied(error.code, {"decision": "DENY", "reason": error.code, "remedy": error.detail}) from error

    def auth(self) -> RenewingAuth:
        """Signs requests of any `httpx2` client as the agent, each with a token that lives."""
        return RenewingAuth(self._agent.key, self, now=self._now)


class RenewingAuth(httpx2.Auth):
    """Signs each request with a key, and presents a token that a `Renewal` keeps alive.

    Args:
        key: of the token's holder.
        renewal: of its tokens.
        now: wall clock, seconds since the epoch.
    """

    requires_request_body = True

    def __init__(self, key: PrivateKey, renewal: Renewal, *, now: Callable[[], float] = time.time) -> None:
        self._key = key
        self._renewal = renewal
        self._now = now

    def sync_auth_flow(self, request: httpx2.Request) -> Generator[httpx2.Request, httpx2.Response, None]:
        """The request with token and proof."""
        request.read()
        yield from self._signed(request, self._renewal.token())

    async def async_auth_flow(self, request: httpx2.Request) -> AsyncGenerator[httpx2.Request, httpx2.Response]:
        """The request with token and proof; a draw blocks no other request of the loop."""
        await request.aread()
        token = await anyio.to_thread.run_sync(self._renewal.token)
        for each in self._signed(request, token):
            yield each

    def _signed(self, request: httpx2.Request, token: str) -> Generator[httpx2.Request, httpx2.Response, None]:
        return ProofAuth(self._key, token, now=self._now).auth_flow(request)
