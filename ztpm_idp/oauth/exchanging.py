"""Token exchange (RFC 8693): the hop protocol in OAuth's words.

The subject token is the holder's, the actor token the delegate's evidence over a nonce of ours. The holder's own key
signs a proof over the exact body. What is lent is the one member of `authorization_details` (RFC 9396).
"""

from __future__ import annotations

import secrets
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Final, Literal

from pydantic import Field, TypeAdapter, ValidationError

from capabilities.token.token_text import token_from_text
from capabilities.values.errors import CapabilityError, Fault
from capabilities.values.scope_json import restriction_from_json
from capabilities.values.strict_json import canonical
from ztpm_idp.domain.commands import Delegate
from ztpm_idp.domain.events import RevocationKind, TokenDelegated
from ztpm_idp.domain.oauth.events import AccessMade
from ztpm_idp.oauth.access_token import jti_of
from ztpm_idp.oauth.form import needed
from ztpm_idp.oauth.issuing import answer_of, resource_of, without_secrets
from ztpm_idp.oauth.problem import OAuthError, OAuthProblem, of_refusal
from ztpm_idp.provider import wire
from ztpm_idp.provider.body_json import BodyError, parse_json
from ztpm_idp.provider.problems import Problem

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from ztpm_idp.domain.events import SignedRequest
    from ztpm_idp.keys.oauth_keys import OAuthKeys
    from ztpm_idp.provider.provider import Provider

ACCESS_TYPE: Final = "urn:ietf:params:oauth:token-type:access_token"
JWT_TYPE: Final = "urn:ietf:params:oauth:token-type:jwt"
CAPABILITY_TYPE: Final = "urn:ztpm:token-type:capability"
"""A token of the profile `ztpm/1`."""
DETAIL_TYPE: Final = "ztpm_delegation"
"""Type of the one authorization detail."""
DETAIL_BYTES: Final = 65_536


class Detail(wire.DelegateRequest):
    """The request that the delegate's evidence names, with its type."""

    type: Literal["ztpm_delegation"]


_DETAILS: Final = TypeAdapter(Annotated[list[Detail], Field(min_length=1, max_length=1)])


async def exchange(
    provider: Provider,
    keys: OAuthKeys,
    form: Mapping[str, str],
    *,
    holder: str,
    key: bytes,
    signed: SignedRequest,
    named: Callable[[bytes, Provider], frozenset[tuple[str, str]] | None],
    digest: Callable[[wire.Body], bytes],
) -> dict[str, object]:
    """The answer to an exchange: an access token bound to the delegate's key, or the capability itself.

    Args:
        provider: runs the hop protocol.
        keys: sign the access token.
        form: parameters.
        holder: id of the party that proved the request.
        key: raw public key that it proved it with.
        signed: the request without body.
        named: reader of every (kind, id) whose revocation concerns a token, unverified.
        digest: of a request, as evidence names it.

    Raises:
        OAuthProblem: nothing was lent.
    """
    wanted = form.get("requested_token_type", ACCESS_TYPE)
    if wanted not in {ACCESS_TYPE, JWT_TYPE, CAPABILITY_TYPE}:
        raise OAuthProblem(OAuthError.INVALID_REQUEST, "requested_token_type is of none that is made here")
    if needed(form, "actor_token_type") != JWT_TYPE:
        raise OAuthProblem(OAuthError.INVALID_REQUEST, f"actor_token_type is {JWT_TYPE}: the delegate's evidence")
    detail, token = _detail(form), await _subject(provider, keys, form)
    request = wire.DelegateRequest(delegate=detail.delegate, purpose=detail.purpose, restriction=detail.restriction)
    try:
        restriction = restriction_from_json(detail.restriction)
    except CapabilityError as error:
        raise OAuthProblem(OAuthError.INVALID_REQUEST, f"{error.code}: {error.detail}") from None
    names = named(token, provider)
    command = Delegate(
        by=holder,
        key=key,
        token=token,
        delegate=detail.delegate,
        purpose=detail.purpose,
        restriction=restriction,
        request_digest=digest(request),
        evidence=needed(form, "actor_token"),
        hop_id=secrets.token_hex(16),
        signed=replace(signed, body=canonical(without_secrets(form)).decode()),
        agents=frozenset(id_ for kind, id_ in names or () if kind == RevocationKind.AGENT),
        names=names,
        resource=None if wanted == CAPABILITY_TYPE else resource_of(form),
    )
    try:
        done = await provider.run(command, actor=holder)
    except Problem as problem:
        raise of_refusal(problem.code, problem.detail) from None
    for event in done.events:
        match event:
            case AccessMade(access=access):
                return answer_of(access, keys, issuer=provider.settings.issuer) | {"issued_token_type": ACCESS_TYPE}
            case TokenDelegated(scope=scope, hop=hop) if wanted == CAPABILITY_TYPE:
                return {
                    "access_token": done.token,
                    "issued_token_type": CAPABILITY_TYPE,
                    "token_type": "DPoP",
                    "expires_in": scope.not_after - hop.attestation.at,
                }
            case _:
                continue
    raise AssertionError


def _detail(form: Mapping[str, str]) -> Detail:
    raw = needed(form, "authorization_details").encode()
    try:
        (detail,) = _DETAILS.validate_python(parse_json(raw, limit_bytes=DETAIL_BYTES))
    except BodyError as error:
        raise OAuthProblem(OAuthError.INVALID_REQUEST, f"authorization_details: {error.detail}") from None
    except ValidationError as error:
        place = ".".join(map(str, error.errors(include_input=False, include_url=False)[0]["loc"]))
        raise OAuthProblem(OAuthError.INVALID_REQUEST, f"authorization_details: one {DETAIL_TYPE}: {place}") from None
    return detail


async def _subject(provider: Provider, keys: OAuthKeys, form: Mapping[str, str]) -> bytes:
    """The capability of the subject token, unverified: itself, or the one behind an access token."""
    subject, kind = needed(form, "subject_token"), needed(form, "subject_token_type")
    match kind:
        case _ if kind == CAPABILITY_TYPE:
            capability = subject
        case _ if kind in {ACCESS_TYPE, JWT_TYPE}:
            jti = jti_of(subject, keys, issuer=provider.settings.issuer)
            async with provider.store.read() as view:
                access = None if jti is None else await view.oauth.access(jti)
            if access is None:
                raise OAuthProblem(OAuthError.INVALID_GRANT, "the subject token is none of ours, or over")
            capability = access.capability
        case _:
            raise OAuthProblem(OAuthError.INVALID_REQUEST, "subject_token_type is of none that is taken here")
    found = token_from_text(capability, provider.rules.caps)
    if isinstance(found, Fault):
        raise OAuthProblem(OAuthError.INVALID_GRANT, f"{found.code}: {found.detail}")
    return found
