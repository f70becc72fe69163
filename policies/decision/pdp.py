"""The decision: one pure function from a request, its evidence and a policy set to an answer.

Total: it never raises. Deterministic: the same values give the same Decision in every process. Evidence that is
missing, late, broken or undecidable is DENY; only a view of the world may be supplied by a person (DEFER).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

from capabilities.values.chain import Chain
from capabilities.values.scope import Tier
from policies.decision.approval import AskAgain, Counts, Refused, Waiting, standing
from policies.decision.combine import PERMITS, SILENT, PolicyAnswer, deny_overrides, evaluate
from policies.decision.obligations import NOTIFY, RECORD, of_permit, of_refusal
from policies.decision.policy import Concern, Policy, PolicySet
from policies.evidence import shape
from policies.evidence.evidence import ImpactReading, prior_leave
from policies.evidence.model import ApprovalUse, Decision, Effect, Request
from policies.evidence.tiers import runtime_tier
from policies.primitives.base import Case, Defers, Fails, Holds, Verdict, found, verified_chain
from policies.primitives.identity import AgentAuthentication
from policies.primitives.tools import PhysicalImpactGate
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from policies.evidence.evidence import Evidence
    from policies.evidence.model import Finding


def decide(request: Request, evidence: Evidence, policies: PolicySet) -> Decision:
    """The answer of `policies` to `request` on `evidence`.

    Args:
        request: the one to decide.
        evidence: all readings, taken at one instant.
        policies: the set; an empty one denies.

    Returns:
        The Decision. An error inside a policy is a DENY with `POLICY_ERROR`.
    """
    try:
        place = shape.fault(request, evidence)
        if place is not None:
            return _undecidable(request, policies, found("", Reason.EVIDENCE_MALFORMED, place=place))
        plan = policies.plan(request)
        case = Case(request, evidence, plan.needs.physical, runtime_tier(evidence, physical=plan.needs.physical))
        answers = [_answer(policy, case) for policy in plan.policies]
        effect, findings = deny_overrides(answers)
        approval: ApprovalUse | None = None
        if effect is Effect.DEFER:
            effect, findings, approval = _asked(case, findings, policies)
        permitted = effect is Effect.PERMIT
        impact = evidence.impact if case.physical and isinstance(evidence.impact, ImpactReading) else None
        return Decision(
            request_id=request.request_id,
            request_digest=request.digest,
            effect=effect,
            reason=Reason.PERMITTED if permitted else findings[0].reason,
            primitive="" if permitted else findings[0].primitive,
            findings=findings,
            tier=case.tier,
            index=None if impact is None else impact.index_milli,
            obligations=of_permit(plan, case, approval) if permitted else of_refusal(effect, plan, answers, findings),
            policy_digest=policies.digest,
            evidence=evidence,
            lifetime_ms=plan.needs.lifetime_ms if permitted else 0,
            approval=approval,
        )
    except Exception as error:  # noqa: BLE001 - total: any exception in deciding is a DENY, and the record names it
        return _undecidable(request, policies, found("", Reason.POLICY_ERROR, error=type(error).__name__))


def _asked(
    case: Case, deferred: tuple[Finding, ...], policies: PolicySet
) -> tuple[Effect, tuple[Finding, ...], ApprovalUse | None]:
    """Effect of a DEFER after people's answer: PERMIT where it counts, else a deferral or denial with the reason."""
    if case.tier is Tier.SAFETY_CRITICAL and prior_leave(case.evidence) is None:
        return Effect.DENY, (found(PhysicalImpactGate.id, Reason.TIER_SAFETY_CRITICAL), *deferred), None
    answer = standing(case, deferred, policies)
    match answer:
        case Waiting():
            return Effect.DEFER, deferred, None
        case AskAgain(finding):
            return Effect.DEFER, (finding, *deferred), None
        case Refused(finding):
            return Effect.DENY, (finding, *deferred), None
        case Counts(ask_id, use):
            return Effect.PERMIT, (), ApprovalUse(ask_id, use)
        case _:
            assert_never(answer)


