"""Lending authority, and taking it back."""

from __future__ import annotations

import hashlib
import secrets
from typing import TYPE_CHECKING, Annotated, Any, Final

import rfc8785
from fastapi import APIRouter, Depends, Request
from fastapi.responses import PlainTextResponse

from capabilities.keys.keys import b64u
from capabilities.values.errors import CapabilityError, Fault, FaultCode
from capabilities.values.scope_json import restriction_from_json, scope_from_json
from ztpm_idp.domain import commands
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.events import RevocationKind, TokenDelegated, TokenIssued
from ztpm_idp.provider import wire
from ztpm_idp.provider.feed import BASE_EPOCHS
from ztpm_idp.provider.heartbeat import revocation_index
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import (
    SCOPE_BYTES,
    SMALL_BYTES,
    Call,
    body_of,
    commanding_within,
    heartbeat_of,
    nonce_of,
    provider_of,
    query_of,
    since_of,
)
from ztpm_idp.routes.described import query

if TYPE_CHECKING:
    from ztpm_idp.provider.done import Done
    from ztpm_idp.provider.provider import Provider

router = APIRouter()
TRUST_HINT: Final = "ztpm-trust"
"""Header with the version of the trust bundle."""
Revoker = Annotated[Call, Depends(commanding_within(SMALL_BYTES, session_keys=True), scope="function")]
Sponsor = Annotated[Call, Depends(commanding_within(SCOPE_BYTES, session_keys=True), scope="function")]
Lender = Annotated[Call, Depends(commanding_within(SCOPE_BYTES), scope="function")]


@router.post("/tokens", status_code=201, openapi_extra=body_of(wire.IssueBody))
async def issue(request: Request, call: Sponsor) -> dict[str, Any]:
    """A sponsor lends authority to an agent; the proof is the sponsor's signature over the request."""
    body = call.body(wire.IssueBody)
    try:
        scope = scope_from_json(body.request.scope)
    except CapabilityError as error:
        raise Problem(error.code, error.detail) from None
    command = commands.Issue(
        by=call.party.id,
        agent=body.request.agent,
        purpose=body.request.purpose,
        scope=scope,
        request_digest=digest_of_request(body.request),
        evidence=body.evidence,
        token_id=b64u(secrets.token_bytes(16)),
        hop_id=secrets.token_hex(16),
        signed=call.signed,
    )
    done = await provider_of(request).run(command, actor=call.party.id, session_key=call.session_key, once=call.once)
    return made(done)


@router.post("/tokens/delegate", status_code=201, openapi_extra=body_of(wire.DelegateBody))
async def delegate(request: Request, call: Lender) -> dict[str, Any]:
    """Delegates part of a holder's token; the proof is by the token's holder."""
    body, provider = call.body(wire.DelegateBody), provider_of(request)
    if call.token is None:
        raise Problem(FaultCode.TOKEN_MISSING)
    try:
        restriction = restriction_from_json(body.request.restriction)
    except CapabilityError as error:
        raise Problem(error.code, error.detail) from None
    names = named(call.token, provider)
    command = commands.Delegate(
        by=call.party.id,
        key=call.key,
        token=call.token,
        delegate=body.request.delegate,
        purpose=body.request.purpose,
        restriction=restriction,
        request_digest=digest_of_request(body.request),
        evidence=body.evidence,
        hop_id=secrets.token_hex(16),
        signed=call.signed,
        agents=frozenset(id_ for kind, id_ in names or () if kind == RevocationKind.AGENT),
        names=names,
    )
    return made(await provider.run(command, actor=call.party.id, once=call.once))


def named(token: bytes, provider: Provider) -> frozenset[tuple[str, str]] | None:
    """Every (kind, id) whose revocation concerns a token, or None where it cannot be read.

    The token is verified later, where that counts.
    """
    found = provider.rules.verifier.names(token, epoch=provider.epochs.highest)
    return None if isinstance(found, Fault) else found


@router.post("/revocations", openapi_extra=body_of(wire.RevocationBody))
async def revoke(request: Request, call: Revoker) -> dict[str, Any]:
    """Revokes a token, hop, agent, key, sponsor or audience, for ever.

    The answer is its epoch or a later one, and whether this provider knows such a thing: one that it never made or
    registered is revoked all the same, but the id may be a slip that protects nobody.
    """
    body = call.body(wire.RevocationBody)
    command = commands.Revoke(call.party.id, body.kind, body.id, body.reason)
    provider, known = provider_of(request), False
    if body.kind not in {RevocationKind.TOKEN, RevocationKind.HOP}:
        # Before: after the commit nothing may stand between it and its answer.
        async with provider.store.read() as view:
            known = await view.knows(body.kind, body.id)
    done = await provider.run(command, actor=call.party.id, session_key=call.session_key, once=call.once)
    return {"epoch": done.epoch, "known": known or done.known, "at_ms": provider.now_ms()}


@router.get("/revocations", response_class=PlainTextResponse, openapi_extra=query("since", "nonce", optional=("base",)))
async def revocations(request: Request) -> PlainTextResponse:
    """The signed revocation index after an epoch, echoing the caller's nonce. Only a store that can commit answers.

    With `base`, which is 0 or that of an earlier page, it begins with a base: without what has ended everywhere.
    """
    names = ("since", "nonce", "base") if "base" in request.query_params else ("since", "nonce")
    since, nonce, *more = query_of(request, *names)
    known, echoed, base = since_of(since), nonce_of(nonce), since_of(more[0]) if more else None
    if base and base % BASE_EPOCHS:
        raise Problem(IdpCode.QUERY_MALFORMED, "base")
    provider = provider_of(request)
    text = await revocation_index(provider, heartbeat_of(request), since=known, nonce=echoed, base=base)
    # The version of the trust bundle is a hint: whoever has an older one asks for it, and verifies it.
    hint = {TRUST_HINT: str(provider.rules.trust.version)}
    return PlainTextResponse(text, headers={"Cache-Control": "no-store", **hint})


@router.get("/revocations/wait", openapi_extra=query("since", optional=("news",)))
async def wait_for_revocation(request: Request) -> dict[str, int | str]:
    """Waits until the epoch is above `since`, at most 20 s, and answers it.

    It is an unsigned hint: the signed index counts. With `news=1` the answer brings that of everything after `since`,
    where there is anything, for nobody's nonce: what it revokes is in force, and no view grows young by it.
    """
    names = ("since", "news") if "news" in request.query_params else ("since",)
    since, *news = query_of(request, *names)
    if news not in ([], ["1"]):
        raise Problem(IdpCode.QUERY_MALFORMED, "news")
    known, provider = since_of(since), provider_of(request)

    async def gone() -> None:
        while (await request.receive())["type"] != "http.disconnect":
            pass

    epoch = await provider.epochs.above(known, gone=gone)
    if not news or epoch <= known:
        return {"epoch": epoch}
    return {"epoch": epoch, "news": await provider.news.after(provider, known, epoch=epoch)}


def digest_of_request(body: wire.Body) -> bytes:
    """SHA-256 of the request's canonical form, which the agent's evidence names."""
    return hashlib.sha256(rfc8785.dumps(body.model_dump(mode="json"))).digest()


def made(done: Done) -> dict[str, Any]:
    """Answer to a request by which a token was made."""
    for event in done.events:
        match event:
            case TokenIssued(token_id=token_id, hop=hop, scope=scope):
                pass
            case TokenDelegated(chain=chain, hop=hop, scope=scope):
                token_id = chain.token_id
            case _:
                continue
        return {"token": done.token, "token_id": token_id, "hop_id": hop.hop_id, "expires_at": scope.not_after}
    raise AssertionError
