"""Keys of the authorization server: they sign access tokens, and nothing else. The first signs, all are published."""

from __future__ import annotations

import hmac
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from capabilities.keys import jws
from capabilities.keys.keys import public_raw, thumbprint
from ztpm_idp.keys.key_files import SettingsError, load_key

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from capabilities.keys.keys import PrivateKey
    from ztpm_idp.keys.key_files import IdpKeys

SETTING: Final = "oauth_key_files"
MOST: Final = 4
"""Most keys at once: a rotation needs two, an overlap with another one three."""
_SECRET_BYTES: Final = 32


@dataclass(frozen=True)
class OAuthKeys:
    """Private keys of the authorization server, the one that signs first.

    Attributes:
        keys: Ed25519 or P-256, at least one, each once.
    """

    keys: tuple[PrivateKey, ...]

    def __repr__(self) -> str:
        return f"OAuthKeys({len(self.keys)})"

    @property
    def signing(self) -> PrivateKey:
        """The key that signs now."""
        return self.keys[0]

    @cached_property
    def public(self) -> dict[str, bytes]:
        """Raw public keys by key id, which is the thumbprint."""
        return {thumbprint(raw): raw for raw in map(public_raw, self.keys)}

    @cached_property
    def jwks(self) -> dict[str, object]:
        """The JSON Web Key Set of all keys (RFC 7517)."""
        return {
            "keys": [
                jws.jwk(raw) | {"kid": kid, "use": "sig", "alg": jws.algorithm_name(raw)}
                for kid, raw in self.public.items()
            ]
        }

    def secrets(self, label: str) -> tuple[bytes, ...]:
        """32 bytes for each key, for this purpose alone and the same in every worker; the first is used now."""
        return tuple(_derived(key, label) for key in self.keys)

    def mac(self, label: str, said: bytes) -> bytes:
        """The authentication code of `said` for this purpose."""
        return hmac.digest(self.secrets(label)[0], said, "sha256")

    def made(self, label: str, said: bytes, mac: bytes) -> bool:
        """True for a code that one of these keys made."""
        return any(hmac.compare_digest(hmac.digest(one, said, "sha256"), mac) for one in self.secrets(label))


def load(names: Sequence[str], folder: Path, keys: IdpKeys, passphrase: str) -> OAuthKeys | None:
    """The keys of these files, or None where there is none.

    Args:
        names: of encrypted PKCS #8 files, the one that signs first; relative ones start in `folder`.
        folder: where the configuration lies.
        keys: of the provider, of which none may be here, too.
        passphrase: of all of them.

    Raises:
        SettingsError: `oauth_key_files`.
    """
    if not names:
        return None
    if len(names) > MOST:
        raise SettingsError(SETTING, f"at most {MOST} keys")
    found = OAuthKeys(tuple(load_key(SETTING, folder / name, passphrase) for name in names))
    if len(found.public) != len(names) or keys.every_public & set(found.public.values()):
        raise SettingsError(SETTING, "one key has one role, and stands here once")
    return found


def _derived(key: PrivateKey, label: str) -> bytes:
    match key:
        case Ed25519PrivateKey():
            secret = key.private_bytes_raw()
        case EllipticCurvePrivateKey():
            secret = key.private_numbers().private_value.to_bytes(_SECRET_BYTES, "big")
        case _:
            raise SettingsError(SETTING, "a key of a file: nonces are derived from it")
    return HKDF(hashes.SHA256(), _SECRET_BYTES, None, f"ztpm oauth {label}".encode()).derive(secret)
