"""Viewer of a page: a person who is logged in, with the roles of the session ([CON-1])."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from fastapi.responses import RedirectResponse, Response

from ztpm_idp.domain.audit import may_audit
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.login.records import ABSOLUTE_MS
from ztpm_idp.domain.parties import PersonRole
from ztpm_idp.login import session
from ztpm_idp.login.pages import PageProblem
from ztpm_idp.routes.caller import provider_of

if TYPE_CHECKING:
    from fastapi import Request

    from ztpm_idp.domain.parties import RegisteredPerson

_EVERYTHING: Final = frozenset({PersonRole.ADMIN, PersonRole.AUDITOR})


@dataclass(frozen=True, slots=True)
class Viewer:
    """A person who looks at the console.

    Attributes:
        person: with the roles of the session.
        session_id: of the session.
    """

    person: RegisteredPerson
    session_id: str

    @property
    def sees_all(self) -> bool:
        """True for who sees the trees, people and agents of everybody."""
        return not self.person.roles.isdisjoint(_EVERYTHING)

    @property
    def audits(self) -> bool:
        """True for who reads the ledger."""
        return may_audit(self.person)

    def sees(self, sponsor: str) -> bool:
        """True where what this sponsor lent may be shown."""
        return self.sees_all or self.person.id == sponsor


def is_part(request: Request) -> bool:
    """True where a script of the page asks for a piece of it, which has no frame."""
    return request.headers.get("hx-request") == "true"


async def viewer_of(request: Request) -> Viewer | Response:
    """The person who is logged in in this browser, or the way to the login page and back.

    Raises:
        StoreUnavailableError: it cannot be said.
    """
    found = await session.signed_in(request)
    if found is not None:
        return Viewer(found.person, found.session_id)
    query = f"?{request.url.query}" if request.url.query and request.method == "GET" else ""
    back_to = f"{request.scope['path']}{query}"
    there = _to_login(request, "" if request.method != "GET" or is_part(request) else back_to)
    if is_part(request):
        # The whole page goes there, not the piece.
        return Response(headers=session.NO_STORE | {"HX-Redirect": there.headers["location"]})
    return there


def _to_login(request: Request, back_to: str) -> RedirectResponse:
    prefix = session.prefix_of(provider_of(request))
    if not session.is_own_page(back_to, prefix):
        back_to = f"{prefix}/console"
    return session.to_login(request, back_to=back_to, fresh_s=ABSOLUTE_MS // 1_000)


def session_over(request: Request, path: str) -> PageProblem:
    """Refusal of an answer without a session; it leads over the login to the question, asked anew.

    Args:
        request: with the answer.
        path: and query of the question, below the console's.
    """
    back_to = f"{session.prefix_of(provider_of(request))}/console{path}"
    log_in = _to_login(request, back_to).headers["location"]
    return PageProblem(IdpCode.NOT_LOGGED_IN, "your session was over, and nothing was done", log_in=log_in)


async def auditor_of(request: Request) -> Viewer | Response:
    """The person, who reads the ledger; or the way to the login page.

    Raises:
        PageProblem: `NOT_PERMITTED`.
    """
    found = await viewer_of(request)
    if isinstance(found, Viewer) and not found.audits:
        raise PageProblem(IdpCode.NOT_PERMITTED, "administrators, approvers and auditors read the ledger")
    return found


def to(request: Request, path: str) -> RedirectResponse:
    """Sends the browser to a page of the console."""
    at = f"{session.prefix_of(provider_of(request))}/console{path}"
    return RedirectResponse(at, status_code=303, headers=session.NO_STORE)
