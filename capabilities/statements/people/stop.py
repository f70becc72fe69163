"""Word of a person who stops a robot: with it the stop latches under any policies.

It permits nothing and moves nothing. The stop itself needs no word, and waits for none. Clause [STM-26].
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.statements import statement_form
from capabilities.statements.claims import Id, Name, Sentence, Url, Whole, lasting, read
from capabilities.values.form import Form, plain

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "stop"
LIFETIME_S: Final = 30
"""Longest time for which it counts, in seconds: that of a proof, whose ids are kept as long ([PRF-7])."""
STOP_BYTES: Final = 4_096
"""Longest text of one: with each member at its longest it has some 3100 bytes."""


class Stop(Form, frozen=True):
    """A person's word that a robot is to be stopped, and to wait for people afterwards.

    Attributes:
        stop_id: 32 hex digits, random; it counts once.
        issuer: canonical URL of the cell's identity provider.
        audience, robot: canonical URL of the cell, and its robot.
        person: the person's id.
        reason: sentence, or empty; why, for the record.
        not_after: until when it counts, seconds since the epoch.
        at: when it was signed, seconds since the epoch.
    """

    stop_id: Id
    issuer: Url
    audience: Url
    robot: Name
    person: Name
    reason: Sentence
    not_after: Whole
    at: Whole


def sign(stop: Stop, key: PrivateKey) -> str:
    """The word, signed by the person.

    Raises:
        StatementError: `STATEMENT_MALFORMED` for a member that is not of its form.
    """
    return statement_form.seal(KIND, plain(stop), key, _read, most_bytes=STOP_BYTES)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Stop:  # noqa: A001 - read as stop.open
    """The word, signed by one of these keys.

    Raises:
        StatementError: as `sealed.open`; also for one that counts for more than `LIFETIME_S`, or never.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> Stop:
    stop = read(Stop, claims)
    lasting(stop.at, stop.not_after, LIFETIME_S)
    return stop
