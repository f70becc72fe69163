"""A policy is the paper's 7-tuple ⟨Subject, Object, Predicate, EP, Effect, Obligation, PITBound⟩; a set decides.

A PERMIT policy is a requirement: a request that it concerns must satisfy its predicate, or is denied. A DENY (or
DEFER) policy is a prohibition (or a question): it speaks when its predicate holds. An instance that exists is well
formed:

* A check that fails never makes the answer milder. So primitives stand under an even number of `not` in a PERMIT,
  under an odd number in a DENY or DEFER; "forbid it unless the sponsor is fresh" can be written, "permit it when a
  limit is broken" cannot.
* A primitive stands only at enforcement points where it has evidence (policies.primitives.catalog).
* PITBound and TEA-4 come together, TEA-4 under `all` alone: physics is a condition of the PERMIT and no alternative
  goes round it.
* A PERMIT is recorded before its effect.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Final

from capabilities.values.chain import Chain
from policies.decision.combine import Always, Not, Predicate, checks, conjuncts
from policies.evidence.model import Effect, Obligation, ObligationKind, Point, Request
from policies.primitives.catalog import ROWS
from policies.primitives.tools import PhysicalImpactGate
from policies.words import canonical
from policies.words.errors import PolicyError, PolicyFault

if TYPE_CHECKING:
    from capabilities.statements.people.latch import LatchCause
    from capabilities.values.scope import Tier
    from policies.evidence.evidence import Evidence
    from policies.words.parameters import Parameters


class Concern(Enum):
    """Relation of a policy's subject or object to a request."""

    YES = "yes"
    NO = "no"
    UNKNOWN = "unknown"
    """The chain is not verified, so nobody knows who calls."""


@dataclass(frozen=True, slots=True)
class Subject:
    """Subject of a policy: holders by agent id and sponsors by subject; None means any."""

    agents: frozenset[str] | None = None
    sponsors: frozenset[str] | None = None

    def concern(self, evidence: Evidence) -> Concern:
        """Checks that the policy is for the verified holder and sponsor."""
        if self.agents is None and self.sponsors is None:
            return Concern.YES
        chain = evidence.chain
        if not isinstance(chain, Chain):
            return Concern.UNKNOWN
        agent_meant = self.agents is None or chain.leaf.agent in self.agents
        sponsor_meant = self.sponsors is None or chain.sponsor.subject in self.sponsors
        return Concern.YES if agent_meant and sponsor_meant else Concern.NO


@dataclass(frozen=True, slots=True)
class Object:
    """Object of a policy: object ids and operations (None means any), less the operations in `without`."""

    ids: frozenset[str] | None = None
    operations: frozenset[str] | None = None
    without: frozenset[str] = frozenset()

    def concern(self, request: Request) -> Concern:
        """Checks that the policy is for the request's object and operation."""
        object_meant = self.ids is None or request.object in self.ids
        operation_meant = self.operations is None or request.operation in self.operations
        meant = object_meant and operation_meant and request.operation not in self.without
        return Concern.YES if meant else Concern.NO


@dataclass(frozen=True, slots=True)
class Policy:
    """One 7-tuple with an id.

    Attributes:
        id: unique in its set.
        subject, object, predicate: its callers, its acts, and its condition.
        points: EP, the enforcement points at which it decides.
        effect: its answer where the predicate holds.
        obligations: those that come with its effect: acts that make a PERMIT count, or that follow a DENY.
        pit_bound: least tier at which its PERMIT escalates to DEFER, or to DENY at tier 4; None for no physical
            dependency.

    Raises:
        PolicyError: when it is not well formed (see the module).
    """

    id: str
    subject: Subject
    object: Object
    predicate: Predicate
    points: frozenset[Point]
    effect: Effect
    obligations: frozenset[Obligation]
    pit_bound: Tier | None

    def __post_init__(self) -> None:
        if not self.points:
            raise PolicyError(PolicyFault.EMPTY, "ep")
        permits = self.effect is Effect.PERMIT
        if isinstance(self.predicate, Always) and permits:
            raise PolicyError(PolicyFault.LOOSENS, "predicate", "a PERMIT that asks for nothing")
        if not isinstance(self.predicate, Always) and _holds_always(self.predicate):
            raise PolicyError(PolicyFault.LOOSENS, "predicate", "always stands alone")
        for primitive, negated in checks(self.predicate):
            if negated is permits:
                raise PolicyError(PolicyFault.LOOSENS, "predicate", primitive.id)
            if not self.points <= ROWS[primitive.id].points:
                raise PolicyError(PolicyFault.WRONG_POINT, "ep", primitive.id)
        if permits and Obligation(ObligationKind.RECORD) not in self.obligations:
            raise PolicyError(PolicyFault.NO_RECORD, "obligation")
        if any(o.kind in (ObligationKind.CONSUME, ObligationKind.CLAMP) for o in self.obligations):
            raise PolicyError(PolicyFault.UNKNOWN_VALUE, "obligation", "made by a decision alone")
        gated = any(p.id == PhysicalImpactGate.id for p, _ in checks(self.predicate))
        required = permits and any(p.id == PhysicalImpactGate.id for p in conjuncts(self.predicate))
        if (gated and not required) or required is (self.pit_bound is None):
            raise PolicyError(PolicyFault.BOUND_WITHOUT_GATE, "pit_bound")

    def concerns(self, request: Request) -> Concern:
        """Checks that the policy is for the point, object and operation of the request, for any caller."""
        return self.object.concern(request) if self.points & request.points else Concern.NO


