"""Reader of incoming content into one case for judgement: evidence, value, and claims to single use."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from capabilities.statements.context.intent import KIND as INTENT
from capabilities.values.chain import Chain
from capabilities.values.units import INT_LIMIT
from pep.context import instructions, messages, screening
from pep.context import json_value as values
from pep.context.flow import Context, Holder
from pep.context.json_value import Plain, ValueFault
from pep.context.messages import MessageDirection, TurnResult
from policies.evidence.content_readings import ContextReading, ItemKind, ItemReading
from policies.evidence.evidence import Evidence
from policies.words.labels import NOBODY, tainted
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from capabilities.values.caps import Caps
    from capabilities.values.errors import Fault
    from pep.base.ports import Clock, ReplayStore
    from pep.context.flow import Flow
    from pep.context.forms import Forms
    from pep.context.instructions import Instruction, People
    from pep.context.messages import Conversations, ReceivedMessage
    from pep.request.authority import Credentials
    from policies.words.labels import Label


@dataclass(frozen=True, slots=True)
class AdmissionCase:
    """One case of admission, to be judged.

    Attributes:
        item, evidence: known properties of the content.
        value: value to be admitted, or the fault for which it is none.
        into: the context.
        proof: name of the proof that it came with, for the record.
        claim: called once everything permits it, and before anything is recorded: None, or why it is taken already.
        note: for the record of a PERMIT; `Reader.recover` reads it.
    """

    item: ItemReading
    evidence: Evidence
    value: Plain | ValueFault
    into: Context
    proof: str
    claim: Callable[[], Reason | None]
    note: Mapping[str, object]


class Reader:
    """Reads incoming content. Reading claims no single use.

    Args:
        clock: both clocks.
        flow: contents of all contexts.
        people: people whose word is an instruction.
        forms: of instructions and messages.
        conversations: messages heard before.
        replay: intents carried out before.
        caps: the bounds.
    """

    def __init__(
        self,
        *,
        clock: Clock,
        flow: Flow,
        people: People,
        forms: Forms,
        conversations: Conversations,
        replay: ReplayStore,
        caps: Caps,
    ) -> None:
        self._clock = clock
        self._flow = flow
        self._people = people
        self._forms = forms
        self._conversations = conversations
        self._replay = replay
        self._caps = caps

    def instruction(self, text: str, credentials: Credentials, into: Context) -> AdmissionCase:
        """Reads a signed intent as an instruction to the holder of this context."""
        people = self._people.people()
        chain = _holding(credentials, into)
        said = self._read(text, people, chain)
        claim, note = _unbound, dict[str, object]()
        if said.intent is not None and chain is not None:
            claim, note = self._once(said, people[said.reading.principal], chain, said.intent.not_after)
        return AdmissionCase(
            item=said.item,
            evidence=replace(self._evidence(credentials, said.item), instruction=said.reading),
            value=ValueFault.MALFORMED if said.intent is None else values.read(said.intent.body),
            into=into,
            proof=credentials.proof_name,
            claim=claim,
            note=note,
        )

    def message(self, text: str, credentials: Credentials, into: Context, intent: str | None) -> AdmissionCase:
        """Reads a signed message as its sender's words to the holder of this context."""
        chain = credentials.chain if isinstance(credentials.chain, Chain) else None
        heard = messages.read(
            text,
            chain=chain,
            addressee=into.holder.agent,
            conversations=self._conversations,
            forms=self._forms,
            at=self._clock.wall_s(),
            caps=self._caps,
        )
        value = ValueFault.MALFORMED if heard.message is None else values.read(heard.message.body)
        item = _said(heard, value, self._spoken(heard))
        evidence = replace(self._evidence(credentials, item), message=heard.reading)
        if intent is not None:
            evidence = replace(evidence, instruction=self._read(intent, self._people.people(), chain).reading)
        note: dict[str, object] = {}
        if heard.line is not None and heard.message is not None:
            line = [heard.line.addressee, heard.line.hop_id, heard.line.conversation]
            note = {"line": line, "sequence": heard.message.sequence, "until_s": heard.until_s}
        return AdmissionCase(item, evidence, value, into, credentials.proof_name, lambda: self._turn(heard), note)

    def item(self, item: ItemReading, value: object, into: Context, chain: Chain | Fault) -> AdmissionCase:
        """Any other content, by its known provenance; its text and its id are screened."""
        plain = values.plain(value)
        seen = screened(item, plain)
        evidence = Evidence(
            at=self._clock.wall_s(),
            at_ms=self._clock.monotonic_ms(),
            chain=chain,
            context=ContextReading(items=(seen,)),
        )
        return AdmissionCase(seen, evidence, plain, into, "", _free, {})

    def recover(self, found: Iterable[Mapping[str, Any]]) -> None:
        """Takes in what an earlier process admitted once, so that it is not admitted again.

        Args:
            found: records of the whole journal, oldest first.
        """
        now_s, now_ms = self._clock.wall_s(), self._clock.monotonic_ms()
        for record in found:
            # only a PERMIT has a note with an end
            note = record["body"].get("admission", {}) if record["kind"] == "decision" else {}
            until_s = note.get("until_s", 0)
            if not now_s < until_s:
                continue
            if "line" in note:
                self._conversations.remember(MessageDirection(*note["line"]), note["sequence"], until_s=until_s)
            elif "once" in note:
                expires_ms = now_ms + int((until_s - now_s) * 1_000)
                self._replay.first_use(note["once"], key=bytes.fromhex(note["key"]), expires_ms=expires_ms)

    def _read(self, text: str, people: Mapping[str, bytes], chain: Chain | None) -> Instruction:
        at = self._clock.wall_s()
        return instructions.read(text, people=people, chain=chain, forms=self._forms, at=at, caps=self._caps)

    def _once(
        self, said: Instruction, key: bytes, chain: Chain, not_after: int
    ) -> tuple[Callable[[], Reason | None], dict[str, object]]:
        """Claim of an intent to be carried out once under each token, and the record's note of it."""
        name = f"{INTENT}/{said.reading.intent_digest}/{chain.token_id}"
        until_s = not_after + self._caps.skew_s

        def claim() -> Reason | None:
            expires_ms = self._clock.monotonic_ms() + int((until_s - self._clock.wall_s()) * 1_000)
            return None if self._replay.first_use(name, key=key, expires_ms=expires_ms) else Reason.REPLAYED

        return claim, {"once": name, "key": key.hex(), "until_s": until_s}

    def _turn(self, heard: ReceivedMessage) -> Reason | None:
        if heard.line is None or heard.message is None:
            return Reason.MESSAGE_UNAUTHENTIC
        taken = self._conversations.take(heard.line, heard.message.sequence, until_s=heard.until_s)
        return None if taken is TurnResult.TAKEN else Reason.MESSAGE_OUT_OF_SEQUENCE

    def _spoken(self, heard: ReceivedMessage) -> Label:
        """Label of a sender's words: they derive from all of the sender's known context."""
        if heard.hop is None:
            return NOBODY
        said = self._flow.label(Context(Holder.of(heard.hop)))
        return replace(said, age_ms=max(said.age_ms, (heard.reading.age_s or 0) * 1_000))

    def _evidence(self, credentials: Credentials, item: ItemReading) -> Evidence:
        return Evidence(
            at=self._clock.wall_s(),
            at_ms=self._clock.monotonic_ms(),
            chain=credentials.chain,
            proof=credentials.proof,
            context=ContextReading(items=(item,)),
        )


