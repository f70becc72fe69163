"""The facts of a real case: all that the twin of `decide` may know of it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from capabilities.values.chain import Chain, Refusal
from capabilities.values.errors import FaultCode
from policies.decision.pdp import decide
from policies.decision.policy import requirement
from policies.evidence import shape
from policies.evidence.evidence import (
    ApprovalReading,
    DeclaredImpact,
    ImpactFault,
    ImpactReading,
    OpeningReading,
    PerceptionReading,
    RobotReading,
    ToolReading,
    TrustReading,
    prior_leave,
)
from policies.evidence.model import Point
from policies.evidence.tiers import FRESH, base_tier, declared_tier, runtime_tier
from policies.primitives.base import Case, Defers, Fails, Holds
from policies.primitives.cognition import BELIEVED
from policies.primitives.tools import StatePreconditions
from policies.proof.facts import ANOTHER_STATE, FACTS, NO_APPROVAL, STATES, Facts, Names, PrimitiveVerdict
from policies.proof.verdicts import unknowns

if TYPE_CHECKING:
    from policies.decision.policy import PolicySet
    from policies.evidence.evidence import Evidence
    from policies.evidence.model import Request
    from policies.primitives.base import Primitive

_PARAMETER_REFUSED: Final = frozenset({FaultCode.PARAMETERS_WRONG, FaultCode.LIMIT_EXCEEDED_BY_REQUEST})
_ANY: Final = 0
"""Stands for a number that the case does not have; no fact that uses it is true."""


def observe(request: Request, evidence: Evidence, policies: PolicySet, names: Names) -> Facts:
    """The facts of a case. One that is not of its declared shape has no other fact."""
    if shape.fault(request, evidence) is not None:
        return replace(ordinary_facts(policies), well_formed=False)
    needs = requirement(request, policies)
    case = Case(request, evidence, needs.physical, runtime_tier(evidence, physical=needs.physical))
    found: dict[str, Any] = {
        "well_formed": True,
        "object": names.place("object", request.object),
        "operation": names.place("operation", request.operation),
        **{str(point): point in request.points for point in Point},
        **_chain(request, evidence, names),
        **_request(evidence),
        **_tool(evidence),
        **_world(case, policies),
        **_approval(case, policies),
        **_opening(evidence, policies),
    }
    return Facts(**found, unknown={primitive: what_it_says(primitive, case) for primitive in unknowns(policies)})


def ordinary_facts(policies: PolicySet) -> Facts:
    """The facts of the case in which nothing is strange, and no unknown primitive fails."""
    known = {row.name: row.metadata["ordinary"] for row in FACTS}
    return Facts(**known, unknown=dict.fromkeys(unknowns(policies), PrimitiveVerdict(holds=True, fails=False)))


def what_it_says(primitive: Primitive, case: Case) -> PrimitiveVerdict:
    """The verdict of a primitive, asked."""
    try:
        verdict = primitive.judge(case)
    except Exception:  # noqa: BLE001 - as `decide` does: an exception denies
        return PrimitiveVerdict(holds=False, fails=False, raises=True)
    return PrimitiveVerdict(
        isinstance(verdict, Holds), isinstance(verdict, Fails), not isinstance(verdict, Holds | Fails | Defers)
    )


def _chain(request: Request, evidence: Evidence, names: Names) -> dict[str, Any]:
    chain, at = evidence.chain, evidence.at
    if not isinstance(chain, Chain):
        numbers = ("sponsor_age_s", "leaf_age_s", "oldest_age_s", "youngest_age_s", "lifetime_s", "delegations")
        truths = ("chain_verified", "sponsor_named", "begun", "unexpired", "audience_meant")
        nobody = {"agent": names.place("agent", ""), "sponsor": names.place("sponsor", "")}
        return nobody | dict.fromkeys((*numbers, "view_age_ms", "ceiling"), _ANY) | dict.fromkeys(truths, False)
    ages = [at - hop.attestation.at for hop in chain.hops]
    return {
        "chain_verified": True,
        "agent": names.place("agent", chain.leaf.agent),
        "sponsor": names.place("sponsor", chain.sponsor.subject),
        "sponsor_named": bool(chain.sponsor.subject) and bool(chain.sponsor.issuer),
        "sponsor_age_s": at - chain.sponsor.authenticated_at,
        "leaf_age_s": ages[-1],
        "oldest_age_s": max(ages),
        "youngest_age_s": min(ages),
        "begun": chain.scope.not_before <= at,
        "unexpired": at < chain.scope.not_after,
        "lifetime_s": chain.scope.not_after - chain.scope.not_before,
        "delegations": len(chain.hops) - 1,
        "view_age_ms": chain.view_age_ms,
        "ceiling": int(chain.scope.ceiling),
        "audience_meant": request.audience in chain.scope.audiences,
    }


def _request(evidence: Evidence) -> dict[str, Any]:
    said = evidence.request_fault
    return {
        "proof_valid": evidence.proof is True,
        "request_free": said is None,
        "after_the_grant": isinstance(said, Refusal) and said.code in _PARAMETER_REFUSED,
        "robot_free": evidence.robot_fault is None,
    }


def _tool(evidence: Evidence) -> dict[str, Any]:
    tool, trust, base = evidence.tool, evidence.trust, base_tier(evidence)
    registered = isinstance(tool, ToolReading) and bool(tool.approved_digest) and base is not None
    if base is not None and isinstance(evidence.impact, DeclaredImpact):
        base = max(base, declared_tier(evidence.impact))  # rows raise the class, with physics or without
    return {
        "tool_pinned": isinstance(tool, ToolReading) and registered and tool.actual_digest == tool.approved_digest,
        "base_known": base is not None,
        "base_tier": _ANY if base is None else int(base),
        "trust_known": isinstance(trust, TrustReading),
        "trust_permille": trust.score_permille if isinstance(trust, TrustReading) else _ANY,
    }


def _world(case: Case, policies: PolicySet) -> dict[str, Any]:
    impact, view, limits = case.evidence.impact, case.evidence.perception, policies.parameters
    read = impact if isinstance(impact, ImpactReading) else None
    # A declared impact looks at no world: it is as one that was computed, and seen, and violates nothing.
    declared = isinstance(impact, DeclaredImpact)
    sensors = view.sensors if isinstance(view, PerceptionReading) else ()
    return {
        "impact_read": declared or read is not None,
        "impact_fault": isinstance(impact, ImpactFault),
        "impact_tier": _impact_tier(impact),
        "index_valid": declared or (read is not None and 0 <= read.index_milli <= 4000),
        "violated": read is not None and read.violations != (),
        "seen_fresh": declared or (read is not None and read.perception == FRESH),
        "slow": declared or (read is not None and read.tcp_speed_um_s <= limits.approved_tcp_speed_um_s),
        "soft": declared or (read is not None and read.contact_permille <= limits.approved_contact_permille),
        "view_known": isinstance(view, PerceptionReading),
        "view_invalid": any(sensor.state not in BELIEVED for sensor in sensors),
        "view_late": not sensors or any(sensor.state != FRESH for sensor in sensors),
        "robot_known": isinstance(case.evidence.robot, RobotReading),
        "robot_ready": isinstance(StatePreconditions().judge(case), Holds),
    }


def _impact_tier(impact: object) -> int:
    """Tier of the impact as it was read; any number where none was."""
    match impact:
        case ImpactReading():
            return int(impact.tier)
        case DeclaredImpact():
            return int(declared_tier(impact))
        case _:
            return _ANY


def _approval(case: Case, policies: PolicySet) -> dict[str, Any]:
    evidence, approval = case.evidence, case.evidence.approval
    chain = evidence.chain
    if not isinstance(approval, ApprovalReading):
        mute = (
            "same_sponsor",
            "same_policies",
            "lists_all",
            "same_impact",
            "sees_clear",
            "uses_left",
            "in_time",
            "recent",
        )
        return {
            **{f"approval_{name}": False for name in mute},
            "approval": NO_APPROVAL,
            "approval_tier": _ANY,
            "approvers": _ANY,
        }
    # the deferring reasons are those of a decision without approval
    unasked = decide(case.request, replace(evidence, approval=None), policies)
    return {
        "approval": STATES.index(approval.state) if approval.state in STATES[1:-1] else ANOTHER_STATE,
        "approval_tier": int(approval.tier),
        "approval_same_sponsor": isinstance(chain, Chain) and chain.sponsor.subject == approval.sponsor,
        "approval_same_policies": approval.policy_digest == policies.digest,
        "approval_lists_all": {str(f.reason) for f in unasked.findings} <= approval.reasons,
        "approval_same_impact": _same_impact(evidence, approval, policies),
        "approval_sees_clear": approval.sees_clear,
        "approvers": len(set(approval.approvers)),
        "approval_uses_left": approval.uses_left >= 1,
        "approval_in_time": evidence.at <= approval.not_after,
        "approval_recent": 0 <= approval.age_ms <= policies.parameters.lease_motion_ms,
    }


def _same_impact(evidence: Evidence, approval: ApprovalReading, policies: PolicySet) -> bool:
    """True where the impact is the shown one, within the slack of an approval."""
    now, slack = evidence.impact, policies.parameters
    if not isinstance(now, ImpactReading):
        return isinstance(now, DeclaredImpact) and now.contributors <= approval.contributors
    moved = [abs(a - b) for a, b in zip(now.start_urad, approval.start_urad, strict=False)]
    return (
        now.model_digest == approval.model_digest
        and now.index_milli <= approval.index_milli + slack.approved_index_slack_milli
        and len(now.start_urad) == len(approval.start_urad)
        and max(moved, default=0) <= slack.approved_start_slack_urad
        and {(c.kind, c.object) for c in now.contributions} <= approval.contributors
    )


def _opening(evidence: Evidence, policies: PolicySet) -> dict[str, Any]:
    opening, approval = evidence.opening, evidence.approval
    force = prior_leave(evidence) is not None
    if not isinstance(opening, OpeningReading):
        return {"opening_in_force": force, "opening_its_own": False, "opening_recent": False}
    return {
        "opening_in_force": force,
        "opening_its_own": isinstance(approval, ApprovalReading) and opening.opening_id == approval.opening_id,
        "opening_recent": 0 <= opening.age_ms <= policies.parameters.lease_motion_ms,
    }
