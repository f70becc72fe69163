"""Files and addresses of a configuration that take effect while the provider serves, without a restart."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ztpm_idp.keys import key_ring, oauth_keys
from ztpm_idp.keys.key_files import SettingsError
from ztpm_idp.keys.watched_file import WatchedFile
from ztpm_idp.platforms.sources import AskedPlatform, PlatformKeys
from ztpm_idp.settings import load_keys, load_platform, load_settings

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from ztpm_idp.keys.key_files import IdpKeys
    from ztpm_idp.keys.oauth_keys import OAuthKeys
    from ztpm_idp.keys.watched_file import Beside
    from ztpm_idp.provider.provider import Provider
    from ztpm_idp.settings import FileSettings

PLATFORM_FILE = "platform_jwks_file"
CONFIG = "config"


def watching(
    settings: FileSettings, config: Path, passphrase: str, keys: IdpKeys
) -> Callable[[Provider], list[Beside]]:
    """Maker of what runs beside a provider: watches over its key ring, OAuth keys and platforms' keys.

    Args:
        settings: of the configuration file.
        config: that file; relative names start in its folder.
        passphrase: of all private keys; kept for as long as the watch is.
        keys: of the provider now.

    Raises:
        SettingsError: a file of a platform is refused: a provider does not start on it.
    """
    folder = config.parent
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
            _config(settings, config, passphrase, provider),
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


def _config(settings: FileSettings, config: Path, passphrase: str, provider: Provider) -> Beside:
    """Watch over the configuration itself, of which the OAuth keys alone take effect without a new start."""

    def read() -> OAuthKeys | None:
        stated = load_settings(config)
        for name in type(settings).model_fields:
            if name != oauth_keys.SETTING and getattr(stated, name) != getattr(settings, name):
                raise SettingsError(name, "changed: it takes effect at the next start")
        return oauth_keys.load(stated.oauth_key_files, config.parent, provider.keys, passphrase)

    return WatchedFile(CONFIG, config, read=read, take=provider.adopt_oauth, faults=provider.faults)


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
