"""Server of a running cell's page: on loopback, for the user who runs the cell alone.

The page shows the arm's place and all asks, which the gateway keeps from strangers; so other accounts on this machine
are refused by the owner of the connection's other end. One thing can be done here: each of them can stop the arm
([LIV-2]).
"""

from __future__ import annotations

import contextlib
import os
import socket
import threading
import time
from importlib import resources
from typing import TYPE_CHECKING, Final

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route

from capabilities.values import strict_json
from pep.base.caller_place import stopping
from ztpm.base.peer import owner_of
from ztpm.edge.places import Bounds
from ztpm.edge.server import EdgeServer
from ztpm.status.live_feed import LiveFeed
from ztpm.status.page import SCRIPTS, STYLE, parts_of, render
from ztpm.status.stopping import CellStop
from ztpm.status.texts import TEXTS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from starlette.requests import Request
    from starlette.types import ASGIApp, Receive, Scope, Send

    from ztpm.cell.cell import Cell
    from ztpm.status.camera import SnapshotCollector
    from ztpm.status.picture import Snapshot
    from ztpm.status.stopping import StopAnswer

HEADERS: Final = {
    "Content-Security-Policy": (
        "default-src 'none'; style-src 'self'; script-src 'self'; connect-src 'self'; base-uri 'none'; "
        "form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
ASSETS: Final = {name: resources.files("ztpm_idp.console.assets") for name in (*SCRIPTS, STYLE)} | {
    "live.js": resources.files("ztpm.status")
}
"""Files that the page fetches, by name, and their folders."""
KINDS: Final = {"js": "text/javascript; charset=utf-8", "css": "text/css; charset=utf-8"}
STOP_BYTES: Final = 256
"""Longest body of a stop."""
START_S: Final = 10.0
STOP_S: Final = 3.0
BOUNDS: Final = Bounds(strangers=64, by_address=64, stops=8, stops_by_address=8, parties=1, by_party=1)
"""Nobody proves anything here: a browser of the owner has a few connections, and other users on this machine theirs."""
ROOT: Final = 0


class StatusError(RuntimeError):
    """Failure to serve the page."""


def status_app(
    picture: Callable[[], Snapshot],
    *,
    feed: LiveFeed,
    stop: Callable[[], StopAnswer],
    host: str,
    port: int,
    owners: frozenset[int],
) -> ASGIApp:
    """App of the page.

    Args:
        picture: takes one.
        feed: of the cell as it is now.
        stop: stops the arm.
        host: the address where it listens; a request that names another host is refused, even one for this machine.
        port: TCP port of the page.
        owners: user ids that may look.
    """

    async def page(_: Request) -> Response:
        taken = await run_in_threadpool(picture)
        return Response(render(taken), media_type="text/html; charset=utf-8", headers=HEADERS)

    async def as_json(_: Request) -> Response:
        return JSONResponse((await run_in_threadpool(picture)).as_json(), headers=HEADERS)

    async def asset(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in ASSETS:
            return _refused("NOT_FOUND", 404)
        content = await run_in_threadpool((ASSETS[name] / name).read_bytes)
        return Response(content, media_type=KINDS[name.rpartition(".")[2]], headers=HEADERS)

    async def events(_: Request) -> Response:
        return StreamingResponse(feed.events(), media_type="text/event-stream", headers=HEADERS)

    async def stopped(request: Request) -> Response:
        stopping(request.scope)
        # [LIV-2] a page of another origin stops nothing: it cannot send this kind of body unasked, and names itself
        if request.headers.getlist("origin") != [f"http://{host}:{port}"]:
            return JSONResponse({"code": "WRONG_ORIGIN", "told": TEXTS["stop"]["wrong_origin"]}, 403, HEADERS)
        if not await _asks_to_stop(request):
            return JSONResponse({"code": "BODY_MALFORMED", "told": TEXTS["stop"]["malformed"]}, 400, HEADERS)
        answer = await run_in_threadpool(stop)
        return JSONResponse(answer.as_json(), 200 if answer.stopped else 503, HEADERS)

    routes = [
        Route("/", page),
        Route("/status.json", as_json),
        Route("/events", events),
        Route("/stop", stopped, methods=["POST"]),
        Route("/{name}", asset),
    ]
    return _OwnersOnly(Starlette(routes=routes), netloc=f"{host}:{port}", owners=owners)


def _refused(code: str, status: int) -> Response:
    """Refusal of a request, with its code as a line of text."""
    return PlainTextResponse(f"{code}\n", status, headers=HEADERS)


async def _asks_to_stop(request: Request) -> bool:
    """True for a JSON body that asks for a stop, and says nothing else."""
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        return False
    body = b""
    async for chunk in request.stream():
        body += chunk
        if len(body) > STOP_BYTES:
            return False
    try:
        said = strict_json.read(body, limit_bytes=STOP_BYTES, limit_depth=1)
    except strict_json.JsonError:
        return False
    return isinstance(said, dict) and list(said) == ["stop"] and said["stop"] is True


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
            return _refused("WRONG_HOST", 421)
        near, far = scope.get("server"), scope.get("client")
        owner = owner_of(tuple(near), tuple(far)) if near and far else None
        if owner not in self._owners:
            return _refused("NOT_YOURS", 403)
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
        feed: of the cell as it is now.
        stop: stops the arm.
        host: a loopback address.
        port: to listen on.

    Raises:
        StatusError: when the port cannot be had.
    """

    def __init__(
        self, picture: Callable[[], Snapshot], *, feed: LiveFeed, stop: Callable[[], StopAnswer], host: str, port: int
    ) -> None:
        self.url = f"http://{host}:{port}/"
        try:
            self._socket = socket.create_server((host, port))
        except OSError as error:
            raise StatusError(f"{host}:{port}: {error.strerror}") from error
        self._feed = feed
        owners = frozenset({os.getuid(), ROOT})
        self._server = _Server(
            status_app(picture, feed=feed, stop=stop, host=host, port=port, owners=owners),
            bounds=BOUNDS,
            log_level="error",
            lifespan="off",
            timeout_graceful_shutdown=1,
        )
        self._thread = threading.Thread(target=self._server.run, args=([self._socket],), name="status", daemon=True)

    @classmethod
    def of(cls, cell: Cell, camera: SnapshotCollector, *, note: Callable[[str, str], object]) -> StatusServer:
        """The page of that cell, at its own address.

        Args:
            cell: running, or about to.
            camera: takes its pictures.
            note: puts on record what a stop's gateway does not: event and sentence.

        Raises:
            StatusError: when the port cannot be had.
        """
        feed = LiveFeed(
            lambda: cell.children.get("gateway"),
            lambda: parts_of(camera.picture()),
            clock=time.monotonic,
            wall_ms=lambda: int(time.time() * 1000),
        )
        addresses = cell.addresses
        stop = CellStop(cell, note=note)
        return cls(camera.picture, feed=feed, stop=stop, host=addresses.status_host, port=addresses.status_port)

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
        self._feed.close()
        if self._thread.ident is not None:
            self._thread.join(STOP_S)
        self._socket.close()
