"""Message of one agent to another (e2): signed by the sender's hop, in form, in turn, inside its grant.

A message allows nothing. The operations that it asks for are compared with the scope of the sender's own hop, so that
no agent asks another for an operation that it does not hold; the addressee's acts are judged by the addressee's own
chain.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, Final, Protocol

from capabilities.keys import keys as key_forms
from capabilities.statements import statement_form
from capabilities.statements.context import message as statement
from capabilities.token import scope_check as scope_request
from capabilities.values.errors import CapabilityError, FaultCode
from capabilities.values.scope import Tier
from policies.evidence.content_readings import MessageReading

if TYPE_CHECKING:
    from capabilities.statements.context.message import Message
    from capabilities.values.caps import Caps
    from capabilities.values.chain import Chain, Hop
    from pep.base.ports import Clock
    from pep.context.forms import Forms, ParsedBody, RequestedOperation

CONVERSATIONS: Final = 16_384
"""Most conversations that are remembered."""
OF_A_HOP: Final = 64
"""Most conversations of one sender's hop with one addressee that are open at once."""


@dataclass(frozen=True, slots=True)
class MessageDirection:
    """One direction of one conversation: the speaker's hop, and the addressee."""

    addressee: str
    hop_id: str
    conversation: str


class TurnResult(Enum):
    """Result of a try to take a turn."""

    TAKEN = "taken"
    OUT_OF_TURN = "out of turn"
    FULL = "full"


class Conversations(Protocol):
    """Port for the messages heard so far. Taking a turn is the check: one call, atomic."""

    def heard(self, line: MessageDirection) -> int:
        """The number of the last message that was heard, 0 for none."""
        ...

    def take(self, line: MessageDirection, sequence: int, *, until_s: float) -> TurnResult:
        """`TAKEN` exactly once for each number of a line, and only for the one after the last.

        Args:
            line: in which it was said.
            sequence: of the message.
            until_s: until when messages of the line may still count, seconds since the epoch.
        """
        ...

    def remember(self, line: MessageDirection, sequence: int, *, until_s: float) -> None:
        """Counts the message as heard, and all before it: it stands in the journal of an earlier process."""
        ...


@dataclass(frozen=True, slots=True)
class ReceivedMessage:
    """Message, as read.

    Attributes:
        reading: for CII-6.
        message: the signed message; None when the signature is not believed.
        hop: the sender's, in the chain; None when it is none of the chain's.
        read: its body, of its form; None when it is of none.
        line: direction of the message; None when that is not known.
        until_s: until when a message under this hop may count.
    """

    reading: MessageReading
    message: Message | None = None
    hop: Hop | None = None
    read: ParsedBody | None = None
    line: MessageDirection | None = None
    until_s: float = 0.0


def read(
    text: str, *, chain: Chain | None, addressee: str, conversations: Conversations, forms: Forms, at: float, caps: Caps
) -> ReceivedMessage:
    """Reads a text as a message, without taking its turn. Raises only errors of `conversations`.

    Args:
        text: the signed message as it came.
        chain: a verified chain that has the sender's hop: the sender's own, or that of a later hop's holder.
        addressee: id of the agent that received it.
        conversations: messages heard before.
        forms: the known forms of messages.
        at: now, seconds since the epoch.
        caps: the bounds.
    """
    if chain is None:
        return _unbelieved("")
    by_thumbprint = {key_forms.thumbprint(hop.key): hop for hop in chain.hops}
    try:
        # The key that signed the text decides its hop, against any claim of the text itself.
        message = statement.open(text, frozenset(hop.key for hop in chain.hops), caps)
    except CapabilityError as error:
        return _unbelieved(str(error.code))
    hop = by_thumbprint[statement_form.signer_thumbprint(text)]
    by_holder = (message.sender, message.token_id, message.hop_id) == (hop.agent, chain.token_id, hop.hop_id)
    line = MessageDirection(addressee, hop.hop_id, message.conversation)
    body = forms.read(message.schema, message.body)
    reading = MessageReading(
        fault=_untimely(message, at=at, caps=caps),
        sender=message.sender,
        addressee=message.addressee,
        by_holder=by_holder,
        addressed=message.addressee == addressee,
        in_schema=body is not None,
        in_sequence=message.sequence == conversations.heard(line) + 1,
        in_delegation=by_holder and body is not None and all(_granted(chain, hop, asked) for asked in body.asked),
        age_s=int(at - message.at) if message.at <= at + caps.skew_s else None,
    )
    return ReceivedMessage(reading, message, hop, body, line, max(message.not_after, hop.scope.not_after) + caps.skew_s)


