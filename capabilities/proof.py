"""Proof of possession: a signature by a key over one request (RFC 9449 DPoP with Ed25519, and the digest of the body).

Clauses [PRF-1] to [PRF-6] in docs/spec.md. Whether a proof was seen before is the verifier's memory, not this module's.
"""

from __future__ import annotations

import hashlib
import hmac
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities import jws, keys, strict_json
from capabilities.errors import BadKeyError, Fault, FaultCode, StatementError

if TYPE_CHECKING:
    from capabilities.caps import Caps
    from capabilities.keys import PrivateKey

TYPE: Final = "dpop+jwt"
_JTI: Final = re.compile(r"[A-Za-z0-9_-]{16,64}", re.ASCII)
_CLAIMS: Final = frozenset({"jti", "htm", "htu", "iat", "bdg"})


@dataclass(frozen=True, slots=True)
class Proof:
    """A proof that holds for the request it was checked against.

    Attributes:
        jti: its id, single use for each key.
        iat: when it was made, seconds since the epoch.
        key: the raw public key that signed it.
        digest: SHA-256 of its text.
    """

    jti: str
    iat: int
    key: bytes
    digest: bytes


def prove(key: PrivateKey, *, method: str, url: str, body: bytes, token: str | None, at: int, jti: str) -> str:
    """A proof, by `key`, for one request.

    Args:
        key: the holder's.
        method: HTTP method, upper case.
        url: canonical URL of the request, without query and fragment.
        body: the exact bytes of the body; empty when there is none.
        token: text of the token that the request presents, or None.
        at: seconds since the epoch.
        jti: 16 to 64 base64url characters, never used before.
    """
    claims: dict[str, object] = {"jti": jti, "htm": method, "htu": url, "iat": at, "bdg": _digest(body)}
    if token is not None:
        claims["ath"] = _digest(token.encode())
    return jws.sign({"typ": TYPE, "jwk": jws.jwk(keys.public_raw(key))}, strict_json.canonical(claims), key)


def check_proof(
    proof: str, *, key: bytes | None, method: str, url: str, body: bytes, token: str | None, at: float, caps: Caps
) -> Proof | Fault:
    """The proof, when it was made by `key` for exactly this request, just now; or the first fault.

    Args:
        proof: its text.
        key: the raw key that must have made it; None for any key, which the answer then names.
        method: HTTP method of the request.
        url: the server's own configured address of the resource, without query and fragment.
        body: the exact bytes that were received.
        token: text of the token that was presented, or None.
        at: seconds since the epoch.
        caps: the bounds.
    """
    # [PRF-1] present, bounded, one spelling
    if not proof:
        return Fault(FaultCode.PROOF_MISSING, "PRF-1")
    try:
        unverified = jws.split(proof, most_bytes=caps.proof_bytes)
        claims = strict_json.parse_object(unverified.payload_raw)
    except StatementError as error:
        return Fault(FaultCode.PROOF_MALFORMED, "PRF-1", error.detail)

    # [PRF-2] the closed set of header members and claims, each of its type
    expected = _CLAIMS if token is None else _CLAIMS | {"ath"}
    header = unverified.header
    if header.keys() != {"typ", "alg", "jwk"} or header["typ"] != TYPE:
        return Fault(FaultCode.PROOF_MALFORMED, "PRF-2", "not the header of a proof")
    if claims.keys() - {"ath"} != _CLAIMS:
        return Fault(FaultCode.PROOF_MALFORMED, "PRF-2", "not the claims of a proof")
    jti, iat = claims["jti"], claims["iat"]
    if not isinstance(jti, str) or _JTI.fullmatch(jti) is None or not isinstance(iat, int) or isinstance(iat, bool):
        return Fault(FaultCode.PROOF_MALFORMED, "PRF-2", "a claim of a wrong form")

    # [PRF-3] the key in the header is the expected one, and it signed; the header chooses nothing
    try:
        signer = jws.key_of_jwk(header["jwk"])
        if key is not None and not hmac.compare_digest(signer, key):
            return Fault(FaultCode.PROOF_WRONG_KEY, "PRF-3")
        jws.check(unverified, signer)
    except BadKeyError as error:
        return Fault(FaultCode.PROOF_MALFORMED, "PRF-3", error.detail)
    except StatementError:
        return Fault(FaultCode.PROOF_WRONG_KEY, "PRF-3", "not signed by the key that it names")

    # [PRF-4] this request: method, address, body
    wanted = {"htm": method, "htu": url, "bdg": _digest(body)}
    # [PRF-5] this token, or none
    if token is not None:
        wanted["ath"] = _digest(token.encode())
    if claims.keys() != expected or any(claims[claim] != value for claim, value in wanted.items()):
        return Fault(
            FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "PRF-5" if claims.get("ath") != wanted.get("ath") else "PRF-4"
        )

    # [PRF-6] just now
    if not -caps.skew_s <= at - iat <= caps.proof_age_s:
        return Fault(FaultCode.PROOF_STALE, "PRF-6")
    return Proof(jti=jti, iat=iat, key=signer, digest=hashlib.sha256(proof.encode()).digest())


def _digest(raw: bytes) -> str:
    return keys.b64u(hashlib.sha256(raw).digest())
