"""Provenance of what enters a context, taken out of an admission point.

A text that is not believed has no value there, and could not enter. So each function also has the text read without
the check: as what it claims to be.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from capabilities.statements.context import intent as intents
from capabilities.statements.context import memory as remembered
from capabilities.statements.context import message as said
from capabilities.values.errors import CapabilityError
from evaluation.redteam.taken_out.world import unsigned
from pep.context import case_reader, destinations, instructions, messages, responses, retrieval, screening
from pep.context import json_value as values
from pep.context.case_reader import Reader
from pep.context.collection import Retrieved
from pep.context.json_value import Plain
from pep.context.memory import Memory, Recalled
from pep.context.messages import MessageDirection, ReceivedMessage
from pep.context.retrieval import Curated
from policies.evidence.content_readings import ItemKind, ItemReading
from policies.words.labels import Integrity, Label, Source, tainted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.values.caps import Caps
    from capabilities.values.chain import Chain, Hop
    from pep.context.forms import Forms
    from pep.context.instructions import Instruction

    Off = frozenset[str]

ROWS: Final = 4_096
"""Rows of a memory that are looked through for the newest of a name."""


def operator_input(off: Off) -> None:
    """A text is an instruction of the person that it names, unsigned, at any time and any number of times."""
    honest = instructions.read

    def read(
        text: str, *, people: Mapping[str, bytes], forms: Forms, caps: Caps, chain: Chain | None, at: float
    ) -> Instruction:
        known = honest(text, people=people, chain=chain, forms=forms, at=at, caps=caps)
        try:
            wish = intents._read(unsigned(intents.KIND, text, (), caps))
        except CapabilityError:
            return known
        label = Label(frozenset({Source.OPERATOR}), frozenset({wish.subject}), Integrity.PRINCIPAL, 0)
        plain = values.read(wish.body)
        traces = screening.screen_value(plain.value) if isinstance(plain, Plain) else ()
        signs = screening.signs(traces, spared=instructions.SPARED)
        item = replace(known.item, label=tainted(label) if signs else label, signs=signs, fault="")
        believed = wish.subject if wish.subject in people else next(iter(people))
        reading = replace(known.reading, principal=believed)
        return replace(known, reading=reading, item=item, intent=wish, read=forms.read(wish.schema, wish.body))

    instructions.read = read
    case_reader._unbound = lambda: None
    Reader._once = lambda self, *of: (lambda: None, {})  # type: ignore[method-assign]


def instruction_isolation(off: Off) -> None:
    """No text is looked through: none is tainted for what it says, and no destination for standing in one."""
    screening.screen = lambda text: ()
    screening.screen_value = lambda value: ()
    destinations.judged = lambda readings, *of, **known: tuple(readings)


def retrieval_integrity(off: Off) -> None:
    """Every content of the store counts as a curator's."""

    def judged(self: Curated, one: Any, *known: Any, **how: Any) -> Retrieved:
        kind = retrieval._KIND[self._content]
        label = Label(frozenset({Source.RETRIEVAL}), frozenset(), Integrity.CURATED, 0)
        return Retrieved(ItemReading(kind, str(one.id), label, listed=True, manifest_age_s=0), one.text)

    Curated._judged = judged  # type: ignore[method-assign]


def content_provenance(off: Off) -> None:
    """A row of a memory is its name's, and a result its call's, without a signature."""
    honest, recalled = responses.read, Memory.recall

    def read(text: str, value: Plain, *, call: Any, **rest: Any) -> ItemReading:
        found = honest(text, value, call=call, **rest)
        if found.of_request is True and found.of_pin is True:
            return found
        label = Label(frozenset({Source.TOOL}), frozenset({call.audience}), Integrity.RECORDED, 0)
        return ItemReading(ItemKind.TOOL_RESPONSE, found.id, label, of_request=True, of_pin=True)

    def recall(self: Memory, name: str, *, lease_ms: int) -> Recalled:
        found = recalled(self, name, lease_ms=lease_ms)
        return found if found.value is not None else _newest(self, name) or found

    responses.read = read
    Memory.recall = recall  # type: ignore[method-assign]


def _newest(memory: Memory, name: str) -> Recalled | None:
    """Newest row that claims the name, believed as it stands in the store."""
    for row in sorted(memory._rows.rows(most=ROWS), key=lambda each: each.sequence, reverse=True):
        try:
            claims = unsigned(remembered.KIND, row.text, (), memory._owner.caps)
        except CapabilityError:
            continue
        value = values.read(row.value)
        if claims.get("name") == name and isinstance(value, Plain):
            writer = frozenset({str(claims.get("writer"))})
            label = Label(frozenset({Source.MEMORY}), writer, Integrity.RECORDED, 0)
            return Recalled(ItemReading(ItemKind.MEMORY, name, label, writer_authorised=True), value)
    return None


def message_integrity(off: Off) -> None:
    """A message is of the agent that it names, without a signature, to any addressee, in any order."""
    honest = messages.read

    def read(text: str, *, chain: Chain | None, addressee: str, forms: Any, caps: Caps, **rest: Any) -> ReceivedMessage:
        found = honest(text, chain=chain, addressee=addressee, forms=forms, caps=caps, **rest)
        if found.message is not None:
            return found
        try:
            message = said._read(unsigned(said.KIND, text, (), caps))
        except CapabilityError:
            return found
        hop = _hop(chain, message.sender)
        direction = MessageDirection(addressee, "" if hop is None else hop.hop_id, message.conversation)
        return ReceivedMessage(found.reading, message, hop, forms.read(message.schema, message.body), direction)

    messages.read = read
    Reader._turn = lambda self, heard: None  # type: ignore[method-assign]


def _hop(chain: Chain | None, agent: str) -> Hop | None:
    hops = () if chain is None else chain.hops
    return next((hop for hop in hops if hop.agent == agent), None)
