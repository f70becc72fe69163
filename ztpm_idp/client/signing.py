"""Signing each request: an authentication class for `httpx2` clients of both kinds, and its twin without headers."""

from __future__ import annotations

import secrets
import sys
import time
from typing import TYPE_CHECKING, Final

import httpx2

from capabilities.proof import mcp_meta
from capabilities.proof.proof import prove

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Mapping

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


class MetaAuth:
    """Signs each request of an MCP carriage without headers, such as stdio ([PRF-10] in docs/spec.md).

    Args:
        key: of the token's holder.
        token: gives its text, as of now.
        audience: canonical URL of the server.
        now: wall clock, seconds since the epoch.
    """

    def __init__(
        self, key: PrivateKey, token: Callable[[], str], audience: str, *, now: Callable[[], float] = time.time
    ) -> None:
        self._key = key
        self._token = token
        self._audience = audience
        self._now = now

    def signed(self, method: str, params: Mapping[str, object]) -> dict[str, object]:
        """The params with token and a fresh proof in their `_meta`.

        Args:
            method: JSON-RPC method of the request.
            params: of it.
        """
        return mcp_meta.attach(
            params,
            rpc_method=method,
            audience=self._audience,
            key=self._key,
            token=self._token(),
            at=int(self._now()),
            jti=secrets.token_urlsafe(_JTI_BYTES),
        )
