"""Domain TEA, tool execution and actuation: the tool, its parameters, and their effect on the world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final, assert_never

from capabilities.token.scope_check import set_ceiling
from capabilities.values.bounds import bound_to_json, kind_to_json, permits
from capabilities.values.chain import Chain, Refusal
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.scope import Each
from policies.evidence.evidence import (
    DeclaredImpact,
    ImpactFault,
    ImpactReading,
    NotCollected,
    RobotReading,
    ToolReading,
    prior_leave,
)
from policies.evidence.tiers import FRESH, RULES, TierRule, base_tier, facts_fresh, runtime_tier
from policies.primitives.base import (
    Case,
    Defers,
    Fails,
    Holds,
    Verdict,
    chain_fault,
    fails,
    found,
    missing,
    verified_chain,
)
from policies.words.reason_table import REASONS, Reason

if TYPE_CHECKING:
    from capabilities.values.scope import Tier
    from policies.evidence.model import Finding


def refusal_detail(refusal: Refusal) -> dict[str, object]:
    """Details of a refusal for the holder: parameter, value, unit or kind, limit, its hop, nearest permitted value."""
    return {
        "parameter": refusal.parameter,
        "value": refusal.value,
        **({"unit": None} if refusal.unit is None else kind_to_json(refusal.unit)),
        **_member(refusal),
        "limit": None if refusal.bound is None else bound_to_json(refusal.bound),
        "set_by": {
            "hop": refusal.hop,
            "hop_id": refusal.hop_id,
            "agent": refusal.agent,
            "sponsor": refusal.sponsor,
        },
        "nearest_permitted": refusal.nearest,
    }


def _member(refusal: Refusal) -> dict[str, object]:
    """Place of the first member of a list that is outside; none for a list of another length."""
    if not isinstance(refusal.bound, Each) or not isinstance(refusal.value, tuple):
        return {}
    least, most, element = refusal.bound.least, refusal.bound.most, refusal.bound.element
    if element is None or not least <= len(refusal.value) <= most:
        return {}
    return {"member": next(at for at, member in enumerate(refusal.value) if not permits(element, member))}


def scope_answer(primitive: str, case: Case) -> Refusal | Fails | None:
    """Refusal by the scope that belongs to `primitive`, None, or the finding of another primitive.

    A refusal of another primitive leaves this one undecided, so it fails too, with the owner's reason. The exception is
    a limit: who finds a value out of bounds has found the grant first, so TEA-1 holds then.
    """
    chain = verified_chain(primitive, case)
    if not isinstance(chain, Chain):
        return chain
    match case.evidence.request_fault:
        case None:
            return None
        case NotCollected():
            return missing(primitive, "request_fault")
        case Fault() as fault:
            return chain_fault(primitive, fault)
        case Refusal() as refusal:
            owners = REASONS[Reason(refusal.code)].owners
            if primitive in owners:
                return refusal
            if primitive == ToolScope.id and refusal.code in _AFTER_THE_GRANT:
                return None
            return fails(owners[0] if owners else primitive, Reason(refusal.code), **refusal_detail(refusal))
        case _:
            assert_never(case.evidence.request_fault)


_AFTER_THE_GRANT: Final = frozenset({FaultCode.PARAMETERS_WRONG, FaultCode.LIMIT_EXCEEDED_BY_REQUEST})


@dataclass(frozen=True, slots=True)
class ToolScope:
    """TEA-1: the operation on this object is granted at every hop."""

    id: ClassVar[str] = "TEA-1"

    def judge(self, case: Case) -> Verdict:
        """Holds when the effective scope, the meet of all hops, has the grant."""
        match scope_answer(self.id, case):
            case None:
                return Holds()
            case Fails() as other:
                return other
            case Refusal() as refusal:
                detail = {"object": case.request.object, "operation": case.request.operation, **refusal_detail(refusal)}
                return fails(self.id, Reason(refusal.code), **detail)
            case other:
                assert_never(other)


@dataclass(frozen=True, slots=True)
class ParameterLimits:
    """TEA-2: every parameter is inside every hop's limits, and inside the robot's own."""

    id: ClassVar[str] = "TEA-2"

    def judge(self, case: Case) -> Verdict:
        """Holds when neither scope nor robot refuses a parameter; a refusal names the tightest bound and who set it."""
        match scope_answer(self.id, case):
            case None:
                pass
            case Fails() as other:
                return other
            case Refusal() as refusal:
                return fails(self.id, Reason(refusal.code), **refusal_detail(refusal))
        match case.evidence.robot_fault:
            case None:
                return Holds()
            case NotCollected():
                return missing(self.id, "robot_fault")
            case Refusal(code=FaultCode.LIMIT_EXCEEDED_BY_REQUEST) as refusal:
                return fails(
                    self.id, Reason.ROBOT_LIMIT, **{**refusal_detail(refusal), "set_by": {"robot": case.request.object}}
                )
            case Refusal() as refusal:
                return fails(self.id, Reason(refusal.code), **refusal_detail(refusal))
            case _:
                assert_never(case.evidence.robot_fault)


@dataclass(frozen=True, slots=True)
class ToolIdentity:
    """TEA-3: the tool's definition equals its approved pin, and its base tier is registered."""

    id: ClassVar[str] = "TEA-3"

    def judge(self, case: Case) -> Verdict:
        """Holds for a registered tool that serves, now, exactly the definition which was approved."""
        match case.evidence.tool:
            case NotCollected():
                return missing(self.id, "tool")
            case ToolReading() as tool:
                return self._reading(tool)
            case _:
                assert_never(case.evidence.tool)

    def _reading(self, tool: ToolReading) -> Verdict:
        if not tool.approved_digest or tool.base_tier is None:
            return fails(self.id, Reason.TOOL_UNKNOWN, tool=tool.name)
        if tool.actual_digest != tool.approved_digest:
            return fails(
                self.id,
                Reason.TOOL_DEFINITION_CHANGED,
                tool=tool.name,
                approved_digest=tool.approved_digest,
                actual_digest=tool.actual_digest,
            )
        return Holds()


