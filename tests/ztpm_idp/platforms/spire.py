"""Platforms as they are in the world: a SPIRE server's authorities, bundle and SVIDs, and a cluster's account tokens.

The certificates have the fields that SPIRE 1.15 gives them (pkg/server/credtemplate), the tokens those of Kubernetes
1.31; no SPIRE server and no cluster is here.
"""

from __future__ import annotations

import base64
import datetime as dt
import json
import uuid
from functools import cache

import jwt
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from capabilities.keys import keys

CLUSTER_ISSUER = "https://kubernetes.default.svc.cluster.local"
HOUR = 3_600


@cache
def rsa_key(name: str) -> rsa.RSAPrivateKey:
    """A key of 2048 bits, made once: making one takes longer than most tests."""
    return rsa.generate_private_key(65_537, 2_048)


def curve_key() -> ec.EllipticCurvePrivateKey:
    return ec.generate_private_key(ec.SECP256R1())


def _name(organisation: str) -> x509.Name:
    named = [(NameOID.COUNTRY_NAME, "US"), (NameOID.ORGANIZATION_NAME, organisation)]
    return x509.Name([x509.NameAttribute(oid, value) for oid, value in named])


def _usage(**held: bool) -> x509.KeyUsage:
    every = (
        "digital_signature content_commitment key_encipherment data_encipherment key_agreement key_cert_sign crl_sign "
        "encipher_only decipher_only"
    ).split()
    return x509.KeyUsage(**{name: held.get(name, False) for name in every})


class Authority:
    """An X.509 authority of a trust domain, or one below it."""

    def __init__(self, domain: str, at: int, *, above: Authority | None = None):
        self.domain, self.at, self.key, self.above = domain, at, curve_key(), above
        signer = self if above is None else above
        issuer = _name("SPIFFE") if above is None else above.certificate.subject
        self.certificate = self._built(
            _name("SPIFFE") if above is None else _name("SPIFFE below"), issuer, self.key.public_key(), signer.key,
            [f"spiffe://{domain}"], ca=True, usage=_usage(key_cert_sign=True, crl_sign=True), lifetime_s=24 * HOUR,
        )  # fmt: skip

    def _built(
        self, subject, issuer, public, signer, uris, *, ca, usage, lifetime_s, dns=(), extended=None, begun_s=10
    ):
        now = dt.datetime.fromtimestamp(self.at, dt.UTC)
        made = (
            x509.CertificateBuilder()
            .subject_name(subject)
            .issuer_name(issuer)
            .public_key(public)
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - dt.timedelta(seconds=begun_s))
            .not_valid_after(now + dt.timedelta(seconds=lifetime_s))
            .add_extension(usage, critical=True)
            .add_extension(x509.BasicConstraints(ca=ca, path_length=None), critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key()), critical=False)
        )
        names = [*map(x509.UniformResourceIdentifier, uris), *map(x509.DNSName, dns)]
        if names:
            made = made.add_extension(x509.SubjectAlternativeName(names), critical=False)
        if extended:
            made = made.add_extension(x509.ExtendedKeyUsage(extended), critical=False)
        return made.sign(signer, hashes.SHA256())

    def svid(self, path, key, *, lifetime_s=HOUR, uris=None, ca=False, usage=None, extended=None, begun_s=10):
        """An X.509-SVID, and what is between it and the authority of the bundle."""
        leaf = self._built(
            _name("SPIRE"), self.certificate.subject, key.public_key(), self.key,
            [f"spiffe://{self.domain}/{path}"] if uris is None else uris, ca=ca, lifetime_s=lifetime_s, begun_s=begun_s,
            usage=usage or _usage(digital_signature=True, key_encipherment=True, key_agreement=True),
            extended=[ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH] if extended is None else extended,
        )  # fmt: skip
        return [leaf] if self.above is None else [leaf, self.certificate]


