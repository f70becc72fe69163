"""Workload identity tokens: a platform's statement about a workload of its own, for the identity provider alone.

A JWT-SVID of SPIFFE, or a projected service account token of Kubernetes. Such a token is a bearer: it is no authority
and no proof, and counts only inside the agent's own signed attestation, once. Where a platform adds `cnf.jkt`, the
thumbprint of the agent's key (RFC 7800, RFC 9449), and its `measurement` of the software, the token says more.

Keys come from what the identity provider's settings name. A key brings its algorithm; the header of a token chooses
neither, `kid` only says which of the known keys is meant.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, assert_never

import jwt

from capabilities.keys import jws, keys
from capabilities.statements.claims import Sha256, Thumbprint, Whole, malformed, read
from capabilities.statements.platform_keys import KEY_SET_BYTES, RS256, OtherKeyError, PlatformKey, jwks, key_set
from capabilities.values import strict_json, text
from capabilities.values.errors import BadKeyError, CapabilityError, FaultCode, StatementError
from capabilities.values.form import Form

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.values.caps import Caps

__all__ = [
    "KEY_SET_BYTES", "AnyPlatform", "Cluster", "OtherKeyError", "Platform", "PlatformKey", "Workload", "digest", "jwks",
    "key_set", "open", "sign",
]  # fmt: skip

_ENGINE: Final = jwt.PyJWS(algorithms=[jws.EDDSA, jws.ES256, RS256])
_HEADER: Final = frozenset({"alg", "kid"})
_TYPES: Final = frozenset({"JWT", "JOSE"})
"""JWT-SVID section 2: `alg`, `kid`, `typ` and no other member; `typ`, where it is stated, is one of these."""
_SIGNATURE_BYTES: Final = 64
"""Bytes of a signature of both algorithms of curves (RFC 8032; RFC 7518 section 3.4)."""
_REQUIRED: Final = frozenset({"sub", "aud", "exp", "iat"})
_BOUND: Final = frozenset({"cnf", "measurement"})
"""Both or neither."""
_OPTIONAL: Final = frozenset({"iss", "nbf", "jti"})
_CLUSTER_REQUIRED: Final = frozenset({"iss", "sub", "aud", "exp", "iat"})
_CLUSTER_OPTIONAL: Final = frozenset({"nbf", "jti", "kubernetes.io"})
_ACCOUNT: Final = "system:serviceaccount:"
"""Starts `sub` of a service account, before its namespace and name (Kubernetes, Authenticating)."""


@dataclass(frozen=True, slots=True)
class Platform:
    """SPIFFE platform whose word on workloads is trusted.

    Attributes:
        trust_domain: its name, e.g. "cell.example".
        keys: of its JWT-SVIDs, by key id.
        authorities: certificates of those who sign its X.509-SVIDs, DER.

    Raises:
        StatementError: `STATEMENT_MALFORMED` for a name that is none.
    """

    trust_domain: str
    keys: Mapping[str, PlatformKey]
    authorities: tuple[bytes, ...] = ()

    def __post_init__(self) -> None:
        if not text.is_trust_domain(self.trust_domain):
            raise StatementError(FaultCode.STATEMENT_MALFORMED, "not a trust domain")
        object.__setattr__(self, "keys", MappingProxyType(dict(self.keys)))

    @property
    def all_keys(self) -> frozenset[bytes]:
        """Its raw keys: nobody else may have one of them."""
        return frozenset(key.raw for key in self.keys.values())

    @property
    def root(self) -> str:
        """Start of the ids of its workloads."""
        return f"spiffe://{self.trust_domain}/"

    def holds(self, workload: str) -> bool:
        """True where a workload id belongs to this trust domain."""
        return workload.startswith(self.root)


@dataclass(frozen=True, slots=True)
class Cluster:
    """Kubernetes cluster whose word on its service accounts is trusted.

    Attributes:
        name: by which the settings call it; the workload ids of its accounts start `k8s://NAME/`.
        issuer: `iss` of its tokens.
        keys: by key id.
        lifetime_s: longest life of a token of it, seconds.

    Raises:
        StatementError: `STATEMENT_MALFORMED` for a name that is none.
    """

    name: str
    issuer: str
    keys: Mapping[str, PlatformKey]
    lifetime_s: int

    def __post_init__(self) -> None:
        if not text.is_trust_domain(self.name):
            raise StatementError(FaultCode.STATEMENT_MALFORMED, "not the name of a cluster")
        object.__setattr__(self, "keys", MappingProxyType(dict(self.keys)))

    @property
    def all_keys(self) -> frozenset[bytes]:
        """Its raw keys: nobody else may have one of them."""
        return frozenset(key.raw for key in self.keys.values())

    @property
    def root(self) -> str:
        """Start of the ids of its workloads."""
        return f"k8s://{self.name}/"

    def holds(self, workload: str) -> bool:
        """True where a workload id belongs to this cluster."""
        return workload.startswith(self.root)


AnyPlatform = Platform | Cluster


@dataclass(frozen=True, slots=True)
class Workload:
    """Workload as its platform states it.

    Attributes:
        id: `spiffe://trust-domain/path`, or `k8s://cluster/namespace/account`.
        audience: the verifier that it is for.
        key_thumbprint: RFC 7638 thumbprint of the key that the workload holds; "" where the platform does not say.
        measurement: SHA-256 over the software that the platform measured; empty where it does not say.
        issued_at, expires_at: seconds since the epoch.
        token_id: `jti` of the token, or "".
    """

    id: str
    audience: str
    key_thumbprint: str
    measurement: bytes
    issued_at: int
    expires_at: int
    token_id: str = ""


def digest(token: str) -> bytes:
    """SHA-256 of the signed part of a token: the same under each signature that verifies ([WLD-8])."""
    return hashlib.sha256(token.rpartition(".")[0].encode()).digest()


def sign(workload: Workload, key: keys.PrivateKey) -> str:
    """The token, signed by a SPIFFE platform whose JWKS is that of `jwks`."""
    claims: dict[str, object] = {
        "sub": workload.id,
        "aud": workload.audience,
        "iat": workload.issued_at,
        "exp": workload.expires_at,
    }
    if workload.key_thumbprint or workload.measurement:
        claims |= {"cnf": {"jkt": workload.key_thumbprint}, "measurement": workload.measurement.hex()}
    if workload.token_id:
        claims["jti"] = workload.token_id
    header: dict[str, object] = {"typ": "JWT", "kid": keys.thumbprint(keys.public_raw(key))}
    payload, domain = strict_json.canonical(claims), workload.id.removeprefix("spiffe://").partition("/")[0]
    usable, _ = key_set(jwks(keys.public_raw(key)))
    _claims(payload, Platform(domain, usable))  # [STM-13]
    return jws.sign(header, payload, key)


def open(token: str, platform: AnyPlatform, *, audience: str, at: float, caps: Caps) -> Workload:  # noqa: A001 - read as workload.open
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
    payload = _signed(token, platform.keys, caps)  # [WLD-1], [WLD-2]
    match platform:  # [WLD-3], [WLD-6]
        case Platform():
            found, longest_s = _claims(payload, platform), caps.workload_token_lifetime_s
        case Cluster():
            found, longest_s = _account(payload, platform), platform.lifetime_s
        case _:
            assert_never(platform)
    # [WLD-4] for us, now, and only for a short while
    if found.audience != audience:
        raise StatementError(FaultCode.WRONG_AUDIENCE, "the token is for another audience")
    if not at < found.expires_at:
        raise StatementError(FaultCode.EXPIRED, "the token is over")
    if not found.issued_at <= at + caps.skew_s:
        raise StatementError(FaultCode.NOT_YET_VALID, "the token is from the future")
    if not 0 < found.expires_at - found.issued_at <= longest_s:
        raise StatementError(FaultCode.LIFETIME_TOO_LONG, f"at most {longest_s} s")
    return found


def _signed(token: str, known: Mapping[str, PlatformKey], caps: Caps) -> bytes:
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
    key = known.get(kid) if isinstance(kid, str) else None
    if key is None:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "signed by no key of the platform")
    if header["alg"] != key.algorithm or (key.algorithm != RS256 and len(signature) != _SIGNATURE_BYTES):
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "another algorithm than the key's")
    try:
        verified = _ENGINE.decode_complete(token, key.public, algorithms=[key.algorithm])
    except jwt.exceptions.PyJWTError:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "not signed by this key") from None
    if verified["payload"] != payload:  # the verified bytes are those that will be read
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "two readers see two payloads")
    return payload


class _Times(Form, frozen=True):
    iat: Whole
    exp: Whole
    nbf: Whole = 0


class _Confirmation(Form, frozen=True):
    jkt: Thumbprint


class _Binding(Form, frozen=True):
    cnf: _Confirmation
    measurement: Sha256


def _claims(payload: bytes, platform: Platform) -> Workload:
    # [WLD-3] exactly the known claims, each of its form; a workload of this trust domain
    members = strict_json.parse_object(payload)
    bound = bool(members.keys() & _BOUND)
    required = _REQUIRED | _BOUND if bound else _REQUIRED
    if not required <= members.keys() <= required | _OPTIONAL:
        raise malformed("not the claims of a workload's token")
    try:
        workload = text.workload_id(members["sub"])
    except CapabilityError:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "sub is no workload id") from None
    if not platform.holds(workload):
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "a workload of another trust domain")
    if members.get("iss", f"spiffe://{platform.trust_domain}") != f"spiffe://{platform.trust_domain}":
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "of another issuer")
    times, audience = _times(members), _audience(members["aud"])
    binding = read(_Binding, {name: members[name] for name in _BOUND}) if bound else None
    return Workload(
        id=workload,
        audience=audience,
        key_thumbprint="" if binding is None else binding.cnf.jkt,
        measurement=b"" if binding is None else binding.measurement,
        issued_at=times.iat,
        expires_at=times.exp,
        token_id=_token_id(members),
    )


def _account(payload: bytes, cluster: Cluster) -> Workload:
    # [WLD-6] a service account of this cluster, as itself and as what is stated beside
    members = strict_json.parse_object(payload)
    if not _CLUSTER_REQUIRED <= members.keys() <= _CLUSTER_REQUIRED | _CLUSTER_OPTIONAL:
        raise malformed("not the claims of a service account's token")
    if members["iss"] != cluster.issuer:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "of another issuer")
    subject = members["sub"]
    namespace, _, account = str(subject).removeprefix(_ACCOUNT).partition(":")
    if not isinstance(subject, str) or subject != f"{_ACCOUNT}{namespace}:{account}":
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "not a service account")
    try:
        workload = text.workload_id(f"k8s://{cluster.name}/{namespace}/{account}")
    except CapabilityError:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "sub is no service account") from None
    beside = members.get("kubernetes.io", {})
    named = beside.get("serviceaccount", {}) if isinstance(beside, dict) else None
    if not isinstance(beside, dict) or not isinstance(named, dict):
        raise malformed("kubernetes.io: not of its form")
    if beside.get("namespace", namespace) != namespace or named.get("name", account) != account:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "two accounts in one token")
    times = _times(members)
    return Workload(workload, _audience(members["aud"]), "", b"", times.iat, times.exp, _token_id(members))


def _times(members: dict[str, object]) -> _Times:
    times = read(_Times, {name: members[name] for name in ("iat", "exp", "nbf") if name in members})
    # `nbf` may only repeat or come before `iat`: a token that waits for later has no use here.
    if times.nbf > times.iat:
        raise StatementError(FaultCode.NOT_YET_VALID, "nbf is after iat")
    return times


def _audience(value: object) -> str:
    if isinstance(value, list) and len(value) == 1:
        value = value[0]
    if not isinstance(value, str):
        raise StatementError(FaultCode.WRONG_AUDIENCE, "not exactly one audience")
    return value


def _token_id(members: dict[str, object]) -> str:
    found = members.get("jti", "")
    return found if isinstance(found, str) else ""