def _answer(policy: Policy, case: Case) -> PolicyAnswer:
    """Answer of one policy that concerns the operation. An error in it denies."""
    try:
        concern = policy.subject.concern(case.evidence)
        if concern is Concern.NO:
            return SILENT
        if concern is Concern.UNKNOWN and policy.effect is Effect.PERMIT:
            # nobody knows whether this policy is for the caller: it cannot speak for them
            stranger = verified_chain(AgentAuthentication.id, case)
            return PolicyAnswer(Effect.DENY, () if isinstance(stranger, Chain) else stranger.findings, grants=True)
        verdict = evaluate(policy.predicate, case)
        match policy.effect:
            case Effect.PERMIT:
                return _permit(policy, verdict, case)
            case Effect.DENY:
                return _speak(policy, verdict, Reason.PROHIBITED)
            case Effect.DEFER:
                return _speak(policy, verdict, Reason.APPROVAL_REQUIRED)
    except Exception as error:  # noqa: BLE001 - a policy that errors denies (Cedar skips it: fine for web pages, wrong for robots)
        return PolicyAnswer(
            Effect.DENY, (found("", Reason.POLICY_ERROR, policy=policy.id, error=type(error).__name__),)
        )


def _permit(policy: Policy, verdict: Verdict, case: Case) -> PolicyAnswer:
    """Answer of a requirement: where it does not hold it denies, and from the PITBound on a PERMIT escalates."""
    match verdict:
        case Holds():
            return PERMITS if policy.pit_bound is None else _bounded(policy, policy.pit_bound, case)
        case Fails(findings):
            return PolicyAnswer(Effect.DENY, findings, grants=True)
        case Defers(findings):
            return PolicyAnswer(Effect.DEFER, findings, grants=True)
        case _:
            assert_never(verdict)


def _bounded(policy: Policy, bound: Tier, case: Case) -> PolicyAnswer:
    """PERMIT as the PITBound leaves it: DENY without a tier, DEFER or DENY from `bound` on."""
    gate, tier = PhysicalImpactGate.id, case.tier
    if tier is None:
        return PolicyAnswer(Effect.DENY, (found(gate, Reason.EVIDENCE_MISSING, evidence="impact"),), grants=True)
    if tier < bound:
        return PERMITS
    detail = {"tier": int(tier), "pit_bound": int(bound), "policy": policy.id}
    if tier is Tier.SAFETY_CRITICAL:
        effect = Effect.DENY if prior_leave(case.evidence) is None else Effect.DEFER
        return PolicyAnswer(effect, (found(gate, Reason.TIER_SAFETY_CRITICAL, **detail),), grants=True)
    return PolicyAnswer(Effect.DEFER, (found(gate, Reason.TIER_NEEDS_APPROVAL, **detail),), grants=True)


def _speak(policy: Policy, verdict: Verdict, plainly: Reason) -> PolicyAnswer:
    """A prohibition or a question: it speaks when its predicate holds, and asks a person where the predicate defers."""
    match verdict:
        case Fails():
            return SILENT
        case Defers(findings):
            return PolicyAnswer(Effect.DEFER, findings)
        case Holds(because):
            return PolicyAnswer(policy.effect, (found("", plainly, policy=policy.id), *because))
        case _:
            assert_never(verdict)


def _undecidable(request: Request, policies: PolicySet, finding: Finding) -> Decision:
    """The DENY for a request or evidence that is not even of the right shape; nothing here can raise."""
    name = getattr(request, "request_id", "")
    digest = getattr(policies, "digest", "")
    return Decision(
        request_id=name if isinstance(name, str) else "",
        request_digest="",
        effect=Effect.DENY,
        reason=finding.reason,
        primitive="",
        findings=(finding,),
        tier=None,
        index=None,
        obligations=(NOTIFY, RECORD),
        policy_digest=digest if isinstance(digest, str) else "",
        evidence=None,
        lifetime_ms=0,
    )
