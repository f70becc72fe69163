"""Requests that are counted: of strangers by address at the door, of callers by id once they are proven.

What takes authority back, stops, or tells enforcement points what is revoked is never counted. Any other request of a
registered caller is. The endpoints that ask for no registered key are named here, one row for each.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Final, assert_never

from starlette.routing import compile_path

from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.login.pages import PageProblem, problem_page
from ztpm_idp.oauth import metadata
from ztpm_idp.oauth.problem import answer as oauth_answer
from ztpm_idp.oauth.problem import of_refusal
from ztpm_idp.provider.problems import Problem, answer
from ztpm_idp.provider.rates import Rates, site

if TYPE_CHECKING:
    import re

    from fastapi import Request
    from starlette.responses import Response
    from starlette.types import ASGIApp, Receive, Scope, Send

    from ztpm_idp.provider.rates import Rate


class Form(Enum):
    """Form of a refusal."""

    PROBLEM = "RFC 9457"
    OAUTH = "RFC 6749"
    PAGE = "HTML"


@dataclass(frozen=True, slots=True)
class Row:
    """Endpoint that strangers may use.

    Attributes:
        logins: counted among logins; else among all that strangers may use.
        form: of its refusal.
    """

    logins: bool
    form: Form


_TOLD: Final = Row(logins=False, form=Form.PROBLEM)
_SHOWN: Final = Row(logins=False, form=Form.PAGE)
_BEGUN: Final = Row(logins=True, form=Form.PROBLEM)
_LOGIN: Final = Row(logins=True, form=Form.PAGE)
_CLIENT: Final = Row(logins=False, form=Form.OAUTH)
OPEN: Final[dict[tuple[str, str], Row]] = {
    ("GET", "/openapi.json"): _TOLD,
    ("GET", metadata.AT_SERVER): _TOLD,
    ("GET", metadata.AT_SERVER + "{path:path}"): _TOLD,
    ("GET", metadata.AT_OPENID): _TOLD,
    ("GET", metadata.AT_OPENID + "{path:path}"): _TOLD,
    ("GET", metadata.AT_RESOURCE): _TOLD,
    ("GET", metadata.AT_RESOURCE + "{path:path}"): _TOLD,
    ("GET", metadata.JWKS): _TOLD,
    ("OPTIONS", metadata.TOKEN): _TOLD,
    ("OPTIONS", metadata.REVOKE): _TOLD,
    ("POST", metadata.TOKEN): _CLIENT,
    ("GET", metadata.AUTHORIZE): _LOGIN,
    ("POST", metadata.AUTHORIZE): _LOGIN,
    ("POST", "/login/devices"): _BEGUN,
    ("POST", "/login/devices/poll"): _TOLD,
    ("GET", "/login/device"): _LOGIN,
    ("POST", "/login/device"): _LOGIN,
    ("POST", "/login/device/answer"): _LOGIN,
    ("GET", "/login"): _SHOWN,
    ("GET", "/login/account"): _SHOWN,
    ("GET", "/login/links/{secret}"): _LOGIN,
    ("POST", "/login/links/{secret}"): _LOGIN,
    ("POST", "/login/passkey"): _LOGIN,
    ("POST", "/login/providers/{name}"): _LOGIN,
    ("GET", "/login/providers/{name}/callback"): _LOGIN,
    ("GET", "/passkeys/passkey.js"): _TOLD,
    ("GET", "/passkeys/enrolments/{enrolment_id}/page"): _TOLD,
    ("POST", "/passkeys/enrolments/{enrolment_id}/credential"): _BEGUN,
    ("GET", "/approvals/page"): _SHOWN,
    ("GET", "/approvals/page/open"): _TOLD,
    ("POST", "/approvals/page/devices"): _TOLD,
    ("POST", "/approvals/page/devices/end"): _SHOWN,
    ("GET", "/approvals/{ask_id}/page"): _TOLD,
    ("GET", "/approvals/{ask_id}/picture"): _TOLD,
    ("GET", "/approvals/{ask_id}/state"): _TOLD,
    ("GET", "/approvals/assets/{name}"): _TOLD,
    ("GET", "/latches/{latch_id}/page"): _TOLD,
    ("GET", "/console"): _SHOWN,
    ("GET", "/console/assets/{name}"): _TOLD,
    ("GET", "/console/tree"): _SHOWN,
    ("GET", "/console/tree/sponsors/{id_}"): _SHOWN,
    ("GET", "/console/tree/hops/{hop_id}"): _SHOWN,
    ("GET", "/console/trail"): _SHOWN,
    ("GET", "/console/trail/export"): _SHOWN,
    ("GET", "/console/trail/entries/{number}"): _SHOWN,
    ("GET", "/console/trail/entries/{number}/line"): _SHOWN,
    ("GET", "/console/trail/entries/{number}/proof"): _SHOWN,
    ("GET", "/console/trail/pictures/{digest}"): _SHOWN,
    ("GET", "/console/trail/requests/{request_id}"): _SHOWN,
    ("GET", "/console/people"): _SHOWN,
    ("GET", "/console/agents"): _SHOWN,
    ("GET", "/console/agents/{id_}"): _SHOWN,
}
"""Endpoints that strangers may use, by method and path below the issuer's, or below the origin."""
FREE: Final = frozenset(
    {
        # Authority is taken back, or refused.
        ("POST", "/revocations"),
        ("GET", "/console/revoke"),
        ("POST", "/console/revocations"),
        ("GET", "/console/acts/{name}"),
        ("POST", "/console/acts"),
        ("GET", "/console/revocations/{epoch}"),
        ("POST", "/agents/{id_}/suspend"),
        ("POST", "/agents/{id_}/retire"),
        ("POST", "/peps/{id_}/suspend"),
        ("POST", "/peps/{id_}/retire"),
        ("POST", "/sensors/{id_}/suspend"),
        ("POST", "/sensors/{id_}/retire"),
        ("POST", "/tools/suspend"),
        ("POST", "/tools/retire"),
        ("POST", "/people/{id_}/disable"),
        ("POST", "/changes/end"),
        ("POST", "/changes/{change_id}/decline"),
        ("POST", "/recoveries"),
        ("POST", "/approvals/{ask_id}/votes"),
        ("POST", "/approvals/{ask_id}/passkey-votes"),
        ("POST", "/latches/{latch_id}/clearings"),
        ("POST", "/latches/{latch_id}/passkey-clearings"),
        ("POST", "/openings/{opening_id}/withdraw"),
        ("POST", "/envelopes/{envelope_id}/revoke"),
        ("POST", "/oauth/scopes/{name}/end"),
        ("POST", "/oauth/lent/{family}/end"),
        ("POST", metadata.REVOKE),
        ("POST", "/logins/end"),
        ("POST", "/login/end"),
        ("POST", "/login/keys/end"),
        # Enforcement points are told of it: a view that grows old stops what moves.
        ("GET", "/revocations"),
        ("GET", "/revocations/wait"),
        ("GET", "/revocations/events"),
        ("GET", "/revocations/points"),
        ("POST", "/revocations/marks"),
        ("POST", "/restoring/marks"),
        ("GET", "/trust"),
        ("GET", "/trust/signed"),
        # The service is looked after.
        ("GET", "/livez"),
        ("GET", "/healthz"),
        ("GET", "/metrics"),
        ("GET", "/readyz"),
    }
)
"""Requests that no rate counts, by method and path below the issuer's; what they cost is bounded by places."""
_EXACT: Final = {key: row for key, row in OPEN.items() if "{" not in key[1]}
_PATTERNS: Final[tuple[tuple[str, str, re.Pattern[str], Row], ...]] = tuple(
    (method, path.partition("{")[0], compile_path(path)[0], row) for (method, path), row in OPEN.items() if "{" in path
)


