"""Reading an encrypted private key: never one that others can read, or one without a passphrase."""

from __future__ import annotations

import os
import stat
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys
from capabilities.values.errors import CapabilityError
from pep.base.errors import ConfigError, PepFault

if TYPE_CHECKING:
    from pathlib import Path

    from capabilities.keys.keys import PrivateKey

PASSPHRASE_VARIABLE: Final = "ZTPM_PASSPHRASE"  # noqa: S105 - the name of the variable


def read_key(path: Path, *, name: str) -> PrivateKey:
    """The key at `path`, with the passphrase of the environment.

    Args:
        path: of the encrypted key.
        name: of the setting that gave the path; it leads the error's detail.

    Raises:
        ConfigError: `CONFIG_INVALID` when the file is missing, can be read by others, or the passphrase is missing or
            wrong.
    """
    passphrase = os.environ.get(PASSPHRASE_VARIABLE, "")
    if not passphrase:
        raise ConfigError(PepFault.CONFIG_INVALID, f"{PASSPHRASE_VARIABLE} is not set")
    try:
        with path.open("rb") as file:
            if stat.S_IMODE(os.fstat(file.fileno()).st_mode) & 0o077:
                raise ConfigError(PepFault.CONFIG_INVALID, f"{name} can be read by others")
            return keys.from_pem(file.read(), passphrase.encode())
    except (OSError, CapabilityError) as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"{name}: {type(error).__name__}") from error
