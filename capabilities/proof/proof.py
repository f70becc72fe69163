"""Proof of possession: a signature by a key over one request (RFC 9449 DPoP, and the digest of the body).

Clauses [PRF-1] to [PRF-6] in docs/spec.md. The memory of proofs seen before is the verifier's, not this module's.

A proof is read in one of two ways, with one result. All of an honest proof but its id, time and signature is known
beforehand, so the exact way only compares bytes. Any other spelling is read strictly, step by step.
"""

from __future__ import annotations

import functools
import hashlib
import hmac
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import msgspec

from capabilities.keys import jws, keys, signatures
from capabilities.proof import freshness
from capabilities.values import strict_json
from capabilities.values.errors import BadKeyError, Fault, FaultCode, StatementError
from capabilities.values.fast_dataclass import maker

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

TYPE: Final = "dpop+jwt"
_JTI: Final = re.compile(r"[A-Za-z0-9_-]{16,64}", re.ASCII)
_CLAIMS: Final = frozenset({"jti", "htm", "htu", "iat", "bdg"})
_TAIL: Final = re.compile(rb'"iat":(0|[1-9][0-9]{0,14}),"jti":"([A-Za-z0-9_-]{16,64})"\}')
"""End of the canonical claims of a proof: `iat` below 10^15, so inside the integers of JSON, and `jti`."""
_COMPACT: Final = msgspec.json.Encoder(order="sorted")
"""Writes texts of ASCII as RFC 8785 does."""
_KEYS_AT_ONCE: Final = 4_096
"""Keys whose header is remembered."""
_NOT_SIGNED: Final = Fault(FaultCode.PROOF_WRONG_KEY, "PRF-3", "not signed by the key that it names")


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


_make_proof: Final = maker(Proof)


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
        claims["ath"] = token_digest(token)
    raw = keys.public_raw(key)
    signed = _canonical_header(raw) + keys.b64u(strict_json.canonical(claims))
    return f"{signed}.{keys.b64u(signatures.sign(key, signed.encode()))}"


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
    if not proof:
        return Fault(FaultCode.PROOF_MISSING, "PRF-1")
    wanted = {"htm": method, "htu": url, "bdg": _digest(body)}
    if token is not None:
        wanted["ath"] = token_digest(token)
    found = None if key is None or len(proof) > caps.proof_bytes else _exact(proof, key, wanted)
    if found is None:
        found = _strict(proof, key, wanted, caps)
    # [PRF-6] just now
    return found if isinstance(found, Fault) else freshness.stale(found.iat, at=at, caps=caps) or found


def token_digest(token: str) -> str:
    """The base64url SHA-256 of a token's text, as `ath` states it (RFC 9449 section 4.2)."""
    # Only ASCII is a token; any other text presented as one gets a digest of its own, and no exception.
    return _digest(token.encode("utf-8", "surrogatepass"))


def _digest(raw: bytes) -> str:
    return keys.b64u(hashlib.sha256(raw).digest())


def _exact(proof: str, key: bytes, wanted: Mapping[str, str]) -> Proof | Fault | None:
    """The proof when it has the canonical spelling for `key` and the wanted claims; None when it has another one.

    The wanted bytes are the canonical ones of values that we chose, so a proof that equals them passes the steps 1, 2,
    4 and 5 of `_strict` by construction. The signature alone is left.
    """
    head = _canonical_header(key)
    if not head or not proof.startswith(head):
        return None
    body, _, signature_text = proof[len(head) :].partition(".")
    try:
        payload, signature = keys.unb64u(body), keys.unb64u(signature_text)
        start = _COMPACT.encode(wanted)[:-1] + b","
    except (BadKeyError, UnicodeEncodeError):
        return None
    if not start.isascii() or not payload.startswith(start):
        return None
    tail = _TAIL.fullmatch(payload, len(start))
    if tail is None or len(signature) != signatures.SIGNATURE_BYTES:
        return None
    try:
        holds = signatures.verify(key, proof[: len(head) + len(body)].encode(), signature)
    except BadKeyError:
        return None
    if not holds:
        return _NOT_SIGNED
    return _make_proof(tail[2].decode(), int(tail[1]), key, _digest_of(proof))


@functools.lru_cache(maxsize=_KEYS_AT_ONCE)
def _canonical_header(key: bytes) -> str:
    """Header of a proof by `key` in canonical base64url with its dot; empty for bytes that are no key."""
    try:
        header = f'{{"alg":"{jws.algorithm_name(key)}","jwk":{keys.minimal_jwk(key)},"typ":"{TYPE}"}}'
    except BadKeyError:
        return ""
    return keys.b64u(header.encode()) + "."


def _strict(proof: str, key: bytes | None, wanted: Mapping[str, str], caps: Caps) -> Proof | Fault:
    # [PRF-1] bounded, one spelling
    try:
        unverified = jws.split(proof, most_bytes=caps.proof_bytes)
        claims = strict_json.parse_object(unverified.payload_raw)
    except StatementError as error:
        return Fault(FaultCode.PROOF_MALFORMED, "PRF-1", error.detail)

    # [PRF-2] the closed set of header members and claims, each of its type
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
        if header["alg"] != jws.algorithm_name(signer):
            return Fault(FaultCode.PROOF_MALFORMED, "PRF-3", "not the algorithm of the key")
        if key is not None and not hmac.compare_digest(signer, key):
            return Fault(FaultCode.PROOF_WRONG_KEY, "PRF-3")
        jws.check(unverified, signer)
    except BadKeyError as error:
        return Fault(FaultCode.PROOF_MALFORMED, "PRF-3", error.detail)
    except StatementError:
        return _NOT_SIGNED

    # [PRF-4] this request: method, address, body
    # [PRF-5] this token, or none
    if claims.keys() != wanted.keys() | _CLAIMS or any(claims[claim] != value for claim, value in wanted.items()):
        clause = "PRF-5" if claims.get("ath") != wanted.get("ath") else "PRF-4"
        return Fault(FaultCode.PROOF_NOT_FOR_THIS_REQUEST, clause)
    return Proof(jti=jti, iat=iat, key=signer, digest=_digest_of(proof))


def _digest_of(proof: str) -> bytes:
    return hashlib.sha256(proof.encode()).digest()
