"""Right to read the figures: from this machine alone, or by a token that the settings name.

Behind a TLS proxy every caller seems to be of this machine, so there it takes the token.
"""

from __future__ import annotations

import hashlib
import hmac
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from ztpm_idp.domain.addresses import is_loopback
from ztpm_idp.keys.key_files import SettingsError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from ztpm_idp.settings import FileSettings, Stated

SETTING: Final = "metrics_token_file"
VARIABLE: Final = "ZTPM_METRICS_TOKEN_FILE"
"""Variable that names the file where the settings name none, as a container is told of a secret."""
_TOKEN: Final = re.compile(r"[A-Za-z0-9._~+/-]{32,256}=*")
"""Form of a token (RFC 6750 section 2.1): 32 characters of base64 have 192 bits."""
_FILE_BYTES: Final = 1_024
_OTHERS: Final = 0o027
"""Rights that nobody else may have: a group may read, as it may a key of TLS, and write nothing."""
_SCHEME: Final = "bearer"


@dataclass(frozen=True, slots=True)
class MetricsAccess:
    """Right to read the figures.

    Attributes:
        token_digest: SHA-256 of the token; None: there is none.
        loopback: callers of this machine may read without one.
    """

    token_digest: bytes | None
    loopback: bool

    def may_read(self, client: str, authorization: str | None, *, forwarded: bool = False) -> bool:
        """True for a caller who may read.

        Args:
            client: address of the connection's other end.
            authorization: header of the request.
            forwarded: a proxy says that it passed the request on.
        """
        if self.token_digest is None:
            return self.loopback and not forwarded and is_loopback(client)
        scheme, _, token = (authorization or "").partition(" ")
        shown = hashlib.sha256(token.encode("utf-8", "surrogatepass")).digest()
        return scheme.lower() == _SCHEME and hmac.compare_digest(shown, self.token_digest)


def by_settings(settings: Stated) -> MetricsAccess:
    """Right of a deployment without a token: callers of this machine, where no proxy makes everybody one."""
    proxied = settings.issuer.startswith("https:") and settings.tls_certificate_file is None
    return MetricsAccess(None, loopback=not proxied)


def load(settings: FileSettings, folder: Path, environment: Mapping[str, str]) -> MetricsAccess:
    """Right to read the figures, by a deployment's settings.

    Args:
        settings: of its file.
        folder: where a relative name starts.
        environment: of the process; `VARIABLE` counts where the settings name no file.

    Raises:
        SettingsError: `metrics_token_file`, when it cannot be read, others may read it, or no token is in it.
    """
    named = settings.metrics_token_file or environment.get(VARIABLE)
    if not named:
        return by_settings(settings)
    file = folder / named
    try:
        mode = file.stat().st_mode & 0o777
        with file.open("rb") as opened:
            raw = opened.read(_FILE_BYTES)
    except OSError:
        raise SettingsError(SETTING, "the file cannot be read") from None
    if mode & _OTHERS:
        raise SettingsError(SETTING, f"others may read or write it (mode {mode:o}); at most 640")
    token = raw.decode("ascii", "replace").strip()
    if not _TOKEN.fullmatch(token):
        raise SettingsError(SETTING, "one token of 32 to 256 characters of base64 is needed: openssl rand -base64 32")
    return MetricsAccess(hashlib.sha256(token.encode()).digest(), loopback=False)