class Spire:
    """A SPIRE server: an X.509 authority, a JWT authority, and the bundle that `spire-server bundle show` exports."""

    def __init__(self, domain: str, at: int):
        self.domain, self.at = domain, at
        self.authority, self.jwt_key, self.sequence = Authority(domain, at), curve_key(), 1

    def bundle(self, **changes) -> bytes:
        """`spire-server bundle show -format spiffe`."""
        x, y = (keys.b64u(each) for each in self._point(self.authority.key))
        der = base64.b64encode(self.authority.certificate.public_bytes(Encoding.DER)).decode()
        tx, ty = (keys.b64u(each) for each in self._point(self.jwt_key))
        stated = {
            "keys": [
                {"use": "x509-svid", "kty": "EC", "crv": "P-256", "x": x, "y": y, "x5c": [der]},
                {"use": "jwt-svid", "kty": "EC", "kid": self.kid, "crv": "P-256", "x": tx, "y": ty},
            ],
            "spiffe_sequence": self.sequence,
            "spiffe_refresh_hint": 300,
        }
        return json.dumps(stated | changes).encode()

    @staticmethod
    def _point(key):
        numbers = key.public_key().public_numbers()
        return numbers.x.to_bytes(32, "big"), numbers.y.to_bytes(32, "big")

    @property
    def kid(self) -> str:
        return keys.thumbprint(keys.public_raw(self.jwt_key))[:32]

    def token(self, path, audience, *, key=None, header=None, lifetime_s=300, **changes) -> str:
        """A JWT-SVID as the Workload API hands it out: it names neither key nor software."""
        claims = {
            "sub": f"spiffe://{self.domain}/{path}", "aud": [audience], "exp": self.at + lifetime_s, "iat": self.at
        }  # fmt: skip
        claims = {name: value for name, value in (claims | changes).items() if value is not None}
        head = {"kid": self.kid, "typ": "JWT"} | (header or {})
        return jwt.encode(claims, key or self.jwt_key, algorithm="ES256", headers=head)


class Kubernetes:
    """A cluster that projects service account tokens, and answers OIDC discovery."""

    def __init__(self, at: int, *, issuer=CLUSTER_ISSUER, name="cluster"):
        self.at, self.issuer, self.key, self.kid = at, issuer, rsa_key(name), f"kid-{name}"

    def jwks(self) -> bytes:
        numbers = self.key.public_key().public_numbers()
        n, e = (keys.b64u(v.to_bytes((v.bit_length() + 7) // 8, "big")) for v in (numbers.n, numbers.e))
        key = {"use": "sig", "kty": "RSA", "kid": self.kid, "alg": "RS256", "n": n, "e": e}
        return json.dumps({"keys": [key]}).encode()

    def discovery(self, base: str, **changes) -> bytes:
        return json.dumps({
            "issuer": self.issuer, "jwks_uri": f"{base}/openid/v1/jwks", "response_types_supported": ["id_token"],
            "subject_types_supported": ["public"], "id_token_signing_alg_values_supported": ["RS256"],
        } | changes).encode()  # fmt: skip

    def token(self, namespace, account, audience, *, key=None, header=None, lifetime_s=3_607, **changes) -> str:
        """A token as the kubelet projects it into a pod."""
        claims = {
            "aud": [audience], "exp": self.at + lifetime_s, "iat": self.at, "iss": self.issuer, "jti": str(uuid.uuid4()),
            "kubernetes.io": {
                "namespace": namespace, "node": {"name": "node-1", "uid": str(uuid.uuid4())},
                "pod": {"name": "agent-0", "uid": str(uuid.uuid4())},
                "serviceaccount": {"name": account, "uid": str(uuid.uuid4())}, "warnafter": self.at + 3_607,
            },
            "nbf": self.at, "sub": f"system:serviceaccount:{namespace}:{account}",
        }  # fmt: skip
        claims = {name: value for name, value in (claims | changes).items() if value is not None}
        head = {"kid": self.kid, "typ": None} | (header or {})
        return jwt.encode(claims, key or self.key, algorithm="RS256", headers=head)
