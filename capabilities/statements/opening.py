"""A person's prior leave to ask for a safety-critical act. It approves nothing."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Final

from capabilities.statements import statement_form
from capabilities.statements.ask import ID
from capabilities.statements.claims import Claims, malformed
from capabilities.statements.vote import USES

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "opening"


@dataclass(frozen=True, slots=True)
class Opening:
    """A person's prior leave that a safety-critical act may be asked for at all. It approves nothing.

    Attributes:
        opening_id: 32 hex digits.
        opener: the person's id.
        audience, agent, object, operation: for what.
        reason: why, for the record.
        uses: how many acts.
        not_before, not_after: seconds since the epoch.
    """

    opening_id: str
    opener: str
    audience: str
    agent: str
    object: str
    operation: str
    reason: str
    uses: int
    not_before: int
    not_after: int


NAMES: Final = tuple(field.name for field in fields(Opening))


def sign(opening: Opening, key: PrivateKey) -> str:
    """The opening, signed by the person."""
    return statement_form.sign(KIND, {name: getattr(opening, name) for name in NAMES}, key)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Opening:  # noqa: A001 - read as opening.open
    """The opening, signed by one of these keys.

    Raises:
        StatementError: as `sealed.open`; also for one that ends before it begins.
    """
    claims = Claims(statement_form.open(KIND, text, keys, caps), *NAMES)
    opening = Opening(
        opening_id=claims.token("opening_id", ID),
        opener=claims.name("opener"),
        audience=claims.url("audience"),
        agent=claims.name("agent"),
        object=claims.name("object"),
        operation=claims.name("operation"),
        reason=claims.name_or_empty("reason"),
        uses=claims.integer("uses", low=1, high=USES),
        not_before=claims.integer("not_before"),
        not_after=claims.integer("not_after"),
    )
    if not opening.not_before < opening.not_after:
        raise malformed("it ends before it begins")
    return opening
