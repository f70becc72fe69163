"""Access tokens of OAuth clients, asked about at the identity provider: clauses [OAT-1] and [OAT-2] in docs/spec.md.

The answer brings the capability that stands behind the token. It is remembered while the revocation epoch stays, so
that a client which calls often costs one question; what it says is verified anew at every use.
"""

from __future__ import annotations

import asyncio
import hashlib
import secrets
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final
from urllib.parse import urlencode

import httpx2

from capabilities import tracing
from capabilities.proof.proof import prove
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.strict_json import JsonError, read
from pep.base.access_token import Looked

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.keys.keys import PrivateKey
    from pep.base.ports import Clock, RevocationFeed

PATH: Final = "/oauth/introspect"
TIMEOUT_S: Final = 2.0
"""Longest wait for one answer."""
ANSWER_BYTES: Final = 65_536
ANSWER_DEPTH: Final = 24
"""Deepest nesting of an answer: `act` of nine agents, and the object around it."""
REMEMBERED: Final = 1_024
"""Most answers that are remembered; the oldest go first."""
ASKED_AT_ONCE: Final = 8
"""Most questions at the same time: a flood of strange tokens must not become one at the provider."""
_UNKNOWN: Final = Fault(FaultCode.TOKEN_MALFORMED, "OAT-2", "not an access token of this identity provider, now")


@dataclass(frozen=True, slots=True)
class _Kept:
    """An answer, and the epoch and number of revoked ids that were known when it was asked for.

    News in force adds ids before the epoch is known.
    """

    looked: Looked
    known: tuple[int, int]


class Introspection:
    """Answers of the identity provider about access tokens.

    Args:
        http: client of the identity provider.
        issuer: its base URL.
        key: of this PEP.
        feed: the revocation view, whose growth ends what is remembered.
        clock: both clocks.
    """

    def __init__(
        self, http: httpx2.AsyncClient, *, issuer: str, key: PrivateKey, feed: RevocationFeed, clock: Clock
    ) -> None:
        self._http = http
        self._url = issuer + PATH
        self._key = key
        self._feed = feed
        self._clock = clock
        self._kept: dict[bytes, _Kept] = {}
        self._asking = asyncio.Semaphore(ASKED_AT_ONCE)

    async def look(self, token: str) -> Looked | Fault:
        """The answer about an access token, or the fault of one that stands for nothing.

        Args:
            token: its text, of any form.
        """
        name, view = hashlib.sha256(token.encode("utf-8", "surrogatepass")).digest(), self._feed.view()
        kept, known = self._kept.get(name), (view.epoch, len(view.revoked))
        if kept is not None and kept.known == known and self._clock.wall_s() < kept.looked.expires_at:
            return kept.looked
        self._kept.pop(name, None)
        async with self._asking:
            answer = await self._ask(token)
        looked = None if answer is None else Looked.read(answer)
        if looked is None:
            return _UNKNOWN
        while len(self._kept) >= REMEMBERED:
            self._kept.pop(next(iter(self._kept)))
        self._kept[name] = _Kept(looked, known)
        return looked

    async def _ask(self, token: str) -> Mapping[str, object] | None:
        body = urlencode({"token": token}, errors="replace").encode()
        proof = prove(
            self._key,
            method="POST",
            url=self._url,
            body=body,
            token=None,
            at=int(self._clock.wall_s()),
            jti=secrets.token_urlsafe(18),
        )
        headers = {"dpop": proof, "content-type": "application/x-www-form-urlencoded", **tracing.carried()}
        content = bytearray()
        try:
            async with (
                asyncio.timeout(TIMEOUT_S),
                self._http.stream("POST", self._url, content=body, headers=headers, follow_redirects=False) as response,
            ):
                async for part in response.aiter_bytes():
                    content += part
                    if response.status_code != 200 or len(content) > ANSWER_BYTES:
                        return None
        except (httpx2.HTTPError, TimeoutError):
            return None
        try:
            answer = read(bytes(content), limit_bytes=ANSWER_BYTES, limit_depth=ANSWER_DEPTH)
        except JsonError:
            return None
        return answer if isinstance(answer, dict) and answer.get("active") is True else None
