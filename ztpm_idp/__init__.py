"""Identity provider: the rights to lend authority, revocations, and the record of it all."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ztpm_idp.app import create_app
    from ztpm_idp.keys.key_files import IdpKeys, SettingsError
    from ztpm_idp.settings import Settings

__all__ = ["IdpKeys", "Settings", "SettingsError", "create_app"]

_HOMES = {
    "IdpKeys": "ztpm_idp.keys.key_files",
    "Settings": "ztpm_idp.settings",
    "SettingsError": "ztpm_idp.keys.key_files",
    "create_app": "ztpm_idp.app",
}


def __getattr__(name: str) -> object:
    # Loaded when asked for: an agent that only wants the client needs no web server and no database library.
    from importlib import import_module

    if name not in _HOMES:
        raise AttributeError(name)
    return getattr(import_module(_HOMES[name]), name)
