"""Trust bundle of an enforcement point over restarts: the newest one acted on stays, an older one is refused ([TRB-4]).

Beside the mark lies the newest bundle that came by succession ([TRB-5]). It holds where it is newer than the file that
the configuration names, so that nobody has to bring each bundle by hand.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Final

from capabilities.keys.trust import TrustBundle
from capabilities.rotation.succession import NewestBundle, check_bundle
from capabilities.values.errors import CapabilityError, Fault
from pep.base.errors import ConfigError, PepFault
from pep.base.files import replace_file

if TYPE_CHECKING:
    from pathlib import Path

    from capabilities.values.caps import Caps

BUNDLE_FILE: Final = "trust-bundle.json"
"""Name of the file beside the mark."""


def newest(configured: TrustBundle, mark: Path) -> TrustBundle:
    """The bundle to begin with: the one that was kept, where it is newer than the configured one.

    Args:
        configured: from the file that the configuration names.
        mark: path of the mark.

    Raises:
        ConfigError: `STATE_UNREADABLE` for a kept bundle that cannot be read.
    """
    path = mark.with_name(BUNDLE_FILE)
    try:
        kept = TrustBundle.from_json(path.read_bytes())
    except (FileNotFoundError, NotADirectoryError):  # the mark says whether it should be there
        return configured
    except (OSError, CapabilityError) as error:
        raise ConfigError(PepFault.STATE_UNREADABLE, str(path)) from error
    return kept if kept.issuer == configured.issuer and kept.version > configured.version else configured


def keep(trust: TrustBundle, mark: Path) -> None:
    """Keeps a bundle that takes the place of the one before, first itself and then its mark.

    Raises:
        OSError: it is not on disk; nothing is lost of what was.
    """
    replace_file(mark.with_name(BUNDLE_FILE), trust.to_json())
    replace_file(mark, _content(NewestBundle.of(trust), trust.issuer))


def check_mark(trust: TrustBundle, path: Path, *, at: float, caps: Caps) -> None:
    """Checks that the bundle may be acted on, and remembers it from now on.

    Args:
        trust: from the file that the configuration names, or the kept one.
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
    try:
        replace_file(path, _content(answer, trust.issuer))
    except OSError as error:
        raise ConfigError(PepFault.STATE_UNREADABLE, str(path)) from error


def _content(seen: NewestBundle, issuer: str) -> bytes:
    return json.dumps({"issuer": issuer, "version": seen.version, "digest": seen.digest.hex()}).encode()


def _read(path: Path, issuer: str) -> NewestBundle | None:
    try:
        stored = json.loads(path.read_bytes())
        seen = NewestBundle(int(stored["version"]), bytes.fromhex(stored["digest"]))
        return seen if stored["issuer"] == issuer else None
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(PepFault.STATE_UNREADABLE, str(path)) from error
