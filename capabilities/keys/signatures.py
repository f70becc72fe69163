"""Signatures of 64 bytes by a key of either algorithm; the key alone says which.

Ed25519 (RFC 8032) is verified by libsodium, ECDSA over P-256 with SHA-256 (FIPS 186-5; r and s of 32 bytes each, as in
RFC 7518 section 3.4) by OpenSSL. Of the two values of s that verify, r with s and r with n - s, only the lower counts,
so that nobody without the key can make a second signature out of a first. Signatures made here are deterministic.
"""

from __future__ import annotations

from enum import Enum
from typing import Final, assert_never

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, utils
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from nacl.bindings import crypto_sign_open
from nacl.exceptions import BadSignatureError

from capabilities.keys import keys
from capabilities.keys.signing_key import SigningKey
from capabilities.values.errors import BadKeyError, FaultCode

SIGNATURE_BYTES: Final = 64
"""Bytes of a signature of both algorithms (RFC 8032 section 5.1.6; RFC 7518 section 3.4)."""
P256_N: Final = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551
"""Order of P-256 (SP 800-186 section 3.2.1.3)."""
_LOW_S: Final = P256_N // 2
_HALF: Final = SIGNATURE_BYTES // 2
_ECDSA: Final = ec.ECDSA(hashes.SHA256())
_DETERMINISTIC: Final = ec.ECDSA(hashes.SHA256(), deterministic_signing=True)
"""RFC 6979: the same key and message give the same signature, and no bad random number gives the key away."""


class Checked(Enum):
    """Answer of `verify`; true exactly when the signature holds."""

    HOLDS = "holds"
    DOES_NOT_HOLD = "does not hold"

    def __bool__(self) -> bool:
        return self is Checked.HOLDS


def sign(key: keys.PrivateKey, message: bytes) -> bytes:
    """The 64 bytes of the signature by `key` over `message`; of a key whose secret is here, always the same.

    Raises:
        BadKeyError: `KEY_MALFORMED` for a key of another curve than P-256, or one whose holder made no signature.
    """
    if isinstance(key, Ed25519PrivateKey):
        return key.sign(message)
    if isinstance(key, SigningKey):
        return _signed_elsewhere(key, message)
    keys.public_raw(key)
    r, s = utils.decode_dss_signature(key.sign(message, _DETERMINISTIC))
    return r.to_bytes(_HALF, "big") + min(s, P256_N - s).to_bytes(_HALF, "big")


def _signed_elsewhere(key: SigningKey, message: bytes) -> bytes:
    """Signature by the holder of the key, in the one spelling, checked: what it says goes out under our name."""
    signature = key.sign(message)
    if keys.algorithm_of(key.public) is keys.Algorithm.P256:
        s = int.from_bytes(signature[_HALF:], "big")
        signature = signature[:_HALF] + min(s, P256_N - s % P256_N).to_bytes(_HALF, "big")
    if not verify(key.public, message, signature):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "the holder of the key made no signature of it")
    return signature


def verify(key: bytes, message: bytes, signature: bytes) -> Checked:
    """Checks that `signature`, in its one spelling, is by the raw public key `key` over `message`.

    Raises:
        BadKeyError: `KEY_MALFORMED` for a key that nothing may be verified with.
    """
    keys.check_raw(key)
    if len(signature) != SIGNATURE_BYTES:
        return Checked.DOES_NOT_HOLD
    match keys.algorithm_of(key):
        case keys.Algorithm.ED25519:
            return _ed25519(key, message, signature)
        case keys.Algorithm.P256:
            return _p256(key, message, signature)
        case algorithm:
            assert_never(algorithm)


def _ed25519(key: bytes, message: bytes, signature: bytes) -> Checked:
    try:
        crypto_sign_open(signature + message, key)
    except BadSignatureError:
        return Checked.DOES_NOT_HOLD
    return Checked.HOLDS


def _p256(key: bytes, message: bytes, signature: bytes) -> Checked:
    r, s = int.from_bytes(signature[:_HALF], "big"), int.from_bytes(signature[_HALF:], "big")
    if not (1 <= r < P256_N and 1 <= s <= _LOW_S):
        return Checked.DOES_NOT_HOLD
    try:
        keys.p256_point(key).verify(utils.encode_dss_signature(r, s), message, _ECDSA)
    except InvalidSignature:
        return Checked.DOES_NOT_HOLD
    return Checked.HOLDS
