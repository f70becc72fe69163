"""Forms that a page of ours sent from this browser, and no others.

Three things hold for each form that changes anything: the browser says that the page is ours (`Sec-Fetch-Site`,
`Origin`), the form holds a token which only a page that we made for this browser can hold, and the cookie behind the
token is sent to this host alone (`__Host-`, `SameSite=Lax`).
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final
from urllib.parse import parse_qsl, urlsplit

from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.login.pages import PageProblem
from ztpm_idp.login.session import BACK_BYTES, COOKIE, cookie, set_cookie

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fastapi import Request
    from fastapi.responses import Response

FIELD: Final = "form_token"
"""Name of the hidden field with the token."""
FORM_BYTES: Final = 8_192
"""Longest form: two addresses to go back to, and a little more."""
BROWSER: Final = "__Host-ztpm-browser"
"""Name of the cookie by which the forms of a browser without a session are told apart."""
_FIELDS: Final = 16
"""Most fields of a form."""
_PURPOSE: Final = b"ztpm form token 1"


@dataclass(frozen=True, slots=True)
class Browser:
    """Browser that a page is made for.

    Attributes:
        secret: its session's cookie, else the one that its first page gives it.
        new: it does not have the cookie yet.
    """

    secret: str
    new: bool

    @property
    def form_token(self) -> str:
        """Token that the forms of a page for this browser hold."""
        return hmac.new(self.secret.encode(), _PURPOSE, hashlib.sha256).hexdigest()

    def keep(self, response: Response) -> None:
        """Gives the browser its cookie with the page, where it has none yet."""
        if self.new:
            set_cookie(response, BROWSER, self.secret, last_s=None)


def browser_of(request: Request) -> Browser:
    """The browser that sent a request."""
    held = _secret(request)
    return Browser(secrets.token_urlsafe(32), new=True) if held is None else Browser(held, new=False)


async def form_of(request: Request, *names: str) -> dict[str, str]:
    """The fields of a form that a page of ours sent from this browser: exactly these, once each.

    Raises:
        PageProblem: `FORM_FORGED`, `FORM_MALFORMED`, `BODY_TOO_LARGE`.
    """
    return own_form(request, await fields_of(request), *names)


async def fields_of(request: Request) -> dict[str, str]:
    """Fields of a form that a page of ours sent, maybe one of another browser: nothing is done on them.

    Raises:
        PageProblem: as `form_of`.
    """
    _from_our_page(request)
    raw = bytearray()
    async for part in request.stream():
        raw += part
        if len(raw) > FORM_BYTES:
            raise PageProblem(IdpCode.BODY_TOO_LARGE, f"at most {FORM_BYTES} bytes")
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/x-www-form-urlencoded":
        raise PageProblem(IdpCode.FORM_MALFORMED, "a form is application/x-www-form-urlencoded")
    try:
        text = bytes(raw).decode("ascii")
        fields = parse_qsl(text, keep_blank_values=True, strict_parsing=True, errors="strict", max_num_fields=_FIELDS)
    except ValueError:
        raise PageProblem(IdpCode.FORM_MALFORMED, "not the fields of a form") from None
    found = dict(fields)
    if len(found) != len(fields):
        raise PageProblem(IdpCode.FORM_MALFORMED, "a field occurs twice")
    return found


def own_form(request: Request, fields: Mapping[str, str], *names: str) -> dict[str, str]:
    """These fields without the token, by which the page was made for this browser.

    Raises:
        PageProblem: `FORM_FORGED`, or `FORM_MALFORMED` for fields that are not exactly these.
    """
    found, held = dict(fields), _secret(request)
    known = Browser(held or "", new=False).form_token
    if held is None or not hmac.compare_digest(found.pop(FIELD, "").encode(), known.encode()):
        raise PageProblem(IdpCode.FORM_FORGED, "open the page again, and send its form from there")
    if found.keys() != set(names):
        raise PageProblem(IdpCode.FORM_MALFORMED, "not the fields of this form")
    return found


def _from_our_page(request: Request) -> None:
    """Refuses a form that another site's page sent, or one whose page is not known."""
    site, origins = request.headers.get("sec-fetch-site"), request.headers.getlist("origin")
    parts = urlsplit(request.app.state.provider.settings.issuer)
    # A browser says at least one of the two with every form; it says `null` where a page hides its origin.
    if site not in {None, "same-origin"} or origins not in ([], [f"{parts.scheme}://{parts.netloc}"]):
        raise PageProblem(IdpCode.FORM_FORGED, "another site's page sent it")
    if site is None and not origins:
        raise PageProblem(IdpCode.FORM_FORGED, "nothing says which page sent it")


def _secret(request: Request) -> str | None:
    """The secret of this browser: its session's, else the one that its first page gave it."""
    held = cookie(request, COOKIE) or cookie(request, BROWSER)
    return None if held is None or len(held) > BACK_BYTES else held