def _unbelieved(fault: str) -> ReceivedMessage:
    """Reading of a text that no hop of the chain signed. Its own claims are not repeated."""
    return ReceivedMessage(
        MessageReading(
            fault=fault or str(FaultCode.STATEMENT_UNTRUSTED),
            sender="",
            addressee="",
            by_holder=False,
            addressed=False,
            in_schema=False,
            in_sequence=False,
            in_delegation=False,
            age_s=None,
        )
    )


def _untimely(message: Message, *, at: float, caps: Caps) -> str:
    if not message.at <= at + caps.skew_s:
        return str(FaultCode.NOT_YET_VALID)
    return "" if at < message.not_after else str(FaultCode.EXPIRED)


def _granted(chain: Chain, hop: Hop, asked: RequestedOperation) -> bool:
    """True where the sender's own hop grants the asked operation. The tier is judged at the act itself (TEA-4)."""
    if asked.values is None:
        return hop.scope.find(asked.object, asked.operation) is not None
    refused = scope_request.refusal(
        replace(chain, hops=chain.hops[: hop.index + 1]),
        object=asked.object,
        operation=asked.operation,
        values=asked.values,
        base_tier=Tier.NO_EFFECT,
    )
    return refused is None


class ConversationBook:
    """`Conversations` port in memory: bounded, atomic, fail-closed. The journal brings its content back.

    A conversation is forgotten when no message in it can count any more. Nothing is forgotten early: when it is full,
    nothing new is heard.
    """

    def __init__(self, clock: Clock, *, capacity: int = CONVERSATIONS, of_a_hop: int = OF_A_HOP) -> None:
        self._clock = clock
        self._capacity = capacity
        self._of_a_hop = of_a_hop
        self._lock = threading.Lock()
        self._heard: dict[tuple[str, str], dict[str, tuple[int, float]]] = {}

    def heard(self, line: MessageDirection) -> int:
        """As the port says."""
        with self._lock:
            return self._heard.get((line.addressee, line.hop_id), {}).get(line.conversation, (0, 0.0))[0]

    def take(self, line: MessageDirection, sequence: int, *, until_s: float) -> TurnResult:
        """As the port says."""
        with self._lock:
            lines = self._heard.get((line.addressee, line.hop_id), {})
            last, before_s = lines.get(line.conversation, (0, 0.0))
            if sequence != last + 1:
                return TurnResult.OUT_OF_TURN
            if last == 0 and not self._room(line):
                return TurnResult.FULL
            self._put(line, sequence, max(before_s, until_s))
            return TurnResult.TAKEN

    def remember(self, line: MessageDirection, sequence: int, *, until_s: float) -> None:
        """As the port says."""
        with self._lock:
            lines = self._heard.get((line.addressee, line.hop_id), {})
            last, before_s = lines.get(line.conversation, (0, 0.0))
            self._put(line, max(last, sequence), max(before_s, until_s))

    def _put(self, line: MessageDirection, sequence: int, until_s: float) -> None:
        self._heard.setdefault((line.addressee, line.hop_id), {})[line.conversation] = (sequence, until_s)

    def _room(self, line: MessageDirection) -> bool:
        """True where one more conversation may begin; conversations that are over make room first."""
        now_s = self._clock.wall_s()
        if sum(map(len, self._heard.values())) >= self._capacity:
            for key, lines in list(self._heard.items()):
                self._heard[key] = {name: kept for name, kept in lines.items() if now_s < kept[1]}
                if not self._heard[key]:
                    del self._heard[key]
        lines = self._heard.get((line.addressee, line.hop_id), {})
        return len(lines) < self._of_a_hop and sum(map(len, self._heard.values())) < self._capacity
