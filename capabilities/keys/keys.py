"""Ed25519 and P-256 keys, their names and their files.

A raw public key is 32 bytes (Ed25519, RFC 8032) or 33 (P-256, the compressed point of SEC 1 section 2.3.3); its length
says which, and the algorithm follows the key. Refused wherever a key enters: an Ed25519 key of small order (under it a
signature can be made without any secret), a point that is not on the curve, and every second spelling.
"""

from __future__ import annotations

import binascii
import functools
import hashlib
from enum import StrEnum
from typing import Final, assert_never, overload

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from capabilities.keys.signing_key import SigningKey
from capabilities.values.errors import BadKeyError, FaultCode

SoftwareKey = Ed25519PrivateKey | ec.EllipticCurvePrivateKey
"""A private key of either algorithm whose secret is here; another curve than P-256 is refused where it is used."""
PrivateKey = SoftwareKey | SigningKey
"""A private key, here or where it signs."""
PublicKey = Ed25519PublicKey | ec.EllipticCurvePublicKey

KEY_BYTES: Final = 32
"""Length of a raw Ed25519 key."""
P256_BYTES: Final = 33
"""Length of a raw P-256 key."""
COORDINATE_BYTES: Final = 32
P256_P: Final = 2**256 - 2**224 + 2**192 + 2**96 - 1
"""The field of P-256 (SP 800-186 section 3.2.1.3)."""
_P256_SIGNS: Final = (2, 3)
"""First byte of a compressed point: y is even, y is odd."""
_P: Final = 2**255 - 19
"""The field of Curve25519 (RFC 8032 section 5.1)."""
_ORDER_EIGHT_Y: Final = 0x05FC536D880238B13933C6D305ACDFD5F098EFF289F4C345B027B2C28F95E826
"""The y of two of the four points of order eight; a test adds them up."""
_SMALL_ORDER_Y: Final = frozenset(
    {
        0,
        1,
        _P - 1,
        _ORDER_EIGHT_Y,
        _P - _ORDER_EIGHT_Y,
    }
)
_SPELLINGS_REFUSED: Final = frozenset(
    (y | sign << 255).to_bytes(KEY_BYTES, "little") for y in (*_SMALL_ORDER_Y, *range(_P, 2**255)) for sign in (0, 1)
)
"""Refused encodings of Ed25519 points: those of small order, and those whose y is not below the field.

There are so few of them that they are listed.
"""


_URL_SAFE: Final = bytes.maketrans(b"+/", b"-_")
_PLAIN: Final = bytes.maketrans(b"-_", b"+/")
_PADDING: Final = (b"", b"===", b"==", b"=")
"""Base64 padding by the length of a text modulo 4."""


class Algorithm(StrEnum):
    """Algorithm of a key; the value is the curve's name in a JWK.

    RFC 7518 section 6.2.1.1, RFC 8037 section 2.
    """

    ED25519 = "Ed25519"
    P256 = "P-256"


# --- keys ------------------------------------------------------------------------------------------------------------


@overload
def generate() -> Ed25519PrivateKey: ...
@overload
def generate(algorithm: Algorithm) -> SoftwareKey: ...
def generate(algorithm: Algorithm = Algorithm.ED25519) -> SoftwareKey:
    """A new private key from the operating system's randomness."""
    match algorithm:
        case Algorithm.ED25519:
            return Ed25519PrivateKey.generate()
        case Algorithm.P256:
            return ec.generate_private_key(ec.SECP256R1())
        case _:
            assert_never(algorithm)


def public_raw(key: PrivateKey | PublicKey) -> bytes:
    """The raw bytes of the public key.

    Raises:
        BadKeyError: `KEY_MALFORMED` for a key of another curve.
    """
    if isinstance(key, SigningKey):
        return check_raw(key.public)
    public = key if isinstance(key, Ed25519PublicKey | ec.EllipticCurvePublicKey) else key.public_key()
    if isinstance(public, Ed25519PublicKey):
        return public.public_bytes_raw()
    if not isinstance(public.curve, ec.SECP256R1):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "a key of another curve than P-256")
    return public.public_bytes(serialization.Encoding.X962, serialization.PublicFormat.CompressedPoint)


def algorithm_of(raw: bytes) -> Algorithm:
    """Algorithm of a raw public key, told by its length.

    Raises:
        BadKeyError: `KEY_MALFORMED` for another type or length.
    """
    match raw:
        case bytes() if len(raw) == KEY_BYTES:
            return Algorithm.ED25519
        case bytes() if len(raw) == P256_BYTES:
            return Algorithm.P256
        case _:
            raise BadKeyError(FaultCode.KEY_MALFORMED, f"neither {KEY_BYTES} nor {P256_BYTES} bytes")


def check_raw(raw: object) -> bytes:
    """The value, when it is a usable raw public key.

    Raises:
        BadKeyError: `KEY_MALFORMED` for another type or length, a non-canonical encoding, a point of small order
            (Ed25519) or one that is not on the curve (P-256).
    """
    if not isinstance(raw, bytes):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not bytes")
    match algorithm_of(raw):
        case Algorithm.ED25519:
            if raw in _SPELLINGS_REFUSED:
                raise BadKeyError(FaultCode.KEY_MALFORMED, "not a canonical point of large order")
        case Algorithm.P256:
            p256_point(raw)
        case algorithm:
            assert_never(algorithm)
    return raw


