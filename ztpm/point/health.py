"""Health of an enforcement point, told at its door: it answers, and its view is young enough to permit."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Final

from capabilities.statements.revocation import NEVER_MS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from starlette.types import ASGIApp, Receive, Scope, Send

ALIVE: Final = ("/livez", "/healthz")
READY: Final = "/readyz"
_READ: Final = frozenset({"GET", "HEAD"})


def health(age_ms: Callable[[], int], lease_ms: Callable[[], int]) -> Mapping[str, ASGIApp]:
    """Apps of the paths at which it is asked.

    Args:
        age_ms: of the revocation view, now.
        lease_ms: age up to which it permits anything at all.
    """

    async def alive(scope: Scope, receive: Receive, send: Send) -> None:  # noqa: ARG001 - there is nothing to receive
        await _answer(scope, send, 200, {"alive": True})

    async def ready(scope: Scope, receive: Receive, send: Send) -> None:  # noqa: ARG001 - there is nothing to receive
        age, lease = age_ms(), lease_ms()
        if age <= lease:
            await _answer(scope, send, 200, {"ready": True})
            return
        cause = "never read" if age >= NEVER_MS else f"{age} ms old, at most {lease}"
        await _answer(scope, send, 503, {"ready": False, "causes": {"revocation_view": cause}})

    return {**dict.fromkeys(ALIVE, alive), READY: ready}


async def _answer(scope: Scope, send: Send, status: int, said: Mapping[str, object]) -> None:
    body = json.dumps(said).encode()
    if scope.get("method") not in _READ:
        status, body = 405, b""
    headers = [
        (b"content-type", b"application/json"),
        (b"content-length", str(len(body)).encode()),
        (b"cache-control", b"no-store"),
        *([(b"allow", b"GET, HEAD")] if status == 405 else []),
    ]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": b"" if scope.get("method") == "HEAD" else body})
