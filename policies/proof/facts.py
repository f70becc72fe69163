"""Facts that a decision depends on: every request with its evidence, reduced to some fifty of them.

A fact is a truth or a number. Two cases with the same facts get the same effect from a policy set whose primitives are
all known here (policies.proof.verdicts); the verdict of an unknown primitive is a fact of its own. So a formula over
facts speaks about every request and evidence, and not only about those that a test names. The facts of a real case
are read off by `policies.proof.case_facts`, and `policies.proof.concrete_cases` makes a real case of facts.

Names count only by whether the set mentions them, so each is a number: its place in `Names`, or the place after the
last for a name that the set never mentions.
"""
# ruff: noqa: RUF009 - a field that a function makes is still a field

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Final

from capabilities.values.scope import Tier

if TYPE_CHECKING:
    from collections.abc import Mapping

    from policies.decision.policy import PolicySet
    from policies.evidence.model import Point
    from policies.primitives.base import Primitive
    from policies.proof.logic import Number, Truth


NO_APPROVAL: Final = 0
OPEN: Final = 1
DENIED: Final = 2
USED: Final = 3
GRANTED: Final = 4
ANOTHER_STATE: Final = 5
STATES: Final = ("none", "open", "denied", "used", "granted", "withdrawn")
"""Answers of people, by the numbers above; the last stands for every other word."""


def _truth(says: str, *, ordinary: bool = True) -> Any:
    return field(metadata={"says": says, "ordinary": ordinary})


def _number(says: str, ordinary: int, low: int | None = None, high: int | None = None, *, real: bool = False) -> Any:
    return field(metadata={"says": says, "ordinary": ordinary, "low": low, "high": high, "real": real})


def _tier(says: str, ordinary: int) -> Any:
    return _number(says, ordinary, min(Tier), max(Tier))


@dataclass(frozen=True, slots=True)
class Facts:
    """Facts of one case.

    Each field is a truth or a number; its metadata has its sentence and its ordinary value.
    """

    object: Number = _number("object", 0, 0)
    operation: Number = _number("operation", 0, 0)
    agent: Number = _number("agent", 0, 0)
    sponsor: Number = _number("sponsor", 0, 0)
    e1: Truth = _truth("the request stands for e1", ordinary=False)
    e2: Truth = _truth("the request stands for e2", ordinary=False)
    e3: Truth = _truth("the request stands for e3", ordinary=False)
    e4: Truth = _truth("the request stands for e4")
    e5: Truth = _truth("the request stands for e5")

    well_formed: Truth = _truth("request and evidence are of the shape that they declare")
    chain_verified: Truth = _truth("the chain is verified")
    sponsor_named: Truth = _truth("the chain names its sponsor and who authenticated them")
    sponsor_age_s: Number = _number("age of the sponsor's authentication, s", 300, real=True)
    leaf_age_s: Number = _number("age of the holder's attestation, s", 60, real=True)
    oldest_age_s: Number = _number("age of the oldest attestation in the chain, s", 60, real=True)
    youngest_age_s: Number = _number("age of the youngest attestation in the chain, s", 60, real=True)
    begun: Truth = _truth("the token's window has begun")
    unexpired: Truth = _truth("the token's window has not ended")
    lifetime_s: Number = _number("length of the token's window, s", 3_600)
    delegations: Number = _number("delegations in the chain", 1, 0)
    view_age_ms: Number = _number("age of the revocation view, ms", 100)
    ceiling: Number = _tier("the token's ceiling", 4)
    audience_meant: Truth = _truth("the token is for this audience")
    proof_valid: Truth = _truth("the holder proved possession of the key")
    request_free: Truth = _truth("the scope says nothing against the request")
    after_the_grant: Truth = _truth("the scope grants the operation but refuses a parameter", ordinary=False)
    robot_free: Truth = _truth("the robot's own limits say nothing against the request")

    tool_pinned: Truth = _truth("the tool is the approved one")
    base_known: Truth = _truth("the tool's base tier is registered")
    base_tier: Number = _tier("the tool's base tier", 1)
    trust_known: Truth = _truth("trust in the chain was read")
    trust_permille: Number = _number("trust in the chain, permille", 800)

    impact_read: Truth = _truth("the physical impact was computed")
    impact_fault: Truth = _truth("physics says that it cannot be believed", ordinary=False)
    impact_tier: Number = _tier("the computed tier", 1)
    index_valid: Truth = _truth("the computed index is one")
    violated: Truth = _truth("physics found a violation", ordinary=False)
    seen_fresh: Truth = _truth("the impact was computed on a fresh view of the world")
    slow: Truth = _truth("the tool centre point is within the speed that people may approve")
    soft: Truth = _truth("every contact is within what people may approve")
    view_known: Truth = _truth("where the view of the world comes from was read")
    view_invalid: Truth = _truth("a sensor's frame must not be believed", ordinary=False)
    view_late: Truth = _truth("not every sensor is fresh, or there is none", ordinary=False)
    robot_known: Truth = _truth("the robot's readiness was read")
    robot_ready: Truth = _truth("the robot is in the state that the command assumes")

    approval: Number = _number("what people said", NO_APPROVAL, NO_APPROVAL, ANOTHER_STATE)
    approval_tier: Number = _tier("the tier that people approved", 3)
    approval_same_sponsor: Truth = _truth("the approval is for this sponsor's chain")
    approval_same_policies: Truth = _truth("the approval is for this policy set")
    approval_lists_all: Truth = _truth("the approval lists every reason that defers")
    approval_same_impact: Truth = _truth("model, index, start and contributors are those that were shown")
    approval_sees_clear: Truth = _truth("every approver saw the cell clear")
    approvers: Number = _number("different people who approved", 2, 0)
    approval_uses_left: Truth = _truth("a use of the approval is left")
    approval_in_time: Truth = _truth("the approval is not over")
    approval_recent: Truth = _truth("the newest word about the approval is recent")
    opening_in_force: Truth = _truth("a person's prior leave is in force", ordinary=False)
    opening_its_own: Truth = _truth("the approval rests on that leave", ordinary=False)
    opening_recent: Truth = _truth("the newest word about the leave is recent")

    unknown: Mapping[Primitive, PrimitiveVerdict] = field(default_factory=dict)
    """Verdict of each primitive that is not modelled here."""

    def stands_for(self, point: Point) -> Truth:
        """True where the request stands for the enforcement point."""
        truth: Truth = getattr(self, str(point))
        return truth


