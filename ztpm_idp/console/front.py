"""Door of the console: its first page, and the files that its pages load."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from fastapi import APIRouter, Request
from fastapi.responses import Response

from capabilities.statements.people import ask
from ztpm_idp.console.pages import ASSETS, page
from ztpm_idp.console.viewing import Viewer, viewer_of
from ztpm_idp.domain.asking.asks import AskState
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import provider_of

if TYPE_CHECKING:
    from capabilities.statements.people.ask import Ask

router = APIRouter()
_TYPES: Final = {
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
FILES: Final = {path.name: path for path in sorted(ASSETS.iterdir()) if path.suffix in _TYPES}
"""Files that pages load, by name: none but those that are in the folder at the start."""
ASKS: Final = 64
"""Most open asks that the first page lists."""
_KEPT_S: Final = 3_600
"""Seconds for which a browser keeps a file without asking; its name has no digest."""


@router.get("/console", include_in_schema=False)
async def show_front(request: Request) -> Response:
    """The first page: the ways into the console for the roles of this session."""
    viewer = await viewer_of(request)
    if not isinstance(viewer, Viewer):
        return viewer
    return page(request, "front.html", viewer, active="", asks=await _open_asks(request))


async def _open_asks(request: Request) -> list[Ask]:
    """Asks that wait for people, the oldest first: every person may read them."""
    provider = provider_of(request)
    at_ms = provider.now_ms()
    async with provider.store.read() as view:
        found = await view.approvals.not_long_over(since_s=at_ms // 1_000)
        waiting = [asked.ask.ask_id for asked in found if asked.state(at_ms) is AskState.OPEN][:ASKS]
        signed = await view.approvals.signed(frozenset(waiting))
    return [ask.open(text, {key}, provider.rules.caps) for text, key in map(signed.__getitem__, waiting)]


@router.get("/console/assets/{name}", include_in_schema=False)
async def show_asset(name: str) -> Response:
    """A style sheet or script of the pages, for everybody: it is the same for all."""
    path = FILES.get(name)
    if path is None:
        raise Problem(IdpCode.PATH_UNKNOWN)
    headers = {
        "Cache-Control": f"max-age={_KEPT_S}",
        "Cross-Origin-Resource-Policy": "same-origin",
        "X-Content-Type-Options": "nosniff",
    }
    return Response(path.read_bytes(), media_type=_TYPES[path.suffix], headers=headers)
