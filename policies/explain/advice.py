"""Warnings about a set that loads but is probably not meant so: pure, each with its code and its place.

A warning never says that a set is unsafe, and no warning never says that it is safe: `ztpm policy prove` says which
claims follow from a set. Warnings are for its author, before that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

from policies.decision.combine import Always, checks
from policies.evidence.model import Effect, Point
from policies.primitives.catalog import CATALOG, ROWS
from policies.primitives.propagation import DynamicTrust
from policies.words.parameters import GATE_PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from policies.decision.policy import Object, Policy, PolicySet, Subject


class AdviceCode(StrEnum):
    """Subject of a warning."""

    CONCERNS_NOTHING = "CONCERNS_NOTHING"
    """A policy that never speaks: its operations are excepted again, or never asked for at its points."""
    SHADOWED = "SHADOWED"
    """A prohibition that asks for nothing covers everything that the policy concerns."""
    REPEATED = "REPEATED"
    """Another policy says exactly the same."""
    MOTION_UNGATED = "MOTION_UNGATED"
    """The set permits an operation that moves something, and no policy makes that depend on its physical impact."""
    NEVER_PERMITTED = "NEVER_PERMITTED"
    """No policy permits an operation of the cell: any request for it is denied with NO_POLICY."""
    OPERATION_UNKNOWN = "OPERATION_UNKNOWN"
    """The set names an operation that the cell does not have."""
    OBJECT_UNKNOWN = "OBJECT_UNKNOWN"
    """The set names an object that the cell does not have."""
    AGENT_UNKNOWN = "AGENT_UNKNOWN"
    """The set names an agent that the registry does not have, or that has ended."""
    SPONSOR_UNKNOWN = "SPONSOR_UNKNOWN"
    """The set names a sponsor of no agent of the registry."""
    TOOL_UNREGISTERED = "TOOL_UNREGISTERED"
    """No registered tool has a declared operation: its server does not start."""
    SENSOR_UNREGISTERED = "SENSOR_UNREGISTERED"
    """A row depends on a sensor that is not registered: it is always at least tier 3."""
    TRUST_OUT_OF_REACH = "TRUST_OUT_OF_REACH"
    """The set wants more trust than it ever gives: people are asked about every act from tier 2 on."""
    PARAMETER_UNUSED = "PARAMETER_UNUSED"
    """The set states a parameter, and no primitive of the set takes its value."""
    PRIMITIVE_NOT_ASKED = "PRIMITIVE_NOT_ASKED"
    """No policy asks one of the 25 primitives."""


@dataclass(frozen=True, slots=True)
class Advice:
    """One warning.

    Attributes:
        code: its subject.
        where: the policy's id, "parameters.NAME", or the id of a primitive or operation.
        sentence: for the author.
    """

    code: AdviceCode
    where: str
    sentence: str


@dataclass(frozen=True, slots=True)
class Known:
    """Operation that a cell has.

    Attributes:
        object: id of its object; "" for any that a token names.
        operation: its name.
        points: the enforcement points at which it is asked for.
        moves: it moves, switches or changes something.
        sensors: ids of sensors on whose facts its tier depends.
        tool: it is that of a tool which a person registers.
    """

    object: str
    operation: str
    points: frozenset[Point]
    moves: bool = False
    sensors: frozenset[str] = frozenset()
    tool: bool = False


@dataclass(frozen=True, slots=True)
class Registered:
    """Ids of the agents that may act, and of their sponsors; operations of tools, and sensors, None for unasked."""

    agents: frozenset[str]
    sponsors: frozenset[str]
    tools: frozenset[str] | None = None
    sensors: frozenset[str] | None = None


def advise(
    policies: PolicySet, *, stated: Collection[str], known: Collection[Known], registered: Registered | None = None
) -> tuple[Advice, ...]:
    """Warnings about the set, in the order of its policies, then about the set as a whole.

    Args:
        policies: the set.
        stated: names of the parameters that its text states; the others are defaults.
        known: every operation of the cell; empty when nothing is known of it.
        registered: parties of the cell's registry; None when it was not asked.
    """
    return (
        *_of_policies(policies),
        *misnamed(policies, known=known, registered=registered),
        *_operations(policies, known),
        *_trust(policies),
        *_parameters(policies, stated),
        *_primitives(policies),
    )


def misnamed(
    policies: PolicySet, *, known: Collection[Known], registered: Registered | None = None
) -> tuple[Advice, ...]:
    """Warnings about names of the set, and of the operations, that nothing has or nobody registered.

    Args:
        policies: the set.
        known: every operation of the cell; empty when nothing is known of it.
        registered: parties of the cell's registry; None when it was not asked.
    """
    return (
        *_names(policies, known, registered.agents if registered else frozenset()),
        *(() if registered is None else _parties(policies, registered)),
        *(() if registered is None else _unregistered(known, registered)),
    )


def _of_policies(policies: PolicySet) -> Iterator[Advice]:
    forbidding = [p for p in policies.policies if p.effect is Effect.DENY and isinstance(p.predicate, Always)]
    for place, policy in enumerate(policies.policies):
        thing = policy.object
        if thing.operations is not None and thing.operations <= thing.without:
            yield Advice(AdviceCode.CONCERNS_NOTHING, policy.id, "every operation that it names is excepted again")
            continue
        for other in forbidding:
            if other is not policy and _covers(other, policy):
                yield Advice(AdviceCode.SHADOWED, policy.id, f"whatever it says, {other.id} forbids it")
        for earlier in policies.policies[:place]:
            if _same(earlier, policy):
                yield Advice(AdviceCode.REPEATED, policy.id, f"{earlier.id} says exactly this")


def _same(one: Policy, other: Policy) -> bool:
    return replace(one, id=other.id) == other


def _covers(one: Policy, other: Policy) -> bool:
    """True where `one` concerns every request and caller that `other` concerns."""
    return (
        other.points <= one.points
        and _covers_subject(one.subject, other.subject)
        and _covers_object(one.object, other.object)
    )


def _covers_subject(one: Subject, other: Subject) -> bool:
    return _includes(one.agents, other.agents) and _includes(one.sponsors, other.sponsors)


def _covers_object(one: Object, other: Object) -> bool:
    if not _includes(one.ids, other.ids):
        return False
    if other.operations is None:
        return one.operations is None and one.without <= other.without
    asked = other.operations - other.without
    return _includes(one.operations, asked) and not asked & one.without


def _includes(one: frozenset[str] | None, other: frozenset[str] | None) -> bool:
    return one is None or (other is not None and other <= one)


def _names(policies: PolicySet, known: Collection[Known], delegates: frozenset[str]) -> Iterator[Advice]:
    """Names in the set that nothing in the cell has, and policies that no request meets.

    The object of a delegation is the delegate.
    """
    objects, operations = {k.object for k in known}, {k.operation for k in known}
    if not known:
        return
    for policy in policies.policies:
        thing = policy.object
        unknown = (thing.ids or frozenset()) - objects - (delegates if Point.AGENT in policy.points else frozenset())
        for name in sorted(unknown):
            yield Advice(AdviceCode.OBJECT_UNKNOWN, policy.id, f"no object is called {name!r}")
        strange = ((thing.operations or frozenset()) | thing.without) - operations
        for name in sorted(strange):
            yield Advice(AdviceCode.OPERATION_UNKNOWN, policy.id, f"no operation is called {name!r}")
        excepted = thing.operations is not None and thing.operations <= thing.without
        # A requirement of everything at a point where nothing of the cell is asked for permits nothing there.
        idle = policy.effect is Effect.PERMIT and thing.ids is None and thing.operations is None
        if not (unknown or strange or excepted or idle or any(_meant(policy, each) for each in known)):
            sentence = "nothing that it names is ever asked for at its enforcement points"
            yield Advice(AdviceCode.CONCERNS_NOTHING, policy.id, sentence)


def _parties(policies: PolicySet, registered: Registered) -> Iterator[Advice]:
    """Agents and sponsors in the set that the registry does not have."""
    for policy in policies.policies:
        for name in sorted((policy.subject.agents or frozenset()) - registered.agents):
            yield Advice(AdviceCode.AGENT_UNKNOWN, policy.id, f"no agent that may act is called {name!r}")
        for name in sorted((policy.subject.sponsors or frozenset()) - registered.sponsors):
            yield Advice(AdviceCode.SPONSOR_UNKNOWN, policy.id, f"no agent has a sponsor called {name!r}")


def _unregistered(known: Collection[Known], registered: Registered) -> Iterator[Advice]:
    """Operations and sensors that a declaration names and the registry does not."""
    for each in sorted(known, key=lambda k: (k.object, k.operation)):
        where = f"{each.object}/{each.operation}"
        if each.tool and registered.tools is not None and each.operation not in registered.tools:
            yield Advice(AdviceCode.TOOL_UNREGISTERED, where, "no registered tool has this operation")
        if registered.sensors is not None:
            for name in sorted(each.sensors - registered.sensors):
                yield Advice(AdviceCode.SENSOR_UNREGISTERED, where, f"no sensor is called {name!r}: at least tier 3")


def _operations(policies: PolicySet, known: Collection[Known]) -> Iterator[Advice]:
    """Warnings about each operation of the cell that the set never permits, or permits without asking physics."""
    for each in sorted(known, key=lambda k: (k.object, k.operation)):
        concerned = [p for p in policies.policies if _meant(p, each)]
        permits = [p for p in concerned if p.effect is Effect.PERMIT]
        where = f"{each.object or 'any'}/{each.operation}"
        if not permits:
            yield Advice(AdviceCode.NEVER_PERMITTED, where, "no policy permits it: it is always denied with NO_POLICY")
        elif each.moves and all(p.pit_bound is None for p in concerned):
            yield Advice(
                AdviceCode.MOTION_UNGATED,
                where,
                "it moves or changes something, and no policy asks TEA-4 for its impact",
            )


def _meant(policy: Policy, known: Known) -> bool:
    thing = policy.object
    return (
        bool(policy.points & known.points)
        and (thing.ids is None or not known.object or known.object in thing.ids)
        and (thing.operations is None or known.operation in thing.operations)
        and known.operation not in thing.without
    )


def _trust(policies: PolicySet) -> Iterator[Advice]:
    """Warnings about policies whose least trust is above the most that any edge has."""
    prior = policies.parameters.trust_prior_permille
    for policy in policies.policies:
        for primitive, _ in checks(policy.predicate):
            if isinstance(primitive, DynamicTrust) and primitive.trust_theta_permille > prior:
                told = f"it wants {primitive.trust_theta_permille} permille, and nobody is given more than {prior}"
                yield Advice(AdviceCode.TRUST_OUT_OF_REACH, policy.id, told)


def _parameters(policies: PolicySet, stated: Collection[str]) -> Iterator[Advice]:
    """Parameters that the text states for nobody."""
    of_primitives = {p.name for row in CATALOG for p in row.parameters} - GATE_PARAMETERS
    taken = {
        (parameter.name, getattr(primitive, parameter.name))
        for policy in policies.policies
        for primitive, _ in checks(policy.predicate)
        for parameter in ROWS[primitive.id].parameters
    }
    for name in sorted(set(stated) & of_primitives):
        if name not in {taker for taker, _ in taken}:
            sentence = "no primitive of the set has this parameter"
        elif (name, getattr(policies.parameters, name)) not in taken:
            sentence = "wherever it is asked for, a policy states another value"
        else:
            continue
        yield Advice(AdviceCode.PARAMETER_UNUSED, f"parameters.{name}", sentence)


def _primitives(policies: PolicySet) -> Iterator[Advice]:
    """Primitives that nobody asks."""
    asked = {primitive.id for policy in policies.policies for primitive, _ in checks(policy.predicate)}
    for row in CATALOG:
        if row.id not in asked:
            points = " ".join(sorted(str(point) for point in row.points))
            yield Advice(
                AdviceCode.PRIMITIVE_NOT_ASKED, row.id, f"{row.name} is never asked (it has evidence at {points})"
            )
