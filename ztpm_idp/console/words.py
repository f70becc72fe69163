"""Passkeys' words on questions of the console: asked in one session, answered within minutes, counted once.

A question is sealed for its session, and the page brings the seal back; a passkey asserts exactly what was asked
([CON-3], [CON-12] in docs/spec.md).
"""

from __future__ import annotations

import json
import secrets
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pydantic import ValidationError

from capabilities.statements.people.assertion import check
from capabilities.values.errors import FaultCode, StatementError
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.login import session
from ztpm_idp.login.pages import PageProblem
from ztpm_idp.provider import passkeys, wire
from ztpm_idp.provider.done import OneUse
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import provider_of
from ztpm_idp.store import ProofUse

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fastapi import Request

    from ztpm_idp.console.viewing import Viewer
    from ztpm_idp.domain.commands import Command
    from ztpm_idp.provider.done import Done

QUESTION_S: Final = 300
"""Seconds for which a page with a question takes the passkey's word: as long as a login page does."""
ASSERTED: Final = ("credential", "authenticator", "client", "signature")
"""Fields of a form that carry an assertion."""


@dataclass(frozen=True, slots=True)
class SealedQuestion:
    """Question that was asked in this session.

    Attributes:
        nonce: the provider's, fresh for it.
        sealed: the text that the page keeps.
        asked_ms: wall clock.
        more: what was sealed with it.
    """

    nonce: str
    sealed: str
    asked_ms: int
    more: Mapping[str, Any]


async def ask(request: Request, viewer: Viewer, purpose: str, *, nonce: str, **more: Any) -> SealedQuestion:
    """A question for this viewer.

    Args:
        request: whose answer asks it.
        viewer: who is asked.
        purpose: for which questions the seal is; it is no cookie's name.
        nonce: from `fresh`.
        more: what the answer is to be compared with.
    """
    provider = provider_of(request)
    at_ms = provider.now_ms()
    kept = {"nonce": nonce, "at_ms": at_ms, "session": viewer.session_id} | more
    async with provider.store.read() as view:
        sealed = session.seal(await view.sessions.secret(), purpose, json.dumps(kept))
    return SealedQuestion(nonce, sealed, at_ms, more)


def fresh() -> str:
    """A nonce for one question."""
    return secrets.token_urlsafe(24)


async def asked(request: Request, viewer: Viewer, purpose: str, sealed: str) -> SealedQuestion:
    """The question that was sealed, when it was asked in this session and not long ago.

    Raises:
        PageProblem: `LOGIN_OVER`.
    """
    provider, kept = provider_of(request), await kept_in(request, purpose, sealed)
    asked_ms, of = int(kept.pop("at_ms", 0)), kept.pop("session", None)
    if of != viewer.session_id or not 0 <= provider.now_ms() - asked_ms <= QUESTION_S * 1_000:
        raise PageProblem(IdpCode.LOGIN_OVER, "ask again on the page, and answer within five minutes")
    return SealedQuestion(str(kept.pop("nonce")), sealed, asked_ms, kept)


async def kept_in(request: Request, purpose: str, sealed: str) -> dict[str, Any]:
    """Members that were sealed for such a question, in any session; none where the seal is not ours."""
    async with provider_of(request).store.read() as view:
        text = session.unseal(await view.sessions.secret(), purpose, sealed)
    kept: dict[str, Any] = {} if text is None else json.loads(text)
    return kept


def assertion_in(form: Mapping[str, str]) -> wire.AssertionBody:
    """The assertion that a form carries.

    Raises:
        PageProblem: `FORM_MALFORMED`.
    """
    try:
        return wire.AssertionBody.model_validate({name: form[name] for name in ASSERTED})
    except ValidationError:
        raise PageProblem(IdpCode.FORM_MALFORMED, "no assertion of a passkey") from None


async def word_on(
    request: Request, viewer: Viewer, question: SealedQuestion, said: wire.AssertionBody, expected: bytes
) -> tuple[OneUse, passkeys.Asserted]:
    """The one use of an assertion by the viewer's own passkey over exactly this challenge, and the assertion.

    Raises:
        PageProblem: `PASSKEY_UNKNOWN`, `NOT_PERMITTED`, or the fault of the assertion.
    """
    provider = provider_of(request)
    try:
        party, found = passkeys.party_of(provider), await passkeys.asserted(provider, said)
    except Problem as problem:
        raise PageProblem(problem.code, problem.detail) from None
    if found.person.id != viewer.person.id:
        raise PageProblem(IdpCode.NOT_PERMITTED, "the passkey is another person's than the session")
    try:
        check(found.assertion, expected=expected, party=party, key=found.key)
    except StatementError as error:
        raise PageProblem(error.code, error.detail) from None
    expires_ms = question.asked_ms + QUESTION_S * 1_000
    use = ProofUse(found.key, question.nonce, expires_ms=expires_ms, at_ms=provider.now_ms())
    return OneUse(use), found


async def done_once(request: Request, viewer: Viewer, command: Command, once: OneUse) -> Done:
    """The command is done for the viewer, and the word on it is used up in the same commit.

    Raises:
        PageProblem: `LOGIN_OVER` for a word that was used before, or the command's refusal.
    """
    try:
        return await provider_of(request).run(command, actor=viewer.person.id, once=once)
    except Problem as problem:
        if problem.code is FaultCode.REPLAYED:
            raise PageProblem(IdpCode.LOGIN_OVER, "this word was used before") from None
        raise PageProblem(problem.code, problem.detail) from None
