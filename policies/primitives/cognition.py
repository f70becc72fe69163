"""Domain CII, cognition and instruction integrity: the words of world, people and documents, and their vouchers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final, assert_never

from capabilities.values.scope import Tier
from policies.evidence.content_readings import ContextReading, InstructionReading, ItemKind, MessageReading
from policies.evidence.evidence import ImpactReading, NotCollected, PerceptionReading
from policies.evidence.tiers import FRESH
from policies.primitives.base import Fails, Holds, age_within, fails, found, missing
from policies.words.errors import PolicyError, PolicyFault
from policies.words.labels import Integrity
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from policies.evidence.content_readings import ArgumentReading, ItemReading
    from policies.evidence.model import Finding
    from policies.primitives.base import Case, Verdict

BELIEVED: Final = frozenset({FRESH, "stale", "missing"})
"""States of a sensor from which nothing false was heard.

Any other word is a view that must not be believed.
"""


@dataclass(frozen=True, slots=True)
class OperatorInput:
    """CII-1: an instruction is signed by an authenticated person, well formed, recent, and bound to the delegation."""

    intent_age_s: int
    skew_s: int
    id: ClassVar[str] = "CII-1"

    def judge(self, case: Case) -> Verdict:
        """Holds for an instruction of a person whose digest is the one that the delegation states."""
        match case.evidence.instruction:
            case NotCollected():
                return missing(self.id, "instruction")
            case InstructionReading() as said:
                return self._reading(case, said)
            case _:
                assert_never(case.evidence.instruction)

    def _reading(self, case: Case, said: InstructionReading) -> Verdict:
        if said.fault or not said.principal:
            return fails(self.id, Reason.INSTRUCTION_UNAUTHENTIC, fault=said.fault)
        if said.well_formed is not True or not said.intent_digest:
            return fails(self.id, Reason.INSTRUCTION_MALFORMED)
        if age_within(case.evidence.at, said.signed_at, bound_s=self.intent_age_s, skew_s=self.skew_s) is None:
            return fails(self.id, Reason.INSTRUCTION_OLD, intent_age_s=self.intent_age_s)
        if said.bound_digest != said.intent_digest:
            return fails(self.id, Reason.INTENT_NOT_BOUND, intent=said.intent_digest, bound=said.bound_digest)
        return Holds()


def entering(primitive: str, case: Case) -> tuple[ItemReading, ...] | Fails:
    """Items that would enter a context, one at least, or the refusal in their place."""
    match case.evidence.context:
        case NotCollected() | ContextReading(items=()):
            return missing(primitive, "context")
        case ContextReading(items=items):
            return items
        case _:
            assert_never(case.evidence.context)


@dataclass(frozen=True, slots=True)
class InstructionIsolation:
    """CII-2: a text that is not from a principal carries no authority, and instructions found in it taint it.

    Screening that found nothing proves nothing: the label that goes with the text protects.
    """

    suspicious_admitted_count: int
    id: ClassVar[str] = "CII-2"

    def judge(self, case: Case) -> Verdict:
        """Holds when no item without a principal's signature is offered as authority, and every sign is a taint."""
        items = entering(self.id, case)
        if isinstance(items, Fails):
            return items
        wrong = tuple(finding for item in items for finding in self._item(item))
        return Fails(wrong) if wrong else Holds()

    def _item(self, item: ItemReading) -> list[Finding]:
        found_in_it = []
        if item.as_authority and (item.label.integrity is not Integrity.PRINCIPAL or item.label.tainted):
            found_in_it.append(found(self.id, Reason.TEXT_WITHOUT_AUTHORITY, kind=str(item.kind), item=item.id))
        if item.signs and not (item.label.tainted and self.suspicious_admitted_count):
            signs = list(item.signs)
            found_in_it.append(found(self.id, Reason.TEXT_SUSPICIOUS, kind=str(item.kind), item=item.id, signs=signs))
        return found_in_it


LISTED: Final = frozenset({ItemKind.DOCUMENT, ItemKind.SCENARIO})
"""Kinds of item that come out of curated collections."""


