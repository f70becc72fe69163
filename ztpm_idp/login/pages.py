"""Pages of logging in: plain HTML with one style, no script, nothing from elsewhere, and no frame around them."""

from __future__ import annotations

import hashlib
from base64 import b64encode
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import jinja2
from fastapi.responses import HTMLResponse

from capabilities.values.characters import shown
from ztpm_idp.provider.problems import STATUS, Problem

if TYPE_CHECKING:
    from ztpm_idp.domain.codes import Code

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
    """A refusal on its way to a person in a browser, as a page.

    Attributes:
        log_in: address of the login page that leads on to what was asked; "" where no login helps.
    """

    def __init__(self, code: Code, detail: str = "", *, again_s: int | None = None, log_in: str = "") -> None:
        super().__init__(code, detail, again_s=again_s)
        self.log_in = log_in


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


def problem_page(problem: PageProblem) -> HTMLResponse:
    """The page of a refusal: its code, what is wrong, what to do."""
    status, title = STATUS[problem.code]
    told = {"code": problem.code.value, "title": title, "detail": problem.detail, "log_in": problem.log_in}
    shown = page("problem.html", status=status, **told)
    if problem.again_s is not None:
        shown.headers["Retry-After"] = str(problem.again_s)
    return shown
