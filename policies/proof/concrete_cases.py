"""Real requests and evidence with given facts, of which a counterexample is made.

Only the facts are chosen; everything else is ordinary, so that the claim breaks on the strange part of a case.
Values that no fact speaks of are invented (digests, ids, joint angles) and mean nothing.
"""

from __future__ import annotations

from dataclasses import replace
from math import ceil, nan
from typing import TYPE_CHECKING, Final

from capabilities.values.chain import Attestation, Chain, EvidenceKind, Hop, Refusal, Sponsor
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.scope import Scope, Tier
from policies.evidence.conduct_readings import BehaviourReading, SequenceReading
from policies.evidence.content_readings import ContextReading, InstructionReading, MessageReading
from policies.evidence.evidence import (
    NOT_COLLECTED,
    ApprovalReading,
    EdgeReading,
    Evidence,
    ImpactFault,
    ImpactReading,
    NotCollected,
    OpeningReading,
    PerceptionReading,
    RobotReading,
    SensorReading,
    ToolReading,
    TrustReading,
)
from policies.evidence.model import Point, Request
from policies.proof.facts import NO_APPROVAL, STATES, Facts, Names
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from policies.decision.policy import PolicySet
    from policies.words.parameters import Parameters

AT: Final = 1_000_000_000
"""The instant of every counterexample, seconds since the epoch."""
AUDIENCE: Final = "https://pep.example/"
ISSUER: Final = "https://idp.example/"
DIGEST: Final = "ab" * 32
"""Stands where a digest must be."""
ASK: Final = "a" * 32
OPENING: Final = "opening-1"


def case_of(facts: Facts, policies: PolicySet, names: Names) -> tuple[Request, Evidence]:
    """A request and evidence with these facts, each a bool or an integer."""
    request = Request(
        request_id="counterexample",
        points=frozenset(point for point in Point if facts.stands_for(point)),
        audience=AUDIENCE,
        object=names.object[facts.object],
        operation=names.operation[facts.operation],
        values=(),
        at=float(AT),
    )
    scope_says = Refusal(FaultCode.LIMIT_EXCEEDED_BY_REQUEST if facts.after_the_grant else FaultCode.NOT_GRANTED)
    chain = _chain(facts, names)
    trust = _trust(facts, chain)
    evidence = Evidence(
        at=float(AT) if facts.well_formed else nan,
        at_ms=0,
        chain=chain,
        proof=True if facts.proof_valid else Fault(FaultCode.PROOF_WRONG_KEY, "PRF-1"),
        request_fault=None if facts.request_free else scope_says,
        robot_fault=None if facts.robot_free else Refusal(FaultCode.LIMIT_EXCEEDED_BY_REQUEST),
        tool=_tool(facts),
        trust=trust,
        impact=_impact(facts, policies.parameters),
        perception=_perception(facts),
        robot=_robot(facts),
        approval=_approval(facts, names, policies),
        opening=_opening(facts, policies.parameters),
    )
    return request, _with_ordinary_conduct(evidence, names.agent[facts.agent])


def _whole(number: object) -> int:
    """The number, or the next whole one above it."""
    return ceil(number)  # type: ignore[call-overload,no-any-return]  # a fact is an int or a fraction


def _chain(facts: Facts, names: Names) -> Chain | Fault:
    if not facts.chain_verified:
        return Fault(FaultCode.SIGNATURE_INVALID, "TOK-3")
    lifetime_s = _whole(facts.lifetime_s)
    match bool(facts.begun), bool(facts.unexpired):
        case True, True:
            begins = AT - min(lifetime_s - 1, 600)
        case True, False:
            begins = AT - max(lifetime_s, 0)
        case _:
            begins = AT + 1 + (max(-lifetime_s, 0) if facts.unexpired else 0)
    ceiling = Tier(facts.ceiling)
    audiences = frozenset({AUDIENCE if facts.audience_meant else "https://elsewhere.example/"})
    scope = Scope((), ceiling, audiences, frozenset(), 0, begins, begins + lifetime_s)
    ages = [_whole(facts.youngest_age_s)] * _whole(facts.delegations) + [_whole(facts.leaf_age_s)]
    # the first is the oldest, the last is the leaf; of two, the first is whichever the leaf is not
    if len(ages) > 1 and facts.oldest_age_s != facts.leaf_age_s:
        ages[0] = _whole(facts.oldest_age_s)
    subject = names.sponsor[facts.sponsor]
    hops = tuple(
        Hop(
            index=i,
            hop_id=f"{i:032x}",
            agent=names.agent[facts.agent] if i == len(ages) - 1 else f"delegator-{i}",
            key=bytes(32),
            delegator=subject if i == 0 else f"delegator-{i - 1}",
            purpose="",
            request_digest=bytes(32),
            attestation=Attestation(EvidenceKind.KEY, bytes(32), AT - age),
            scope=scope,
        )
        for i, age in enumerate(ages)
    )
    issuer = ISSUER if facts.sponsor_named else ""
    sponsor = Sponsor(issuer, subject, "operator-key", AT - _whole(facts.sponsor_age_s))
    return Chain("A" * 22, bytes(32), sponsor, 1, hops, 1, _whole(facts.view_age_ms))


