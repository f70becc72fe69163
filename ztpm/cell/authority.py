"""Small certification authority of one cell, and the certificates that it gives to the cell's machines."""

from __future__ import annotations

import datetime as dt
import ipaddress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cryptography.x509 import Certificate

AUTHORITY_DAYS: Final = 3_650
"""Life of the authority; ours: as long as a cell."""
MACHINE_DAYS: Final = 730
"""Life of a machine's certificate; ours. `ztpm doctor --idp` says two weeks before that it ends."""
BACKDATED: Final = dt.timedelta(minutes=5)
"""Certificates hold from so long before they were made, since two machines' clocks differ a little."""
CURVE: Final = ec.SECP256R1()


@dataclass(frozen=True, slots=True)
class Issued:
    """One certificate and its key, PEM; the key is encrypted where it has a passphrase."""

    certificate: bytes
    key: bytes


def new_authority(name: str, passphrase: bytes, *, at: float) -> Issued:
    """An authority that signs certificates of machines and nothing else.

    Args:
        name: of the cell, for people.
        passphrase: encrypts its key.
        at: seconds since the epoch.
    """
    key = ec.generate_private_key(CURVE)
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"authority of the cell {name}"[:64])])
    made = (
        _begun(subject, subject, key, at=at, days=AUTHORITY_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )
    encrypted = serialization.BestAvailableEncryption(passphrase)
    return Issued(_pem(made.sign(key, SHA256())), _key(key, encrypted))


def machine_certificate(authority: Issued, passphrase: bytes, hosts: Iterable[str], *, at: float) -> Issued:
    """A certificate for one machine's addresses, and its key without a passphrase.

    Args:
        authority: of the cell.
        passphrase: of the authority's key.
        hosts: addresses or names at which the machine is reached.
        at: seconds since the epoch.

    Raises:
        ValueError: the passphrase does not open the authority's key.
    """
    own = x509.load_pem_x509_certificate(authority.certificate)
    signer = serialization.load_pem_private_key(authority.key, passphrase)
    if not isinstance(signer, ec.EllipticCurvePrivateKey):
        raise ValueError("the authority's key is of another kind")  # noqa: TRY004 - a file's content, not a type of ours
    key = ec.generate_private_key(CURVE)
    names = [_name(host) for host in dict.fromkeys(hosts)]
    identifier = own.extensions.get_extension_for_class(x509.SubjectKeyIdentifier).value
    made = (
        _begun(x509.Name([]), own.subject, key, at=at, days=MACHINE_DAYS)
        .add_extension(x509.SubjectAlternativeName(names), critical=True)  # RFC 5280, 4.2.1.6: the subject is empty
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(identifier), critical=False)
    )
    return Issued(_pem(made.sign(signer, SHA256())), _key(key, serialization.NoEncryption()))


def _begun(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, *, at: float, days: int
) -> x509.CertificateBuilder:
    begun = dt.datetime.fromtimestamp(int(at), dt.UTC) - BACKDATED
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begun)
        .not_valid_after(begun + dt.timedelta(days=days))
    )


def _usage(*, signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs, key_cert_sign=signs, crl_sign=signs, content_commitment=False,
        key_encipherment=False, data_encipherment=False, key_agreement=False, encipher_only=False, decipher_only=False,
    )  # fmt: skip


def _name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _pem(certificate: Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _key(key: ec.EllipticCurvePrivateKey, encryption: serialization.KeySerializationEncryption) -> bytes:
    return key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, encryption)