@dataclass(frozen=True, slots=True)
class RetrievalIntegrity:
    """CII-3: a retrieved document is signed by a curator, unmodified, and listed in the audited manifest."""

    manifest_age_s: int
    id: ClassVar[str] = "CII-3"

    def judge(self, case: Case) -> Verdict:
        """Holds when every document is listed in a manifest of a curator that is at most `manifest_age_s` old.

        An item that is no document belongs to CII-5, and is no reason against this one.
        """
        items = entering(self.id, case)
        if isinstance(items, Fails):
            return items
        wrong = tuple(finding for item in items if item.kind in LISTED for finding in self._item(item))
        return Fails(wrong) if wrong else Holds()

    def _item(self, item: ItemReading) -> list[Finding]:
        if item.fault or item.label.integrity < Integrity.CURATED:
            return [found(self.id, Reason.DOCUMENT_UNSIGNED, item=item.id, fault=item.fault)]
        if item.listed is not True:
            return [found(self.id, Reason.DOCUMENT_NOT_LISTED, item=item.id)]
        age_s = item.manifest_age_s
        if age_s is None or not 0 <= age_s <= self.manifest_age_s:
            return [found(self.id, Reason.MANIFEST_OLD, item=item.id, age_s=age_s, manifest_age_s=self.manifest_age_s)]
        return []


@dataclass(frozen=True, slots=True)
class SensorProvenance:
    """CII-4: knowledge of the world comes from the cell's own sensors, and no sensor's word must be disbelieved.

    A sensor that is silent or late is no fault: TEA-4 asks a person then.
    """

    id: ClassVar[str] = "CII-4"

    def judge(self, case: Case) -> Verdict:
        """Holds when no sensor's newest frame is invalid, and a view that is called fresh rests on fresh sensors."""
        match case.evidence.perception:
            case NotCollected():
                return missing(self.id, "perception")
            case PerceptionReading() as perception:
                return self._reading(case, perception)
            case _:
                assert_never(case.evidence.perception)

    def _reading(self, case: Case, perception: PerceptionReading) -> Verdict:
        refused = [{"sensor": s.sensor, "fault": s.fault} for s in perception.sensors if s.state not in BELIEVED]
        if refused:
            return fails(self.id, Reason.PERCEPTION_INVALID, sensors=refused)
        impact = case.evidence.impact
        called_fresh = isinstance(impact, ImpactReading) and impact.perception == FRESH
        late = [s.sensor for s in perception.sensors if s.state != FRESH]
        if called_fresh and (late or not perception.sensors):
            return fails(self.id, Reason.PERCEPTION_INVALID, not_fresh=late)
        return Holds()


