"""Signed checkpoint of the ledger: its length and the hash of its last entry."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.statements import statement_form
from capabilities.statements.claims import HexDigest, Url, Whole, read
from capabilities.values.form import Form, plain

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "checkpoint"


class Checkpoint(Form, frozen=True):
    """The state of a ledger.

    Attributes:
        issuer: canonical URL of the identity provider.
        size: number of entries.
        head: hash (hex) of the last entry; 64 zeros for an empty ledger.
        as_of_ms: wall clock, milliseconds since the epoch.
    """

    issuer: Url
    size: Whole
    head: HexDigest
    as_of_ms: Whole


def sign(checkpoint: Checkpoint, key: PrivateKey) -> str:
    """The signed checkpoint."""
    return statement_form.seal(KIND, plain(checkpoint), key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Checkpoint:  # noqa: A001 - read as checkpoint.open
    """The checkpoint, signed by one of these keys.

    Raises:
        StatementError: as `sealed.open`.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> Checkpoint:
    return read(Checkpoint, claims)
