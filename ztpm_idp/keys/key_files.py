"""The private keys of an identity provider, one for each role, and how one is read from its file."""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from capabilities.keys.keys import Algorithm, algorithm_of, from_pem, public_raw
from capabilities.keys.signing_key import SigningKey
from capabilities.keys.trust import TrustBundle
from capabilities.keys.windows import Role
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import BadKeyError

if TYPE_CHECKING:
    from pathlib import Path

    from capabilities.keys.keys import PrivateKey
    from capabilities.rotation.rotation import KeyRing

TokenKey = Ed25519PrivateKey | SigningKey
"""A private key that signs tokens, here or where it signs; one that signs elsewhere is Ed25519 (`token_key`)."""
PASSPHRASE_VARIABLE: Final = "ZTPM_PASSPHRASE"  # noqa: S105  its name, not its value
"""The environment variable that holds the passphrase of the key files."""


class SettingsError(Exception):
    """A setting that is refused.

    Attributes:
        setting: its name.
        why: the fault in it; never its value.
    """

    def __init__(self, setting: str, why: str) -> None:
        super().__init__(f"{setting}: {why}")
        self.setting = setting
        self.why = why


class UnsafeError(ValueError):
    """Carries a setting's name through pydantic.

    Attributes:
        setting, why: as of `SettingsError`.
    """

    def __init__(self, setting: str, why: str) -> None:
        super().__init__(why)
        self.setting = setting
        self.why = why


class SignerUnavailableError(Exception):
    """A key whose holder, such as a hardware module, does not sign now.

    Its text names key and cause, and no secret.
    """


@dataclass(frozen=True, slots=True)
class IdpKeys:
    """The five private keys that an identity provider signs with, one for each role.

    Attributes:
        ring: the key ring that they are taken from, if any.
        former_registry: registry keys that signed before and are still trusted; they sign trust bundles alone, for
            those verifiers that do not know the new key yet.
    """

    root: TokenKey
    attester: TokenKey
    feed: PrivateKey
    registry: PrivateKey
    ledger: PrivateKey
    ring: KeyRing | None = None
    former_registry: tuple[PrivateKey, ...] = ()

    def __repr__(self) -> str:
        return "IdpKeys(...)"

    @property
    def every_public(self) -> frozenset[bytes]:
        """The raw public keys that this provider has or had: nobody else may have one of them."""
        now = frozenset(map(public_raw, (self.root, self.attester, self.feed, self.registry, self.ledger)))
        return now if self.ring is None else now | self.ring.all_keys

    @property
    def bundle_version(self) -> int:
        """Version of the trust bundle of these keys."""
        return 1 if self.ring is None else self.ring.version

    def root_key_id(self, stated: int) -> int:
        """Number of the root key that signs, by the ring; `stated` where there is none."""
        return stated if self.ring is None else self.ring.active(Role.ROOT).number

    def trust(self, *, issuer: str, root_key_id: int, version: int = 1) -> TrustBundle:
        """Trust bundle of these keys: that of the key ring, or one of these five, for ever.

        Raises:
            BadKeyError: `KEY_WRONG_ROLE` when a key has two roles.
        """
        if self.ring is not None:
            return self.ring.bundle(DEFAULT)
        return TrustBundle(
            issuer=issuer,
            version=version,
            roots={root_key_id: public_raw(self.root)},
            attesters=frozenset({public_raw(self.attester)}),
            feed=frozenset({public_raw(self.feed)}),
            registry=frozenset({public_raw(self.registry)}),
            ledger=frozenset({public_raw(self.ledger)}),
        )


def token_key(setting: str, key: PrivateKey) -> TokenKey:
    """The key, when it has the algorithm that the token profile signs with; the other roles may have either.

    Raises:
        SettingsError: naming the setting.
    """
    if algorithm_of(public_raw(key)) is not Algorithm.ED25519 or isinstance(key, EllipticCurvePrivateKey):
        raise SettingsError(setting, "not an Ed25519 key")
    return key


def load_key(setting: str, path: Path, passphrase: str) -> PrivateKey:
    """The private key of an encrypted file that nobody else may read or write.

    Raises:
        SettingsError: naming the setting.
    """
    try:
        with path.open("rb") as file:
            if stat.S_IMODE(os.fstat(file.fileno()).st_mode) & 0o077:
                raise SettingsError(setting, "others may read or write the file; its mode must be 0600")
            return from_pem(file.read(), passphrase.encode())
    except OSError:
        raise SettingsError(setting, "the file cannot be read") from None
    except BadKeyError:
        raise SettingsError(setting, "not an encrypted key, or a wrong passphrase") from None
