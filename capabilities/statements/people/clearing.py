"""Clearing of a latch by a person, over every word of it that was shown.

It binds the SHA-256 of the latch's text, moves nothing, permits nothing and opens no lease. Clause [STM-22].
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.statements import statement_form
from capabilities.statements.claims import HexDigest, Id, Name, Url, Whole, lasting, read
from capabilities.statements.people.latch import LatchCause
from capabilities.values.form import Form, plain

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "clearing"
LIFETIME_S: Final = 600
"""Longest time for which a clearing counts, in seconds: who signs it has just looked at the cell."""


class Clearing(Form, frozen=True):
    """A person's word that a robot may be commanded again.

    Attributes:
        latch_id: of the latch.
        latch_digest: SHA-256 (hex) of the latch's text, as `vote.digest_of` gives it.
        audience, robot, cause: as the latch states them.
        approver: the person's id.
        not_after: until when it counts, seconds since the epoch.
        at: when it was signed, seconds since the epoch.
    """

    latch_id: Id
    latch_digest: HexDigest
    audience: Url
    robot: Name
    cause: LatchCause
    approver: Name
    not_after: Whole
    at: Whole


NAMES: Final = Clearing.__struct_fields__


def sign(clearing: Clearing, key: PrivateKey) -> str:
    """The clearing, signed by the person."""
    return statement_form.seal(KIND, plain(clearing), key, read_claims)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Clearing:  # noqa: A001 - read as clearing.open
    """The clearing, signed by one of these keys.

    Raises:
        StatementError: as `sealed.open`; also for one that counts for more than `LIFETIME_S`, or never.
    """
    return read_claims(statement_form.open(KIND, text, keys, caps))


def read_claims(claims: dict[str, object]) -> Clearing:
    """The clearing of these members.

    Raises:
        StatementError: `STATEMENT_MALFORMED`.
    """
    clearing = read(Clearing, claims)
    lasting(clearing.at, clearing.not_after, LIFETIME_S)
    return clearing
