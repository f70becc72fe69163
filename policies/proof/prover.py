"""Prover of the claims about one set: each holds for all requests and evidence, or a confirmed case breaks it.

A counterexample is reported only after the real `decide` has answered it and the answers break the claim in the words
of the readings (policies.proof.confirmation). One that does not is reported as a fault of the prover.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Final

from policies.decision.combine import Always, Check, Not
from policies.decision.pdp import decide
from policies.decision.policy import Object, Policy, PolicySet, Subject, requirement
from policies.evidence.model import Effect, Obligation, ObligationKind, Point
from policies.evidence.tiers import runtime_tier
from policies.primitives.base import Case
from policies.primitives.propagation import DynamicTrust
from policies.proof.case_facts import what_it_says
from policies.proof.claims import Question, claims_of
from policies.proof.concrete_cases import case_of
from policies.proof.confirmation import DecidedCase
from policies.proof.facts import FACTS, NAMES_OF, STATES, Facts, names_of
from policies.proof.verdicts import unknowns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from policies.primitives.base import Primitive
    from policies.proof.claims import Claim
    from policies.proof.facts import Names, PrimitiveVerdict
    from policies.proof.search import Found, Search

HARMLESS: Final = frozenset({"read_state", "stop"})
"""The operations that move nothing in a cell of ours; every other one is taken to move something."""
ROUNDS: Final = 16
"""Most searches for one case.

