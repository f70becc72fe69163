"""Last look before an act: all that its PERMIT rests on, as it is right before the effect.

A motion is watched while it lasts; an act is over at once, so it is looked at right before. Between the verdict and
here lie a record on disk and all that the shell waits for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from pep.request.call import tool_reading
from policies.decision.pdp import decide
from policies.evidence.evidence import ApprovalReading, OpeningReading
from policies.evidence.model import Effect
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.base.ports import Registry
    from pep.people.asks import Asks
    from pep.request.call import Call
    from policies.decision.policy import PolicySet
    from policies.evidence.evidence import Evidence
    from policies.evidence.model import Decision


@dataclass(frozen=True, slots=True)
class LastLook:
    """Looks at one permitted act once more.

    Attributes:
        call: of the act.
        decision: its PERMIT.
        collect: gives the evidence that needs no physics, as of now.
        registry: of tools.
        asks: people's answers.
        policies: gives those in force.
    """

    call: Call
    decision: Decision
    collect: Callable[[Call], Evidence]
    registry: Registry
    asks: Asks
    policies: Callable[[], PolicySet]

    def __call__(self) -> Reason | None:
        """Reason for which the act would not be permitted now; None where it would."""
        if not self.asks.stands(self.decision):
            return Reason.APPROVAL_NOT_USABLE
        known, tool = self.decision.evidence, self.call.tool
        if known is None:
            return Reason.EVIDENCE_MISSING
        tool = tool_reading(tool.name, self.registry.tool(tool.name), tool.actual_digest)
        now = self.collect(replace(self.call, tool=tool))
        # The use of the answer is this request's own already, so nobody is asked for it again.
        now = _aged(replace(now, approval=known.approval, opening=known.opening), now.at_ms - known.at_ms)
        decided = decide(self.call.request, now, self.policies())
        if decided.effect is not Effect.PERMIT:
            return decided.reason
        # What rests on an answer only now has not used it.
        return None if decided.approval == self.decision.approval else Reason.APPROVAL_NOT_USABLE


def _aged(evidence: Evidence, by_ms: int) -> Evidence:
    """The evidence with people's words so much older."""
    approval, opening = evidence.approval, evidence.opening
    if isinstance(approval, ApprovalReading):
        approval = replace(approval, age_ms=approval.age_ms + by_ms)
    if isinstance(opening, OpeningReading):
        opening = replace(opening, age_ms=opening.age_ms + by_ms)
    return replace(evidence, approval=approval, opening=opening)
