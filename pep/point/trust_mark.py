"""Mark of the newest trust bundle acted on, on disk: an older one is refused ([TRB-4])."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from capabilities.rotation.succession import NewestBundle, check_bundle
from capabilities.values.errors import Fault
from pep.base.errors import ConfigError, PepFault
from pep.base.files import replace_file

if TYPE_CHECKING:
    from pathlib import Path

    from capabilities.keys.trust import TrustBundle
    from capabilities.values.caps import Caps


def check_mark(trust: TrustBundle, path: Path, *, at: float, caps: Caps) -> None:
    """Checks that the bundle may be acted on, and remembers it from now on.

    Args:
        trust: from the file that the configuration names.
        path: of the mark; made when there is none.
        at: seconds since the epoch.
        caps: the bounds.

    Raises:
        ConfigError: `CONFIG_INVALID` for a bundle that is older than one that was seen, other than the one of its
            version, of the future or over; `STATE_UNREADABLE` for a mark that cannot be read or written: starting
            from none would take an old bundle back.
    """
    answer = check_bundle(trust, _read(path, trust.issuer), at=at, caps=caps)
    if isinstance(answer, Fault):
        raise ConfigError(PepFault.CONFIG_INVALID, f"trust_file: {answer.code}: {answer.detail}")
    content = {"issuer": trust.issuer, "version": answer.version, "digest": answer.digest.hex()}
    try:
        replace_file(path, json.dumps(content).encode())
    except OSError as error:
        raise ConfigError(PepFault.STATE_UNREADABLE, str(path)) from error


def _read(path: Path, issuer: str) -> NewestBundle | None:
    try:
        stored = json.loads(path.read_bytes())
        seen = NewestBundle(int(stored["version"]), bytes.fromhex(stored["digest"]))
        return seen if stored["issuer"] == issuer else None
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(PepFault.STATE_UNREADABLE, str(path)) from error
