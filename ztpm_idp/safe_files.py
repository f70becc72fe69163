"""Files of a deployment, refused where others may change or read them, and TLS files that would not serve.

The settings name them; a fault is told with the setting's name.
"""

from __future__ import annotations

import datetime as dt
import stat
from pathlib import Path
from typing import TYPE_CHECKING, Final

import sqlalchemy as sa
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.dsa import DSAPublicKey
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPublicKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_private_key

from policies.decision.load import SHIPPED
from ztpm_idp.keys.key_files import SettingsError
from ztpm_idp.keys.passphrase import OTHERS_WRITE, STRANGERS_READ, check_modes

if TYPE_CHECKING:
    from ztpm_idp.settings import Stated

RSA_BITS: Final = 2_048
"""Least RSA modulus (NIST SP 800-131A rev. 2, 112 bits of security)."""


def check_files(settings: Stated, config: Path, *, at: float) -> None:
    """Configuration, policies, store and TLS files are safe and usable.

    Args:
        settings: of the configuration.
        config: the file itself; relative names start in its folder.
        at: seconds since the epoch.

    Raises:
        SettingsError: naming the setting of the first that is not.
    """
    folder = config.parent
    check_modes("config", config, OTHERS_WRITE)
    if settings.policy not in SHIPPED:
        check_modes("policy", folder / settings.policy, OTHERS_WRITE)
    _check_store(settings.database_url)
    check_tls_files(settings, folder, at=at)


def check_tls_files(settings: Stated, folder: Path, *, at: float) -> None:
    """Certificate and key, where the settings name them, are safe and usable.

    Args:
        settings: of the configuration.
        folder: where relative names start.
        at: seconds since the epoch.

    Raises:
        SettingsError: `tls_certificate_file` or `tls_key_file`.
    """
    if settings.tls_certificate_file is not None and settings.tls_key_file is not None:
        check_tls_pair(folder / settings.tls_certificate_file, folder / settings.tls_key_file, at=at)


def check_tls_pair(certificate: Path, key: Path, *, at: float) -> None:
    """Certificate and key are safe and usable: their rights, and all that `check_tls` looks at.

    Args:
        certificate: PEM file of the chain.
        key: PEM file of its key.
        at: seconds since the epoch.

    Raises:
        SettingsError: `tls_certificate_file` or `tls_key_file`.
    """
    check_modes("tls_certificate_file", certificate, OTHERS_WRITE)
    check_modes("tls_key_file", key, STRANGERS_READ | OTHERS_WRITE)
    check_tls(certificate, key, at=at)


def _check_store(database_url: str) -> None:
    """A store in a file is its owner's; one elsewhere has rights of its own."""
    url = sa.make_url(database_url)
    if url.get_backend_name() != "sqlite" or not url.database:
        return
    file = Path(url.database)
    try:
        folder = stat.S_IMODE(file.parent.stat().st_mode)
    except OSError:
        raise SettingsError("database_url", "its folder is missing") from None
    if folder & OTHERS_WRITE and not folder & stat.S_ISVTX:
        raise SettingsError("database_url", f"others may replace the store (its folder has mode {folder:o})")
    if file.exists():
        check_modes("database_url", file, STRANGERS_READ | OTHERS_WRITE)


def check_tls(certificate: Path, key: Path, *, at: float) -> x509.Certificate:
    """The certificate, when it holds now, is strong enough, and the key is its own.

    Raises:
        SettingsError: `tls_certificate_file` or `tls_key_file`.
    """
    try:
        chain = x509.load_pem_x509_certificates(certificate.read_bytes())
    except (OSError, ValueError):
        raise SettingsError("tls_certificate_file", "not a certificate in PEM form") from None
    own, now = chain[0], dt.datetime.fromtimestamp(at, dt.UTC)
    if not own.not_valid_before_utc <= now:
        raise SettingsError("tls_certificate_file", "the certificate is of the future")
    if not now < own.not_valid_after_utc:
        raise SettingsError("tls_certificate_file", f"the certificate ended on {own.not_valid_after_utc:%Y-%m-%d}")
    public = own.public_key()
    if isinstance(public, DSAPublicKey) or (isinstance(public, RSAPublicKey) and public.key_size < RSA_BITS):
        raise SettingsError("tls_certificate_file", f"its key is too weak: RSA from {RSA_BITS} bits on, or ECDSA")
    try:
        private = load_pem_private_key(key.read_bytes(), None)
    except (OSError, ValueError, TypeError):
        raise SettingsError("tls_key_file", "not a private key in PEM form without a passphrase") from None
    spelled = (Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    if private.public_key().public_bytes(*spelled) != public.public_bytes(*spelled):
        raise SettingsError("tls_key_file", "not the key of the certificate")
    return own
