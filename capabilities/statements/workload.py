"""Workload identity tokens: a platform's statement about the software that it runs, bound to the agent's key.

The form is a JWT-SVID (SPIFFE) with two claims more: `cnf.jkt`, the thumbprint of the agent's key (RFC 7800, RFC 9449),
and `measurement`, taken by the platform. Such a token is no authority and no proof: it is handed in inside the
agent's own signed attestation, whose nonce keeps it from being replayed.

The keys come from a file that the identity provider's settings name. A key brings its algorithm; the header of a token
chooses neither, `kid` only says which of the known keys is meant.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import jwt

from capabilities.keys import jws, keys
from capabilities.statements.claims import Sha256, Thumbprint, Whole, malformed, read
from capabilities.values import strict_json, text
from capabilities.values.errors import BadKeyError, CapabilityError, FaultCode, StatementError
from capabilities.values.form import Form

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.values.caps import Caps

KEYS: Final = 16
"""Most keys of one platform: a rotation needs two."""
KID_BYTES: Final = 128
"""Longest key id; SPIRE's have 32 characters, a thumbprint 43."""
KEY_SET_BYTES: Final = 16_384
"""Largest key file: 16 keys of less than 1 KiB."""

_ENGINE: Final = jwt.PyJWS(algorithms=[jws.EDDSA, jws.ES256])
_HEADER: Final = frozenset({"alg", "kid"})
_TYPES: Final = frozenset({"JWT", "JOSE"})
"""JWT-SVID section 2: `alg`, `kid`, `typ` and no other member; `typ`, where it is stated, is one of these."""
_SIGNATURE_BYTES: Final = 64
"""Bytes of a signature of both algorithms (RFC 8032; RFC 7518 section 3.4)."""
_COORDINATE_BYTES: Final = 32
_REQUIRED: Final = frozenset({"sub", "aud", "exp", "iat", "cnf", "measurement"})
_OPTIONAL: Final = frozenset({"iss", "nbf", "jti"})
_JWK_OPTIONAL: Final = frozenset({"alg", "use", "key_ops"})
_USES: Final = frozenset({"sig", "jwt-svid"})
"""RFC 7517; SPIFFE Trust Domain and Bundle section 4.2.2."""
_SET_OPTIONAL: Final = frozenset({"spiffe_sequence", "spiffe_refresh_hint"})


@dataclass(frozen=True, slots=True)
class PlatformKey:
    """A public key of the platform.

    Attributes:
        algorithm: `EdDSA` or `ES256`, and no other with this key.
        raw: the raw key (`capabilities.keys.keys`).
    """

    algorithm: str
    raw: bytes

    @property
    def public(self) -> keys.PublicKey:
        """The key to verify with."""
        return keys.public_key(self.raw)


@dataclass(frozen=True, slots=True)
class Platform:
    """Platform whose word on workloads is trusted.

    Attributes:
        trust_domain: its name, e.g. "cell.example".
        keys: by key id, at least one.

    Raises:
        StatementError: `STATEMENT_MALFORMED` for a name that is none.
    """

    trust_domain: str
    keys: Mapping[str, PlatformKey]

    def __post_init__(self) -> None:
        if not text.is_trust_domain(self.trust_domain):
            raise StatementError(FaultCode.STATEMENT_MALFORMED, "not a trust domain")
        object.__setattr__(self, "keys", MappingProxyType(dict(self.keys)))

    @property
    def all_keys(self) -> frozenset[bytes]:
        """Its raw keys: nobody else may have one of them."""
        return frozenset(key.raw for key in self.keys.values())

    def holds(self, workload: str) -> bool:
        """True where a workload id belongs to this trust domain."""
        return workload.startswith(f"spiffe://{self.trust_domain}/")


@dataclass(frozen=True, slots=True)
class Workload:
    """Workload as its platform states it.

    Attributes:
        id: `spiffe://trust-domain/path`.
        audience: the verifier that it is for.
        key_thumbprint: RFC 7638 thumbprint of the key that the workload holds.
        measurement: SHA-256 over the software that the platform measured.
        issued_at, expires_at: seconds since the epoch.
    """

    id: str
    audience: str
    key_thumbprint: str
    measurement: bytes
    issued_at: int
    expires_at: int


# --- keys ------------------------------------------------------------------------------------------------------------


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
    if len(raw) > KEY_SET_BYTES:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, f"at most {KEY_SET_BYTES} bytes")
    members = strict_json.parse_object(strict_json.without_mark(raw))
    found = members.get("keys")
    if not members.keys() <= {"keys", *_SET_OPTIONAL} or not isinstance(found, list) or not 1 <= len(found) <= KEYS:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, f"not a set of 1 to {KEYS} keys")
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
    if not by_id:
        raise OtherKeyError(others[0][0], f"no usable key; {'; '.join(why for _, why in others)}")
    return by_id, tuple(why for _, why in others)


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
        case _:
            kind = " ".join(str(value[each])[:16] for each in ("kty", "crv") if each in value)
            raise OtherKeyError(FaultCode.KEY_MALFORMED, f"{kind or 'no type'}, neither Ed25519 nor P-256")
    needed = {"kty", "crv", "x", "kid"} | ({"y"} if algorithm == jws.ES256 else set())
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
    return kid, PlatformKey(algorithm, keys.p256_raw(_coordinate(value["x"]), _coordinate(value["y"])))


def _coordinate(value: object) -> bytes:
    raw = keys.unb64u(value) if isinstance(value, str) else b""
    if len(raw) != _COORDINATE_BYTES:
        raise BadKeyError(FaultCode.KEY_MALFORMED, f"not {_COORDINATE_BYTES} bytes in base64url")
    return raw


