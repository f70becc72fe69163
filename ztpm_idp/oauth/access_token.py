"""Access tokens as JWT (RFC 9068): signed by PyJWT with the one algorithm of the key, read back strictly."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import jwt

from capabilities.keys import jws, keys
from capabilities.values.strict_json import canonical

if TYPE_CHECKING:
    from ztpm_idp.domain.oauth.records import AccessRecord
    from ztpm_idp.keys.oauth_keys import OAuthKeys

TYPE: Final = "at+jwt"
TOKEN_BYTES: Final = 8_192
"""Longest access token that is read: nine actors with the longest ids take less than half."""


def sign(access: AccessRecord, signing: OAuthKeys, *, issuer: str) -> str:
    """The text of an access token.

    Args:
        access: its record.
        signing: the first key signs.
        issuer: the `iss`.
    """
    claims: dict[str, object] = {
        "iss": issuer,
        "sub": access.sponsor,
        "aud": access.audience,
        "client_id": access.client_id,
        "iat": access.issued_at,
        "exp": access.not_after,
        "auth_time": access.authenticated_at,
        "jti": access.jti,
        "act": act_of(access.actors),
    }
    if access.scope:
        claims["scope"] = access.scope
    if access.jkt is not None:
        claims["cnf"] = {"jkt": access.jkt}
    raw = keys.public_raw(signing.signing)
    header: dict[str, object] = {"typ": TYPE, "kid": keys.thumbprint(raw)}
    return jws.sign(header, canonical(claims), signing.signing)


def act_of(actors: tuple[str, ...]) -> dict[str, object]:
    """The nested `act` of RFC 8693: who acts now, and inside who delegated to it."""
    nested: dict[str, object] = {}
    for actor in reversed(actors):
        nested = {"sub": actor} | ({"act": nested} if nested else {})
    return nested


def jti_of(text: str, signing: OAuthKeys, *, issuer: str) -> str | None:
    """The id of an access token that one of these keys signed, over or not; None for anything else."""
    if len(text) > TOKEN_BYTES or not text.isascii():
        return None
    try:
        header = jwt.get_unverified_header(text)
        kid = header.get("kid")
        raw = signing.public.get(kid) if isinstance(kid, str) else None
        if raw is None or header.get("typ") != TYPE:
            return None
        claims = jwt.decode(
            text,
            jws.public_key(raw),
            algorithms=[jws.algorithm_name(raw)],
            issuer=issuer,
            # Times and audience are judged by the record, which says the same.
            options={"verify_exp": False, "verify_iat": False, "verify_aud": False, "require": ["jti", "exp", "aud"]},
        )
    except jwt.PyJWTError:
        return None
    jti = claims["jti"]
    return jti if isinstance(jti, str) else None
