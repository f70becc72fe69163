"""One thing that an agent had remembered: who wrote it, under which authority, and the label that it had then.

An enforcement point says it to itself, through a store that it does not trust: every row names the one before it, so a
row that was changed, taken out or put back shows. Clause [STM-12] in docs/spec.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

from msgspec.structs import astuple

from capabilities.statements import statement_form
from capabilities.statements.claims import HexDigest, Id, Name, Positive, TokenId, Url, Whole, malformed, ordered, read
from capabilities.statements.context.admission import Integrity, Signers, Sources
from capabilities.statements.revocation import Revoked
from capabilities.values import form
from capabilities.values.form import Form, converted, plain, upto, whole, words

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "memory"
FIRST_PREVIOUS: Final = "0" * 64
BEHIND: Final = 32
"""Most names behind a row: sponsor, token, mandate, and three for each of at most nine hops."""
_REVOCABLE: Final = frozenset(map(str, Revoked)) - {str(Revoked.AUDIENCE)}


class _Behind(Form, frozen=True):
    kind: Annotated[str, words(*_REVOCABLE)]
    id: Annotated[str, whole(r"[A-Za-z0-9._:@/|+=~%-]{1,256}")]


if TYPE_CHECKING:
    Pair = tuple[str, str]
else:
    Pair = converted(tuple, lambda value: astuple(form.read(_Behind, value)))


class Remembered(Form, frozen=True):
    """One row of a memory.

    Attributes:
        audience: canonical URL of the enforcement point whose memory it is.
        sequence: of the row, from 1 on, without gaps.
        previous: SHA-256 (hex) of the text of the row before it; zeros for the first.
        name: under which it is remembered; a later row of the same name takes its place.
        value: SHA-256 (hex) of the value's canonical JSON.
        writer, hop_id, token_id: the holder that wrote it, and its token.
        behind: (kind, id) of all whose revocation takes the authority behind it away, each once, in order.
        sources, signers, integrity, age_ms, tainted: its label when it was written, as in a receipt.
        at: when it was written, seconds since the epoch.
    """

    audience: Url
    sequence: Positive
    previous: HexDigest
    name: Name
    value: HexDigest
    writer: Name
    hop_id: Id
    token_id: TokenId
    behind: Annotated[tuple[Pair, ...], upto(BEHIND)]
    sources: Sources
    signers: Signers
    integrity: Integrity
    age_ms: Whole
    tainted: bool
    at: Whole


def sign(row: Remembered, key: PrivateKey) -> str:
    """The row, signed by the enforcement point."""
    behind = [{"kind": kind, "id": id_} for kind, id_ in row.behind]
    return statement_form.seal(KIND, plain(row) | {"behind": behind}, key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Remembered:  # noqa: A001 - read as memory.open
    """The row, signed by one of these keys: that of the enforcement point itself.

    Raises:
        StatementError: as `sealed.open`; also for one without a source, or with names out of order.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> Remembered:
    row = read(Remembered, claims)
    ordered(row.behind, "a name")
    ordered(row.sources, "a source")
    ordered(row.signers, "a signer")
    if (row.sequence == 1) is not (row.previous == FIRST_PREVIOUS):
        raise malformed("the first row follows none, and every other one some")
    return row
