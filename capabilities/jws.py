"""Compact JWS (RFC 7515) with Ed25519 (RFC 8037) in one spelling: what both proofs and statements are made of.

PyJWT makes and checks the signature; the algorithm is fixed. What it is lenient about is decided here before it is
asked: base64url, duplicate members, unknown header members, `use` and `key_ops` of a key. Header members never choose a
key or an algorithm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import jwt

from capabilities import keys, strict_json
from capabilities.errors import BadKeyError, FaultCode, StatementError

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

ALGORITHM: Final = "EdDSA"
_ENGINE: Final = jwt.PyJWS(algorithms=[ALGORITHM])
_JWK_REQUIRED: Final = frozenset({"kty", "crv", "x"})
_JWK_ALLOWED: Final = _JWK_REQUIRED | {"use", "key_ops", "alg", "kid"}


@dataclass(frozen=True, slots=True)
class Unverified:
    """A compact JWS that is well formed; nobody has checked its signature.

    Attributes:
        text: the three parts as they came.
        header: its members; `alg` is EdDSA.
        header_raw, payload_raw: the decoded bytes.
    """

    text: str
    header: dict[str, object]
    header_raw: bytes
    payload_raw: bytes


def sign(header: dict[str, object], payload: bytes, key: Ed25519PrivateKey) -> str:
    """The compact JWS of `payload` with these header members and `alg`, the header in canonical form."""
    return _ENGINE.encode(payload, key, algorithm=ALGORITHM, headers=header, sort_headers=True)


def split(text: str, *, most_bytes: int) -> Unverified:
    """The parts of a compact JWS.

    Raises:
        StatementError: `STATEMENT_MALFORMED` when it is longer than `most_bytes`, has not three parts in canonical
            base64url, a header that is no strict JSON object, or another algorithm.
    """
    if len(text) > most_bytes:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, f"not a text of at most {most_bytes} characters")
    parts = text.split(".")
    if len(parts) != 3:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "not three parts")
    try:
        header_raw, payload_raw, signature = (keys.unb64u(part) for part in parts)
    except BadKeyError:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "not canonical base64url") from None
    header = strict_json.parse_object(header_raw)
    if header.get("alg") != ALGORITHM or len(signature) != 64:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "not signed with Ed25519")
    return Unverified(text, header, header_raw, payload_raw)


def check(unverified: Unverified, key: bytes) -> bytes:
    """The payload, when `key` signed it.

    Raises:
        StatementError: `STATEMENT_UNTRUSTED` otherwise.
        BadKeyError: `KEY_MALFORMED` for a key that nothing may be verified with.
    """
    public = keys.public_key(key)
    try:
        verified = _ENGINE.decode_complete(unverified.text, public, algorithms=[ALGORITHM])
    except jwt.exceptions.PyJWTError:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "not signed by this key") from None
    payload = verified["payload"]
    if payload != unverified.payload_raw:  # what was verified is what will be read
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "two readers see two payloads")
    return unverified.payload_raw


def jwk(raw: bytes) -> dict[str, object]:
    """The minimal public JWK of a key."""
    return {"crv": "Ed25519", "kty": "OKP", "x": keys.b64u(raw)}


def key_of_jwk(value: object) -> bytes:
    """The raw key of a public Ed25519 JWK that may verify signatures.

    Raises:
        BadKeyError: `KEY_MALFORMED` for another kind of key, a private member or an unknown one; `KEY_WRONG_ROLE` when
            its `use`, `key_ops` or `alg` forbid verifying.
    """
    if not isinstance(value, dict) or not _JWK_REQUIRED <= value.keys() <= _JWK_ALLOWED:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not the members of a public key")
    if value["kty"] != "OKP" or value["crv"] != "Ed25519" or not isinstance(value["x"], str):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not an Ed25519 key")
    if value.get("use", "sig") != "sig" or value.get("key_ops", ["verify"]) != ["verify"]:
        raise BadKeyError(FaultCode.KEY_WRONG_ROLE, "not a key to verify with")
    if value.get("alg", ALGORITHM) not in {ALGORITHM, "Ed25519"}:
        raise BadKeyError(FaultCode.KEY_WRONG_ROLE, "a key of another algorithm")
    return keys.check_raw(keys.unb64u(value["x"]))
