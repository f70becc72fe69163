"""The ledger's signed checkpoint: how long it is and what its last entry's hash is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.statements import statement_form
from capabilities.statements.claims import Claims

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "checkpoint"


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """The state of a ledger.

    Attributes:
        issuer: canonical URL of the identity provider.
        size: number of entries.
        head: hash (hex) of the last entry; 64 zeros for an empty ledger.
        as_of_ms: wall clock, milliseconds since the epoch.
    """

    issuer: str
    size: int
    head: str
    as_of_ms: int


def sign(checkpoint: Checkpoint, key: PrivateKey) -> str:
    """The signed checkpoint."""
    claims: dict[str, object] = {
        "issuer": checkpoint.issuer,
        "size": checkpoint.size,
        "head": checkpoint.head,
        "as_of_ms": checkpoint.as_of_ms,
    }
    return statement_form.sign(KIND, claims, key)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Checkpoint:  # noqa: A001 - read as checkpoint.open
    """The checkpoint, signed by one of these keys.

    Raises:
        StatementError: as `sealed.open`.
    """
    claims = Claims(statement_form.open(KIND, text, keys, caps), "issuer", "size", "head", "as_of_ms")
    return Checkpoint(
        issuer=claims.url("issuer"),
        size=claims.integer("size"),
        head=claims.hex_digest("head"),
        as_of_ms=claims.integer("as_of_ms"),
    )