@functools.lru_cache(maxsize=4_096)
def p256_point(raw: bytes) -> ec.EllipticCurvePublicKey:
    """The key object of a compressed point of P-256, remembered: finding y costs as much as a signature.

    Raises:
        BadKeyError: `KEY_MALFORMED` for another length or prefix, an x of the field's size or more, or no point.
    """
    canonical = len(raw) == P256_BYTES and raw[0] in _P256_SIGNS and int.from_bytes(raw[1:], "big") < P256_P
    if not canonical:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not a canonical compressed point")
    try:
        return ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), raw)
    except ValueError:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not a point of P-256") from None


def p256_raw(x: bytes, y: bytes) -> bytes:
    """The raw key of a point of P-256 that is given by both coordinates, 32 bytes each.

    Raises:
        BadKeyError: `KEY_MALFORMED` for another length, a coordinate of the field's size or more, or no point.
    """
    if len(x) != COORDINATE_BYTES or len(y) != COORDINATE_BYTES:
        raise BadKeyError(FaultCode.KEY_MALFORMED, f"a coordinate that is not {COORDINATE_BYTES} bytes")
    raw = bytes([_P256_SIGNS[y[-1] & 1]]) + x
    if p256_coordinates(raw) != (x, y):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not a point of P-256")
    return raw


def p256_coordinates(raw: bytes) -> tuple[bytes, bytes]:
    """X and y of a raw P-256 key, 32 bytes each.

    Raises:
        BadKeyError: as `p256_point`.
    """
    numbers = p256_point(raw).public_numbers()
    return numbers.x.to_bytes(COORDINATE_BYTES, "big"), numbers.y.to_bytes(COORDINATE_BYTES, "big")


def public_key(raw: bytes) -> PublicKey:
    """The key object of a raw public key.

    Raises:
        BadKeyError: as `check_raw`.
    """
    match algorithm_of(raw):
        case Algorithm.ED25519:
            return Ed25519PublicKey.from_public_bytes(check_raw(raw))
        case Algorithm.P256:
            return p256_point(raw)
        case algorithm:
            assert_never(algorithm)


@functools.lru_cache(maxsize=4_096)
def thumbprint(raw: bytes) -> str:
    """The RFC 7638 thumbprint of a raw key: SHA-256 of its minimal JWK, base64url.

    Raises:
        BadKeyError: `KEY_MALFORMED` for a length that no key has, or no point of P-256.
    """
    return b64u(thumbprint_bytes(raw))


def thumbprint_bytes(raw: bytes) -> bytes:
    """The 32 bytes of `thumbprint`."""
    return hashlib.sha256(minimal_jwk(raw).encode()).digest()


def minimal_jwk(raw: bytes) -> str:
    """The canonical JSON of the minimal public JWK of a raw key (RFC 7638 section 3.2, RFC 8037 appendix A.3).

    Raises:
        BadKeyError: as `thumbprint`.
    """
    # No value needs an escape.
    match algorithm_of(raw):
        case Algorithm.ED25519:
            return f'{{"crv":"Ed25519","kty":"OKP","x":"{b64u(raw)}"}}'
        case Algorithm.P256:
            x, y = map(b64u, p256_coordinates(raw))
            return f'{{"crv":"P-256","kty":"EC","x":"{x}","y":"{y}"}}'
        case algorithm:
            assert_never(algorithm)


def b64u(raw: bytes) -> str:
    """Base64url without padding (RFC 7515 section 2)."""
    return binascii.b2a_base64(raw, newline=False).translate(_URL_SAFE).rstrip(b"=").decode()


def unb64u(value: str) -> bytes:
    """The bytes of a base64url text in its one spelling: no padding, other alphabet, white space or spare bits.

    Raises:
        BadKeyError: `KEY_MALFORMED` for any other spelling.
    """
    try:
        raw = binascii.a2b_base64(value.encode("ascii").translate(_PLAIN) + _PADDING[len(value) % 4])
    except (UnicodeEncodeError, binascii.Error):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not base64url") from None
    # The decoder is lenient, so encode the result again: bytes have one text in base64url, and only that one is taken.
    if b64u(raw) != value:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not the canonical base64url")
    return raw


def to_pem(key: SoftwareKey, passphrase: bytes) -> bytes:
    """The key as PKCS #8, encrypted under a passphrase that is not empty.

    Raises:
        BadKeyError: `KEY_MALFORMED` for an empty passphrase or a key of another curve.
    """
    if not passphrase:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "an empty passphrase")
    public_raw(key)
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.BestAvailableEncryption(passphrase),
    )


def from_pem(pem: bytes, passphrase: bytes) -> SoftwareKey:
    """The key of an encrypted PKCS #8 file.

    Raises:
        BadKeyError: `KEY_MALFORMED` for a wrong passphrase, an unencrypted file, or a key of another kind.
    """
    try:
        key = serialization.load_pem_private_key(pem, passphrase)
    except (ValueError, TypeError):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not a key, or a wrong passphrase") from None
    if not isinstance(key, Ed25519PrivateKey | ec.EllipticCurvePrivateKey):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "neither an Ed25519 nor a P-256 key")
    public_raw(key)
    return key
