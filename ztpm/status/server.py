"""Server of the status page: GET only, on loopback, for the user who runs the cell alone.

The page shows the arm's place and all asks, which the gateway keeps from strangers; so other accounts on this machine
are refused by the owner of the connection's other end. Nothing here changes anything.
"""

from __future__ import annotations

import contextlib
import os
import socket
import threading
import time
from typing import TYPE_CHECKING, Final

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route

from ztpm.base.peer import owner_of
from ztpm.edge.places import Bounds
from ztpm.edge.server import EdgeServer
from ztpm.status.page import STYLE, render

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from starlette.requests import Request
    from starlette.types import ASGIApp, Receive, Scope, Send

    from ztpm.status.picture import Snapshot

HEADERS: Final = {
    "Content-Security-Policy": (
        "default-src 'none'; style-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
START_S: Final = 10.0
STOP_S: Final = 3.0
BOUNDS: Final = Bounds(strangers=64, by_address=64, stops=1, stops_by_address=1, parties=1, by_party=1)
"""Nobody proves anything here: a browser of the owner has a few connections, and other users on this machine theirs."""
ROOT: Final = 0


class StatusError(RuntimeError):
    """Failure to serve the page."""


def status_app(picture: Callable[[], Snapshot], *, host: str, port: int, owners: frozenset[int]) -> ASGIApp:
    """App of the status page.

    Args:
        picture: takes one.
        host: the address where it listens; a request that names another host is refused, even one for this machine.
        port: TCP port of the page.
        owners: user ids that may look.
    """

    async def page(_: Request) -> Response:
        taken = await run_in_threadpool(picture)
        return Response(render(taken), media_type="text/html; charset=utf-8", headers=HEADERS)

    async def as_json(_: Request) -> Response:
        return JSONResponse((await run_in_threadpool(picture)).as_json(), headers=HEADERS)

    async def style(_: Request) -> Response:
        return Response(STYLE, media_type="text/css; charset=utf-8", headers=HEADERS)

    routes = [Route("/", page), Route("/status.json", as_json), Route("/style.css", style)]
    return _OwnersOnly(Starlette(routes=routes), netloc=f"{host}:{port}", owners=owners)


class _OwnersOnly:
    """Refuses users who are not among the owners, and requests for another host."""

    def __init__(self, app: ASGIApp, *, netloc: str, owners: frozenset[int]) -> None:
        self._app = app
        self._netloc = netloc.encode()
        self._owners = owners

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and (refused := self._refusal(scope)) is not None:
            await refused(scope, receive, send)
            return
        await self._app(scope, receive, send)

    def _refusal(self, scope: Scope) -> Response | None:
        if [value for name, value in scope["headers"] if name == b"host"] != [self._netloc]:
            return PlainTextResponse("WRONG_HOST\n", 421, headers=HEADERS)
        near, far = scope.get("server"), scope.get("client")
        owner = owner_of(tuple(near), tuple(far)) if near and far else None
        if owner not in self._owners:
            return PlainTextResponse("NOT_YOURS\n", 403, headers=HEADERS)
        return None


class _Server(EdgeServer):
    """A server in a thread: signals are the main thread's."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """No signal is captured here."""
        yield


class StatusServer:
    """The page, served from a thread of its own.

    Args:
        picture: takes one.
        host: a loopback address.
        port: to listen on.

    Raises:
        StatusError: when the port cannot be had.
    """

    def __init__(self, picture: Callable[[], Snapshot], *, host: str, port: int) -> None:
        self.url = f"http://{host}:{port}/"
        try:
            self._socket = socket.create_server((host, port))
        except OSError as error:
            raise StatusError(f"{host}:{port}: {error.strerror}") from error
        owners = frozenset({os.getuid(), ROOT})
        self._server = _Server(
            status_app(picture, host=host, port=port, owners=owners),
            bounds=BOUNDS,
            log_level="error",
            lifespan="off",
            timeout_graceful_shutdown=1,
        )
        self._thread = threading.Thread(target=self._server.run, args=([self._socket],), name="status", daemon=True)

    def start(self) -> None:
        """Serves the page.

        Raises:
            StatusError: when it is not, `START_S` seconds later.
        """
        self._thread.start()
        deadline = time.monotonic() + START_S
        while not self._server.started:
            if time.monotonic() > deadline or not self._thread.is_alive():
                raise StatusError(f"{self.url} is not served")
            time.sleep(0.01)

    def stop(self) -> None:
        """Stops serving."""
        self._server.should_exit = True
        if self._thread.ident is not None:
            self._thread.join(STOP_S)
        self._socket.close()
