"""Suppositions: the same request or evidence with one thing changed, to learn the decision in that case.

None of them is ever evidence of anything. They are made of readings that were verified, and are themselves not.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, cast

from capabilities.token.scope_check import refusal
from capabilities.values.chain import Chain, Refusal
from policies.decision.pdp import decide
from policies.evidence.evidence import (
    ApprovalReading,
    DeclaredImpact,
    ImpactReading,
    OpeningReading,
    PerceptionReading,
    RobotReading,
    ToolReading,
)
from policies.evidence.model import Effect
from policies.evidence.tiers import FRESH
from policies.primitives.tools import RUNNING

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from capabilities.values.bounds import Measured
    from policies.decision.policy import PolicySet
    from policies.evidence.evidence import Evidence
    from policies.evidence.model import Request


def with_chain(evidence: Evidence, change: Callable[[Chain], Chain]) -> Evidence:
    """The evidence with its verified chain changed; a fault stays one."""
    return replace(evidence, chain=change(evidence.chain)) if isinstance(evidence.chain, Chain) else evidence


def scoped(chain: Chain, **changes: object) -> Chain:
    """The chain with the leaf's scope changed."""
    leaf = replace(chain.leaf, scope=replace(chain.leaf.scope, **changes))  # type: ignore[arg-type]  # fields of a scope
    return replace(chain, hops=(*chain.hops[:-1], leaf))


def attested(chain: Chain, at: int) -> Chain:
    """The chain with every hop attested now."""
    return replace(chain, hops=tuple(replace(h, attestation=replace(h.attestation, at=at)) for h in chain.hops))


def refused(request: Request, evidence: Evidence) -> Refusal | None:
    """Refusal of a request by the chain's scope; None also where the scope cannot be asked."""
    chain, tool = evidence.chain, evidence.tool
    if not isinstance(chain, Chain) or not isinstance(tool, ToolReading) or tool.base_tier is None:
        return None
    return refusal(
        chain, object=request.object, operation=request.operation, values=request.values, base_tier=tool.base_tier
    )


def valued(request: Request, values: Mapping[str, Measured]) -> Request:
    """The request with other values."""
    changed = (
        replace(value, value=cast("Any", values[value.name])) if value.name in values else value
        for value in request.values
    )
    return replace(request, values=tuple(changed))


def sighted(evidence: Evidence) -> Evidence:
    """Evidence of the same world, freshly seen by every sensor."""
    impact, seen = evidence.impact, evidence.perception
    if isinstance(impact, ImpactReading):
        evidence = replace(evidence, impact=replace(impact, perception=FRESH))
    if isinstance(seen, PerceptionReading):
        sensors = tuple(replace(sensor, state=FRESH, fault="") for sensor in seen.sensors)
        evidence = replace(evidence, perception=replace(seen, sensors=sensors))
    return evidence


def ready(robot: RobotReading) -> RobotReading | None:
    """Robot as a person would leave it; None where the held object is unknown."""
    if robot.expected_payload_g is None:
        return None
    ready = replace(robot, robot_mode=RUNNING, safety_mode=1, remote_control=True, exclusive=True, frames_match=True)
    return replace(ready, payload_g=robot.expected_payload_g)


_HOUR_S: Final = 3_600
"""Life of a supposed approval in seconds: longer than the moment at which it is supposed."""


def approved(request: Request, evidence: Evidence, policies: PolicySet, people: int) -> Evidence:
    """The case after so many people approved it as it is, with prior leave where the tier wants one."""
    until = int(evidence.at) + _HOUR_S
    opened = people > 1
    opening = OpeningReading("supposed", "a person", 1, until, 0) if opened else evidence.opening
    asked = replace(evidence, approval=None, opening=opening)
    chain, impact, deferred = asked.chain, asked.impact, decide(request, asked, policies)
    if not isinstance(chain, Chain) or deferred.effect is not Effect.DEFER or deferred.tier is None:
        return asked
    computed = impact if isinstance(impact, ImpactReading) else None
    declared = impact.contributors if isinstance(impact, DeclaredImpact) else frozenset()
    approval = ApprovalReading(
        ask_id="supposed",
        state="granted",
        reasons=frozenset(str(finding.reason) for finding in deferred.findings),
        tier=deferred.tier,
        index_milli=0 if computed is None else computed.index_milli,
        contributors=declared | {(c.kind, c.object) for c in (computed.contributions if computed else ())},
        start_urad=() if computed is None else computed.start_urad,
        model_digest="" if computed is None else computed.model_digest,
        policy_digest=policies.digest,
        approvers=tuple(f"person {n}" for n in range(1, people + 1)),
        sponsor=chain.sponsor.subject,
        opening_id="supposed" if opened else "",
        sees_clear=True,
        uses_left=1,
        use=1,
        not_after=until,
        age_ms=0,
    )
    return replace(asked, approval=approval)
