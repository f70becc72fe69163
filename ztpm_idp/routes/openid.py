"""Logging in at an OpenID provider: the way there, and the answer that comes back."""

from __future__ import annotations

from typing import Final
from urllib.parse import urlsplit

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, RedirectResponse, Response

from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.login import session
from ztpm_idp.login.forms import form_of
from ztpm_idp.login.oidc import ATTEMPT_S, MAX_AGE_S, Attempt, LoginFailedError, OpenIdProvider
from ztpm_idp.login.pages import PageProblem, page, problem_page
from ztpm_idp.login.session import NO_STORE
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import provider_of, since_of

router = APIRouter(include_in_schema=False)
ATTEMPT: Final = "__Host-ztpm-attempt"
"""Name of the cookie with the login that is on its way."""
_ANSWER_BYTES: Final = 8_192
"""Longest answer of a provider, as it stands in an address."""


@router.post("/login/providers/{name}", response_class=HTMLResponse)
async def leave(request: Request, name: str) -> Response:
    """Sends the browser to the provider, by a page of ours: a form may lead to no other host."""
    form, chosen = await form_of(request, "fresh_s"), _chosen(request, name)
    try:
        asked = since_of(form["fresh_s"]) if form["fresh_s"] else MAX_AGE_S
        url, attempt = await chosen.begin(max_age_s=min(asked, MAX_AGE_S))
    except LoginFailedError as error:
        raise _failed(error) from None
    except Problem as problem:
        raise PageProblem(problem.code, "fresh_s") from None
    shown = page("leave.html", name=chosen.configured.stated.title, url=url, host=urlsplit(url).netloc)
    sealed = session.seal(await _secret(request), ATTEMPT, attempt.to_text())
    session.set_cookie(shown, ATTEMPT, sealed, last_s=ATTEMPT_S)
    return shown


@router.get("/login/providers/{name}/callback", response_class=RedirectResponse)
async def come_back(request: Request, name: str) -> Response:
    """A session begins for the person who has the login that the provider answers with; the attempt is over."""
    try:
        response: Response = await _logged_in(request, name)
    except PageProblem as problem:
        response = problem_page(problem)
    session.set_cookie(response, ATTEMPT, "", last_s=0)
    return response


async def _logged_in(request: Request, name: str) -> RedirectResponse:
    chosen, answer = _chosen(request, name), request.query_params
    if len(str(answer)) > _ANSWER_BYTES or len(answer.multi_items()) != len(answer):
        raise PageProblem(IdpCode.QUERY_MALFORMED, "an answer has each parameter once")
    held = session.cookie(request, ATTEMPT)
    kept = None if held is None else session.unseal(await _secret(request), ATTEMPT, held)
    if kept is None:
        raise PageProblem(IdpCode.LOGIN_OVER, "no login was begun in this browser, or it was ended already")
    try:
        found = await chosen.finish(Attempt.from_text(kept), dict(answer))
    except LoginFailedError as error:
        raise _failed(error) from None
    async with provider_of(request).store.read() as view:
        person = await view.sessions.login_owner(found.login)
    if person is None:
        raise PageProblem(IdpCode.LOGIN_UNKNOWN, f"An administrator can give it to a person. It is: {found.login}")
    response = RedirectResponse(session.back_of(request), status_code=303, headers=NO_STORE)
    try:
        await session.begin(request, response, person=person, how=found.how, roles=found.roles)
    except Problem as problem:
        raise PageProblem(problem.code, problem.detail) from None
    session.set_cookie(response, session.BACK, "", last_s=0)
    return response


def _chosen(request: Request, name: str) -> OpenIdProvider:
    found: OpenIdProvider | None = request.app.state.login_providers.get(name)
    if found is None:
        raise PageProblem(IdpCode.PATH_UNKNOWN, "no such login provider")
    return found


def _failed(error: LoginFailedError) -> PageProblem:
    return PageProblem(IdpCode.LOGIN_FAILED if error.reachable else IdpCode.LOGIN_PROVIDER_SILENT, error.why)


async def _secret(request: Request) -> bytes:
    async with provider_of(request).store.read() as view:
        return await view.sessions.secret()
