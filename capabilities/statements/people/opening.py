"""A person's prior leave to ask for a safety-critical act. It approves nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

from capabilities.statements import statement_form
from capabilities.statements.claims import Id, Name, NameOrEmpty, Url, Whole, malformed, read
from capabilities.statements.people.vote import USES
from capabilities.values.form import Form, plain, within

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "opening"


class Opening(Form, frozen=True):
    """A person's prior leave that a safety-critical act may be asked for at all. It approves nothing.

    Attributes:
        opening_id: 32 hex digits.
        opener: the person's id.
        audience, agent, object, operation: the act that may be asked for.
        reason: why, for the record.
        uses: how many acts.
        not_before, not_after: seconds since the epoch.
    """

    opening_id: Id
    opener: Name
    audience: Url
    agent: Name
    object: Name
    operation: Name
    reason: NameOrEmpty
    uses: Annotated[int, within(1, USES)]
    not_before: Whole
    not_after: Whole


def sign(opening: Opening, key: PrivateKey) -> str:
    """The opening, signed by the person."""
    return statement_form.seal(KIND, plain(opening), key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Opening:  # noqa: A001 - read as opening.open
    """The opening, signed by one of these keys.

    Raises:
        StatementError: as `sealed.open`; also for one that ends before it begins.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> Opening:
    opening = read(Opening, claims)
    if not opening.not_before < opening.not_after:
        raise malformed("it ends before it begins")
    return opening
