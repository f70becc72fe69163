"""Pages of logging in: plain HTML with one style, no script, nothing from elsewhere, and no frame around them."""

from __future__ import annotations

import hashlib
from base64 import b64encode
from pathlib import Path
from typing import Any, Final

import jinja2
from fastapi.responses import HTMLResponse

from capabilities.values.characters import shown
from ztpm_idp.provider.problems import STATUS, Problem

_FOLDER: Final = Path(__file__).parent / "templates"
_STYLE: Final = (_FOLDER / "login.css").read_text("utf-8")
_PAGES: Final = jinja2.Environment(
    loader=jinja2.FileSystemLoader(_FOLDER),
    autoescape=True,
    finalize=lambda value: shown(value) if type(value) is str else value,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_STYLE_HASH: Final = b64encode(hashlib.sha256(_STYLE.encode()).digest()).decode()


class PageProblem(Problem):
    """A refusal on its way to a person in a browser, as a page."""


def page(template: str, *, status: int = 200, script: str | None = None, **values: Any) -> HTMLResponse:
    """A page that a browser keeps nowhere and shows in no frame.

    Args:
        template: its file.
        status: of the answer.
        script: text of its one script, which its policy names by its hash; None: it has none.
        values: of the template; escaped.
    """
    scripts = ""
    if script is not None:
        scripts = (
            f"script-src 'sha256-{b64encode(hashlib.sha256(script.encode()).digest()).decode()}'; connect-src 'self'; "
        )
    headers = {
        "Cache-Control": "no-store",
        "Content-Security-Policy": f"default-src 'none'; base-uri 'none'; form-action 'self'; "
        f"frame-ancestors 'none'; {scripts}style-src 'sha256-{_STYLE_HASH}'",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cross-Origin-Resource-Policy": "same-origin",
        # With "no-referrer" a form would name its origin as `null`.
        "Referrer-Policy": "same-origin",
        "X-Content-Type-Options": "nosniff",
        "X-Frame-Options": "DENY",
    }
    text = _PAGES.get_template(template).render(style=_STYLE, script=script, **values)
    return HTMLResponse(text, status_code=status, headers=headers)


def problem_page(problem: Problem) -> HTMLResponse:
    """The page of a refusal: its code, what is wrong, what to do."""
    status, title = STATUS[problem.code]
    shown = page("problem.html", status=status, code=problem.code.value, title=title, detail=problem.detail)
    if problem.again_s is not None:
        shown.headers["Retry-After"] = str(problem.again_s)
    return shown
