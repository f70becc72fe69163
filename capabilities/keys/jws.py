"""Compact JWS (RFC 7515) with Ed25519 (RFC 8037) or P-256 (RFC 7518), in one spelling each.

Proofs and statements are made of it. PyJWT writes it, `capabilities.keys.signatures` signs and verifies; the key fixes
the algorithm. Points on which readers are lenient are decided here before a signature is asked for: base64url,
duplicate members, unknown header members, `use` and `key_ops` of a key. Header members never choose a key or an
algorithm: `alg` must be that of the key.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, assert_never

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from capabilities.keys import keys, signatures
from capabilities.keys.keys import Algorithm
from capabilities.keys.signing_key import SigningKey
from capabilities.values import strict_json
from capabilities.values.errors import BadKeyError, FaultCode, StatementError

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
    from jwt import PyJWS

EDDSA: Final = "EdDSA"
ES256: Final = "ES256"
_ALGORITHMS: Final = frozenset({EDDSA, ES256})
_ALSO_NAMED: Final = {EDDSA: frozenset({EDDSA, "Ed25519"}), ES256: frozenset({ES256})}
"""Names that `alg` of a JWK may give a key's algorithm (RFC 9864 names Ed25519 beside EdDSA)."""
_JWK_REQUIRED: Final = {"OKP": frozenset({"kty", "crv", "x"}), "EC": frozenset({"kty", "crv", "x", "y"})}
_JWK_OPTIONAL: Final = frozenset({"use", "key_ops", "alg", "kid"})


@dataclass(frozen=True, slots=True)
class Unverified:
    """A compact JWS that is well formed; nobody has checked its signature.

    Attributes:
        signed: the first two parts as they came, which are the signed bytes.
        header: its members; `alg` is EdDSA or ES256.
        header_raw, payload_raw, signature: the decoded bytes.
    """

    signed: bytes
    header: dict[str, object]
    header_raw: bytes
    payload_raw: bytes
    signature: bytes


def algorithm_name(raw: bytes) -> str:
    """Algorithm name in `alg` for a raw public key.

    Raises:
        BadKeyError: `KEY_MALFORMED` for a length that no key has.
    """
    match keys.algorithm_of(raw):
        case Algorithm.ED25519:
            return EDDSA
        case Algorithm.P256:
            return ES256
        case algorithm:
            assert_never(algorithm)


def sign(header: dict[str, object], payload: bytes, key: keys.PrivateKey) -> str:
    """The compact JWS of `payload` with these header members and the key's `alg`, the header in canonical form.

    Raises:
        BadKeyError: `KEY_MALFORMED` for a key of another curve than P-256, or one whose holder made no signature.
    """
    if isinstance(key, SigningKey):
        return _signed_elsewhere(header, payload, key)
    algorithm = EDDSA if isinstance(key, Ed25519PrivateKey) else ES256
    keys.public_raw(key)
    return _engine().encode(payload, key, algorithm=algorithm, headers=header, sort_headers=True)


@functools.cache
def _engine() -> PyJWS:
    # Loaded by the first signature: whoever only reads is spared half of what a verifier would load.
    import jwt
    from jwt.algorithms import ECAlgorithm

    class LowS(ECAlgorithm):
        """ES256 with the one signature that `capabilities.keys.signatures` makes."""

        def sign(self, msg: bytes, key: EllipticCurvePrivateKey) -> bytes:
            return signatures.sign(key, msg)

    engine = jwt.PyJWS(algorithms=[EDDSA])
    engine.register_algorithm(ES256, LowS(ECAlgorithm.SHA256))
    return engine


