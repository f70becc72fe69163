"""Caller of a request: the body within its cap, the proof of possession over it, and the proven party."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, TypeVar

from fastapi import Request  # noqa: TC002  the framework reads the annotations

from capabilities.proof.proof import check_proof
from capabilities.statements.claims import NONCE
from capabilities.statements.people.picture import PICTURE_BYTES
from capabilities.token.token_text import token_from_text
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import Fault, FaultCode, StatementError
from capabilities.values.strict_json import canonical
from capabilities.values.units import INT_LIMIT
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.events import SignedRequest
from ztpm_idp.domain.login.devices import carried
from ztpm_idp.domain.parties import RegisteredPerson, Standing
from ztpm_idp.provider.body_json import BodyError, parse_json
from ztpm_idp.provider.done import OneUse
from ztpm_idp.provider.problems import Problem
from ztpm_idp.provider.wire import Body, parse_body
from ztpm_idp.routes.rated import count_caller
from ztpm_idp.store.errors import StoreUnavailableError

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable

    from capabilities.proof.proof import Proof
    from ztpm_idp.domain.login.records import SessionKey
    from ztpm_idp.domain.parties import Party
    from ztpm_idp.provider.heartbeat import Heartbeat
    from ztpm_idp.provider.provider import Provider

B = TypeVar("B", bound=Body)
SMALL_BYTES: Final = 16_384
"""Largest body of most routes: a signed statement or two, and some short texts."""
SCOPE_BYTES: Final = 65_536
"""Largest body with a whole scope: what a token of 16 KiB can hold, spelled out."""
ASK_BYTES: Final = 135_168
"""Largest body with a signed ask or mandate: its text and room for its name."""
PICTURED_BYTES: Final = ASK_BYTES + PICTURE_BYTES * 3 // 2
"""Largest body with an ask and its picture, of whose characters fewer than half are quotes, which JSON escapes."""
PLACE: Final = "dev.ztpm.place"
"""ASGI extension by which a listener learns whose connection it is, and lets no stranger push it out."""
_SCHEME = "DPoP "
_SINCE = re.compile(r"0|[1-9][0-9]{0,15}")


@dataclass(frozen=True, slots=True)
class ProvenCall:
    """A request with a valid proof of possession.

    Attributes:
        key: the key that signed the proof.
        raw: the body as it came.
        sent: method, address and proof.
    """

    key: bytes
    raw: bytes
    sent: SignedRequest

    @property
    def signed(self) -> SignedRequest:
        """The part of the request that the ledger keeps.

        Raises:
            Problem: with the code of the fault, for a body that is no JSON.
        """
        return _kept(self.sent, self.raw)

    def body(self, model: type[B]) -> B:
        """The body as `model`.

        Raises:
            Problem: with the code of the fault.
        """
        return parsed(model, self.raw)


@dataclass(frozen=True, slots=True)
class Call(ProvenCall):
    """A request of a registered party.

    Attributes:
        party: who calls.
        token: the token of `Authorization: DPoP`, decoded; the proof names it.
        once: use of the proof, for the one command that the request is about.
        session_key: the session-bound key that signed, which bounds what is done; `party` has its roles alone.
    """

    party: Party
    token: bytes | None
    once: OneUse
    session_key: SessionKey | None = None


@dataclass(frozen=True, slots=True)
class RootCall(ProvenCall):
    """A request proven by the provider's root key."""


def _kept(sent: SignedRequest, raw: bytes) -> SignedRequest:
    """The request with its body in canonical form, so that blanks fill no ledger.

    A body that came so, as our clients send it, is verified with the proof's `bdg`.
    """
    try:
        body = canonical(parse_json(raw))
    except BodyError as error:
        raise Problem(error.code, error.detail) from None
    except StatementError:
        raise Problem(IdpCode.BODY_MALFORMED) from None
    return replace(sent, body=body.decode())


def parsed(model: type[B], raw: bytes) -> B:
    """A body as `model`.

    Raises:
        Problem: with the code of the fault.
    """
    try:
        return parse_body(model, raw)
    except BodyError as error:
        raise Problem(error.code, error.detail) from None


def provider_of(request: Request) -> Provider:
    """The provider that this application serves."""
    provider: Provider = request.app.state.provider
    return provider


def heartbeat_of(request: Request) -> Heartbeat:
    """The shared heartbeat of this application."""
    heartbeat: Heartbeat = request.app.state.heartbeat
    return heartbeat


