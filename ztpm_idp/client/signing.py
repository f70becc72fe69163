"""Signing each request: an authentication class for `httpx2` clients of both kinds."""

from __future__ import annotations

import secrets
import sys
import time
from typing import TYPE_CHECKING, Final

import httpx2

from capabilities.proof.proof import prove

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from capabilities.keys.keys import PrivateKey

_JTI_BYTES: Final = 18
_TRACES: Final = "opentelemetry.trace"


class ProofAuth(httpx2.Auth):
    """Signs each request with a key, for `httpx2` clients of both kinds; presents a token when it has one.

    Args:
        key: of the caller; with a token, of its holder.
        token: its text, or None.
        now: wall clock, seconds since the epoch.
    """

    requires_request_body = True

    def __init__(self, key: PrivateKey, token: str | None = None, *, now: Callable[[], float] = time.time) -> None:
        self._key = key
        self._token = token
        self._now = now

    def auth_flow(self, request: httpx2.Request) -> Generator[httpx2.Request, httpx2.Response, None]:
        """The request with a fresh proof over its method, address and body."""
        url = str(request.url)
        if "?" in url or "#" in url:
            url = str(request.url.copy_with(query=None, fragment=None))
        request.headers["DPoP"] = prove(
            self._key,
            method=request.method,
            url=url,
            body=request.content,
            token=self._token,
            at=int(self._now()),
            jti=secrets.token_urlsafe(_JTI_BYTES),
        )
        if self._token is not None:
            request.headers["Authorization"] = f"DPoP {self._token}"
        if _TRACES in sys.modules:  # without it no trace is current, and it takes a while to load
            from capabilities import tracing

            request.headers.update(tracing.carried())
        yield request
