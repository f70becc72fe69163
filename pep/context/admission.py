"""Gate of admission: nothing reaches an agent that was not judged, recorded and labelled.

    what is said -> reading -> decide -> record -> enter the context -> the value, with its label and a receipt
                    pure       pure      durable

Plain calls, for any agent framework: the program that runs the agent asks here before it puts anything before the
model. Every failure on the way is DENY.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol

from pep.base.errors import JournalError
from pep.context import json_value as values
from pep.context import receipts, screening
from pep.context.case_reader import Reader
from pep.context.flow import Full
from pep.context.json_value import Plain, ValueFault
from pep.gate import records
from pep.request.denial import denial
from policies.decision.pdp import decide
from policies.evidence import case_json as recorded
from policies.evidence.content_readings import ItemKind, ItemReading
from policies.evidence.evidence import Evidence
from policies.evidence.model import Decision, Effect, ObligationKind, Point, Request
from policies.words.labels import tainted
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps
    from capabilities.values.chain import Chain
    from capabilities.values.errors import Fault
    from pep.base.ports import Clock, Journal, ReplayStore
    from pep.context.case_reader import AdmissionCase
    from pep.context.flow import Context, Flow, Holder
    from pep.context.forms import Forms
    from pep.context.instructions import People
    from pep.context.messages import Conversations
    from pep.request.authority import Credentials
    from policies.decision.policy import PolicySet
    from policies.words.labels import Label

OBJECT: Final = "context"
"""The object of every request of admission."""
OPERATION_OF: Final = {
    ItemKind.INSTRUCTION: "instruct",
    ItemKind.MESSAGE: "hear",
    ItemKind.DOCUMENT: "retrieve",
    ItemKind.MEMORY: "remember",
    ItemKind.TOOL_RESPONSE: "respond",
    ItemKind.SCENARIO: "scenario",
}
POINT_OF: Final = {ItemKind.INSTRUCTION: Point.OPERATOR, ItemKind.MESSAGE: Point.AGENT}
"""Enforcement point of each kind that is not judged at e3."""


@dataclass(frozen=True, slots=True)
class Admitted:
    """A value that may be put before the agent, and has been entered into its context.

    Attributes:
        value: a copy of its own; what its receipt vouches for.
        label: of the value.
        receipt: text of the signed receipt, for the argument that will come from it.
        decision: the PERMIT.
        record: hash of its record.
    """

    value: object
    label: Label
    receipt: str
    decision: Decision
    record: str


@dataclass(frozen=True, slots=True)
class NotAdmitted:
    """Value that must not reach the agent.

    Attributes:
        decision: the decision, DENY or DEFER.
        record: hash of its record, or "" when it could not be recorded.
    """

    decision: Decision
    record: str


@dataclass(frozen=True, slots=True)
class Released:
    """The one value of a reader, with the label of all that it read, and a receipt."""

    value: object
    label: Label
    receipt: str


class Admits(Protocol):
    """Port of admission for retrieval, memory and tool adapters."""

    def admit(self, item: ItemReading, value: object, *, into: Context) -> Admitted | NotAdmitted:
        """Admits the value into that context, on record; or returns the reason why not. Never raises.

        Args:
            item: its known properties: kind, id, label, provenance. Screening is added here, and taints the label.
            value: plain JSON, mostly a text; at most 1 MiB in canonical form.
            into: the context that it would enter (`Flow.context` for a holder, `Flow.fresh` for a reader).
        """
        ...


class Standing(Protocol):
    """Port for the authority behind a context, as of now."""

    def chain(self, context: Context) -> Chain | Fault:
        """The holder's verified chain, or the fault with which it fell. Never raises."""
        ...