def jwks(public: bytes) -> bytes:
    """The JWKS of one raw key; its id is its thumbprint."""
    member = {**jws.jwk(public), "kid": keys.thumbprint(public), "use": "sig", "alg": jws.algorithm_name(public)}
    return strict_json.canonical({"keys": [member]})


# --- tokens ----------------------------------------------------------------------------------------------------------


def sign(workload: Workload, key: keys.PrivateKey) -> str:
    """The token, signed by a platform whose JWKS is that of `jwks`."""
    claims = {
        "sub": workload.id,
        "aud": workload.audience,
        "iat": workload.issued_at,
        "exp": workload.expires_at,
        "cnf": {"jkt": workload.key_thumbprint},
        "measurement": workload.measurement.hex(),
    }
    header: dict[str, object] = {"typ": "JWT", "kid": keys.thumbprint(keys.public_raw(key))}
    payload, domain = strict_json.canonical(claims), workload.id.removeprefix("spiffe://").partition("/")[0]
    usable, _ = key_set(jwks(keys.public_raw(key)))
    _claims(payload, Platform(domain, usable))  # [STM-13]
    return jws.sign(header, payload, key)


def open(token: str, platform: Platform, *, audience: str, at: float, caps: Caps) -> Workload:  # noqa: A001 - read as workload.open
    """Statement of the platform about one of its own workloads, to this audience, now.

    Args:
        token: compact JWS.
        platform: the platform that is trusted.
        audience: the only one that the token may name.
        at: seconds since the epoch.
        caps: the bounds.

    Raises:
        StatementError: `STATEMENT_MALFORMED`, `STATEMENT_UNTRUSTED`, `WRONG_AUDIENCE`, `EXPIRED`, `NOT_YET_VALID` or
            `LIFETIME_TOO_LONG`.
    """
    payload = _signed(token, platform, caps)  # [WLD-1], [WLD-2]
    found = _claims(payload, platform)  # [WLD-3]
    # [WLD-4] for us, now, and only for a short while
    if found.audience != audience:
        raise StatementError(FaultCode.WRONG_AUDIENCE, "the token is for another audience")
    if not at < found.expires_at:
        raise StatementError(FaultCode.EXPIRED, "the token is over")
    if not found.issued_at <= at + caps.skew_s:
        raise StatementError(FaultCode.NOT_YET_VALID, "the token is from the future")
    if not 0 < found.expires_at - found.issued_at <= caps.workload_token_lifetime_s:
        raise StatementError(FaultCode.LIFETIME_TOO_LONG, f"at most {caps.workload_token_lifetime_s} s")
    return found


def _signed(token: str, platform: Platform, caps: Caps) -> bytes:
    # [WLD-1] bounded, one spelling, closed header
    parts = token.split(".")
    if len(token) > caps.workload_token_bytes or len(parts) != 3:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, f"not three parts in {caps.workload_token_bytes} bytes")
    try:
        header_raw, payload, signature = map(keys.unb64u, parts)
    except BadKeyError:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "not canonical base64url") from None
    header = strict_json.parse_object(header_raw)
    kind = header.get("typ", "JWT")
    if not _HEADER <= header.keys() <= _HEADER | {"typ"} or not isinstance(kind, str) or kind not in _TYPES:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "not the header of a JWT-SVID")
    # [WLD-2] a key of the platform, with the key's own algorithm
    kid = header["kid"]
    key = platform.keys.get(kid) if isinstance(kid, str) else None
    if key is None:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "signed by no key of the platform")
    if header["alg"] != key.algorithm or len(signature) != _SIGNATURE_BYTES:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "another algorithm than the key's")
    try:
        verified = _ENGINE.decode_complete(token, key.public, algorithms=[key.algorithm])
    except jwt.exceptions.PyJWTError:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "not signed by this key") from None
    if verified["payload"] != payload:  # the verified bytes are those that will be read
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "two readers see two payloads")
    return payload


class _Beginning(Form, frozen=True):
    iat: Whole
    nbf: Whole = 0


class _Confirmation(Form, frozen=True):
    jkt: Thumbprint


class _Binding(Form, frozen=True):
    cnf: _Confirmation
    measurement: Sha256
    exp: Whole


def _claims(payload: bytes, platform: Platform) -> Workload:
    # [WLD-3] exactly the known claims, each of its form; a workload of this trust domain
    members = strict_json.parse_object(payload)
    if not _REQUIRED <= members.keys() <= _REQUIRED | _OPTIONAL:
        raise malformed("not the claims of a workload's token")
    try:
        workload = text.workload_id(members["sub"])
    except CapabilityError:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "sub is no workload id") from None
    if not platform.holds(workload):
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "a workload of another trust domain")
    if members.get("iss", f"spiffe://{platform.trust_domain}") != f"spiffe://{platform.trust_domain}":
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "of another issuer")
    begins = read(_Beginning, {name: members[name] for name in ("iat", "nbf") if name in members})
    # `nbf` may only repeat or come before `iat`: a token that waits for later has no use here.
    if begins.nbf > begins.iat:
        raise StatementError(FaultCode.NOT_YET_VALID, "nbf is after iat")
    audience = members["aud"]
    if isinstance(audience, list) and len(audience) == 1:
        audience = audience[0]
    if not isinstance(audience, str):
        raise StatementError(FaultCode.WRONG_AUDIENCE, "not exactly one audience")
    bound = read(_Binding, {name: members[name] for name in ("cnf", "measurement", "exp")})
    return Workload(
        id=workload,
        audience=audience,
        key_thumbprint=bound.cnf.jkt,
        measurement=bound.measurement,
        issued_at=begins.iat,
        expires_at=bound.exp,
    )
