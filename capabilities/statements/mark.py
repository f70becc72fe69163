"""Signed mark of an enforcement point: how far it followed a feed, and what it knows to be revoked.

Told to a provider that is being restored ([STM-15]), and without entries to confirm a view ([STM-17]).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

from capabilities.keys import jws
from capabilities.statements import statement_form
from capabilities.statements.claims import Url, Whole, ordered, read
from capabilities.statements.revocation import ENTRIES, Revoked, check_id
from capabilities.values import strict_json
from capabilities.values.form import Form, plain, upto, whole, words

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "mark"


class MarkEntry(Form, frozen=True):
    """One thing that is known to be revoked: its kind, and its id as in a revocation index."""

    kind: Annotated[str, words(*Revoked)]
    id: str


class Mark(Form, frozen=True):
    """Mark of an enforcement point, or one part of it.

    Attributes:
        issuer: canonical URL of the identity provider whose feed it followed.
        line, epoch: of the newest index that it accepted; zeros where it accepted none.
        head: of the line's chain at `epoch`; empty in a mark of an earlier release.
        entries: the kept revocations that this part holds, ascending, each once.
        remaining: number of further parts; the whole mark is told with the part that has none.
        at: when it was signed, seconds since the epoch.
    """

    issuer: Url
    line: Whole
    epoch: Whole
    head: Annotated[str, whole(r"([0-9a-f]{64})?")]
    entries: Annotated[tuple[MarkEntry, ...], upto(ENTRIES)]
    remaining: Whole
    at: Whole


def sign(mark: Mark, key: PrivateKey) -> str:
    """The mark, signed by its enforcement point."""
    return statement_form.seal(KIND, plain(mark), key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Mark:  # noqa: A001 - read as mark.open
    """The mark, signed by one of these keys.

    Raises:
        StatementError: as `sealed.open`.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def unverified(text: str, caps: Caps) -> Mark:
    """Claims of a mark that nobody has verified: good for finding the rows that its judgement must see.

    Raises:
        StatementError: `STATEMENT_MALFORMED`.
    """
    return _read(strict_json.parse_object(jws.split(text, most_bytes=caps.statement_bytes).payload_raw))


def _read(claims: dict[str, object]) -> Mark:
    mark = read(Mark, claims)
    for entry in mark.entries:
        check_id(entry.kind, entry.id)
    ordered(tuple((entry.kind, entry.id) for entry in mark.entries), "an entry")
    return mark