@dataclass(frozen=True, slots=True)
class PrimitiveVerdict:
    """Verdict of a primitive or a predicate; neither `holds` nor `fails` is a deferral.

    Attributes:
        holds, fails: never both.
        raises: it does not answer at all.
    """

    holds: Truth
    fails: Truth
    raises: Truth = False


FACTS: Final = tuple(f for f in fields(Facts) if "says" in f.metadata)
"""Every fact but those of unknown primitives."""
NAMES_OF: Final = ("object", "operation", "agent", "sponsor")
"""The facts that are names."""


@dataclass(frozen=True, slots=True)
class Names:
    """The names that a set mentions, sorted; every other name is the same to it.

    Attributes:
        object, operation, agent, sponsor: names of that kind, and one last that the set does not mention.
        named_operations: how many of the operations the set itself mentions, those first.
    """

    object: tuple[str, ...]
    operation: tuple[str, ...]
    agent: tuple[str, ...]
    sponsor: tuple[str, ...]
    named_operations: int

    def of(self, kind: str) -> tuple[str, ...]:
        """The names of a kind in `NAMES_OF`."""
        names: tuple[str, ...] = getattr(self, kind)
        return names

    def place(self, kind: str, name: str) -> int:
        """Place of a name; every name that is not mentioned stands last."""
        names = self.of(kind)
        return names.index(name) if name in names[:-1] else len(names) - 1

    def places(self, kind: str, members: frozenset[str]) -> tuple[int, ...]:
        """Places of the members."""
        return tuple(self.place(kind, member) for member in sorted(members))


def names_of(policies: PolicySet, harmless: frozenset[str]) -> Names:
    """The names that matter to a set and its floor, together with the operations that are called harmless."""
    objects: set[str] = set()
    operations: set[str] = set()
    agents: set[str] = set()
    sponsors: set[str] = set()
    for policy in policies.policies:
        objects |= policy.object.ids or frozenset()
        operations |= (policy.object.operations or frozenset()) | policy.object.without
        agents |= policy.subject.agents or frozenset()
        sponsors |= policy.subject.sponsors or frozenset()
    others = set(harmless)
    for policy in policies.floor.policies if policies.floor else ():
        objects |= policy.object.ids or frozenset()
        others |= (policy.object.operations or frozenset()) | policy.object.without
        agents |= policy.subject.agents or frozenset()
        sponsors |= policy.subject.sponsors or frozenset()
    return Names(
        (*sorted(objects), _unlike("another-object", objects)),
        (*sorted(operations), *sorted(others - operations), _unlike("unnamed-operation", operations | others)),
        (*sorted(agents), _unlike("another-agent", agents)),
        (*sorted(sponsors), _unlike("another-person", sponsors)),
        len(operations),
    )


def _unlike(name: str, taken: set[str] | frozenset[str]) -> str:
    """A name that is not taken."""
    while name in taken:
        name += "-"
    return name
