"""Answers of a person to a shown ask: only the digest of a text that was read is signed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from msgspec import structs

from capabilities.keys.keys import check_raw, unb64u
from capabilities.statements.people import ask, picture, vote
from capabilities.values.arguments import Argument
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import BadKeyError, FaultCode, StatementError
from capabilities.values.scope import Tier
from capabilities.values.units import Quantity
from ztpm_idp.client.caller import ClientError

if TYPE_CHECKING:
    from capabilities.keys.keys import PrivateKey
    from capabilities.statements.people.ask import Ask

LIFETIME_S: Final = 120
"""Life of an approval in seconds, unless the approver states another (DESIGN section 6)."""


@dataclass(frozen=True, slots=True)
class ShownAsk:
    """Ask as read from its text, and the digest of that very text, which a vote binds."""

    ask: Ask
    digest: str


@dataclass(frozen=True, slots=True)
class Terms:
    """Terms of an approval.

    Attributes:
        uses: how often, 1 to 100.
        lifetime_s: for how long, seconds.
        sees_clear: the person sees the cell clear.
    """

    uses: int = 1
    lifetime_s: int = LIFETIME_S
    sees_clear: bool = False


DEFAULT_TERMS: Final = Terms()
"""Once, for 120 s, without seeing the cell."""


def read(answer: dict[str, Any], ask_id: str) -> ShownAsk:
    """The ask in the identity provider's answer, parsed strictly from its signed text.

    The key that must have signed it is the one the provider states. A provider that lies about it gains nothing: the
    vote binds the text, and the enforcement point knows which text it asked.

    Args:
        answer: of `GET /approvals/{ask_id}`.
        ask_id: which was asked for; the text must be of this ask.

    Raises:
        StatementError: the text is no ask, not signed by that key, or another ask.
    """
    text, key = answer.get("ask"), answer.get("pep_key")
    if not isinstance(text, str) or not isinstance(key, str):
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "no ask in the answer")
    try:
        signer = check_raw(unb64u(key))
    except BadKeyError:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "no key in the answer") from None
    shown = ask.open(text, {signer}, DEFAULT)
    if shown.ask_id != ask_id:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "another ask")
    return ShownAsk(shown, vote.digest_of(text))


def pictured(shown: ShownAsk, text: str) -> str:
    """The text of the ask's own picture, read strictly.

    Raises:
        ClientError: `ASK_PICTURE_DIFFERS`, it is another; `ANSWER_MALFORMED`, it is none.
    """
    if picture.digest_of(text) != shown.ask.picture_digest:
        raise ClientError("ASK_PICTURE_DIFFERS", 200, "the ask names another picture")
    try:
        picture.read(text)
    except StatementError as error:
        raise ClientError("ANSWER_MALFORMED", 200, error.detail) from None
    return text


def sign_vote(shown: ShownAsk, answer: str, terms: Terms, key: PrivateKey, *, approver: str, at: int) -> str:
    """Signed vote on the shown ask.

    Args:
        shown: by `read`.
        answer: "approve", "deny" or "withdraw".
        terms: of an approval; a denial or withdrawal takes any.
        key: of the person.
        approver: the person's id.
        at: now, seconds since the epoch.
    """
    stated = vote.Vote(
        ask_id=shown.ask.ask_id,
        nonce=shown.ask.nonce,
        ask_digest=shown.digest,
        answer=answer,
        approver=approver,
        sees_clear=terms.sees_clear,
        uses=terms.uses,
        not_after=at + terms.lifetime_s,
        at=at,
    )
    return vote.sign(stated, key)


def plain(shown: Ask) -> dict[str, Any]:
    """The ask's members as plain JSON values, for showing."""
    return {name: _plain(getattr(shown, name)) for name in ask.NAMES}


def _plain(value: object) -> Any:
    match value:
        case tuple():
            return [_plain(member) for member in value]
        case ask.Contributor():
            return structs.asdict(value)
        case Quantity() | Argument():
            return ask.stated(value)
        case ask.AskedFact():
            return structs.asdict(value) | {"unit": str(value.unit)}
        case Tier():
            return int(value)
        case _:
            return value