def rates_of(request: Request) -> Rates:
    """The rates of this application."""
    rates: Rates = request.app.state.rates
    return rates


def address_of(request: Request) -> str:
    """The address that a request came from, behind the proxies that are trusted; empty where nothing says it."""
    return _address(rates_of(request), request.scope)


def count_caller(request: Request, caller: str) -> None:
    """Counts a request of a registered party, whose proof is verified and not used up yet.

    Raises:
        Problem: `RATE_EXCEEDED`.
    """
    if (request.method, request.scope["route"].path) in FREE:
        return
    rate = rates_of(request).callers
    if wait_s := rate.wait_s(caller):
        raise Problem(IdpCode.RATE_EXCEEDED, _told(rate, wait_s, "of one caller"), again_s=wait_s)


class Door:
    """Counts the requests of strangers by their address, before anything of them is read.

    Args:
        app: behind it.
        prefix: path of the issuer.
        rates: of this application.
    """

    def __init__(self, app: ASGIApp, *, prefix: str, rates: Rates) -> None:
        self._app = app
        self._prefix = prefix
        self._rates = rates

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuses a request too many."""
        if scope["type"] == "http" and (row := self._row(scope["method"], scope["path"])) is not None:
            rate = self._rates.logins if row.logins else self._rates.open
            if wait_s := rate.wait_s(site(_address(self._rates, scope))):
                await _refusal(row.form, _told(rate, wait_s, "from one address"), wait_s)(scope, receive, send)
                return
        await self._app(scope, receive, send)

    def _row(self, method: str, path: str) -> Row | None:
        below = path.removeprefix(self._prefix)
        if (row := _EXACT.get((method, below))) is not None:
            return row
        for each, stem, pattern, row in _PATTERNS:
            if method == each and below.startswith(stem) and pattern.fullmatch(below):
                return row
        return None


def _address(rates: Rates, scope: Scope) -> str:
    forwarded = [value.decode("latin-1") for name, value in scope["headers"] if name == b"x-forwarded-for"]
    client = scope.get("client")
    return rates.address(client[0] if client else "", forwarded)


def _told(rate: Rate, wait_s: int, whose: str) -> str:
    return f"at most {rate.a_minute} requests a minute {whose}; again in {wait_s} s"


def _refusal(form: Form, detail: str, again_s: int) -> Response:
    match form:
        case Form.PROBLEM:
            return answer(IdpCode.RATE_EXCEEDED, detail, again_s=again_s)
        case Form.OAUTH:
            refused = oauth_answer(of_refusal(IdpCode.RATE_EXCEEDED, detail, again_s=again_s))
            refused.headers["Access-Control-Allow-Origin"] = "*"  # as every answer there has
            return refused
        case Form.PAGE:
            return problem_page(PageProblem(IdpCode.RATE_EXCEEDED, detail, again_s=again_s))
        case _:
            assert_never(form)
