"""Files of a configuration that take effect while the provider serves, without a restart."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ztpm_idp.keys import key_ring
from ztpm_idp.keys.watched_file import WatchedFile
from ztpm_idp.settings import load_keys

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from ztpm_idp.keys.key_files import IdpKeys
    from ztpm_idp.provider.provider import Provider
    from ztpm_idp.settings import FileSettings


def watching(settings: FileSettings, folder: Path, passphrase: str) -> Callable[[Provider], list[WatchedFile[IdpKeys]]]:
    """Maker of the watch over the key ring, for one provider.

    Args:
        settings: of a configuration file.
        folder: where relative names start.
        passphrase: of all private keys; kept for as long as the watch is.
    """

    def watch(provider: Provider) -> list[WatchedFile[IdpKeys]]:
        if settings.key_ring_file is None:
            return []
        return [
            WatchedFile(
                key_ring.SETTING,
                folder / settings.key_ring_file,
                read=lambda: load_keys(settings, folder, passphrase),
                take=provider.adopt,
                faults=provider.faults,
            )
        ]

    return watch
