"""Client authentication: `private_key_jwt` (RFC 7523) for registered clients with a key, `none` for all others.

There are no client secrets: nothing that is sent may be used twice.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import jwt

from capabilities.keys import jws
from capabilities.keys.keys import b64u
from capabilities.values import text
from ztpm_idp.oauth.client_documents import is_document_url
from ztpm_idp.oauth.problem import OAuthError, OAuthProblem

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ztpm_idp.domain.oauth.records import ClientRecord
    from ztpm_idp.provider.provider import Provider

_REGISTERED: Final = re.compile(text.REGISTERED, re.ASCII)
ASSERTION_TYPE: Final = "urn:ietf:params:oauth:client-assertion-type:jwt-bearer"
ASSERTION_S: Final = 600
"""Longest time to the end of an assertion: twice what the MCP SDK states."""
ASSERTION_BYTES: Final = 4_096
_FAILED: Final = "the client is unknown or its authentication failed"
"""One description for all: strangers learn of no client."""


@dataclass(frozen=True, slots=True)
class Client:
    """An authenticated client.

    Attributes:
        client_id: id, or URL of a metadata document.
        record: of a registered client; None for one with a document.
        assertion: that it signed, or "".
    """

    client_id: str
    record: ClientRecord | None
    assertion: str


async def client_of(provider: Provider, form: Mapping[str, str], *, authorization: bool, endpoint: str) -> Client:
    """The client of a request to an endpoint of clients.

    Args:
        provider: has the clients, and remembers assertions.
        form: parameters of the request.
        authorization: whether there was an `Authorization` header, which no client of ours has.
        endpoint: URL of the endpoint; beside the issuer it may be the audience of an assertion.

    Raises:
        OAuthProblem: `invalid_client`, or `invalid_request`.
    """
    if authorization or "client_secret" in form:
        raise OAuthProblem(OAuthError.INVALID_CLIENT, "private_key_jwt or none: there are no client secrets here")
    assertion, client_id = form.get("client_assertion"), form.get("client_id")
    if assertion is not None:
        return await _by_assertion(provider, form, assertion, endpoint)
    if client_id is None:
        raise OAuthProblem(OAuthError.INVALID_CLIENT, "client_id or client_assertion is missing")
    if is_document_url(client_id):
        if not provider.settings.client_documents:
            raise OAuthProblem(OAuthError.INVALID_CLIENT, "client metadata documents are switched off here")
        return Client(client_id, None, "")
    record = await registered(provider, client_id)
    if record is None or record.key is not None:
        raise OAuthProblem(OAuthError.INVALID_CLIENT, _FAILED)
    return Client(client_id, record, "")


async def registered(provider: Provider, client_id: str) -> ClientRecord | None:
    """The registered client of this id."""
    if _REGISTERED.fullmatch(client_id) is None:
        return None
    async with provider.store.read() as view:
        return await view.oauth.client(client_id)


async def _by_assertion(provider: Provider, form: Mapping[str, str], assertion: str, endpoint: str) -> Client:
    if form.get("client_assertion_type") != ASSERTION_TYPE:
        raise OAuthProblem(OAuthError.INVALID_CLIENT, f"client_assertion_type is {ASSERTION_TYPE}")
    failed = OAuthProblem(OAuthError.INVALID_CLIENT, _FAILED)
    if len(assertion) > ASSERTION_BYTES or not assertion.isascii():
        raise failed
    try:
        stated = jwt.decode(assertion, options={"verify_signature": False})
    except jwt.PyJWTError:
        raise failed from None
    client_id = stated.get("sub")
    record = await registered(provider, client_id) if isinstance(client_id, str) else None
    if record is None or record.key is None or form.get("client_id", client_id) != client_id:
        raise failed
    claims = _verified(assertion, record, provider, endpoint)
    once = b64u(hashlib.sha256(str(claims["jti"]).encode()).digest())
    expires_ms = (int(claims["exp"]) + provider.rules.caps.skew_s) * 1_000
    if not await provider.store.first_use(key=record.key, jti=once, expires_ms=expires_ms, at_ms=provider.now_ms()):
        raise OAuthProblem(OAuthError.INVALID_CLIENT, "the assertion was used before")
    return Client(record.client_id, record, assertion)


def _verified(assertion: str, record: ClientRecord, provider: Provider, endpoint: str) -> dict[str, Any]:
    """The claims of an assertion that this client signed just now, for this server."""
    key, at, skew_s = record.key or b"", provider.now_ms() / 1_000, provider.rules.caps.skew_s
    try:
        claims = jwt.decode(
            assertion,
            jws.public_key(key),
            algorithms=[jws.algorithm_name(key)],
            audience=[provider.settings.issuer, endpoint],
            issuer=record.client_id,
            subject=record.client_id,
            # Times are judged below, by the clock of this provider.
            options={"verify_exp": False, "verify_iat": False, "verify_nbf": False, "require": ["exp", "jti", "aud"]},
        )
    except jwt.PyJWTError:
        raise OAuthProblem(OAuthError.INVALID_CLIENT, _FAILED) from None
    times = [claims["exp"], claims.get("iat", int(at)), claims.get("nbf", int(at))]
    if not isinstance(claims["jti"], str) or not all(isinstance(t, int) and not isinstance(t, bool) for t in times):
        raise OAuthProblem(OAuthError.INVALID_CLIENT, _FAILED)
    if isinstance(claims["aud"], list) and len(claims["aud"]) != 1:
        raise OAuthProblem(OAuthError.INVALID_CLIENT, "an assertion is for this server alone")
    expires, issued, begins = times
    if not at < expires + skew_s or expires - at > ASSERTION_S or max(issued, begins) > at + skew_s:
        raise OAuthProblem(OAuthError.INVALID_CLIENT, f"an assertion ends within {ASSERTION_S} s, and is not over")
    return claims
