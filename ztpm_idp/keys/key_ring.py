"""The key ring of a deployment: which of its keys sign, and where their private halves lie."""

from __future__ import annotations

import os
import stat
from typing import TYPE_CHECKING, Final

from capabilities.keys.keys import public_raw
from capabilities.keys.windows import Role
from capabilities.rotation.rotation import KeyRing, KeyState
from capabilities.rotation.rotation_json import ring_from_json
from capabilities.values.errors import BadKeyError
from ztpm_idp.keys.key_files import IdpKeys, SettingsError, load_key, token_key

if TYPE_CHECKING:
    from pathlib import Path

    from capabilities.keys.keys import PrivateKey
    from capabilities.rotation.rotation import KeyRecord
    from ztpm_idp.keys.hardware_token import HardwareToken

SETTING: Final = "key_ring_file"
RING_BYTES: Final = 2**20
"""Largest file: 4096 keys of less than 256 bytes."""


def load(name: str, folder: Path, issuer: str, passphrase: str, *, hardware: HardwareToken | None = None) -> IdpKeys:
    """The private keys that sign by the ring of this file.

    Args:
        name: of the file; a relative one starts in `folder`.
        folder: where the configuration lies.
        issuer: that the ring is of.
        passphrase: of all private keys.
        hardware: token of a hardware module; it holds the private keys that have no file beside the ring.

    Raises:
        SettingsError: `key_ring_file` when it or a private key beside it is unreadable, may be written by others, is
            of another issuer or does not hold together.
    """
    path = folder / name
    ring = _read(path, issuer)

    def private(record: KeyRecord) -> PrivateKey:
        file = path.parent / f"{record.id}.key"
        if hardware is not None and not file.exists():
            return hardware.key(record.id, record.key)
        key = load_key(SETTING, file, passphrase)
        if public_raw(key) != record.key:
            raise SettingsError(SETTING, f"{record.id}.key is not the key that the ring names")
        return key

    signing = {role: private(ring.active(role)) for role in Role}
    former = [r for r in ring.records if r.role is Role.REGISTRY and r.state is KeyState.RETIRED]
    return IdpKeys(
        root=token_key(SETTING, signing[Role.ROOT]),
        attester=token_key(SETTING, signing[Role.ATTESTER]),
        feed=signing[Role.FEED],
        registry=signing[Role.REGISTRY],
        ledger=signing[Role.LEDGER],
        ring=ring,
        former_registry=tuple(map(private, former)),
    )


def check_current(keys: IdpKeys, *, at: float) -> None:
    """The trust bundle of the ring, if there is one, holds now.

    Raises:
        SettingsError: `key_ring_file` when it is of the future or over: nobody would trust a signature made here.
    """
    if keys.ring is None:
        return
    bundle = keys.trust(issuer=keys.ring.issuer, root_key_id=0)
    if not bundle.issued_at <= at < bundle.valid_until:
        raise SettingsError(SETTING, "its trust bundle does not hold now; a new one: ztpm keys renew")


def _read(path: Path, issuer: str) -> KeyRing:
    try:
        with path.open("rb") as file:
            if stat.S_IMODE(os.fstat(file.fileno()).st_mode) & 0o022:
                raise SettingsError(SETTING, "others may write the file: who may, may sign")
            ring = ring_from_json(file.read(RING_BYTES))
    except OSError:
        raise SettingsError(SETTING, "the file cannot be read") from None
    except BadKeyError as error:
        raise SettingsError(SETTING, f"{error.code}: {error.detail}") from None
    if ring.issuer != issuer:
        raise SettingsError(SETTING, "the ring of another issuer")
    return ring
