"""Steps of a rotation on a cell's directory: ring, private keys and trust bundle, in safe order.

The private key is on disk before the ring names it, and the ring before the bundle that it makes. A step that was cut
off half way leaves a private key that nobody names, or an old bundle, which the next step writes anew.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from capabilities.keys import keys
from capabilities.rotation import rotation
from capabilities.rotation.rotation_json import ring_from_json, ring_to_json
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import BadKeyError
from ztpm.base.layout import LayoutError, new_key, read_key, replace_private
from ztpm_idp.keys.hardware_token import open_token
from ztpm_idp.settings import load_settings

if TYPE_CHECKING:
    from capabilities.keys.windows import Role
    from capabilities.rotation.rotation import KeyRing, RotationRefused
    from ztpm.base.layout import Layout
    from ztpm_idp.keys.hardware_token import HardwareToken


class RotationStep(Protocol):
    """A step of `capabilities.rotation.rotation` on one key."""

    def __call__(self, ring: KeyRing, id_: str, *, at: int) -> KeyRing | RotationRefused:
        """Ring after the step."""
        ...


def read(layout: Layout) -> KeyRing:
    """The ring of a cell.

    Raises:
        LayoutError: when there is none, or others can write it.
        capabilities.values.errors.BadKeyError: when it does not hold together.
    """
    try:
        mode = layout.key_ring.stat().st_mode
    except FileNotFoundError as error:
        raise LayoutError(f"{layout.key_ring} is missing") from error
    if mode & 0o022:
        raise LayoutError(f"{layout.key_ring} can be written by others (mode {mode & 0o777:o}); it must be 600")
    return ring_from_json(layout.key_ring.read_bytes())


def prepare(
    layout: Layout,
    role: Role,
    algorithm: keys.Algorithm,
    *,
    passphrase: bytes,
    at: int,
    token: HardwareToken | None = None,
) -> KeyRing | RotationRefused:
    """Makes a further key of a role, encrypted under the passphrase that opens the present signing key.

    Args:
        layout: of the cell.
        role: role of the key.
        algorithm: algorithm of its signatures.
        passphrase: of all keys of the provider.
        at: seconds since the epoch.
        token: of a hardware module, in which the key is made; None: in a file.

    Raises:
        LayoutError, capabilities.values.errors.BadKeyError: as `read`; also for another passphrase than the other
        keys'.
        SettingsError: `pkcs11`, when the token makes no key.
        OSError: when a file cannot be written.
    """
    ring = read(layout)
    signing = layout.idp_key(ring.active(role).id)
    try:
        if token is None or signing.exists():
            read_key(signing, passphrase)
    except BadKeyError as error:  # one passphrase opens them all, or the provider does not start
        raise LayoutError(f"the passphrase does not open {ring.active(role).id}") from error
    number = 1 + max(record.number for record in ring.records if record.role is role)
    name = f"{rotation.ID_STEM[role]}-{number}"
    path = layout.idp_key(name)
    # Asked with a key that is thrown away, so that no file is made for a step that is refused.
    asked = rotation.prepare(ring, role, keys.public_raw(keys.generate(algorithm)), at=at)
    if isinstance(asked, rotation.RotationRefused):
        return asked
    path.unlink(missing_ok=True)  # of a step that was cut off: no ring names it
    if token is not None:
        return _written(layout, rotation.prepare(ring, role, token.make(name, algorithm), at=at))
    made = new_key(path, passphrase, algorithm)
    return _written(layout, rotation.prepare(ring, role, keys.public_raw(made), at=at))


def token_of(layout: Layout, role: str) -> HardwareToken | None:
    """The token in which the provider's configuration wants keys of this role made, if any.

    Raises:
        SettingsError: the configuration is refused, or the token is not to be had.
    """
    stated = load_settings(layout.idp_config).pkcs11
    if stated is None or role not in stated.roles:
        return None
    return open_token(stated.module, stated.token)


def step(layout: Layout, verb: RotationStep, id_: str, *, at: int) -> KeyRing | RotationRefused:
    """Activates, taints or revokes a key.

    A revoked key keeps its file: the operator may want to show it.

    Raises:
        LayoutError, capabilities.values.errors.BadKeyError: as `read`.
        OSError: when a file cannot be written.
    """
    return _written(layout, verb(read(layout), id_, at=at))


def renew(layout: Layout, *, at: int) -> KeyRing | RotationRefused:
    """Renews the trust bundle of the same keys for its whole life from now on.

    Raises:
        LayoutError, capabilities.values.errors.BadKeyError: as `read`.
        OSError: when a file cannot be written.
    """
    return _written(layout, rotation.renew(read(layout), at=at))


def _written(layout: Layout, answer: KeyRing | RotationRefused) -> KeyRing | RotationRefused:
    if isinstance(answer, rotation.RotationRefused):
        return answer
    replace_private(layout.key_ring, ring_to_json(answer))
    replace_private(layout.trust, answer.bundle(DEFAULT).to_json())
    return answer