def screened(item: ItemReading, value: Plain | ValueFault) -> ItemReading:
    """The item with every sign in its text and id, and with the taint of them."""
    traces = screening.screen(item.id)
    if isinstance(value, Plain):
        traces += screening.screen_value(value.value)
    found = frozenset((*item.signs, *screening.signs(traces)))
    label = tainted(item.label) if found else item.label
    return replace(item, signs=tuple(sorted(found)), label=replace(label, age_ms=min(label.age_ms, INT_LIMIT)))


def _said(heard: ReceivedMessage, value: Plain | ValueFault, label: Label) -> ItemReading:
    """Message as content of a context: its sender's words, without authority."""
    said = ItemReading(
        kind=ItemKind.MESSAGE,
        id="" if heard.message is None else heard.message.conversation,
        label=label,
        fault=heard.reading.fault,
    )
    return screened(said, value)


def _holding(credentials: Credentials, into: Context) -> Chain | None:
    """Chain of a caller who proved to hold it, and who owns this context."""
    chain = credentials.chain
    if credentials.fault is not None or not isinstance(chain, Chain) or Holder.of(chain.leaf) != into.holder:
        return None
    return chain


def _unbound() -> Reason | None:
    return Reason.INTENT_NOT_BOUND


def _free() -> Reason | None:
    return None