def _signed_elsewhere(header: dict[str, object], payload: bytes, key: SigningKey) -> str:
    """The same text as by PyJWT, which takes no key whose secret is not here."""
    whole = {"typ": "JWT", **header, "alg": algorithm_name(key.public)}
    signed = f"{keys.b64u(strict_json.canonical(whole))}.{keys.b64u(payload)}"
    return f"{signed}.{keys.b64u(signatures.sign(key, signed.encode()))}"


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
    algorithm = header.get("alg")
    if not isinstance(algorithm, str) or algorithm not in _ALGORITHMS or len(signature) != signatures.SIGNATURE_BYTES:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "signed with neither EdDSA nor ES256")
    return Unverified(text[: text.rindex(".")].encode(), header, header_raw, payload_raw, signature)


def check(unverified: Unverified, key: bytes) -> bytes:
    """The payload, when `key` signed it with its own algorithm.

    Raises:
        StatementError: `STATEMENT_UNTRUSTED` otherwise.
        BadKeyError: `KEY_MALFORMED` for a key that nothing may be verified with.
    """
    if unverified.header["alg"] != algorithm_name(key):
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "another algorithm than the key's")
    if not signatures.verify(key, unverified.signed, unverified.signature):
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "not signed by this key")
    return unverified.payload_raw


def public_key(raw: bytes) -> keys.PublicKey:
    """The key object of a raw public key, for PyJWT.

    Raises:
        BadKeyError: `KEY_MALFORMED` for a length that no key has, or no point of P-256.
    """
    match keys.algorithm_of(raw):
        case Algorithm.ED25519:
            return Ed25519PublicKey.from_public_bytes(raw)
        case Algorithm.P256:
            return keys.p256_point(raw)
        case algorithm:
            assert_never(algorithm)


def jwk(raw: bytes) -> dict[str, object]:
    """The minimal public JWK of a key.

    Raises:
        BadKeyError: `KEY_MALFORMED` for a length that no key has, or no point of P-256.
    """
    match keys.algorithm_of(raw):
        case Algorithm.ED25519:
            return {"crv": "Ed25519", "kty": "OKP", "x": keys.b64u(raw)}
        case Algorithm.P256:
            x, y = map(keys.b64u, keys.p256_coordinates(raw))
            return {"crv": "P-256", "kty": "EC", "x": x, "y": y}
        case algorithm:
            assert_never(algorithm)


def key_of_jwk(value: object) -> bytes:
    """The raw key of a public Ed25519 or P-256 JWK that may verify signatures.

    Raises:
        BadKeyError: `KEY_MALFORMED` for another kind of key, a private member or an unknown one; `KEY_WRONG_ROLE` when
            its `use`, `key_ops` or `alg` forbid verifying.
    """
    kind = value.get("kty") if isinstance(value, dict) else None
    required = _JWK_REQUIRED.get(kind) if isinstance(kind, str) else None
    if not isinstance(value, dict) or required is None or not required <= value.keys() <= required | _JWK_OPTIONAL:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not the members of a public key")
    x, y = _coordinate(value["x"]), _coordinate(value.get("y", ""))
    match kind, value["crv"]:
        case "OKP", "Ed25519":
            algorithm = EDDSA
        case "EC", "P-256":
            algorithm = ES256
        case _:
            raise BadKeyError(FaultCode.KEY_MALFORMED, "neither Ed25519 nor P-256")
    if value.get("use", "sig") != "sig" or value.get("key_ops", ["verify"]) != ["verify"]:
        raise BadKeyError(FaultCode.KEY_WRONG_ROLE, "not a key to verify with")
    named = value.get("alg", algorithm)
    if not isinstance(named, str) or named not in _ALSO_NAMED[algorithm]:
        raise BadKeyError(FaultCode.KEY_WRONG_ROLE, "a key of another algorithm")
    if algorithm == ES256:
        return keys.p256_raw(x, y)
    if len(x) != keys.KEY_BYTES:
        raise BadKeyError(FaultCode.KEY_MALFORMED, f"not {keys.KEY_BYTES} bytes")
    return keys.check_raw(x)


def _coordinate(value: object) -> bytes:
    if not isinstance(value, str):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "a coordinate that is no text")
    return keys.unb64u(value)
