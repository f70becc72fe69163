"""The authorization endpoint: a person, freshly logged in, lets a client act or does not.

Nothing is fetched for a stranger, and nothing is sent to a redirect URI that is not the client's. The page is made anew
from the request when its form comes back, and the form holds a code over all that the person was shown.
"""

from __future__ import annotations

import hashlib
import secrets
from typing import TYPE_CHECKING, Final

from fastapi import APIRouter, Request
from fastapi.responses import RedirectResponse, Response

from capabilities.keys.keys import b64u, generate, public_raw, unb64u
from capabilities.values.errors import BadKeyError
from capabilities.values.strict_json import canonical
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.oauth.commands import Assent
from ztpm_idp.domain.oauth.lending import FAMILY_S
from ztpm_idp.domain.parties import PersonRole
from ztpm_idp.login.forms import FIELD, browser_of, form_of
from ztpm_idp.login.pages import PageProblem
from ztpm_idp.login.session import signed_in, to_login
from ztpm_idp.oauth import metadata
from ztpm_idp.oauth.assent_page import page
from ztpm_idp.oauth.authorizing import (
    Asking,
    AuthorizationRequest,
    NoRedirectError,
    chosen_of,
    query_text,
    read_request,
    redirect_of,
    response_to,
)
from ztpm_idp.oauth.client_auth import registered
from ztpm_idp.oauth.client_documents import DocumentError, is_document_url
from ztpm_idp.oauth.form import parameters
from ztpm_idp.oauth.issuing import SECRET_BYTES, digest_of
from ztpm_idp.oauth.problem import OF_CODE, OAuthError, OAuthProblem
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import prefix_of, provider_of
from ztpm_idp.routes.oauth import keys_of

if TYPE_CHECKING:
    from ztpm_idp.domain.oauth.records import TemplateRecord
    from ztpm_idp.login.session import SignedIn
    from ztpm_idp.oauth.client_documents import Fetch
    from ztpm_idp.provider.provider import Provider

router = APIRouter()
FRESH_S: Final = 300
"""Greatest age of the login of a person who lets a client act."""
_SHOWN: Final = "assent page"
_NO_STORE: Final = {"Cache-Control": "no-store", "Referrer-Policy": "no-referrer"}
_DAY_S: Final = 86_400


@router.get(metadata.AUTHORIZE, include_in_schema=False)
async def ask(request: Request) -> Response:
    """Asks the person whether the client may act."""
    keys_of(request)
    stated = _read(request.scope["query_string"].decode("latin-1"))
    return await _asked(request, stated, answer=None, shown="")


@router.post(metadata.AUTHORIZE, include_in_schema=False)
async def take_answer(request: Request) -> Response:
    """Takes the person's answer, and sends the browser back to the client with a code or a refusal."""
    keys_of(request)
    fields = await form_of(request, "asked", "shown", "answer")
    if fields["answer"] not in {"allow", "deny"}:
        raise PageProblem(IdpCode.FORM_MALFORMED, "allow or deny")
    return await _asked(request, _read(fields["asked"]), answer=fields["answer"], shown=fields["shown"])


async def _asked(request: Request, stated: dict[str, str], *, answer: str | None, shown: str) -> Response:
    """The page, or the answer at the client's redirect URI."""
    provider, query = provider_of(request), query_text(stated)
    client_id = stated.get("client_id", "")
    record = await registered(provider, client_id)
    if record is None and not (provider.settings.client_documents and is_document_url(client_id)):
        raise PageProblem(IdpCode.CLIENT_UNKNOWN, "client_id is of no client that is known here")
    person = await signed_in(request)
    if record is None and not _fresh(provider, person):
        return _log_in(request, query)  # nothing is fetched for a stranger
    if record is not None:
        asking = Asking(record.client_id, record.client_id, record.name, "", record.redirects)
    else:
        asking = await _fetched(request, client_id, "" if person is None else person.person.id)
    try:
        redirect = redirect_of(stated, asking)
    except NoRedirectError as error:
        raise PageProblem(IdpCode.QUERY_MALFORMED, error.why) from None
    issuer, state = provider.settings.issuer, stated.get("state")
    try:
        asked = read_request(stated, redirect)
        async with provider.store.read() as view:
            chosen = chosen_of(asked, await view.oauth.templates())
        if person is None or not _fresh(provider, person):
            return _log_in(request, query)
        if PersonRole.SPONSOR not in person.person.roles:
            raise PageProblem(IdpCode.NOT_PERMITTED, "a sponsor lets clients act")
        said = _said(person, query, asking, chosen)
        if answer is None:
            return _page(request, asking, asked, chosen, person, query=query, said=said)
        if not _is_said(request, said, shown):
            raise PageProblem(IdpCode.FORM_FORGED, "the client or its scopes are others than the page showed")
        code = await _given(provider, asking, asked, chosen, person=person, allowed=answer == "allow")
    except OAuthProblem as problem:
        told = response_to(
            redirect, issuer=issuer, state=state, error=problem.error.value, error_description=problem.description
        )
        return RedirectResponse(told, status_code=303, headers=_NO_STORE)
    return RedirectResponse(
        response_to(redirect, issuer=issuer, state=state, code=code), status_code=303, headers=_NO_STORE
    )


