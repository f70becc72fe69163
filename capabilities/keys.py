"""Ed25519 keys, their names, and the bundle of public keys that a verifier trusts.

A raw public key is 32 bytes (RFC 8032). Keys of small order and keys in a non-canonical encoding are refused wherever
one enters: under a key of small order a signature can be made without any secret.
"""

from __future__ import annotations

import base64
import binascii
import functools
import hashlib
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from capabilities import strict_json, text
from capabilities.errors import BadKeyError, CapabilityError, FaultCode

if TYPE_CHECKING:
    from collections.abc import Mapping

KEY_BYTES: Final = 32
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


# --- keys ------------------------------------------------------------------------------------------------------------


def generate() -> Ed25519PrivateKey:
    """A new private key from the operating system's randomness."""
    return Ed25519PrivateKey.generate()


def public_raw(key: Ed25519PrivateKey | Ed25519PublicKey) -> bytes:
    """The 32 raw bytes of the public key."""
    public = key.public_key() if isinstance(key, Ed25519PrivateKey) else key
    return public.public_bytes_raw()


def check_raw(raw: object) -> bytes:
    """The value, when it is a usable raw public key.

    Raises:
        BadKeyError: `KEY_MALFORMED` for another type or length, a non-canonical encoding, or a point of small order.
    """
    if not isinstance(raw, bytes) or len(raw) != KEY_BYTES:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not 32 bytes")
    y = int.from_bytes(raw, "little") & ((1 << 255) - 1)
    if y >= _P or y in _SMALL_ORDER_Y:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not a canonical point of large order")
    return raw


def public_key(raw: bytes) -> Ed25519PublicKey:
    """The key object of a raw public key.

    Raises:
        BadKeyError: as `check_raw`.
    """
    return Ed25519PublicKey.from_public_bytes(check_raw(raw))


@functools.lru_cache(maxsize=4_096)
def thumbprint(raw: bytes) -> str:
    """The RFC 7638 thumbprint of an Ed25519 key (RFC 8037 appendix A.3): SHA-256 of its minimal JWK, base64url."""
    return b64u(thumbprint_bytes(raw))


def thumbprint_bytes(raw: bytes) -> bytes:
    """The 32 bytes of `thumbprint`."""
    # The canonical JSON of three fixed members whose values need no escape.
    return hashlib.sha256(f'{{"crv":"Ed25519","kty":"OKP","x":"{b64u(raw)}"}}'.encode()).digest()


def b64u(raw: bytes) -> str:
    """Base64url without padding (RFC 7515 section 2)."""
    return base64.urlsafe_b64encode(raw).rstrip(b"=").decode()


def unb64u(value: str) -> bytes:
    """The bytes of a base64url text in its one spelling: no padding, other alphabet, white space or spare bits.

    Raises:
        BadKeyError: `KEY_MALFORMED` for any other spelling.
    """
    try:
        raw = base64.b64decode(value.encode("ascii") + b"=" * (-len(value) % 4), altchars=b"-_", validate=True)
    except (UnicodeEncodeError, binascii.Error):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not base64url") from None
    if b64u(raw) != value:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not the canonical base64url")
    return raw


def to_pem(key: Ed25519PrivateKey, passphrase: bytes) -> bytes:
    """The key as PKCS #8, encrypted under a passphrase that is not empty.

    Raises:
        BadKeyError: `KEY_MALFORMED` for an empty passphrase.
    """
    if not passphrase:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "an empty passphrase")
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.BestAvailableEncryption(passphrase),
    )


def from_pem(pem: bytes, passphrase: bytes) -> Ed25519PrivateKey:
    """The key of an encrypted PKCS #8 file.

    Raises:
        BadKeyError: `KEY_MALFORMED` for a wrong passphrase, an unencrypted file, or a key of another kind.
    """
    try:
        key = serialization.load_pem_private_key(pem, passphrase)
    except (ValueError, TypeError):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not a key, or a wrong passphrase") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not an Ed25519 key")
    return key