class Admission:
    """Judges everything that would enter a context. Any thread; all IO is in its ports.

    Args:
        policies: the policies of decisions.
        clock: both clocks.
        journal: durable; nothing is admitted before its answer.
        audience: canonical URL of this admission point; its receipts name it.
        key: of this PEP; signs receipts.
        flow: contents of all contexts.
        standing: the authority behind a context.
        people: people whose word is an instruction.
        forms: of instructions and messages.
        conversations: messages heard before.
        replay: intents carried out before.
        caps: the bounds.
    """

    def __init__(
        self,
        *,
        policies: PolicySet,
        clock: Clock,
        journal: Journal,
        audience: str,
        key: PrivateKey,
        flow: Flow,
        standing: Standing,
        people: People,
        forms: Forms,
        conversations: Conversations,
        replay: ReplayStore,
        caps: Caps,
    ) -> None:
        self._policies = policies
        self._clock = clock
        self._journal = journal
        self._audience = audience
        self._key = key
        self._flow = flow
        self._standing = standing
        self._reader = Reader(
            clock=clock,
            flow=flow,
            people=people,
            forms=forms,
            conversations=conversations,
            replay=replay,
            caps=caps,
        )

    def instruct(self, text: str, *, credentials: Credentials, into: Context) -> Admitted | NotAdmitted:
        """Admits a person's signed intent at e1, once for each token, as an instruction. Never raises.

        Args:
            text: the signed intent (`capabilities.statements.context.intent`).
            credentials: of the orchestrator, after steps 1 to 10. Without a chain and a proof that hold, the intent is
                bound to nothing.
            into: its context.
        """
        return self._guarded(ItemKind.INSTRUCTION, lambda: self._reader.instruction(text, credentials, into))

    def hear(
        self, text: str, *, credentials: Credentials, into: Context, intent: str | None = None
    ) -> Admitted | NotAdmitted:
        """Admits another agent's signed message at e2, once, as that agent's words. Never raises.

        Args:
            text: the signed message (`capabilities.statements.context.message`).
            credentials: of a chain that has the sender's hop, after steps 1 to 9 at least: the message is the proof.
            into: the addressee's context.
            intent: the person's signed intent that the work is under, where it came along.
        """
        return self._guarded(ItemKind.MESSAGE, lambda: self._reader.message(text, credentials, into, intent))

    def admit(self, item: ItemReading, value: object, *, into: Context) -> Admitted | NotAdmitted:
        """e3: see `Admits.admit`."""
        return self._guarded(item.kind, lambda: self._reader.item(item, value, into, self._standing.chain(into)))

    def release(self, reader: Context, value: object) -> Released | ValueFault:
        """Ends a reader with its one value; or returns the reason why it is no value.

        The value derives from everything that the reader read, also where it does not show. It enters no context by
        this: to hand it on as an argument, its receipt is enough. Before it is shown to another model, `Flow.enter`
        that context, with the value.
        """
        label = self._flow.close(reader)
        plain = values.plain(value)
        if isinstance(plain, ValueFault):
            return plain
        if screening.screen_value(plain.value):
            label = tainted(label)
        return Released(plain.value, label, self._receipt(plain, label, reader.holder))

    def recover(self, found: Iterable[Mapping[str, Any]]) -> None:
        """Takes in what an earlier process admitted once, so that it is not admitted again.

        Args:
            found: records of the whole journal, oldest first.
        """
        self._reader.recover(found)

    # --- from there on all are alike ---------------------------------------------------------------------------------

    def _guarded(self, kind: ItemKind, read: Callable[[], AdmissionCase]) -> Admitted | NotAdmitted:
        request = Request(
            request_id=secrets.token_hex(16),
            points=frozenset({POINT_OF.get(kind, Point.CONTEXT)}),
            audience=self._audience,
            object=OBJECT,
            operation=OPERATION_OF[kind],
            values=(),
            at=self._clock.wall_s(),
        )
        try:
            return self._settle(request, read())
        except Exception as error:  # noqa: BLE001 - any exception on the way is DENY; a narrower net would leak
            return self._broken(request, error)

    def _settle(self, request: Request, case: AdmissionCase) -> Admitted | NotAdmitted:
        decided_ms = self._clock.monotonic_ms()
        decision = decide(request, case.evidence, self._policies)
        if decision.effect is not Effect.PERMIT:
            return self._refused(request, case, decision)
        if isinstance(case.value, ValueFault):
            large = case.value is ValueFault.TOO_LARGE
            return self._refused(
                request, case, denial(decision, Reason.BODY_TOO_LARGE if large else Reason.BODY_MALFORMED)
            )
        undone = next((owed.kind for owed in decision.obligations if owed.kind is not ObligationKind.RECORD), None)
        if undone is not None:
            # nothing here watches, lowers or tells: a PERMIT that asks for it does not count
            return self._refused(request, case, denial(decision, Reason.OBLIGATION_UNMET, obligation=str(undone)))
        taken = case.claim()
        if taken is not None:
            return self._refused(request, case, denial(decision, taken))
        label = case.item.label
        receipt = self._receipt(case.value, label, case.into.holder)
        record = self._journal.append("decision", self._body(request, case, decision))
        late = self._clock.monotonic_ms() > decided_ms + decision.lifetime_ms
        full = None if late else self._flow.enter(case.into, label, case.value.value)
        if late or isinstance(full, Full):
            reason = Reason.VERDICT_EXPIRED if late else Reason.EVIDENCE_MISSING
            self._journal.append("outcome", records.outcome(request, record, "refused", reason=reason))
            return NotAdmitted(denial(decision, reason), record)
        self._journal.append("outcome", records.outcome(request, record, "done"))
        return Admitted(case.value.value, label, receipt, decision, record)

    def _refused(self, request: Request, case: AdmissionCase, decision: Decision) -> NotAdmitted:
        return NotAdmitted(decision, self._journal.append("decision", self._body(request, case, decision)))

    def _broken(self, request: Request, error: Exception) -> NotAdmitted:
        """An exception on the way: DENY, recorded if that is still possible."""
        reason = Reason.RECORD_FAILED if isinstance(error, JournalError) else Reason.EVIDENCE_MISSING
        unknown = Evidence(at=self._clock.wall_s(), at_ms=self._clock.monotonic_ms())
        decision = denial(decide(request, unknown, self._policies), reason, error=type(error).__name__)
        if reason is Reason.RECORD_FAILED:
            return NotAdmitted(decision, "")
        try:
            body = {**recorded.to_plain(request, unknown), "decision": records.decision_body(decision), "proof": ""}
            return NotAdmitted(decision, self._journal.append("decision", body))
        except Exception as failed:  # noqa: BLE001 - any error of a journal means no record
            return NotAdmitted(denial(decision, Reason.RECORD_FAILED, error=type(failed).__name__), "")

    def _body(self, request: Request, case: AdmissionCase, decision: Decision) -> dict[str, object]:
        """Record of a decision, with the digest of the admitted value in place of the value."""
        holder = case.into.holder
        noted = {
            "hop_id": holder.hop_id,
            "agent": holder.agent,
            "reader": case.into.reader,
            "value": case.value.digest if isinstance(case.value, Plain) else str(case.value),
            **(case.note if decision.effect is Effect.PERMIT else {}),
        }
        return {
            **recorded.to_plain(request, case.evidence),
            "decision": records.decision_body(decision),
            "proof": case.proof,
            "admission": noted,
        }

    def _receipt(self, value: Plain, label: Label, holder: Holder) -> str:
        return receipts.issue(value, label, holder, audience=self._audience, key=self._key, at=self._clock.wall_s())
