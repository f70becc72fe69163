"""Pages of the console: one frame, and parts that replace a piece of a page.

They load files of their own host alone. Everything is escaped, and every text of a caller is spelled by `shown`, so
that no name looks like another or turns the line ([CON-4] in docs/spec.md).
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import jinja2
from fastapi.responses import HTMLResponse
from markupsafe import Markup

from capabilities.values.characters import shown
from ztpm_idp.console.texts import TEXTS
from ztpm_idp.console.viewing import is_part
from ztpm_idp.login.forms import browser_of
from ztpm_idp.login.session import prefix_of
from ztpm_idp.provider.problems import STATUS
from ztpm_idp.routes.caller import provider_of

if TYPE_CHECKING:
    from fastapi import Request

    from ztpm_idp.console.viewing import Viewer
    from ztpm_idp.provider.problems import Problem

ASSETS: Final = Path(__file__).parent / "assets"
HTMX: Final = "htmx-4.0.1.js"
HEADERS: Final = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'; "
    "connect-src 'self'; img-src 'self'; script-src 'self'; style-src 'self'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    # With "no-referrer" a form would name its origin as `null`.
    "Referrer-Policy": "same-origin",
    "Vary": "HX-Request",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
"""Headers of every page and part: nothing inline, nothing of another host, no frame around it."""
_ID_CHARACTERS: Final = 12
"""Characters of an id that a narrow column shows."""


def time_of(at_ms: int) -> str:
    """UTC, to the second; the bare number for a time that no calendar holds."""
    try:
        return datetime.fromtimestamp(at_ms // 1_000, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    except (ValueError, OverflowError, OSError):
        return f"{at_ms} ms"


def _short(text: str) -> str:
    return text if len(text) <= _ID_CHARACTERS else text[: _ID_CHARACTERS - 1] + "…"


def _lines(text: str) -> Markup:
    """The text with its lines as lines; every other character that is not seen is spelled."""
    return Markup("\n").join(shown(line) for line in text.split("\n"))


_PAGES: Final = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
    autoescape=True,
    finalize=lambda value: shown(value) if type(value) is str else value,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_PAGES.globals["t"] = TEXTS
_PAGES.filters |= {"time": time_of, "short": _short, "lines": _lines, "under": lambda name: name.replace("-", "_")}


def problem_part(request: Request, problem: Problem) -> HTMLResponse:
    """A refusal in place of the piece that a script of a page asked for."""
    status, title = STATUS[problem.code]
    text = _PAGES.get_template("problem.html").render(
        code=problem.code.value, title=title, detail=problem.detail, at=f"{prefix_of(provider_of(request))}/console"
    )
    return HTMLResponse(text, status_code=status, headers=HEADERS)


def page(request: Request, template: str, viewer: Viewer, **values: Any) -> HTMLResponse:
    """A page for this person, or the piece of it that a script asks for.

    Args:
        request: answered by it.
        template: its file.
        viewer: who looks.
        values: of the template; escaped.
    """
    provider = provider_of(request)
    text = _PAGES.get_template(template).render(
        part=is_part(request),
        at=f"{prefix_of(provider)}/console",
        prefix=prefix_of(provider),
        issuer=provider.settings.issuer,
        htmx=HTMX,
        viewer=viewer,
        token=browser_of(request).form_token,
        **values,
    )
    return HTMLResponse(text, headers=HEADERS)