# --- trust -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TrustBundle:
    """The public keys that a verifier trusts, by what each may sign. Raw keys, 32 bytes each; no key has two roles.

    Attributes:
        issuer: canonical URL of the identity provider.
        version: grows with each change; part of every cache key.
        roots: by root key id.
        attesters, feed, registry, ledger: by role.

    Raises:
        BadKeyError: `KEY_MALFORMED` for a bad key, an empty role or a bad issuer; `KEY_WRONG_ROLE` for a key with two
            roles.
    """

    issuer: str
    version: int
    roots: Mapping[int, bytes]
    attesters: frozenset[bytes]
    feed: frozenset[bytes]
    registry: frozenset[bytes]
    ledger: frozenset[bytes]

    def __post_init__(self) -> None:
        try:
            text.url(self.issuer, most_bytes=256)
        except CapabilityError:
            raise BadKeyError(FaultCode.KEY_MALFORMED, "the issuer is not a canonical URL") from None
        if self.version < 0:
            raise BadKeyError(FaultCode.KEY_MALFORMED, "the version is not a whole number")
        object.__setattr__(self, "roots", MappingProxyType(dict(self.roots)))
        if not all(0 <= number < 2**32 for number in self.roots):
            raise BadKeyError(FaultCode.KEY_MALFORMED, "a root key id that is no 32-bit number")
        if len(set(self.roots.values())) != len(self.roots):
            # The id in a token is not signed: two ids of one key would make two spellings of one token.
            raise BadKeyError(FaultCode.KEY_WRONG_ROLE, "a root key with two ids")
        roles = (frozenset(self.roots.values()), self.attesters, self.feed, self.registry, self.ledger)
        if not all(roles):
            raise BadKeyError(FaultCode.KEY_MALFORMED, "a role without a key")
        if sum(map(len, roles)) != len(self.all_keys):
            raise BadKeyError(FaultCode.KEY_WRONG_ROLE, "a key with two roles")
        for raw in self.all_keys:
            check_raw(raw)

    @property
    def all_keys(self) -> frozenset[bytes]:
        """Every key of the bundle: none of them may belong to an agent."""
        return frozenset(self.roots.values()) | self.attesters | self.feed | self.registry | self.ledger

    def to_json(self) -> bytes:
        """The canonical JSON (RFC 8785) of the bundle."""
        return strict_json.canonical(
            {
                "issuer": self.issuer,
                "version": self.version,
                "roots": {str(number): b64u(raw) for number, raw in self.roots.items()},
                **{role: sorted(map(b64u, getattr(self, role))) for role in _SETS},
            }
        )

    @classmethod
    def from_json(cls, raw: bytes) -> TrustBundle:
        """The bundle of its JSON.

        Raises:
            StatementError: `STATEMENT_MALFORMED` when the JSON is not of this shape.
            BadKeyError: as the constructor.
        """
        members = strict_json.parse_object(raw)
        roots = members.get("roots")
        if members.keys() != {"issuer", "version", "roots", *_SETS} or not isinstance(roots, dict):
            raise BadKeyError(FaultCode.KEY_MALFORMED, "not the members of a trust bundle")
        issuer, version = members["issuer"], members["version"]
        if not isinstance(issuer, str) or not isinstance(version, int) or isinstance(version, bool):
            raise BadKeyError(FaultCode.KEY_MALFORMED, "issuer or version of a wrong type")
        sets = {role: _key_set(members[role]) for role in _SETS}
        return cls(issuer=issuer, version=version, roots={_number(k): _key(v) for k, v in roots.items()}, **sets)


_SETS: Final = ("attesters", "feed", "registry", "ledger")


def _key(value: object) -> bytes:
    if not isinstance(value, str):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not a base64url text")
    return unb64u(value)


def _key_set(value: object) -> frozenset[bytes]:
    if not isinstance(value, list):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not a list of keys")
    found = frozenset(map(_key, value))
    if len(found) != len(value):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "a key twice")
    return found


def _number(digits: str) -> int:
    if not digits.isascii() or not digits.isdigit() or len(digits) > 10 or str(int(digits)) != digits:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not a root key id")
    return int(digits)