IMPACT_FAULTS: Final = frozenset(
    {
        Reason.NOT_A_NUMBER,
        Reason.NOT_FINITE,
        Reason.NOT_ON_GRID,
        Reason.OUT_OF_RANGE,
        Reason.ROBOT_LIMIT,
        Reason.ENGINES_DISAGREE,
        Reason.STATEMENT_MALFORMED,
        Reason.STATEMENT_WRONG_KIND,
        Reason.STATEMENT_UNTRUSTED,
        Reason.PHYSICS_FAULT,
        Reason.UNPROVEN,
        Reason.PERCEPTION_INVALID,
        Reason.PERCEPTION_MISSING,
        Reason.BUSY,
    }
)
"""Faults that physics may state.

Any other word, above all a mild one, is itself a fault of physics.
"""


def impact_detail(case: Case, chain: Chain, tier: Tier) -> dict[str, object]:
    """Details of a decision on physics: tier, index, ceiling, contributions, and the greatest permitted value."""
    detail: dict[str, object] = {"tier": int(tier), "ceiling": int(chain.scope.ceiling)}
    impact = case.evidence.impact
    if isinstance(impact, ImpactReading):
        detail |= {
            "index_milli": impact.index_milli,
            "contributions": [
                {
                    "kind": c.kind,
                    "index_milli": c.index_milli,
                    "link": c.link,
                    "object": c.object,
                    "at_ms": c.at_ms,
                    "clearance_um": c.clearance_um,
                    "speed_um_s": c.speed_um_s,
                    "source": c.source,
                }
                for c in impact.contributions
            ],
            "highest_speed_of_lower_tier": impact.lower_tier_speed,
            "violations": list(impact.violations),
            "perception": impact.perception,
            "perception_age_ms": impact.perception_age_ms,
        }
    elif isinstance(impact, DeclaredImpact):
        detail["raised_by"] = list(impact.raised_by)
        if impact.facts:
            detail["facts"] = [
                {"fact": f.fact, "state": f.state, "value": f.value, "unit": f.unit, "age_ms": f.age_ms}
                for f in impact.facts
            ]
    return detail


def ceiling_set_by(chain: Chain) -> dict[str, object]:
    """Hop that set the effective ceiling, as plain JSON."""
    hop = set_ceiling(chain)
    return {"hop": hop.index, "hop_id": hop.hop_id, "agent": hop.agent, "sponsor": chain.sponsor.subject}


