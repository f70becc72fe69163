"""Advice: the verdict on a call that is only asked about.

It comes by the gate's own way up to the record, and nothing follows from it here. A call that comes later is decided
anew, on what is so by then; so an approval is seen and not used, a budget is looked at and not charged, and nobody is
asked. The physics of a robot is of the instant of its motion, and is computed for motions alone: a question about one
lacks that evidence, and missing evidence denies.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pep.base.errors import JournalError
from pep.request.denial import broken, denial
from pep.request.permit import unfulfilled
from policies.evidence.evidence import ApprovalReading, Evidence
from policies.evidence.model import Effect
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.gate.budget_charge import BudgetCharge
    from pep.people.asks import Asks
    from pep.people.deferral import AskNotice
    from pep.request.call import Call
    from policies.evidence.model import Decision


@dataclass(frozen=True, slots=True)
class Advice:
    """Verdict of one instant, which permits nothing.

    Attributes:
        evidence: on which.
        decision: the verdict; an approval that it rests on is not used.
        ask: the open question to people about this very call; None where nobody has been asked.
    """

    evidence: Evidence
    decision: Decision
    ask: AskNotice | None = None


async def advised(
    call: Call,
    judge: Callable[[], tuple[Evidence, Decision]],
    *,
    asks: Asks,
    charge: BudgetCharge,
    policy_digest: str,
) -> Advice:
    """The verdict on a call as of now; every failure on the way is DENY.

    Args:
        call: asked about.
        judge: gives the evidence on it, without physics, and the gate's verdict.
        asks: of people, in whose answers the verdict may hold a use.
        charge: of the call, which is not made.
        policy_digest: of the policy set, hex.
    """
    evidence = Evidence(at=call.request.at, at_ms=call.arrived_ms)
    try:
        try:
            evidence, decision = judge()
        finally:
            # In the same step of the loop: no call can miss the use that was held for the verdict.
            asks.release(call.request.request_id)
        decision = await charge.looked(evidence, decision)
    except Exception as error:  # noqa: BLE001 - any exception on the way is DENY; a narrower net would leak
        reason = Reason.RECORD_FAILED if isinstance(error, JournalError) else Reason.EVIDENCE_MISSING
        return Advice(evidence, broken(call.request, reason, error, policy_digest=policy_digest))
    if decision.effect is Effect.PERMIT and (undone := unfulfilled(decision, call.request)) is not None:
        decision = denial(decision, Reason.OBLIGATION_UNMET, obligation=str(undone.kind))
    approval = evidence.approval
    if decision.effect is Effect.DEFER and isinstance(approval, ApprovalReading):
        return Advice(evidence, decision, asks.notice_of(approval.ask_id))
    return Advice(evidence, decision)
