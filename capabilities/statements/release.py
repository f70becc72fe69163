"""Release of an agent's software: its publisher states the digests of all that it is made of."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Final

from msgspec import field

from capabilities.statements import statement_form
from capabilities.statements.claims import Name, Sha256, Whole, malformed, read
from capabilities.values import strict_json
from capabilities.values.errors import FaultCode, StatementError
from capabilities.values.form import Form, plain

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "release"
LIFETIME_S: Final = 366 * 86_400
"""Longest life of a release: a year, like the signed description of a cell."""


class Release(Form, frozen=True):
    """Publisher's word on what its software is made of.

    Attributes:
        publisher: name by which the configuration of the identity provider calls it.
        name: of the software.
        software, model, prompt, tools: SHA-256 over the program, the model, the prompt and the manifest of its tools.
        at, not_after: in between it holds, seconds since the epoch.
    """

    publisher: Name
    name: Name
    software: Sha256
    model: Sha256
    prompt: Sha256
    tools: Sha256
    at: Whole
    not_after: Whole = field(name="not_after")

    @property
    def measurement(self) -> bytes:
        """The software digest of an agent that is this release: SHA-256 over the four digests, [STM-19]."""
        return measurement(self.software, self.model, self.prompt, self.tools)


def measurement(software: bytes, model: bytes, prompt: bytes, tools: bytes) -> bytes:
    """The one digest of these four."""
    digests = {"model": model.hex(), "prompt": prompt.hex(), "software": software.hex(), "tools": tools.hex()}
    return hashlib.sha256(strict_json.canonical(digests)).digest()


def sign(release: Release, key: PrivateKey) -> str:
    """The signed release."""
    digests = {name: getattr(release, name).hex() for name in ("software", "model", "prompt", "tools")}
    return statement_form.seal(KIND, plain(release) | digests, key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Release:  # noqa: A001 - read as release.open
    """The release, signed by one of these keys. Whether it is in force, `check_times` says.

    Raises:
        StatementError: as `statement_form.open`.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def check_times(release: Release, *, at: float, caps: Caps) -> None:
    """Checks that the release is in force at `at`, seconds since the epoch.

    Raises:
        StatementError: `NOT_YET_VALID` or `EXPIRED`.
    """
    if not release.at <= at + caps.skew_s:
        raise StatementError(FaultCode.NOT_YET_VALID, "a release of the future")
    if not at < release.not_after:
        raise StatementError(FaultCode.EXPIRED, "the release is over")


def _read(claims: dict[str, object]) -> Release:
    release = read(Release, claims)
    if not 0 < release.not_after - release.at <= LIFETIME_S:
        raise malformed(f"not_after: not within {LIFETIME_S} s of at")
    return release
