"""The passphrase of key files, and the rights that others may not have to a file."""

from __future__ import annotations

import stat
from pathlib import Path
from typing import TYPE_CHECKING, Final

from ztpm_idp.keys.key_files import SettingsError

if TYPE_CHECKING:
    from collections.abc import Mapping

PASSPHRASE_FILE_VARIABLE: Final = "ZTPM_PASSPHRASE_FILE"  # noqa: S105 - its name, not its value
PASSPHRASE_BYTES: Final = 4_096
"""Longest file of a passphrase; ours."""
OTHERS_WRITE: Final = 0o022
"""Group or others may write; a file that decides is its owner's alone."""
STRANGERS_READ: Final = 0o007
"""Others may read, write or enter. A group may read: secrets of containers and of certificate services come so."""


def passphrase_of(variable: str, environment: Mapping[str, str]) -> str:
    """The passphrase of the key files, from the environment or from the file that it names.

    Args:
        variable: name of the variable that holds it.
        environment: of the process.

    Raises:
        SettingsError: `ZTPM_PASSPHRASE_FILE`, when the file is unreadable, open to others, or both are stated.
    """
    stated, named = environment.get(variable, ""), environment.get(PASSPHRASE_FILE_VARIABLE, "")
    if not named:
        return stated
    if stated:
        raise SettingsError(PASSPHRASE_FILE_VARIABLE, f"{variable} is set, too")
    file = Path(named)
    check_modes(PASSPHRASE_FILE_VARIABLE, file, STRANGERS_READ | OTHERS_WRITE)
    try:
        text = file.read_bytes()[: PASSPHRASE_BYTES + 1].decode()
    except (OSError, UnicodeDecodeError):
        raise SettingsError(PASSPHRASE_FILE_VARIABLE, "the file cannot be read") from None
    found = text.removesuffix("\n").removesuffix("\r")
    if not found or len(found) > PASSPHRASE_BYTES or "\n" in found:
        raise SettingsError(PASSPHRASE_FILE_VARIABLE, "not one line with a passphrase")
    return found


def check_modes(setting: str, path: Path, refused: int) -> None:
    """The file is there, and nobody has a right of these to it.

    Raises:
        SettingsError: naming the setting.
    """
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
    except OSError:
        raise SettingsError(setting, "the file cannot be read") from None
    if mode & refused & OTHERS_WRITE:
        raise SettingsError(setting, f"others may write {path.name} (mode {mode:o})")
    if mode & refused:
        raise SettingsError(setting, f"others may read {path.name} (mode {mode:o})")
