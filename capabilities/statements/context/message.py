"""A message from one agent to another, by the sender's own key. It says something and allows nothing.

It names the hop that it is said under and its place in one conversation. Clause [STM-6] in docs/spec.md.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final

from capabilities.statements import statement_form
from capabilities.statements.claims import (
    AgentId,
    Body,
    Id,
    Name,
    Nonce,
    Positive,
    TokenId,
    Whole,
    lasting,
    malformed,
    read,
    stated,
)
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.form import Form, plain, whole

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "message"
LIFETIME_S: Final = 3_600
"""Longest life of a message: that of the hop of evidence kind `key` that it is said under."""


class Message(Form, frozen=True):
    """Message of one agent to another.

    Attributes:
        sender, addressee: agent ids, two different ones.
        token_id, hop_id: of the token, and of the sender's own hop in it, under which it is said.
        conversation: 16 to 64 base64url characters, the same through one conversation.
        sequence: of the sender's messages in the conversation, from 1 on, each one more.
        in_reply_to: SHA-256 (hex) of the text of the message that it answers, or "".
        schema: name of the form of the body.
        body: canonical JSON (RFC 8785) of an object; its numbers are integers.
        at, not_after: when it was said, and until when it counts; seconds since the epoch, at most `LIFETIME_S` apart.
    """

    sender: AgentId
    addressee: AgentId
    token_id: TokenId
    hop_id: Id
    conversation: Nonce
    sequence: Positive
    in_reply_to: Annotated[str, whole("|[0-9a-f]{64}")]
    schema: Name
    body: Body
    at: Whole
    not_after: Whole


@dataclass(frozen=True, slots=True)
class ExpectedMessage:
    """Place where the addressee expects the next message of a sender.

    Attributes:
        sender, addressee, token_id, hop_id, conversation: as in `Message`; the hop is the sender's in a chain that was
            verified, and the key that the message is opened with is that hop's.
        heard: sequence of the sender's last message in the conversation, 0 for none.
    """

    sender: str
    addressee: str
    token_id: str
    hop_id: str
    conversation: str
    heard: int


def sign(message: Message, key: PrivateKey) -> str:
    """The message, signed by its sender.

    Raises:
        StatementError: `STATEMENT_MALFORMED` when the body is no canonical JSON object.
    """
    return statement_form.seal(KIND, plain(message) | {"body": stated(message.body)}, key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Message:  # noqa: A001 - read as message.open
    """Message signed by one of these keys: those of the expected sender, and no others.

    Raises:
        StatementError: as `sealed.open`; also for a message to oneself, a body that is too long,
            and one that lives longer than `LIFETIME_S` or not at all.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> Message:
    message = read(Message, claims)
    if message.sender == message.addressee:
        raise malformed("a message to oneself")
    lasting(message.at, message.not_after, LIFETIME_S)
    return message


def refusal(message: Message, place: ExpectedMessage, *, at: float, caps: Caps) -> Fault | None:
    """None when the message is the next one in its place, now; else the first fault ([STM-6]).

    Args:
        message: opened with the key of the hop that `place` names.
        place: where it is expected.
        at: seconds since the epoch.
        caps: the bounds.
    """
    if (message.sender, message.token_id, message.hop_id) != (place.sender, place.token_id, place.hop_id):
        return Fault(FaultCode.STATEMENT_UNTRUSTED, "STM-6", "not said by this agent under this hop")
    if message.addressee != place.addressee or message.conversation != place.conversation:
        return Fault(FaultCode.WRONG_AUDIENCE, "STM-6", "said to another, or in another conversation")
    if message.sequence <= place.heard:
        return Fault(FaultCode.REPLAYED, "STM-6", f"{place.heard} messages were heard")
    if message.sequence != place.heard + 1:
        return Fault(FaultCode.CHAIN_BROKEN, "STM-6", f"message {place.heard + 1} is missing")
    if not message.at <= at + caps.skew_s:
        return Fault(FaultCode.NOT_YET_VALID, "STM-6")
    if not at < message.not_after:
        return Fault(FaultCode.EXPIRED, "STM-6")
    return None


def digest_of(text: str) -> str:
    """SHA-256 (hex) of a message's text, which an answer to it names."""
    return hashlib.sha256(text.encode("ascii")).hexdigest()
