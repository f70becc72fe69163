"""X.509-SVIDs as evidence: a SPIFFE workload proves the key of its certificate over a nonce and the agent's key.

The proof is a compact JWS by the certificate's key; its header brings the chain. The chain is verified up to the
authorities of the bundle that the identity provider's settings name: what it brings is looked at only after that.
"""

from __future__ import annotations

import base64
import datetime as dt
from typing import TYPE_CHECKING, Final

import jwt
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509 import verification

from capabilities.keys import jws, keys
from capabilities.statements.claims import Nonce, Thumbprint, Whole, read
from capabilities.statements.platform_keys import RS256
from capabilities.statements.workload import Workload
from capabilities.values import strict_json, text
from capabilities.values.errors import BadKeyError, CapabilityError, FaultCode, StatementError
from capabilities.values.form import Form

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capabilities.statements.workload import Platform
    from capabilities.values.caps import Caps

TYPE: Final = "ztpm-x509-svid+jwt"
CHAIN: Final = 3
"""Most certificates: the SVID, and two intermediates as of a SPIRE server below another."""
_HEADER: Final = frozenset({"alg", "typ", "x5c"})
_ENGINE: Final = jwt.PyJWS(algorithms=[jws.ES256, RS256])
LeafKey = ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey


class _Confirmation(Form, frozen=True):
    jkt: Thumbprint


class _Proof(Form, frozen=True):
    aud: str
    cnf: _Confirmation
    iat: Whole
    nonce: Nonce


def prove(
    chain: Sequence[x509.Certificate], key: LeafKey, *, audience: str, nonce: str, key_thumbprint: str, at: int
) -> str:
    """The proof of a workload that has an X.509-SVID.

    Args:
        chain: the SVID, then its intermediates.
        key: of the SVID; P-256 or RSA.
        audience: issuer URL of the identity provider.
        nonce: of the identity provider, that of the attestation around the proof.
        key_thumbprint: of the agent's registered key.
        at: seconds since the epoch.
    """
    header: dict[str, object] = {
        "typ": TYPE,
        "x5c": [base64.b64encode(one.public_bytes(Encoding.DER)).decode() for one in chain],
    }
    payload = strict_json.canonical({"aud": audience, "cnf": {"jkt": key_thumbprint}, "iat": at, "nonce": nonce})
    algorithm = jws.ES256 if isinstance(key, ec.EllipticCurvePrivateKey) else RS256
    return _ENGINE.encode(payload, key, algorithm=algorithm, headers=header, sort_headers=True)


def open(token: str, platform: Platform, *, audience: str, nonce: str, at: float, caps: Caps) -> Workload:  # noqa: A001 - read as x509_svid.open
    """The workload whose SVID the chain begins with, which proved its key now, for this audience and nonce.

    Args:
        token: compact JWS, as `prove` makes it.
        platform: whose authorities are trusted.
        audience: issuer URL of the identity provider.
        nonce: that the proof must name.
        at: seconds since the epoch.
        caps: the bounds.

    Raises:
        StatementError: `STATEMENT_MALFORMED`, `STATEMENT_UNTRUSTED`, `WRONG_AUDIENCE`, `NOT_YET_VALID` or `EXPIRED`.
    """
    # [WLD-7] bounded, one spelling, closed header
    header, payload = _parts(token, caps)
    chain = _certificates(header["x5c"])
    # the chain first, up to the authorities of the bundle: nothing in it is believed before
    _verify(chain, platform, at)
    workload = _identity(chain[0], platform)
    # and only then the signature, by the key of the first certificate of this very chain
    public, algorithm = _key(chain[0])
    if header["alg"] != algorithm:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "another algorithm than the certificate's key")
    try:
        verified = _ENGINE.decode_complete(token, public, algorithms=[algorithm])
    except jwt.exceptions.PyJWTError:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "not signed by the key of the certificate") from None
    if verified["payload"] != payload:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "two readers see two payloads")
    # for us, now, over our nonce
    said = read(_Proof, strict_json.parse_object(payload))
    if said.aud != audience:
        raise StatementError(FaultCode.WRONG_AUDIENCE, "the proof is for another audience")
    if said.nonce != nonce:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "the proof is over another nonce")
    if not said.iat <= at + caps.skew_s:
        raise StatementError(FaultCode.NOT_YET_VALID, "the proof is from the future")
    if not at < said.iat + caps.nonce_age_s + caps.skew_s:
        raise StatementError(FaultCode.EXPIRED, "the proof is older than any nonce")
    return Workload(workload, said.aud, said.cnf.jkt, b"", said.iat, int(chain[0].not_valid_after_utc.timestamp()))


def _parts(token: str, caps: Caps) -> tuple[dict[str, object], bytes]:
    parts = token.split(".")
    if len(token) > caps.credential_bytes or len(parts) != 3:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, f"not three parts in {caps.credential_bytes} bytes")
    try:
        header_raw, payload, _ = map(keys.unb64u, parts)
    except BadKeyError:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "not canonical base64url") from None
    header = strict_json.parse_object(header_raw)
    if header.keys() != _HEADER or header["typ"] != TYPE:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "not the header of a proof by an X.509-SVID")
    return header, payload


def _certificates(value: object) -> list[x509.Certificate]:
    if not isinstance(value, list) or not 1 <= len(value) <= CHAIN or not all(isinstance(one, str) for one in value):
        raise StatementError(FaultCode.STATEMENT_MALFORMED, f"not a chain of 1 to {CHAIN} certificates")
    try:
        return [x509.load_der_x509_certificate(base64.b64decode(one, validate=True)) for one in value]
    except ValueError:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "a certificate that is none") from None


def _verify(chain: list[x509.Certificate], platform: Platform, at: float) -> None:
    if not platform.authorities:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "the platform has no X.509 authority")
    try:
        store = verification.Store([x509.load_der_x509_certificate(der) for der in platform.authorities])
        now = dt.datetime.fromtimestamp(at, dt.UTC)
        builder = verification.PolicyBuilder().store(store).time(now).max_chain_depth(CHAIN)
        builder.build_client_verifier().verify(chain[0], chain[1:])
    except (verification.VerificationError, ValueError, x509.UnsupportedGeneralNameType) as error:
        why = type(error).__name__
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, f"no chain to an authority of the bundle: {why}") from None


def _identity(leaf: x509.Certificate, platform: Platform) -> str:
    """SPIFFE ID of a certificate that is verified already (X.509-SVID sections 2, 4 and 5.2)."""
    extensions = leaf.extensions
    try:
        usage = extensions.get_extension_for_class(x509.KeyUsage).value
        names = extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        found = names.get_values_for_type(x509.UniformResourceIdentifier)
    except x509.ExtensionNotFound:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "a certificate that is no SVID") from None
    if not usage.digital_signature or usage.key_cert_sign or usage.crl_sign or len(found) != 1:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "a certificate that is no SVID of one workload")
    try:
        workload = text.workload_id(found[0])
    except CapabilityError:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "not the SPIFFE ID of a workload") from None
    if not platform.holds(workload):
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "a workload of another trust domain")
    return workload


def _key(leaf: x509.Certificate) -> tuple[ec.EllipticCurvePublicKey | rsa.RSAPublicKey, str]:
    match leaf.public_key():
        case ec.EllipticCurvePublicKey(curve=ec.SECP256R1()) as public:
            return public, jws.ES256
        case rsa.RSAPublicKey() as public:
            return public, RS256
        case _:
            raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "the certificate's key is neither P-256 nor RSA")
