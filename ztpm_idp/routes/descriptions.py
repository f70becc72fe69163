"""Descriptions that stock clients look for, answered however they ask: HEAD, a slash at the end, a page's preflight."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from ztpm_idp.oauth import metadata

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

_PLACES: Final = (metadata.AT_SERVER, metadata.AT_OPENID, metadata.AT_RESOURCE)
_PREFLIGHT: Final = (
    (b"access-control-allow-origin", b"*"),
    (b"access-control-allow-methods", b"GET, HEAD"),
    (b"access-control-allow-headers", b"*"),
    (b"access-control-max-age", b"600"),
)


class Descriptions:
    """Turns each request for a description into the plain one, and leaves of its answer what was asked for.

    So what is not there is not there for a preflight either, and all are counted alike.

    Args:
        app: behind it.
        prefix: path of the issuer.
    """

    def __init__(self, app: ASGIApp, *, prefix: str) -> None:
        self._app = app
        self._exact = frozenset({prefix + place for place in (*_PLACES, metadata.JWKS)})
        self._roots = _PLACES

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One ASGI connection."""
        path = scope["path"].removesuffix("/") if scope["type"] == "http" else ""
        if not self._is_description(path) or (method := scope["method"]) not in {"GET", "HEAD", "OPTIONS"}:
            await self._app(scope, receive, send)
            return
        plain = {**scope, "method": "GET", "path": path, "raw_path": path.encode("latin-1", "replace")}
        await self._app(plain, receive, send if method == "GET" else _bodiless(send, preflight=method == "OPTIONS"))

    def _is_description(self, path: str) -> bool:
        return path in self._exact or any(path == root or path.startswith(f"{root}/") for root in self._roots)


def _bodiless(send: Send, *, preflight: bool) -> Send:
    """Sends an answer without its body, or as a preflight's where it is a good one."""

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start" and preflight and message["status"] == 200:
            message = {**message, "status": 204, "headers": list(_PREFLIGHT)}
        elif message["type"] == "http.response.body":
            message = {**message, "body": b""}
        await send(message)

    return sent