def authenticated_within(body_bytes: int) -> Callable[[Request], Awaitable[Call]]:
    """Dependency of a route whose bodies have at most so many bytes: see `authenticated`."""

    async def within(request: Request) -> Call:
        return await _authenticated(request, await read_body(request, body_bytes=body_bytes))

    return within


def commanding_within(body_bytes: int, *, session_keys: bool = False) -> Callable[[Request], AsyncIterator[Call]]:
    """Dependency of a route that is one command: its proof is used up in the command's own commit.

    With `session_keys` such keys may call, too; the route hands `Call.session_key` on to `Provider.run`. Where the
    command did not come to that, the proof is used up all the same before the answer leaves: so this must end with the
    route (`Depends(..., scope="function")`).
    """

    async def within(request: Request) -> AsyncIterator[Call]:
        call = await _known(request, await read_body(request, body_bytes=body_bytes), session_keys=session_keys)
        try:
            yield call
        except StoreUnavailableError:
            with suppress(Problem):  # a proof that was used before: the commit came through, and only its word was lost
                await provider_of(request).use_up(call.once.proof)
            call.once.spent = True
            raise
        finally:
            if not call.once.spent:
                await provider_of(request).use_up(call.once.proof)

    return within


async def authenticated(request: Request) -> Call:
    """The call, when its proof is by a registered party and for exactly this request.

    Raises:
        Problem: 401 with the fault of the proof or token, 403 for a revoked caller, 413 for a body over the cap.
    """
    return await _authenticated(request, await read_body(request, body_bytes=SMALL_BYTES))


async def authenticated_with(request: Request, raw: bytes) -> Call:
    """The call of a request whose body was read already: see `authenticated`."""
    return await _authenticated(request, raw)


def in_session(body_bytes: int = SMALL_BYTES) -> Callable[[Request], Awaitable[Call]]:
    """Dependency of a route that session-bound keys may call, too; it hands `Call.session_key` on to `Provider.run`."""

    async def within(request: Request) -> Call:
        return await _authenticated(request, await read_body(request, body_bytes=body_bytes), session_keys=True)

    return within


async def by_any_key(request: Request) -> ProvenCall:
    """The call of a key that nobody has registered, when its proof is for exactly this request.

    Raises:
        Problem: as `authenticated`.
    """
    # Not used up: a stranger's proof is stored nowhere, and what it may ask for is bounded and good for its key alone.
    _, (key, _, raw, sent) = _proven(request, await read_body(request, body_bytes=SMALL_BYTES))
    return ProvenCall(key, raw, sent)


async def by_root(request: Request) -> RootCall:
    """The call, when its proof is by the provider's root key and for exactly this request.

    Raises:
        Problem: as `authenticated`; `NOT_PERMITTED` for any other key.
    """
    proof, (key, _, raw, sent) = _proven(request, await read_body(request, body_bytes=SMALL_BYTES))
    provider = provider_of(request)
    if key != provider.rules.root_key:
        raise Problem(IdpCode.NOT_PERMITTED)
    await provider.use_up(proof)
    return RootCall(key, raw, sent)


async def _authenticated(request: Request, raw: bytes, *, session_keys: bool = False) -> Call:
    call = await _known(request, raw, session_keys=session_keys)
    await provider_of(request).use_up(call.once.proof)
    call.once.spent = True
    return call


async def _known(request: Request, raw: bytes, *, session_keys: bool) -> Call:
    """The call of a registered party, or of a session-bound key; its proof is still to be used up."""
    proof, (key, token, raw, sent) = _proven(request, raw)
    provider = provider_of(request)
    bound: SessionKey | None = None
    try:
        party = await provider.known(proof)
    except Problem as problem:
        found = await _session_bound(provider, key) if problem.code is IdpCode.CALLER_UNKNOWN else None
        if found is None:
            raise
        if not session_keys:
            raise Problem(IdpCode.SESSION_KEY_TOO_WEAK, "an operator key does this") from None
        party, bound = found
    place = (request.scope.get("extensions") or {}).get(PLACE)
    if place is not None:
        place.proven(f"{type(party).__name__} {party.id}")
    count_caller(request, party.id)
    request.state.caller = f"{type(party).__name__} {party.id}"
    request.state.notice = await provider.notice(party)
    return Call(key, raw, sent, party, token, OneUse(proof), bound)


async def _session_bound(provider: Provider, key: bytes) -> tuple[RegisteredPerson, SessionKey] | None:
    """The active person for whom this session-bound key signs now, with the roles that it carries, and the key."""
    async with provider.store.read() as view:
        held = await view.devices.session_key(key)
        person = None if held is None else await view.party(held.person)
    if held is None or held.over(provider.now_ms()) or not isinstance(person, RegisteredPerson):
        return None
    return (carried(person, held), held) if person.standing is Standing.ACTIVE else None


