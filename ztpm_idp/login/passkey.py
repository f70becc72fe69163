"""Logging in by passkey: a challenge for one browser, asserted once."""

from __future__ import annotations

import json
import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pydantic import ValidationError

from capabilities.keys.keys import b64u, thumbprint
from capabilities.statements.people.assertion import login_challenge, relying_party
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.login.records import Authentication, Method
from ztpm_idp.login import session
from ztpm_idp.login.pages import PageProblem
from ztpm_idp.provider import passkeys
from ztpm_idp.provider.done import OneUse
from ztpm_idp.provider.problems import Problem
from ztpm_idp.provider.wire import AssertionBody
from ztpm_idp.store import ProofUse

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fastapi import Request

    from ztpm_idp.provider.provider import Provider

PASSKEY: Final = "__Host-ztpm-passkey"
"""Name of the cookie with the nonce of a login page."""
PASSKEY_S: Final = 300
"""Seconds for which a login page takes a passkey: to look for it, and touch it."""
PASSKEY_SCRIPT: Final = (Path(__file__).parent / "templates" / "passkey.js").read_text("utf-8")
"""The login page's one script."""
_METHODS: Final = ("pop", "user")
"""Methods of a passkey: a key whose possession was proven, with its user verified there (RFC 8176 section 2)."""


@dataclass(frozen=True, slots=True)
class PasskeyAsked:
    """Question of one login page for a passkey.

    Attributes:
        challenge: base64url.
        rp: id of the relying party.
        sealed: nonce and time, for the browser to keep.
    """

    challenge: str
    rp: str
    sealed: str


async def ask_passkey(request: Request) -> PasskeyAsked | None:
    """A new challenge for the browser that sent the request; None where this provider can have no passkeys."""
    provider = _provider(request)
    party = relying_party(provider.settings.issuer)
    if party is None:
        return None
    nonce = secrets.token_urlsafe(24)
    kept = json.dumps({"nonce": nonce, "at_ms": provider.now_ms()})
    sealed = session.seal(await _secret(provider), PASSKEY, kept)
    return PasskeyAsked(b64u(login_challenge(provider.settings.issuer, nonce)), party.rp_id, sealed)


async def logged_in(request: Request, form: Mapping[str, str]) -> tuple[str, Authentication, OneUse]:
    """The person whose passkey asserted the challenge of this browser, the authentication, and its one use.

    Raises:
        PageProblem: `LOGIN_OVER`, `FORM_MALFORMED`, or as `passkeys.verified_login`.
    """
    provider = _provider(request)
    at_ms, held = provider.now_ms(), session.cookie(request, PASSKEY)
    kept = None if held is None else session.unseal(await _secret(provider), PASSKEY, held)
    if kept is None:
        raise PageProblem(IdpCode.LOGIN_OVER, "open the login page again")
    asked: dict[str, Any] = json.loads(kept)
    nonce, asked_ms = str(asked["nonce"]), int(asked["at_ms"])
    if not 0 <= at_ms - asked_ms <= PASSKEY_S * 1_000:
        raise PageProblem(IdpCode.LOGIN_OVER, "open the login page again")
    try:
        said = AssertionBody.model_validate(dict(form))
    except ValidationError:
        raise PageProblem(IdpCode.FORM_MALFORMED, "not an assertion") from None
    try:
        person = await passkeys.verified_login(provider, said, nonce=nonce)
    except Problem as problem:
        raise PageProblem(problem.code, problem.detail) from None
    async with provider.store.read() as view:
        known = await view.people.passkey(said.credential)
    if known is None:
        raise PageProblem(IdpCode.PASSKEY_UNKNOWN)
    use = ProofUse(known[1], nonce, expires_ms=asked_ms + PASSKEY_S * 1_000, at_ms=at_ms)
    return person.id, Authentication(Method.PASSKEY, at_ms, amr=_METHODS, key=thumbprint(known[1])), OneUse(use)


async def _secret(provider: Provider) -> bytes:
    async with provider.store.read() as view:
        return await view.sessions.secret()


def _provider(request: Request) -> Provider:
    provider: Provider = request.app.state.provider
    return provider
