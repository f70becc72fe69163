"""Plain DPoP proof (RFC 9449), as a client makes it whose server is not ours, and the other way round.

It covers no body, and may have further claims.

Clause [PRF-11] in docs/spec.md. It proves the key and the token of a request, so it counts for what a bearer token
could do, and for nothing more.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import jwt

from capabilities.keys import jws, keys
from capabilities.proof import freshness
from capabilities.proof.proof import TYPE, token_digest
from capabilities.values import strict_json
from capabilities.values.errors import BadKeyError, Fault, FaultCode, StatementError

if TYPE_CHECKING:
    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

JTI_BYTES: Final = 256
"""Longest `jti` of a stock client; it is remembered by its digest."""
NONCE_BYTES: Final = 256
_MEMBERS: Final = {"OKP": ("kty", "crv", "x"), "EC": ("kty", "crv", "x", "y")}
_PRIVATE: Final = frozenset({"d", "p", "q", "dp", "dq", "qi", "k", "oth"})
_ENGINE: Final = jwt.PyJWS(algorithms=[jws.EDDSA, jws.ES256])
_CLAUSE: Final = "PRF-11"


@dataclass(frozen=True, slots=True)
class PlainProof:
    """A plain proof that holds for the request it was checked against.

    Attributes:
        jti: SHA-256 of its id, base64url; single use for each key.
        iat: when it was made, seconds since the epoch.
        key: the raw public key that signed it.
        thumbprint: name of that key, as `cnf.jkt` states it.
        nonce: the server's nonce that it states, or None.
    """

    jti: str
    iat: int
    key: bytes
    thumbprint: str
    nonce: str | None


def prove_plain(
    key: PrivateKey, *, method: str, url: str, token: str | None, nonce: str | None, at: int, jti: str
) -> str:
    """A proof, by `key`, for one request to any server.

    Args:
        key: that the access token is bound to, or will be.
        method: HTTP method, upper case.
        url: of the request, without query and fragment.
        token: text of the access token that the request presents, or None.
        nonce: that the server gave for this request, or None.
        at: seconds since the epoch.
        jti: never used before.
    """
    claims: dict[str, object] = {"jti": jti, "htm": method, "htu": url, "iat": at}
    if token is not None:
        claims["ath"] = token_digest(token)
    if nonce is not None:
        claims["nonce"] = nonce
    header: dict[str, object] = {"typ": TYPE, "jwk": jws.jwk(keys.public_raw(key))}
    return jws.sign(header, strict_json.canonical(claims), key)


def check_plain(proof: str, *, method: str, url: str, token: str | None, at: float, caps: Caps) -> PlainProof | Fault:
    """The proof, when it is for this request, made just now, and signed by the key that it names.

    Args:
        proof: compact JWS.
        method: HTTP method, upper case.
        url: the server's own configured address of the resource, without query and fragment.
        token: text of the access token, or None where none is presented.
        at: seconds since the epoch.
        caps: bounds.
    """
    try:
        unverified = jws.split(proof, most_bytes=caps.proof_bytes)
        claims = strict_json.parse_object(unverified.payload_raw)
    except StatementError as error:
        return _malformed(error.detail)
    header = unverified.header
    if header.get("typ") != TYPE or "crit" in header:
        return _malformed("not the header of a proof")
    try:
        key = jws.key_of_jwk(_public(header.get("jwk")))
        # By PyJWT, since stock clients make either of the two P-256 signatures; the id is remembered, not the text.
        _ENGINE.decode(proof, jws.public_key(key), algorithms=[jws.algorithm_name(key)])
    except (BadKeyError, jwt.PyJWTError):
        return Fault(FaultCode.PROOF_WRONG_KEY, _CLAUSE, "not signed by the key that it names")
    jti, iat, nonce = claims.get("jti"), claims.get("iat"), claims.get("nonce")
    if not isinstance(jti, str) or not 1 <= len(jti) <= JTI_BYTES:
        return _malformed("jti")
    if not isinstance(iat, int) or isinstance(iat, bool):
        return _malformed("iat")
    if nonce is not None and (not isinstance(nonce, str) or len(nonce) > NONCE_BYTES):
        return _malformed("nonce")
    wanted = {"htm": method, "htu": url, "ath": None if token is None else token_digest(token)}
    if any(claims.get(claim) != value for claim, value in wanted.items()):
        return Fault(FaultCode.PROOF_NOT_FOR_THIS_REQUEST, _CLAUSE)
    stale = freshness.stale(iat, at=at, caps=caps)
    if stale is not None:
        return stale
    once = keys.b64u(hashlib.sha256(jti.encode()).digest())
    return PlainProof(once, iat, key, keys.thumbprint(key), nonce)


def _public(jwk: object) -> object:
    """The members of a public key that say which; libraries add others, of which none may be private."""
    if not isinstance(jwk, dict) or _PRIVATE & jwk.keys():
        return None
    return {member: jwk.get(member) for member in _MEMBERS.get(str(jwk.get("kty")), ())}


def _malformed(detail: str) -> Fault:
    return Fault(FaultCode.PROOF_MALFORMED, _CLAUSE, detail)