A case is looked for anew when an unknown primitive's real verdict is not the one that the solver assumed.
"""


class Standing(StrEnum):
    """Standing of a claim."""

    PROVEN = "proven"
    BROKEN = "counterexample"
    FAULT = "fault of the prover"
    """The solver has a case, and `decide` does not confirm it: the formulas and the code say different things."""
    UNDECIDED = "undecided"
    """The solver gave no answer."""
    SKIPPED = "skipped"
    """z3 is not installed."""


@dataclass(frozen=True, slots=True)
class CounterexampleCase:
    """One real case of a counterexample.

    Attributes:
        told: the request, the evidence, the set, and the decision of `decide`.
        departures: facts that are not ordinary, or not as in the case before; each with its value.
    """

    told: DecidedCase
    departures: tuple[tuple[str, object], ...]


@dataclass(frozen=True, slots=True)
class Result:
    """Standing of one claim about a set.

    Attributes:
        claim: the judged one.
        standing: see there.
        seconds: that it took.
        counterexample: the real cases that break the claim, or of a fault those that should have; else none.
        about_nothing: the set permits nothing of which the claim speaks, so it holds of nothing.
        assumed: ids of primitives of which something is taken for granted: that they do not soften with the tier (P5),
            or with stricter numbers (P8).
    """

    claim: Claim
    standing: Standing
    seconds: float
    counterexample: tuple[CounterexampleCase, ...] = ()
    about_nothing: bool = False
    assumed: tuple[str, ...] = ()


def prove(
    policies: PolicySet, *, harmless: frozenset[str] = HARMLESS, clock: Callable[[], float]
) -> tuple[Result, ...]:
    """Standing of each claim for `policies`.

    Args:
        policies: the set.
        harmless: operations that move nothing, in any set.
        clock: seconds, for the times that are told.
    """
    if importlib.util.find_spec("z3") is None:
        return tuple(Result(claim, Standing.SKIPPED, 0.0) for claim in claims_of(policies))
    return tuple(prove_one(claim, policies, harmless=harmless, clock=clock) for claim in claims_of(policies))


def prove_one(claim: Claim, policies: PolicySet, *, harmless: frozenset[str], clock: Callable[[], float]) -> Result:
    """Standing of one claim. Needs z3."""
    from policies.proof import search, symbols

    began = clock()
    question = Question(policies, harmless, names_of(policies, harmless), symbols.SYMBOLIC)
    cases, known = search.any_cases(claim, question)
    decided = search.outcomes(question, cases)
    numbers = search.candidates(policies)

    def cases_in_which(wanted: object) -> Search:
        return search.Search(cases, known, wanted, numbers)

    nothing = False
    try:
        confirm = lambda told: claim.shown(told, harmless)  # noqa: E731
        standing, shown = _real_case(cases_in_which(claim.broken(question, decided)), question, confirm)
        if standing is Standing.PROVEN and claim.matters is not None:
            # that decisions of this kind exist at all is confirmed by a real one, too
            permitted = lambda told: all(each.permitted for each in told)  # noqa: E731
            witness, _ = _real_case(cases_in_which(claim.matters(question, decided[0])), question, permitted)
            nothing = witness is Standing.PROVEN
            if witness is Standing.FAULT and not unknowns(policies):
                standing = Standing.FAULT
    except search.UndecidedError:
        standing, shown = Standing.UNDECIDED, ()
    assumed = tuple(sorted({p.id for p in unknowns(policies)})) if claim.compares in ("a tier", "a set") else ()
    return Result(claim, standing, clock() - began, shown, nothing, assumed)


def _real_case(
    search: Search, question: Question, confirmed: Callable[[tuple[DecidedCase, ...]], bool]
) -> tuple[Standing, tuple[CounterexampleCase, ...]]:
    """PROVEN when there is no case; BROKEN with a real one that is confirmed; FAULT with one that is not."""
    last: tuple[CounterexampleCase, ...] = ()
    for number in range(ROUNDS):
        found = search.next()
        if found is None:
            return (Standing.FAULT if number else Standing.PROVEN), last
        for told in _told(found, question):
            last = tuple(_departures(found, told))
            if confirmed(told):
                return Standing.BROKEN, last
        differing = [_says_otherwise(facts, each) for facts, each in zip(found.facts, told, strict=True)]
        if not any(differing):
            return Standing.FAULT, last
        for of, verdicts in enumerate(differing):
            search.insist(of, found.facts[of], verdicts)
    return Standing.FAULT, last


def _told(found: Found, question: Question) -> Iterator[tuple[DecidedCase, ...]]:
    """The real cases, decided; with an added policy, once for each real DENY policy in its place."""
    first, *others = found.facts
    before = _decided(first, question.policies, question.names)
    if found.added is None:
        yield before, *(_decided(facts, question.policies, question.names) for facts in others)
        return
    (second,) = others
    for policy in _denials(question.policies):
        both = _with_members(question.policies, (*question.policies.policies, policy))
        yield before, _decided(second, both, question.names)


def _decided(facts: Facts, policies: PolicySet, names: Names) -> DecidedCase:
    request, evidence = case_of(facts, policies, names)
    return DecidedCase(request, evidence, policies, decide(request, evidence, policies))


def _with_members(policies: PolicySet, members: tuple[Policy, ...]) -> PolicySet:
    """The set with other members, and so with another digest."""
    return PolicySet(policies.name, policies.version, members, policies.parameters)


def _denials(policies: PolicySet) -> Iterator[Policy]:
    """DENY policies that deny, are silent, or ask a person about an act of tier 2 and above."""
    taken = {policy.id for policy in policies.policies}
    name = "added"
    while name in taken:
        name += "-"
    always = Policy(
        name,
        Subject(),
        Object(),
        Always(),
        frozenset(Point),
        Effect.DENY,
        frozenset({Obligation(ObligationKind.RECORD)}),
        None,
    )
    yield always
    yield replace(always, subject=Subject(agents=frozenset({"nobody"})))
    asks = Not(Check(DynamicTrust(trust_theta_permille=1000)))
    yield replace(always, predicate=asks, points=frozenset({Point.AGENT, Point.TOOL, Point.ACTUATION}))


def _says_otherwise(facts: Facts, told: DecidedCase) -> dict[Primitive, PrimitiveVerdict]:
    """Verdicts of unknown primitives on the real case, where the solver assumed another one."""
    needs = requirement(told.request, told.policies)
    case = Case(told.request, told.evidence, needs.physical, runtime_tier(told.evidence, physical=needs.physical))
    real = {primitive: what_it_says(primitive, case) for primitive in facts.unknown}
    return {primitive: said for primitive, said in real.items() if said != facts.unknown[primitive]}


def _departures(found: Found, all_told: tuple[DecidedCase, ...]) -> Iterator[CounterexampleCase]:
    """Each case with its extraordinary facts, or those that differ from the case before.

    Names are in the request.
    """
    before: Facts | None = None
    for facts, told in zip(found.facts, all_told, strict=True):
        strange: list[tuple[str, object]] = []
        for row in FACTS:
            value = getattr(facts, row.name)
            usual = row.metadata["ordinary"] if before is None else getattr(before, row.name)
            if row.name not in NAMES_OF and value != usual:
                strange.append((row.metadata["says"], STATES[value] if row.name == "approval" else value))
        yield CounterexampleCase(told, tuple(strange))
        before = facts