def _holds_always(predicate: Predicate) -> bool:
    """True where an `Always` stands anywhere inside."""
    match predicate:
        case Always():
            return True
        case Not(part):
            return _holds_always(part)
        case _:
            return any(_holds_always(part) for part in getattr(predicate, "parts", ()))


@dataclass(frozen=True, slots=True)
class Requirement:
    """Evidence that a gate must collect before it asks for a decision, and the decision's life.

    Attributes:
        physical: whether the physical impact must be computed.
        lease_ms: oldest revocation view that verification may use.
        lifetime_ms: how long after the decision its effect may begin.
    """

    physical: bool
    lease_ms: int
    lifetime_ms: int


@dataclass(frozen=True, slots=True)
class Plan:
    """Policies, evidence and obligations for one operation, for any caller.

    Attributes:
        policies: those that concern it.
        needs: the evidence to collect for it.
        obligations: the obligations of a PERMIT.
    """

    policies: tuple[Policy, ...]
    needs: Requirement
    obligations: frozenset[Obligation]


PLANS: Final = 256
"""Most plans that a set remembers: a cell has a dozen operations, and a stranger may name any."""


@dataclass(frozen=True, slots=True)
class PolicySet:
    """Policies that decide together, with their parameters.

    Attributes:
        name, version: of the set.
        policies: in any order; ids are unique.
        parameters: the set's numbers.
        floor: of a set that extends another one, the policies of that one which it keeps whole; they decide nothing.
        latch: the stops after which a robot waits for a person ([LSD-21]); none of them by default.
        digest: SHA-256 (hex) of all that, the same for every order of policies.
    """

    name: str
    version: int
    policies: tuple[Policy, ...]
    parameters: Parameters
    floor: PolicySet | None = field(default=None, compare=False, repr=False)
    latch: frozenset[LatchCause] = frozenset()
    digest: str = field(init=False, compare=False)
    _plans: dict[tuple[frozenset[Point], str, str], Plan] = field(
        init=False, compare=False, repr=False, default_factory=dict
    )

    def __post_init__(self) -> None:
        ids = [policy.id for policy in self.policies]
        if len(set(ids)) != len(ids):
            raise PolicyError(PolicyFault.DUPLICATE_ID, "policy")
        content = (self.name, self.version, sorted(self.policies, key=lambda policy: policy.id), self.parameters)
        latch = (sorted(map(str, self.latch)),) if self.latch else ()  # without one, the digest of before
        object.__setattr__(self, "digest", canonical.digest("policy-set", (*content, *latch)))

    def plan(self, request: Request) -> Plan:
        """Plan for a request.

        Points, object and operation fix it, so it is made once and remembered.
        """
        about = request.points, request.object, request.operation
        plan = self._plans.get(about)
        if plan is None:
            if len(self._plans) >= PLANS:
                self._plans.clear()
            plan = self._plans[about] = self._planned(request)
        return plan

    def _planned(self, request: Request) -> Plan:
        """The plan for a request. An act that no policy names counts as physical."""
        concerned = tuple(policy for policy in self.policies if policy.concerns(request) is Concern.YES)
        physical = not concerned or any(policy.pit_bound is not None for policy in concerned)
        of, permits = self.parameters, (policy for policy in concerned if policy.effect is Effect.PERMIT)
        return Plan(
            policies=concerned,
            needs=Requirement(
                physical=physical,
                lease_ms=of.lease_motion_ms if physical else of.lease_other_ms,
                lifetime_ms=of.verdict_lifetime_ms if physical else of.verdict_lifetime_other_ms,
            ),
            obligations=frozenset().union(*(policy.obligations for policy in permits)),
        )


def requirement(request: Request, policies: PolicySet) -> Requirement:
    """Evidence that the set needs for an operation, for any caller."""
    return policies.plan(request).needs