@dataclass(frozen=True, slots=True)
class PhysicalImpactGate:
    """TEA-4: the runtime tier, computed from the live world, is under the token's ceiling and selects the effect."""

    id: ClassVar[str] = "TEA-4"

    def judge(self, case: Case) -> Verdict:
        """Holds up to tier 2 (CATP-3 asks for trust there), defers at tier 3, fails at tier 4.

        With a person's prior leave in force, tier 4 defers instead.

        Before that: a reading that cannot be believed is a fault and no tier; a violation is refused, and no authority
        lifts it; and a tier above the ceiling is always refused and asks nobody.
        """
        chain = verified_chain(self.id, case)
        if not isinstance(chain, Chain):
            return chain
        impact = case.evidence.impact
        if isinstance(impact, ImpactFault):
            return self._fault(impact)
        base = base_tier(case.evidence)
        match impact:
            case NotCollected() if base is not None and not base <= chain.scope.ceiling:
                # the base tier alone is above the ceiling: no physics was needed to know
                return Fails((self._above(case, chain, base),))
            case NotCollected():
                return missing(self.id, "impact")
            case ImpactReading() | DeclaredImpact():
                return missing(self.id, "tool") if base is None else self._reading(case, chain, impact)
            case _:
                assert_never(impact)

    def _reading(self, case: Case, chain: Chain, impact: ImpactReading | DeclaredImpact) -> Verdict:
        """The verdict on an impact whose base tier is known."""
        tier = runtime_tier(case.evidence, physical=True)
        unseen = impact.perception != FRESH if isinstance(impact, ImpactReading) else not facts_fresh(impact)
        if tier is None or (isinstance(impact, ImpactReading) and not 0 <= impact.index_milli <= 4000):
            return fails(self.id, Reason.PHYSICS_FAULT)
        detail = impact_detail(case, chain, tier)
        refused: list[Finding] = []
        if isinstance(impact, ImpactReading) and impact.violations != ():
            refused.append(found(self.id, Reason.PHYSICS_VIOLATION, **detail))
        if not tier <= chain.scope.ceiling:
            refused.append(self._above(case, chain, tier))
        if refused:
            return Fails(tuple(refused))
        match RULES[tier]:
            case TierRule.AUDIT | TierRule.TRUST:
                return Holds()
            case TierRule.ASK:
                asked = [found(self.id, Reason.TIER_NEEDS_APPROVAL, **detail)]
                if unseen:
                    asked.append(found(self.id, Reason.PERCEPTION_MISSING, **detail))
                return Defers(tuple(asked))
            case TierRule.REFUSE:
                critical = [found(self.id, Reason.TIER_SAFETY_CRITICAL, **detail)]
                if prior_leave(case.evidence) is None:
                    return Fails(tuple(critical))
                if unseen:
                    critical.append(found(self.id, Reason.PERCEPTION_MISSING, **detail))
                return Defers(tuple(critical))
            case rule:
                assert_never(rule)

    def _fault(self, impact: ImpactFault) -> Fails:
        """The refusal for physics that could not be computed or must not be believed."""
        known = {str(reason): reason for reason in IMPACT_FAULTS}
        return fails(self.id, known.get(impact.reason, Reason.PHYSICS_FAULT), said=impact.reason, cause=impact.detail)

    def _above(self, case: Case, chain: Chain, tier: Tier) -> Finding:
        """The finding for a tier above the ceiling, with the hop that set the ceiling."""
        detail = impact_detail(case, chain, tier)
        return found(self.id, Reason.ABOVE_CEILING, **detail, set_by=ceiling_set_by(chain))


RUNNING: Final = 7
"""RTDE robot_mode RUNNING: power is on and the brakes are open."""
NO_CONTROLLER: Final = -1
"""RTDE robot_mode of a controller that is not there, or says nothing."""
UNSTOPPED: Final = frozenset({1, 2})
"""RTDE safety_mode NORMAL and REDUCED; recovery, where a person frees the arm by hand, is none of them."""


@dataclass(frozen=True, slots=True)
class StatePreconditions:
    """TEA-5: the robot is in the state that a command assumes, and this enforcement point commands it alone."""

    id: ClassVar[str] = "TEA-5"

    def judge(self, case: Case) -> Verdict:
        """Holds when every part is known to hold.

        No person is asked: the state of a robot cannot be approved. Every part that does not hold has its finding, an
        unknown one included.
        """
        match case.evidence.robot:
            case NotCollected():
                return missing(self.id, "robot")
            case RobotReading() as robot:
                return self._reading(robot)
            case _:
                assert_never(case.evidence.robot)

    def _reading(self, robot: RobotReading) -> Verdict:
        if robot.robot_mode == NO_CONTROLLER:  # nothing else is known of a controller that says nothing
            return Fails((found(self.id, Reason.ROBOT_NOT_RUNNING, robot_mode=robot.robot_mode),))
        payload: dict[str, object] = {"payload_g": robot.payload_g, "expected_payload_g": robot.expected_payload_g}
        parts: tuple[tuple[bool, Reason, dict[str, object]], ...] = (
            (robot.safety_mode in UNSTOPPED, Reason.ROBOT_SAFETY_STOP, {"safety_mode": robot.safety_mode}),
            (robot.robot_mode == RUNNING, Reason.ROBOT_NOT_RUNNING, {"robot_mode": robot.robot_mode}),
            (robot.remote_control is True, Reason.ROBOT_NOT_REMOTE, {"remote_control": robot.remote_control}),
            (robot.exclusive is True, Reason.ROBOT_NOT_EXCLUSIVE, {}),
            # An unknown expectation is None, and no payload equals it.
            (robot.payload_g == robot.expected_payload_g, Reason.PAYLOAD_MISMATCH, payload),
            (robot.frames_match is True, Reason.FRAMES_MISMATCH, {}),
        )
        wrong = tuple(found(self.id, reason, **detail) for holds, reason, detail in parts if not holds)
        return Fails(wrong) if wrong else Holds()
