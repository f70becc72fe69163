"""Timed cases, and each with one condition broken alone.

The engines must agree on all of them before anything is timed.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from evaluation.decisions.facts import OF_READING, Situation, situation
from policies import ROWS, Effect, Point, PolicySet
from policies.decision.combine import checks

if TYPE_CHECKING:
    from collections.abc import Mapping

    from evaluation.decisions.readings import Fact

POINTS: Final = frozenset({Point.TOOL, Point.ACTUATION})
"""One gate run stands for both."""


@dataclass(frozen=True, slots=True)
class Case:
    """Case that is timed.

    Attributes:
        name: as the rows spell it.
        effect: the answer.
        changes: of the ordinary facts.
        bare: nothing but chain, proof and tool was collected.
    """

    name: str
    effect: Effect
    changes: Mapping[str, Fact]
    bare: bool = False

    def situation(self, policies: PolicySet, changes: Mapping[str, Fact] = MappingProxyType({})) -> Situation:
        """The case with further changes."""
        return situation({**self.changes, **changes}, frozenset() if self.bare else readings(policies))


PERMIT: Final = Case("move", Effect.PERMIT, {})
STOP: Final = Case("stop", Effect.PERMIT, {"operation": "stop"}, bare=True)
CASES: Final = (
    PERMIT,
    Case("move over a limit", Effect.DENY, {"request_fault": "LIMIT_EXCEEDED_BY_REQUEST"}),
    Case("move of tier 3", Effect.DEFER, {"impact_tier": 3, "index_milli": 2_500}),
    STOP,
)


def readings(policies: PolicySet) -> frozenset[str]:
    """The readings that a policy of the set looks at where tools are called and things move."""
    asked = (policy for policy in policies.policies if policy.points & POINTS)
    named = {name for policy in asked for p, _ in checks(policy.predicate) for name in ROWS[p.id].evidence}
    return frozenset(named & OF_READING.keys())


BROKEN: Final[Mapping[str, Mapping[str, Fact]]] = MappingProxyType(
    {
        "the token has expired": {"chain": "EXPIRED"},
        "a signature is not valid": {"chain": "SIGNATURE_INVALID"},
        "a hop is not narrower": {"chain": "NOT_NARROWER"},
        "the proof was used before": {"proof": "REPLAYED"},
        "the leaf was attested too long ago": {"leaf_attestation_age_s": 3_601},
        "the leaf was attested more than a day ago": {"leaf_attestation_age_s": 86_401},
        "the leaf is attested in the future": {"leaf_attestation_age_s": -6},
        "a hop was attested too long ago": {"oldest_attestation_age_s": 3_601},
        "a hop is attested in the future": {"oldest_attestation_age_s": -6},
        "no sponsor": {"sponsor": ""},
        "no issuer": {"issuer": ""},
        "the sponsor logged in too long ago": {"sponsor_age_s": 86_401},
        "the sponsor logged in before any mandate": {"sponsor_age_s": 604_801},
        "the sponsor logs in in the future": {"sponsor_age_s": -6},
        "too long ago for tier 2": {"sponsor_age_s": 28_801, "impact_tier": 2},
        "too long ago for tier 3": {"sponsor_age_s": 3_601, "impact_tier": 3},
        "too long ago for tier 4": {"sponsor_age_s": 901, "impact_tier": 4, "ceiling": 4},
        "not valid yet": {"valid_since_s": -1},
        "not valid any more": {"valid_for_s": 0},
        "an old view of revocations": {"view_age_ms": 2_001},
        "a very old view of revocations": {"view_age_ms": 30_001},
        "a view of revocations from the future": {"view_age_ms": -1},
        "for another server": {"audience": "http://127.0.0.1:9001/mcp"},
        "too many hops": {"delegations": 9},
        "it lives too long": {"valid_since_s": 86_401},
        "no lifetime": {"valid_since_s": -1, "valid_for_s": 1},
        "the operation is not granted": {"request_fault": "NOT_GRANTED"},
        "another parameter": {"request_fault": "PARAMETERS_WRONG"},
        "over a limit": {"request_fault": "LIMIT_EXCEEDED_BY_REQUEST"},
        "over the robot's limit": {"robot_fault": "LIMIT_EXCEEDED_BY_REQUEST"},
        "the tool is not registered": {"approved_digest": ""},
        "the tool was changed": {"actual_digest": "5a" * 32},
        "a tool above the ceiling": {"base_tier": 4},
        "a tool of tier 3": {"base_tier": 3},
        "too little trust": {"trust_permille": 699, "impact_tier": 2},
        "less than no trust": {"trust_permille": -1},
        "more than all trust": {"trust_permille": 1_001},
        "more trust than its weakest edge": {"least_edge_permille": 700},
        "an edge above the prior": {"least_edge_permille": 801},
        "an edge below nothing": {"least_edge_permille": -1, "trust_permille": -1},
        "trust in another chain's edges": {"edges_of_chain": False},
        "no physics": {"impact": "PHYSICS_FAULT"},
        "tier 3": {"impact_tier": 3},
        "tier 3 above the ceiling": {"impact_tier": 3, "ceiling": 2},
        "tier 4": {"impact_tier": 4, "ceiling": 4},
        "an index below nothing": {"index_milli": -1},
        "an index above everything": {"index_milli": 4_001},
        "a violation": {"violations": frozenset({"zone"})},
        "an unseen cell": {"perception": "stale", "sensors": frozenset({"stale"})},
        "a frame that must not be believed": {"sensors": frozenset({"fresh", "invalid"})},
        "a view called fresh without sensors that are": {"sensors": frozenset({"fresh", "stale"})},
        "the robot is not running": {"robot_mode": 5},
        "the robot is stopped": {"safety_mode": 3},
        "the robot is not remote": {"remote_control": False},
        "somebody else commands": {"exclusive": False},
        "another payload": {"payload_g": 1_201},
        "other frames": {"frames_match": False},
        "an unfinished motion": {"unfinished": True},
        "nobody knows what is held": {"held_known": False},
        "the arm is elsewhere": {"drift_urad": 20_001},
        "a drift below nothing": {"drift_urad": -1},
        "acts that undo each other": {"alternations": 7},
        "fewer than no alternations": {"alternations": -1},
        "a sequence of tier 3": {"sequence_tier": 3},
        "a sequence above the ceiling": {"sequence_tier": 3, "ceiling": 2},
        "a sequence of tier 4": {"sequence_tier": 4, "ceiling": 4},
        "word of another agent": {"behaviour_of": "agent-0"},
        "old word of its behaviour": {"behaviour_age_ms": 5_001},
        "word from the future": {"behaviour_age_ms": -1},
        "an unusual rate": {"deviations": frozenset({"rate"})},
        "an escalation": {"deviations": frozenset({"escalation"})},
        "it deviated after it was attested": {"deviated_ago_s": 30},
        "a contracted agent": {"contracted": True},
        "an argument of unknown origin": {"unnamed_arguments": 1},
        "an argument that nobody vouches for": {"integrities": frozenset({"NONE", "AGENT"})},
        "a recorded argument at tier 3": {"integrities": frozenset({"RECORDED", "AGENT"}), "impact_tier": 3},
    }
)
"""Changes of the permitted move, each for one condition. A fact that the set does not look at changes nothing."""

BROKEN_STOP: Final = (
    "the token has expired",
    "the proof was used before",
    "the leaf was attested more than a day ago",
    "the leaf is attested in the future",
)
"""Broken conditions that concern a stop, too."""