def _trust(facts: Facts, chain: Chain | Fault) -> TrustReading | NotCollected:
    if not facts.trust_known:
        return NOT_COLLECTED
    score = _whole(facts.trust_permille)
    hops = chain.hops if isinstance(chain, Chain) else ()
    return TrustReading(score, tuple(EdgeReading(hop.delegator, hop.agent, score) for hop in hops))


def _tool(facts: Facts) -> ToolReading:
    base = Tier(facts.base_tier) if facts.base_known else None
    return ToolReading("tool", DIGEST, DIGEST if facts.tool_pinned else "cd" * 32, base)


def _impact(facts: Facts, limits: Parameters) -> ImpactReading | ImpactFault | NotCollected:
    if not facts.impact_read:
        return ImpactFault(str(Reason.PERCEPTION_INVALID)) if facts.impact_fault else NOT_COLLECTED
    return ImpactReading(
        tier=Tier(facts.impact_tier),
        index_milli=1_000 * int(facts.impact_tier) if facts.index_valid else -1,
        violations=("person",) if facts.violated else (),
        contributions=(),
        lower_tier_speed=None,
        tcp_speed_um_s=limits.approved_tcp_speed_um_s + (0 if facts.slow else 1),
        contact_permille=limits.approved_contact_permille + (0 if facts.soft else 1),
        start_urad=(0,) * 6,
        perception="fresh" if facts.seen_fresh else "stale",
        perception_age_ms=50,
        scene_digest=DIGEST,
        model_digest=DIGEST,
        engine="kernel",
    )


def _perception(facts: Facts) -> PerceptionReading | NotCollected:
    if not facts.view_known:
        return NOT_COLLECTED
    state = "invalid" if facts.view_invalid else "stale" if facts.view_late else "fresh"
    return PerceptionReading((SensorReading("camera", state, "UNTRUSTED" if facts.view_invalid else "", 50),))


def _robot(facts: Facts) -> RobotReading | NotCollected:
    if not facts.robot_known:
        return NOT_COLLECTED
    return RobotReading(7, 1 if facts.robot_ready else 3, True, True, 1_000, 1_000, True)  # noqa: FBT003 - running, normal, and all as expected


def _approval(facts: Facts, names: Names, policies: PolicySet) -> ApprovalReading | None:
    if facts.approval == NO_APPROVAL:
        return None
    lease_ms = policies.parameters.lease_motion_ms
    shown_index = 1_000 * int(facts.impact_tier) if facts.index_valid else -1
    return ApprovalReading(
        ask_id=ASK,
        state=STATES[facts.approval],
        reasons=frozenset(str(reason) for reason in Reason) if facts.approval_lists_all else frozenset(),
        tier=Tier(facts.approval_tier),
        index_milli=shown_index,
        contributors=frozenset(),
        start_urad=(0,) * 6,
        model_digest=DIGEST if facts.approval_same_impact else "cd" * 32,
        policy_digest=policies.digest if facts.approval_same_policies else "cd" * 32,
        approvers=tuple(f"person-{i}" for i in range(_whole(facts.approvers))),
        sponsor=names.sponsor[facts.sponsor] if facts.approval_same_sponsor else "somebody else",
        opening_id=OPENING if facts.opening_its_own else "another opening",
        sees_clear=bool(facts.approval_sees_clear),
        uses_left=1 if facts.approval_uses_left else 0,
        use=1,
        not_after=AT + 60 if facts.approval_in_time else AT - 1,
        age_ms=0 if facts.approval_recent else lease_ms + 1,
    )


def _opening(facts: Facts, limits: Parameters) -> OpeningReading | None:
    if not facts.opening_in_force:
        return None
    return OpeningReading(OPENING, "opener", 1, AT + 60, 0 if facts.opening_recent else limits.lease_motion_ms + 1)


def _with_ordinary_conduct(evidence: Evidence, agent: str) -> Evidence:
    """Evidence with readings for the unknown primitives as they are where nothing is wrong.

    No fact says anything about these readings.
    """
    return replace(
        evidence,
        instruction=InstructionReading("", "sponsor", AT, well_formed=True, intent_digest=DIGEST, bound_digest=DIGEST),
        message=MessageReading("", "delegator-0", agent, *(True,) * 5, 0),
        context=ContextReading(),
        sequence=SequenceReading(
            unfinished=False, tier=Tier(0), index_milli=0, drift_urad=0, alternations=0, held_known=True, acts=0
        ),
        behaviour=BehaviourReading(agent, (), None, contracted=False, samples=1_000, age_ms=0),
    )
