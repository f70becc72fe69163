"""Public keys of a platform, as it publishes them: a JWKS (RFC 7517), or a SPIFFE bundle with authorities.

Keys come from files and addresses that the identity provider's settings name. A key brings its algorithm; what is for
another use, or of an algorithm that is not taken here, is left out and named.
"""

from __future__ import annotations

import base64
import binascii
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_der_public_key

from capabilities.keys import jws, keys
from capabilities.values import strict_json
from capabilities.values.errors import BadKeyError, FaultCode, StatementError

if TYPE_CHECKING:
    from collections.abc import Mapping

KEYS: Final = 16
"""Most keys of one platform: a rotation needs two."""
KID_BYTES: Final = 128
"""Longest key id; SPIRE's have 32 characters, a thumbprint 43."""
KEY_SET_BYTES: Final = 16_384
"""Largest key file: 16 keys of less than 1 KiB."""
BUNDLE_BYTES: Final = 65_536
"""Largest bundle: 16 keys, and 16 certificates of less than 3 KiB in base64."""
RS256: Final = "RS256"
"""RSASSA-PKCS1-v1_5 with SHA-256 (RFC 7518 section 3.3): Kubernetes signs service account tokens with it."""
_RSA_BITS: Final = range(2_048, 8_193)
"""RFC 7518 section 3.3 wants 2048 bits or more; beyond 8192 a check costs too much."""
_RSA_E: Final = 65_537
"""The one public exponent in use (FIPS 186-5 section 5.1 wants one above 2^16)."""
_COORDINATE_BYTES: Final = 32
_JWK_OPTIONAL: Final = frozenset({"alg", "use", "key_ops"})
_USES: Final = frozenset({"sig", "jwt-svid"})
"""RFC 7517; SPIFFE Trust Domain and Bundle section 4.2.2."""
_AUTHORITY: Final = "x509-svid"
_SET_OPTIONAL: Final = frozenset({"spiffe_sequence", "spiffe_refresh_hint"})
_HIGHEST: Final = 2**53 - 1
"""Highest sequence number: JSON numbers above are not exact (RFC 7493 section 2.2)."""
_NEEDED: Final = {
    jws.EDDSA: frozenset({"kty", "crv", "x", "kid"}),
    jws.ES256: frozenset({"kty", "crv", "x", "y", "kid"}),
    RS256: frozenset({"kty", "n", "e", "kid"}),
}
RsaKey = rsa.RSAPublicKey


@dataclass(frozen=True, slots=True)
class PlatformKey:
    """A public key of the platform.

    Attributes:
        algorithm: `EdDSA`, `ES256` or `RS256`, and no other with this key.
        raw: the raw key (`capabilities.keys.keys`); of RSA, its SubjectPublicKeyInfo in DER.
    """

    algorithm: str
    raw: bytes

    @property
    def public(self) -> keys.PublicKey | RsaKey:
        """The key to verify with."""
        if self.algorithm != RS256:
            return keys.public_key(self.raw)
        key = load_der_public_key(self.raw)
        if not isinstance(key, rsa.RSAPublicKey):
            raise BadKeyError(FaultCode.KEY_MALFORMED, "not an RSA key")
        return key


@dataclass(frozen=True, slots=True)
class Bundle:
    """A SPIFFE bundle.

    Attributes:
        keys: of JWT-SVIDs, by id; may be empty.
        authorities: certificates of those who sign X.509-SVIDs, DER; may be empty, but not with the keys.
        sequence: of the bundle, if it states one: it only grows.
        refresh_hint_s: seconds after which it is to be fetched again, if it says so.
        others: what was left out, in words.
    """

    keys: Mapping[str, PlatformKey]
    authorities: tuple[bytes, ...]
    sequence: int | None
    refresh_hint_s: int | None
    others: tuple[str, ...]


class OtherKeyError(BadKeyError):
    """A key that a set rightly holds, for another use or of another algorithm."""


def key_set(raw: bytes) -> tuple[dict[str, PlatformKey], tuple[str, ...]]:
    """The usable keys of a JWKS (RFC 7517), by id, and the others in words.

    A key for X.509 certificates, or of another type, curve or algorithm, is left out (SPIFFE Trust Domain and Bundle
    section 4.2).

    Raises:
        StatementError: `STATEMENT_MALFORMED` when it is no strict JSON of that shape or too large.
        BadKeyError: `KEY_MALFORMED` for a private or unknown member, no id or an id twice; `KEY_WRONG_ROLE` for a key
            that is for signing; `OtherKeyError` when no key is usable.
    """
    usable, others = _usable(_members(raw, KEY_SET_BYTES, KEYS)[1])
    if not usable:
        raise OtherKeyError(others[0][0], f"no usable key; {'; '.join(why for _, why in others)}")
    return usable, tuple(why for _, why in others)


def bundle(raw: bytes) -> Bundle:
    """The SPIFFE bundle of these bytes (SPIFFE Trust Domain and Bundle section 4), as SPIRE exports it.

    Raises:
        StatementError, BadKeyError: as `key_set`; also for an authority without exactly one certificate.
    """
    members, found = _members(raw, BUNDLE_BYTES, 2 * KEYS)
    certificates = [one for one in found if isinstance(one, dict) and one.get("use") == _AUTHORITY]
    usable, others = _usable([one for one in found if one not in certificates])
    authorities = tuple(dict.fromkeys(map(_authority, certificates)))
    if not usable and not authorities:
        raise OtherKeyError(FaultCode.KEY_MALFORMED, f"no usable key; {'; '.join(why for _, why in others)}")
    sequence, hint_s = (_number(members, name) for name in ("spiffe_sequence", "spiffe_refresh_hint"))
    return Bundle(MappingProxyType(usable), authorities, sequence, hint_s, tuple(why for _, why in others))


