"""Edge of the application: the trace, the figures and the log line of each request."""

from __future__ import annotations

import logging
from contextvars import ContextVar
from typing import TYPE_CHECKING, Final

from capabilities import tracing
from capabilities.values import trace_context
from ztpm_idp.provider.metrics import METHODS, OTHER

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from opentelemetry.trace import Span
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

    from ztpm_idp.provider.metrics import Metrics

ACCESS: Final = logging.getLogger("ztpm_idp.access")
"""Log of accesses: one line for each request, at INFO; at DEBUG of those that come by themselves."""
AGAIN_AND_AGAIN: Final = frozenset(
    {
        "/livez", "/healthz", "/readyz", "/metrics", "/revocations", "/revocations/wait", "/revocations/events",
        "/revocations/marks", "/registry", "/conduct", "/approvals/answers", "/trust", "/trust/signed",
    }
)  # fmt: skip
"""Routes that probes and enforcement points ask by themselves, some of them several times a second."""
REQUEST_ID: Final = b"ztpm-request-id"
"""Header of every answer, which a caller quotes to the readers of the log."""
_ID_BYTES: Final = 8
_FAILED: Final = 500
_CURRENT: Final = ContextVar("request_id", default="")


def context() -> dict[str, str]:
    """Ids of the request and trace that are current, for each line of the log; empty outside of every request."""
    request = _CURRENT.get()
    return ({"request_id": request} if request else {}) | tracing.context()


class Observing:
    """ASGI layer around the whole application.

    Args:
        app: the application.
        metrics: count the requests.
        random: so many random bytes.
    """

    def __init__(self, app: ASGIApp, *, metrics: Metrics, random: Callable[[int], bytes]) -> None:
        self._app = app
        self._metrics = metrics
        self._random = random

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One ASGI connection."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id = self._random(_ID_BYTES).hex()
        known = _CURRENT.set(request_id)
        try:
            with tracing.entered(trace_context.REQUEST, _caller(scope), random=self._random) as span:
                await self._seen(scope, receive, send, span, request_id)
        finally:
            _CURRENT.reset(known)

    async def _seen(self, scope: Scope, receive: Receive, send: Send, span: Span, request_id: str) -> None:
        begun, status = self._metrics.clock(), _FAILED
        scope.setdefault("state", {})

        async def tell(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                message["headers"] = [*message["headers"], (REQUEST_ID, request_id.encode())]
            await send(message)

        with self._metrics.open.track_inprogress():
            try:
                await self._app(scope, receive, tell)
            finally:
                seconds = self._metrics.clock() - begun
                route = getattr(scope.get("route"), "path", None)
                method = scope["method"] if scope["method"] in METHODS else OTHER
                self._metrics.request(route, method, status, seconds)
                span.set_attributes(
                    {
                        trace_context.ROUTE: route or "",
                        trace_context.METHOD: method,
                        trace_context.STATUS: status,
                    }
                )
                _write(route, method, status, seconds, scope["state"])


def _write(route: str | None, method: str, status: int, seconds: float, state: Mapping[str, object]) -> None:
    """One line; nothing of it is a text that a stranger chose."""
    level = logging.DEBUG if route in AGAIN_AND_AGAIN and status < _FAILED else logging.INFO
    if ACCESS.isEnabledFor(level):
        told = {
            "method": method,
            "route": route,
            "status": status,
            "code": state.get("code"),
            "caller": state.get("caller"),
            "duration_ms": round(seconds * 1_000, 3),
        }
        ACCESS.log(level, "request", extra={name: value for name, value in told.items() if value is not None})


def _caller(scope: Scope) -> trace_context.TraceIds | None:
    """Ids of the caller's trace; of a header that came twice none are taken."""
    found = [value for name, value in scope["headers"] if name == trace_context.HEADER.encode()]
    return trace_context.read(found[0].decode("latin-1")) if len(found) == 1 else None
