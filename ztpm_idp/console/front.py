"""Door of the console: its first page, and the files that its pages load."""

from __future__ import annotations

from typing import Final

from fastapi import APIRouter, Request
from fastapi.responses import Response

from ztpm_idp.console.pages import ASSETS, page
from ztpm_idp.console.viewing import Viewer, viewer_of
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.provider.problems import Problem

router = APIRouter()
_TYPES: Final = {
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
FILES: Final = {path.name: path for path in sorted(ASSETS.iterdir()) if path.suffix in _TYPES}
"""Files that pages load, by name: none but those that are in the folder at the start."""
_KEPT_S: Final = 3_600
"""Seconds for which a browser keeps a file without asking; its name has no digest."""


@router.get("/console", include_in_schema=False)
async def show_front(request: Request) -> Response:
    """The first page: the ways into the console for the roles of this session."""
    viewer = await viewer_of(request)
    return page(request, "front.html", viewer, active="") if isinstance(viewer, Viewer) else viewer


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
