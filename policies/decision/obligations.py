"""Obligations: acts that make a PERMIT count, and acts that follow a DENY.

A policy asks for those that it knows beforehand; those that only a decision can know are made here.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from policies.evidence.model import Effect, Obligation, ObligationKind
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from policies.decision.combine import PolicyAnswer
    from policies.decision.policy import Plan
    from policies.evidence.model import ApprovalUse, Finding
    from policies.primitives.base import Case

RECORD: Final = Obligation(ObligationKind.RECORD)
CONSUME: Final = Obligation(ObligationKind.CONSUME)
NOTIFY: Final = Obligation(ObligationKind.NOTIFY)
REATTEST: Final = Obligation(ObligationKind.REATTEST)
LOWER_TRUST: Final = Obligation(ObligationKind.LOWER_TRUST)

SPEED: Final = "speed"
"""Parameter for whose value an impact is computed, and for no higher one."""

AFTER: Final[Mapping[Reason, Obligation]] = MappingProxyType(
    {
        # an agent tried to have more than was lent, or to pass for another one; a slip of a parameter is neither
        **dict.fromkeys(
            (
                Reason.SIGNATURE_INVALID,
                Reason.HOP_NOT_ATTESTED,
                Reason.NOT_CANONICAL,
                Reason.CHAIN_BROKEN,
                Reason.NOT_NARROWER,
                Reason.PROOF_WRONG_KEY,
                Reason.PROOF_NOT_FOR_THIS_REQUEST,
                Reason.REPLAYED,
                Reason.DELEGATE_NOT_ALLOWED,
                Reason.NOT_GRANTED,
                Reason.ABOVE_CEILING,
                Reason.INSTRUCTION_UNAUTHENTIC,
                Reason.INTENT_NOT_BOUND,
                Reason.TEXT_WITHOUT_AUTHORITY,
                Reason.MESSAGE_UNAUTHENTIC,
                Reason.MESSAGE_OUT_OF_DELEGATION,
            ),
            LOWER_TRUST,
        ),
        # the holder is not, or no longer, known to be the attested agent
        **dict.fromkeys(
            (
                Reason.ATTESTATION_INVALID,
                Reason.ATTESTATION_OLD,
                Reason.REATTESTATION_NEEDED,
                Reason.BEHAVIOUR_DEVIATES,
            ),
            REATTEST,
        ),
        # something of ours is broken or was tampered with, and only a person can set it right
        **dict.fromkeys(
            (
                Reason.POLICY_ERROR,
                Reason.ENGINES_DISAGREE,
                Reason.PHYSICS_FAULT,
                Reason.PERCEPTION_INVALID,
                Reason.STATEMENT_UNTRUSTED,
                Reason.TOOL_DEFINITION_CHANGED,
                Reason.DOCUMENT_UNSIGNED,
                Reason.TRUST_NOT_OF_EDGE,
                Reason.BEHAVIOUR_DRIFTS,
                Reason.SCOPE_CONTRACTED,
            ),
            NOTIFY,
        ),
    }
)
"""Obligation that follows a DENY for a reason, beside its record; none where the record is enough."""


def of_permit(plan: Plan, case: Case, approval: ApprovalUse | None) -> tuple[Obligation, ...]:
    """Obligations of a PERMIT: those of its policies, the use of its approval, the clamp of its speed."""
    owed = list(plan.obligations)
    if approval is not None:
        owed.append(CONSUME)
    if plan.needs.physical:
        # the impact was computed for this speed, and the decision is for no higher one
        owed += [Obligation(ObligationKind.CLAMP, value) for value in case.request.quantities if value.name == SPEED]
    return _sorted(owed)


def of_refusal(
    effect: Effect, plan: Plan, answers: Iterable[PolicyAnswer], findings: Iterable[Finding]
) -> tuple[Obligation, ...]:
    """Obligations of a DENY or DEFER: those of the policies that brought it about, and those of the findings."""
    owed = {RECORD}
    for policy, answer in zip(plan.policies, answers, strict=True):
        if policy.effect is effect is answer.effect:
            owed |= policy.obligations
    if effect is Effect.DENY:
        owed.update(_after(findings))
    return _sorted(owed)


def _after(findings: Iterable[Finding]) -> Iterator[Obligation]:
    return (AFTER[finding.reason] for finding in findings if finding.reason in AFTER)


def _sorted(owed: Iterable[Obligation]) -> tuple[Obligation, ...]:
    return tuple(sorted(owed, key=lambda obligation: obligation.kind))
