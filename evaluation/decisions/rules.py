"""The rules of a policy set as plain conditions over facts, for engines that know nothing of chains and physics.

A rule says: where its guard holds, each of its clauses must hold, or the answer is its effect. DENY goes before DEFER
before PERMIT. A set that asks for something that has no plain form here is not compiled at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final

from evaluation.decisions.readings import VERIFIED
from policies import Effect, Point, PolicySet
from policies.decision.combine import AllOf, Check, conjuncts
from policies.evidence.conduct_readings import DRIFT, Feature
from policies.primitives import cognition, governance, identity, propagation, sequence, tools
from policies.words.labels import Integrity

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from policies.decision.policy import Policy


class Op(StrEnum):
    """Comparison of a fact with a constant, or with another fact."""

    EQUAL = "=="
    UNEQUAL = "!="
    LESS = "<"
    AT_MOST = "<="
    AT_LEAST = ">="
    ONE_OF = "one of"
    """A text or number is a member of the constant set."""
    WITHIN = "within"
    """Each member of a set is a member of the constant set."""
    HAS = "has"
    """A set has the text of another fact, or a constant text."""
    EMPTY = "empty"


@dataclass(frozen=True, slots=True)
class OtherFact:
    """Other fact that an atom compares with."""

    name: str


Constant = str | int | bool | tuple[str, ...] | tuple[int, ...] | None


@dataclass(frozen=True, slots=True)
class Atom:
    """One comparison."""

    fact: str
    op: Op
    against: Constant | OtherFact = None


Clause = tuple[Atom, ...]
"""Clause: at least one of its atoms holds."""


@dataclass(frozen=True, slots=True)
class Rule:
    """See the module.

    Attributes:
        name: of the policy and the primitive.
        primitive: that answers for it.
        effect: DENY or DEFER.
        guard: all of it holds where the rule is asked.
        holds: the conditions.
    """

    name: str
    primitive: str
    effect: Effect
    guard: Clause
    holds: tuple[Clause, ...]


class NoPlainFormError(Exception):
    """Condition of the policy set that `rules` has no plain form of; the text names it."""


def compiled(policies: PolicySet, points: frozenset[Point]) -> tuple[Rule, ...]:
    """The rules of all policies that decide at `points`.

    Raises:
        NoPlainFormError: see the class.
    """
    return tuple(rule for policy in policies.policies if policy.points & points for rule in _of_policy(policy))


def _of_policy(policy: Policy) -> list[Rule]:
    anybody = policy.subject.agents is policy.subject.sponsors is policy.object.ids is None
    plain = isinstance(policy.predicate, Check | AllOf)
    if not (anybody and plain and policy.effect is Effect.PERMIT):
        raise NoPlainFormError(policy.id)
    guard = _guard(policy)
    rules = []
    for primitive in conjuncts(policy.predicate):
        if type(primitive) not in _PLAIN:
            raise NoPlainFormError(primitive.id)
        denied, asked = _PLAIN[type(primitive)](primitive)
        for effect, holds in ((Effect.DENY, denied), (Effect.DEFER, asked)):
            if holds:
                name = f"{effect.lower()} {policy.id} {primitive.id}"
                rules.append(Rule(name, primitive.id, effect, guard, tuple(holds)))
    if policy.pit_bound is not None:
        bound = (Atom("tier", Op.LESS, int(policy.pit_bound)),)
        rules.append(Rule(f"defer {policy.id} PITBound", tools.PhysicalImpactGate.id, Effect.DEFER, guard, (bound,)))
    return rules


def _guard(policy: Policy) -> Clause:
    """Clause that limits a policy to its points and operations."""
    guard = [Atom("operation", Op.UNEQUAL, name) for name in sorted(policy.object.without)]
    if policy.object.operations is not None:
        guard.append(Atom("operation", Op.ONE_OF, tuple(sorted(policy.object.operations))))
    if not {Point.TOOL, Point.ACTUATION} <= policy.points:
        guard.append(Atom("points", Op.HAS, *map(str, policy.points & {Point.TOOL, Point.ACTUATION})))
    return tuple(guard)


# --- conditions of each primitive, as its class states them: those that deny, and those that ask ---

_CHAIN: Final = (Atom("chain", Op.EQUAL, VERIFIED),)
Parts = tuple[list[Clause], list[Clause]]


def _between(fact: str, low: int, high: int) -> list[Clause]:
    return [(Atom(fact, Op.AT_LEAST, low),), (Atom(fact, Op.AT_MOST, high),)]


def _is(fact: str, value: Constant) -> Clause:
    return (Atom(fact, Op.EQUAL, value),)


def _agent(p: identity.AgentAuthentication) -> Parts:
    recent = _between("leaf_attestation_age_s", -p.skew_s, p.attestation_age_s)
    return [_CHAIN, _is("proof", VERIFIED), *recent], []


def _root(p: identity.HumanRoot) -> Parts:
    lower = [
        (Atom("tier", Op.LESS, tier), Atom("sponsor_age_s", Op.AT_MOST, bound_s))
        for tier, bound_s in (
            (1, p.sponsor_age_tier_1_s),
            (2, p.sponsor_age_tier_2_s),
            (3, p.sponsor_age_tier_3_s),
            (4, p.sponsor_age_tier_4_s),
        )
    ]
    named: list[Clause] = [(Atom("sponsor", Op.UNEQUAL, ""),), (Atom("issuer", Op.UNEQUAL, ""),)]
    return [_CHAIN, *named, *_between("sponsor_age_s", -p.skew_s, p.sponsor_age_tier_0_s), *lower], []


def _links(p: identity.LinkValidity) -> Parts:
    window: list[Clause] = [(Atom("valid_since_s", Op.AT_LEAST, 0),), (Atom("valid_for_s", Op.AT_LEAST, 1),)]
    fresh = [
        (Atom("operation", Op.EQUAL, "read_state"), Atom("view_age_ms", Op.AT_MOST, p.lease_motion_ms)),
        (Atom("view_age_ms", Op.AT_MOST, p.lease_other_ms),),
        (Atom("view_age_ms", Op.AT_LEAST, 0),),
    ]
    return [_CHAIN, *window, *fresh], []


def _bounded(p: identity.BoundedChain) -> Parts:
    audience: Clause = (Atom("audiences", Op.HAS, OtherFact("audience")),)
    life = _between("lifetime_s", 1, p.lifetime_max_s)
    return [_CHAIN, audience, (Atom("delegations", Op.AT_MOST, p.hops_max_count),), *life], []


def _boundary(p: propagation.BoundaryAttestation) -> Parts:
    oldest: Clause = (Atom("oldest_attestation_age_s", Op.AT_MOST, p.attestation_age_s),)
    return [_CHAIN, oldest, (Atom("newest_attestation_age_s", Op.AT_LEAST, -p.skew_s),)], []


def _edge_trust(p: propagation.NonTransitiveTrust) -> Parts:
    weakest: Clause = (Atom("trust_permille", Op.AT_MOST, OtherFact("least_edge_permille")),)
    least = _between("least_edge_permille", 0, p.trust_prior_permille)
    return [_CHAIN, _is("edges_of_chain", value=True), *least, weakest, (Atom("trust_permille", Op.AT_LEAST, 0),)], []


def _trust(p: propagation.DynamicTrust) -> Parts:
    enough = (Atom("trust_permille", Op.AT_LEAST, p.trust_theta_permille), Atom("tier", Op.LESS, 2))
    return _between("trust_permille", 0, 1000), [enough]


def _scope(_: tools.ToolScope) -> Parts:
    after = ("LIMIT_EXCEEDED_BY_REQUEST", "PARAMETERS_WRONG", "none")
    return [_CHAIN, (Atom("request_fault", Op.ONE_OF, after),)], []


def _limits(_: tools.ParameterLimits) -> Parts:
    return [_CHAIN, _is("request_fault", "none"), _is("robot_fault", "none")], []


def _tool(_: tools.ToolIdentity) -> Parts:
    return [
        (Atom("approved_digest", Op.UNEQUAL, ""),),
        (Atom("actual_digest", Op.EQUAL, OtherFact("approved_digest")),),
    ], []


def _gate(_: tools.PhysicalImpactGate) -> Parts:
    computed = [_is("impact", "computed"), *_between("index_milli", 0, 4000), (Atom("violations", Op.EMPTY),)]
    under: Clause = (Atom("tier", Op.AT_MOST, OtherFact("ceiling")),)
    return [_CHAIN, *computed, under, (Atom("tier", Op.LESS, 4),)], [(Atom("tier", Op.LESS, 3),)]


def _sequence(p: sequence.SequenceCoherence) -> Parts:
    free = [_is("unfinished", value=False), _is("held_known", value=True)]
    steady = [
        *_between("drift_urad", 0, p.sequence_drift_urad),
        *_between("alternations", 0, p.alternations_max_count),
    ]
    under: list[Clause] = [
        (Atom("sequence_tier", Op.AT_MOST, OtherFact("ceiling")),),
        (Atom("sequence_tier", Op.LESS, 4),),
    ]
    above: list[Clause] = [(Atom("tier", Op.AT_MOST, OtherFact("ceiling")),), (Atom("tier", Op.LESS, 4),)]
    asked: list[Clause] = [(Atom("sequence_tier", Op.LESS, 3),), (Atom("tier", Op.LESS, 3),)]
    return [_CHAIN, *free, *steady, *under, *above], asked


def _readiness(_: tools.StatePreconditions) -> Parts:
    unstopped = tuple(sorted(tools.UNSTOPPED))
    modes: list[Clause] = [(Atom("safety_mode", Op.ONE_OF, unstopped),), _is("robot_mode", tools.RUNNING)]
    flags = [_is(name, value=True) for name in ("remote_control", "exclusive", "frames_match")]
    return [*modes, *flags, (Atom("payload_g", Op.EQUAL, OtherFact("expected_payload_g")),)], []


def _sensors(_: cognition.SensorProvenance) -> Parts:
    believed: Clause = (Atom("sensors", Op.WITHIN, tuple(sorted(cognition.BELIEVED))),)
    rests = (Atom("perception", Op.UNEQUAL, "fresh"), Atom("sensors", Op.WITHIN, ("fresh",)))
    return [believed, rests], []


def _content(p: cognition.ProvenanceOfContent) -> Parts:
    every = sorted(integrity.name for integrity in Integrity)
    tiers = {"NONE": p.unvouched_max_tier, "AGENT": p.agent_max_tier}
    tiers |= {"RECORDED": p.recorded_max_tier, "CURATED": p.recorded_max_tier}
    clauses: list[Clause] = [_is("unnamed_arguments", 0)]
    for bound in sorted(set(tiers.values()) - {4}):
        believed = tuple(name for name in every if tiers.get(name, 4) > bound)
        clauses.append((Atom("tier", Op.AT_MOST, bound), Atom("integrities", Op.WITHIN, believed)))
    return clauses, []


_KNOWN: Final = (Atom("behaviour_of", Op.EQUAL, OtherFact("agent")),)


def _known(age_ms: int) -> list[Clause]:
    return [_CHAIN, _KNOWN, *_between("behaviour_age_ms", 0, age_ms)]


_DRIFT: Final = tuple(sorted(map(str, DRIFT)))
_USAGE: Final = tuple(sorted(map(str, set(Feature) - DRIFT)))

_PLAIN: Final[Mapping[type, Callable[[Any], Parts]]] = {
    identity.AgentAuthentication: _agent,
    identity.HumanRoot: _root,
    identity.LinkValidity: _links,
    identity.NoScopeEscalation: lambda _: ([_CHAIN], []),
    identity.BoundedChain: _bounded,
    propagation.NonTransitiveTrust: _edge_trust,
    propagation.ScopeNarrowing: lambda _: ([_CHAIN], []),
    propagation.DynamicTrust: _trust,
    propagation.BoundaryAttestation: _boundary,
    tools.ToolScope: _scope,
    tools.ParameterLimits: _limits,
    tools.ToolIdentity: _tool,
    tools.PhysicalImpactGate: _gate,
    tools.StatePreconditions: _readiness,
    sequence.SequenceCoherence: _sequence,
    cognition.SensorProvenance: _sensors,
    cognition.ProvenanceOfContent: _content,
    governance.BehaviouralBaseline: lambda p: (
        _known(p.behaviour_age_ms),
        [(Atom("deviations", Op.WITHIN, _DRIFT),)],
    ),
    governance.DriftContainment: lambda p: (
        [*_known(p.behaviour_age_ms), (Atom("deviations", Op.WITHIN, _USAGE),)],
        [],
    ),
    governance.Reverification: lambda p: (
        [*_known(p.behaviour_age_ms), (Atom("leaf_attestation_age_s", Op.LESS, OtherFact("deviated_ago_s")),)],
        [],
    ),
    governance.ScopeContraction: lambda p: (
        [
            *_known(p.behaviour_age_ms),
            (*_is("contracted", value=False), Atom("tier", Op.AT_MOST, p.contracted_max_tier)),
        ],
        [],
    ),
}
"""Conditions of each class: denied where they do not hold, asked where they do not."""