def _page(
    request: Request,
    asking: Asking,
    asked: AuthorizationRequest,
    chosen: tuple[TemplateRecord, ...],
    person: SignedIn,
    *,
    query: str,
    said: bytes,
) -> Response:
    browser = browser_of(request)
    form = {"asked": query, "shown": b64u(keys_of(request).mac(_SHOWN, said)), FIELD: browser.form_token}
    response = page(asking, asked, chosen, person=person.person.id, form=form, days=FAMILY_S // _DAY_S)
    browser.keep(response)
    return response


async def _given(
    provider: Provider,
    asking: Asking,
    asked: AuthorizationRequest,
    chosen: tuple[TemplateRecord, ...],
    *,
    person: SignedIn,
    allowed: bool,
) -> str:
    """The code of the person's assent."""
    if not allowed:
        raise OAuthProblem(OAuthError.ACCESS_DENIED, "the person does not let the client act")
    code = secrets.token_urlsafe(SECRET_BYTES)
    command = Assent(
        by=person.person.id,
        client_id=asking.client_id,
        agent=asking.agent,
        agent_key=public_raw(generate()),
        client_name=asking.host or asking.name,
        document=asking.document,
        templates=frozenset(template.name for template in chosen),
        resource=chosen[0].audience,
        redirect=asked.redirect,
        challenge=asked.challenge,
        jkt=asked.jkt,
        method=person.how.method.value,
        authenticated_at=person.at_ms // 1_000,
        family=secrets.token_hex(16),
        code=digest_of(code),
    )
    try:
        await provider.run(command, actor=person.person.id)
    except Problem as problem:
        error = OF_CODE.get(problem.code, OAuthError.ACCESS_DENIED)
        raise OAuthProblem(error, f"{problem.code.value}: {problem.detail}") from None
    return code


async def _fetched(request: Request, client_id: str, person: str) -> Asking:
    fetch: Fetch = request.app.state.fetch_document
    try:
        document = await fetch(client_id)
    except DocumentError as error:
        raise PageProblem(IdpCode.CLIENT_UNKNOWN, error.why) from None
    # One agent for each client and person: what that person lent ends with it, and with nobody else's.
    agent = "oauth-" + hashlib.sha256(f"{person} {client_id}".encode()).hexdigest()[:32]
    return Asking(client_id, agent, document.name, document.host, document.redirects, document.digest)


def _said(person: SignedIn, query: str, asking: Asking, chosen: tuple[TemplateRecord, ...]) -> bytes:
    """All that the person was shown, in one text."""
    return canonical(
        {
            "session": person.session_id,
            "query": query,
            "document": asking.document.hex(),
            "name": asking.name,
            "scopes": [[one.name, one.words, one.audience, one.limits] for one in chosen],
        }
    )


def _is_said(request: Request, said: bytes, shown: str) -> bool:
    try:
        mac = unb64u(shown)
    except BadKeyError:
        return False
    return keys_of(request).made(_SHOWN, said, mac)


def _fresh(provider: Provider, person: SignedIn | None) -> bool:
    return person is not None and person.fresh(FRESH_S, at_ms=provider.now_ms())


def _log_in(request: Request, query: str) -> Response:
    back_to = f"{prefix_of(provider_of(request))}{metadata.AUTHORIZE}?{query}"
    try:
        return to_login(request, back_to=back_to, fresh_s=FRESH_S)
    except ValueError:
        raise PageProblem(IdpCode.QUERY_MALFORMED, "the request is too long") from None


def _read(query: str) -> dict[str, str]:
    try:
        return parameters(query)
    except OAuthProblem as problem:
        raise PageProblem(IdpCode.QUERY_MALFORMED, problem.description) from None
