"""Several ASGI apps behind one door, each at a path of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from starlette.types import ASGIApp, Receive, Scope, Send


class PathRouter:
    """Router to the app of a request's path.

    Args:
        app: for every path that is not named; it alone hears of the server's beginning and end.
        named: the others, by their whole path.
    """

    def __init__(self, app: ASGIApp, named: Mapping[str, ASGIApp]) -> None:
        self._app = app
        self._named = dict(named)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One ASGI connection."""
        await self._named.get(scope.get("path", ""), self._app)(scope, receive, send)