def _number(members: dict[str, object], name: str) -> int | None:
    value = members.get(name)
    if value is None and name not in members:
        return None
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= _HIGHEST:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, f"{name}: not a number from 0 on")
    return value


def _authority(value: dict[str, object]) -> bytes:
    chain = value.get("x5c")
    if "d" in value or not isinstance(chain, list) or len(chain) != 1 or not isinstance(chain[0], str):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "an X.509 authority without exactly one certificate")
    try:
        der = base64.b64decode(chain[0], validate=True)
        x509.load_der_x509_certificate(der)
    except (ValueError, binascii.Error):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "an X.509 authority that is no certificate") from None
    return der


def _members(raw: bytes, most_bytes: int, most: int) -> tuple[dict[str, object], list[object]]:
    if len(raw) > most_bytes:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, f"at most {most_bytes} bytes")
    members = strict_json.parse_object(strict_json.without_mark(raw))
    found = members.get("keys")
    if not members.keys() <= {"keys", *_SET_OPTIONAL} or not isinstance(found, list) or not 1 <= len(found) <= most:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, f"not a set of 1 to {most} keys")
    return members, found


def _usable(found: list[object]) -> tuple[dict[str, PlatformKey], list[tuple[FaultCode, str]]]:
    usable: list[tuple[str, PlatformKey]] = []
    others: list[tuple[FaultCode, str]] = []
    for place, value in enumerate(found):
        try:
            usable.append(_key(value))
        except OtherKeyError as error:
            others.append((error.code, f"keys[{place}]: {error.detail}"))
    by_id = dict(usable)
    if len(by_id) != len(usable) or len({key.raw for key in by_id.values()}) != len(usable):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "a key or a key id twice")
    return by_id, others


def _key(value: object) -> tuple[str, PlatformKey]:
    if not isinstance(value, dict):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not a key")
    if not isinstance(value.get("kty"), str) or value["kty"] == "oct" or "d" in value:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not a public key")
    use = value.get("use", "sig")
    if isinstance(use, str) and use not in _USES:
        raise OtherKeyError(FaultCode.KEY_WRONG_ROLE, f"for another use, {use[:16]!r}")
    match value.get("kty"), value.get("crv"):
        case "OKP", "Ed25519":
            algorithm = jws.EDDSA
        case "EC", "P-256":
            algorithm = jws.ES256
        case "RSA", None:
            algorithm = RS256
        case _:
            kind = " ".join(str(value[each])[:16] for each in ("kty", "crv") if each in value)
            raise OtherKeyError(FaultCode.KEY_MALFORMED, f"{kind or 'no type'}, neither Ed25519, P-256 nor RSA")
    needed = _NEEDED[algorithm]
    if not needed <= value.keys() <= needed | _JWK_OPTIONAL:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not the members of a public key")
    kid = value["kid"]
    if not isinstance(kid, str) or not 1 <= len(kid) <= KID_BYTES or not kid.isascii() or not kid.isprintable():
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not a key id")
    if not isinstance(use, str) or value.get("key_ops", ["verify"]) != ["verify"]:
        raise BadKeyError(FaultCode.KEY_WRONG_ROLE, "not a key to verify with")
    if value.get("alg", algorithm) != algorithm:
        raise BadKeyError(FaultCode.KEY_WRONG_ROLE, "a key of another algorithm")
    if algorithm == jws.EDDSA:
        return kid, PlatformKey(algorithm, keys.check_raw(_coordinate(value["x"])))
    if algorithm == RS256:
        return kid, PlatformKey(algorithm, _rsa(value["n"], value["e"]))
    return kid, PlatformKey(algorithm, keys.p256_raw(_coordinate(value["x"]), _coordinate(value["y"])))


def _rsa(n: object, e: object) -> bytes:
    if not isinstance(n, str) or not isinstance(e, str):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not an RSA key")
    modulus, exponent = (int.from_bytes(keys.unb64u(each), "big") for each in (n, e))
    if modulus.bit_length() not in _RSA_BITS or exponent != _RSA_E or not modulus & 1:
        raise OtherKeyError(FaultCode.KEY_MALFORMED, f"RSA of {modulus.bit_length()} bits, or another exponent")
    public = rsa.RSAPublicNumbers(exponent, modulus).public_key()
    return public.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)


def _coordinate(value: object) -> bytes:
    raw = keys.unb64u(value) if isinstance(value, str) else b""
    if len(raw) != _COORDINATE_BYTES:
        raise BadKeyError(FaultCode.KEY_MALFORMED, f"not {_COORDINATE_BYTES} bytes in base64url")
    return raw


def jwks(public: bytes) -> bytes:
    """The JWKS of one raw key; its id is its thumbprint."""
    member = {**jws.jwk(public), "kid": keys.thumbprint(public), "use": "sig", "alg": jws.algorithm_name(public)}
    return strict_json.canonical({"keys": [member]})