def _proven(request: Request, raw: bytes) -> tuple[Proof, tuple[bytes, bytes | None, bytes, SignedRequest]]:
    """Proof that is valid for exactly this request, by any key; with it all of the call but its party."""
    provider = provider_of(request)
    proof_text, token_text = _one_header(request, "dpop"), _token_text(request)
    if proof_text is None:
        raise Problem(FaultCode.PROOF_MISSING)
    url = provider.settings.issuer + request.scope["path"].removeprefix(prefix_of(provider))
    proof = check_proof(
        proof_text,
        key=None,
        method=request.method,
        url=url,
        body=raw,
        token=token_text,
        at=provider.now_ms() / 1_000,
        caps=DEFAULT,
    )
    if isinstance(proof, Fault):
        raise Problem(proof.code, proof.detail)
    token = None if token_text is None else token_from_text(token_text, DEFAULT)
    if isinstance(token, Fault):
        raise Problem(token.code, token.detail)
    return proof, (proof.key, token, raw, SignedRequest(request.method, url, "", proof_text))


def prefix_of(provider: Provider) -> str:
    """The path of the issuer, below which every endpoint is."""
    return "/" + provider.settings.issuer.split("/", 3)[3]


async def read_body(request: Request, *, body_bytes: int) -> bytes:
    """The body, never more than the route's cap in memory, and nothing of one that announces more.

    Raises:
        Problem: `BODY_TOO_LARGE`.
    """
    too_large = Problem(IdpCode.BODY_TOO_LARGE, f"at most {body_bytes} bytes")
    if any(
        length.isdecimal() and int(length[:20]) > body_bytes for length in request.headers.getlist("content-length")
    ):
        raise too_large
    raw = bytearray()
    async for part in request.stream():
        raw += part
        if len(raw) > body_bytes:
            raise too_large
    return bytes(raw)


def _one_header(request: Request, name: str) -> str | None:
    """A header that may occur once. Two would be read differently by two readers."""
    found = request.headers.getlist(name)
    if len(found) > 1:
        raise Problem(FaultCode.PROOF_MALFORMED, "a header occurs twice")
    return found[0] if found else None


def _token_text(request: Request) -> str | None:
    header = _one_header(request, "authorization")
    if header is None:
        return None
    if not header.startswith(_SCHEME):
        raise Problem(FaultCode.TOKEN_MALFORMED, "the scheme is DPoP")
    return header.removeprefix(_SCHEME)


def body_of(model: type[Body]) -> dict[str, Any]:
    """The OpenAPI description of a body that we read ourselves."""
    schema = model.model_json_schema()
    content = {"application/json": {"schema": _whole(schema, schema.pop("$defs", {}))}}
    return {"requestBody": {"required": True, "content": content}}


def _whole(schema: Any, parts: dict[str, Any]) -> Any:
    """A schema with its parts in their places: a reference would lead into another document."""
    match schema:
        case {"$ref": str(named)}:
            return _whole(parts[named.removeprefix("#/$defs/")], parts)
        case dict():
            return {name: _whole(inner, parts) for name, inner in schema.items()}
        case list():
            return [_whole(inner, parts) for inner in schema]
        case _:
            return schema


def query_of(request: Request, *names: str) -> tuple[str, ...]:
    """The values of exactly these query parameters, once each.

    Raises:
        Problem: `QUERY_MALFORMED`.
    """
    if sorted(request.query_params.multi_items()) != sorted(
        (name, request.query_params.get(name, "")) for name in names
    ):
        raise Problem(IdpCode.QUERY_MALFORMED, f"exactly {' and '.join(names)}")
    return tuple(request.query_params[name] for name in names)


def since_of(text: str) -> int:
    """The epoch, version or entry that a question asks after.

    Raises:
        Problem: `QUERY_MALFORMED`.
    """
    if not _SINCE.fullmatch(text) or int(text) > INT_LIMIT:
        raise Problem(IdpCode.QUERY_MALFORMED, "a number that is none")
    return int(text)


def nonce_of(text: str) -> str:
    """The nonce of a question, which the answer echoes.

    Raises:
        Problem: `QUERY_MALFORMED`.
    """
    if not NONCE.fullmatch(text):
        raise Problem(IdpCode.QUERY_MALFORMED, "nonce")
    return text