@dataclass(frozen=True, slots=True)
class ProvenanceOfContent:
    """CII-5: a remembered value or a tool's result has provenance, and so has every argument made of it.

    A value is believed up to a tier by who vouches for it: nobody (or a tainted text), an agent, a record.
    """

    unvouched_max_tier: int
    agent_max_tier: int
    recorded_max_tier: int
    id: ClassVar[str] = "CII-5"

    def __post_init__(self) -> None:
        if not self.unvouched_max_tier <= self.agent_max_tier <= self.recorded_max_tier:
            raise PolicyError(PolicyFault.NOT_MONOTONE, "primitive", "who vouches for less would be believed for more")

    def max_tier(self, argument: ArgumentReading) -> Tier:
        """The highest tier of an act with this argument."""
        label = argument.label
        if argument.fault or label.tainted:
            return Tier(self.unvouched_max_tier)
        match label.integrity:
            case Integrity.NONE:
                return Tier(self.unvouched_max_tier)
            case Integrity.AGENT:
                return Tier(self.agent_max_tier)
            case Integrity.RECORDED | Integrity.CURATED:
                return Tier(self.recorded_max_tier)
            case Integrity.SENSED | Integrity.PRINCIPAL:
                return Tier.SAFETY_CRITICAL
            case _:
                assert_never(label.integrity)

    def judge(self, case: Case) -> Verdict:
        """Holds when every memory and response has provenance, and every argument is believed for the tier."""
        match case.evidence.context:
            case NotCollected():
                return missing(self.id, "context")
            case ContextReading() as context:
                return self._reading(case, context)
            case _:
                assert_never(case.evidence.context)

    def _reading(self, case: Case, context: ContextReading) -> Verdict:
        if {argument.name for argument in context.arguments} != {value.name for value in case.request.values}:
            return missing(self.id, "context.arguments")
        wrong = [finding for item in context.items for finding in self._item(item)]
        wrong += [finding for argument in context.arguments for finding in self._argument(case, argument)]
        return Fails(tuple(wrong)) if wrong else Holds()

    def _item(self, item: ItemReading) -> list[Finding]:
        match item.kind:
            case ItemKind.MEMORY:
                if item.fault or item.writer_authorised is not True:
                    return [found(self.id, Reason.PROVENANCE_MISSING, item=item.id, fault=item.fault)]
            case ItemKind.TOOL_RESPONSE:
                if item.fault or item.label.integrity < Integrity.RECORDED:
                    return [found(self.id, Reason.PROVENANCE_MISSING, item=item.id, fault=item.fault)]
                if item.of_request is not True or item.of_pin is not True:
                    detail = {"of_request": item.of_request, "of_pin": item.of_pin}
                    return [found(self.id, Reason.RESPONSE_MISMATCH, item=item.id, **detail)]
            case ItemKind.INSTRUCTION | ItemKind.MESSAGE | ItemKind.DOCUMENT | ItemKind.SCENARIO:
                pass
            case _:
                assert_never(item.kind)
        return []

    def _argument(self, case: Case, argument: ArgumentReading) -> list[Finding]:
        highest = self.max_tier(argument)
        if case.tier is None:
            # without physics the primitive that needs it says so, and no argument is believed for an unknown tier
            return (
                [] if highest is Tier.SAFETY_CRITICAL else [found(self.id, Reason.EVIDENCE_MISSING, evidence="impact")]
            )
        if case.tier <= highest:
            return []
        detail: dict[str, object] = {
            "parameter": argument.name,
            "integrity": argument.label.integrity.name.lower(),
            "tainted": argument.label.tainted,
            "sources": sorted(map(str, argument.label.sources)),
            "fault": argument.fault,
            "tier": int(case.tier),
            "max_tier": int(highest),
        }
        return [found(self.id, Reason.ARGUMENT_NOT_VOUCHED, **detail)]


@dataclass(frozen=True, slots=True)
class MessageIntegrity:
    """CII-6: a message between agents is signed by the delegating holder, in schema, addressed, in sequence, inside."""

    message_age_s: int
    skew_s: int
    id: ClassVar[str] = "CII-6"

    def judge(self, case: Case) -> Verdict:
        """Holds when all of it is known to hold; every part that does not has its finding."""
        match case.evidence.message:
            case NotCollected():
                return missing(self.id, "message")
            case MessageReading() as message:
                return self._reading(message)
            case _:
                assert_never(case.evidence.message)

    def _reading(self, message: MessageReading) -> Verdict:
        parties: dict[str, object] = {"sender": message.sender, "addressee": message.addressee}
        age_s = message.age_s
        in_time = age_s is not None and -self.skew_s <= age_s <= self.message_age_s
        parts: tuple[tuple[bool, Reason, dict[str, object]], ...] = (
            (
                not message.fault and message.by_holder is True,
                Reason.MESSAGE_UNAUTHENTIC,
                {**parties, "fault": message.fault},
            ),
            (message.in_schema is True, Reason.MESSAGE_MALFORMED, {}),
            (message.addressed is True, Reason.MESSAGE_MISDIRECTED, parties),
            (message.in_sequence is True, Reason.MESSAGE_OUT_OF_SEQUENCE, {}),
            (message.in_delegation is True, Reason.MESSAGE_OUT_OF_DELEGATION, {}),
            (in_time, Reason.MESSAGE_OLD, {"age_s": age_s, "message_age_s": self.message_age_s}),
        )
        wrong = tuple(found(self.id, reason, **detail) for holds, reason, detail in parts if not holds)
        return Fails(wrong) if wrong else Holds()
