"""Files and addresses of a configuration that take effect while the provider serves, without a restart."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ztpm_idp.keys import key_ring
from ztpm_idp.keys.key_files import SettingsError
from ztpm_idp.keys.watched_file import WatchedFile
from ztpm_idp.platforms.sources import AskedPlatform, PlatformKeys
from ztpm_idp.settings import load_keys, load_platform

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from ztpm_idp.keys.key_files import IdpKeys
    from ztpm_idp.keys.watched_file import Beside
    from ztpm_idp.provider.provider import Provider
    from ztpm_idp.settings import FileSettings

PLATFORM_FILE = "platform_jwks_file"


def watching(
    settings: FileSettings, folder: Path, passphrase: str, keys: IdpKeys
) -> Callable[[Provider], list[Beside]]:
    """Maker of what runs beside a provider: it watches its key ring and the keys of its platforms.

    Args:
        settings: of a configuration file.
        folder: where relative names start.
        passphrase: of all private keys; kept for as long as the watch is.
        keys: of the provider now.

    Raises:
        SettingsError: a file of a platform is refused: a provider does not start on it.
    """
    sources = [PlatformKeys(stated, folder) for stated in settings.platforms]
    first = {source.setting: source.read() for source in sources if source.path is not None}
    for setting, platform in first.items():
        if platform.all_keys & keys.every_public:
            raise SettingsError(setting, "a key of the provider itself: one key has one role")

    def beside(provider: Provider) -> list[Beside]:
        for setting, platform in first.items():
            provider.trust_platform(setting, platform)
        return [
            *_ring(settings, folder, passphrase, provider),
            *_platform(settings, folder, provider),
            *(_source(source, provider) for source in sources),
        ]

    return beside


def _ring(settings: FileSettings, folder: Path, passphrase: str, provider: Provider) -> list[Beside]:
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


def _platform(settings: FileSettings, folder: Path, provider: Provider) -> list[Beside]:
    if settings.platform_jwks_file is None:
        return []
    return [
        WatchedFile(
            PLATFORM_FILE,
            folder / settings.platform_jwks_file,
            read=lambda: load_platform(settings, folder, provider.keys),
            take=lambda platform: provider.trust_platform("", platform),
            faults=provider.faults,
        )
    ]


def _source(source: PlatformKeys, provider: Provider) -> Beside:
    path, setting = source.path, source.setting
    if path is None:
        return AskedPlatform(
            source, take=lambda platform: provider.trust_platform(setting, platform), faults=provider.faults
        )
    return WatchedFile(
        setting,
        path,
        read=source.read,
        take=lambda platform: provider.trust_platform(setting, platform),
        faults=provider.faults,
    )
