"""Looking for cases in which a formula is true: none at all, or the most ordinary one.

Every question is put to the solver over facts alone; `policies.proof.symbols` has the meaning of their terms.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, Final

import z3

from policies.decision.combine import checks
from policies.decision.extend import at_least_as_strict
from policies.evidence.model import Point
from policies.proof.claims import Cases, Question
from policies.proof.facts import FACTS, NAMES_OF, Facts, PrimitiveVerdict
from policies.proof.laws import laws
from policies.proof.logic import Truth, implies
from policies.proof.outcome import Added, Outcome, outcome
from policies.proof.symbols import SYMBOLIC, any_fact, any_facts, any_verdict
from policies.proof.verdicts import unknowns

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from policies.decision.policy import PolicySet
    from policies.primitives.base import Primitive
    from policies.proof.claims import Claim

RAISED: Final = ("base_tier", "impact_tier", "approval_lists_all")
"""The facts that another tier changes; all else stays as it is."""


_REQUEST: Final = tuple(row for row in FACTS if row.name in NAMES_OF or row.name in tuple(Point))
ORDER: Final = (*_REQUEST, *(row for row in reversed(FACTS) if row not in _REQUEST))
"""Order in which facts are made ordinary.

The chain comes last, so that where several facts could be strange, it is one of the chain.
"""


JUDGED: Final = (
    "operation", "chain_verified", "base_known", "base_tier", "impact_read", "impact_tier", "seen_fresh",
    "trust_known", "opening_in_force",
)  # fmt: skip
"""Facts that change the verdict of an unknown primitive, as far as is known."""


class UndecidedError(Exception):
    """The solver gave no answer: nothing is proven."""


def any_cases(claim: Claim, question: Question) -> tuple[Cases, list[Truth]]:
    """Cases that a claim compares, with open facts, and the laws that hold for them."""
    first = any_facts(unknowns(question.policies))
    known = list(laws(first, question.names, SYMBOLIC))
    match claim.compares:
        case "a policy":
            added = Added(*(z3.Bool(f"the added policy {does}") for does in ("is concerned", "denies", "defers")))
            second = replace(first, approval_lists_all=any_fact("approval_lists_all", "'"))
            # with one more to say why, there are at least as many reasons
            known.append(implies(SYMBOLIC, second.approval_lists_all, first.approval_lists_all))
            known.append(SYMBOLIC.no(SYMBOLIC.every(added.denies, added.defers)))
            return Cases((first, second), added), known
        case "a tier":
            raised = {name: any_fact(name, "'") for name in RAISED}
            unknown = {primitive: any_verdict(f"{primitive!r}'") for primitive in first.unknown}
            second = replace(first, **raised, unknown=unknown)
            known += [*laws(second, question.names, SYMBOLIC), *_no_softer(first, second)]
            return Cases((first, second)), known
        case "a set":
            return Cases((first,)), [*known, *_as_strict(first)]
        case _:
            return Cases((first,)), known


def _no_softer(lower: Facts, higher: Facts) -> Iterator[Truth]:
    """Terms by which the higher case has no lower part of a tier, and no unknown primitive softens."""
    yield lower.base_tier <= higher.base_tier
    yield lower.impact_tier <= higher.impact_tier
    for primitive, before in lower.unknown.items():
        after = higher.unknown[primitive]
        yield implies(SYMBOLIC, before.raises, after.raises)
        yield implies(SYMBOLIC, before.fails, SYMBOLIC.some(after.fails, after.raises))
        yield implies(SYMBOLIC, after.holds, before.holds)


def _as_strict(facts: Facts) -> Iterator[Truth]:
    """Terms by which an unknown primitive of stricter numbers fails wherever the same one of laxer numbers does."""
    for lax, before in facts.unknown.items():
        for strict, after in facts.unknown.items():
            if strict != lax and at_least_as_strict(lax, strict):
                yield implies(SYMBOLIC, before.raises, after.raises)
                yield implies(SYMBOLIC, before.fails, SYMBOLIC.some(after.fails, after.raises))
                yield implies(SYMBOLIC, after.holds, before.holds)


def outcomes(question: Question, cases: Cases) -> list[Outcome]:
    """Outcome of each case."""
    last = len(cases.facts) - 1
    return [
        outcome(question.policies, facts, question.names, question.logic, cases.added if i == last else None)
        for i, facts in enumerate(cases.facts)
    ]


@dataclass(frozen=True, slots=True)
class Found:
    """One answer of the solver: the facts of each case, and the added policy's answers, as plain values."""

    facts: tuple[Facts, ...]
    added: Added | None


class Search:
    """The cases in which a formula is true, one after the other."""

    def __init__(self, cases: Cases, known: list[Truth], wanted: Truth, candidates: tuple[int, ...]) -> None:
        """Prepares a search; nothing is looked for yet.

        Args:
            cases: terms for all facts.
            known: the laws that hold for them.
            wanted: the condition to be found.
            candidates: numbers that are tried, in order, where the ordinary one is not possible.
        """
        self._cases, self._candidates = cases, candidates
        self._solver = z3.SolverFor("QF_LIRA")
        self._solver.add(*known, wanted)

    def next(self) -> Found | None:
        """The most ordinary case, or None when there is none.

        Raises:
            UndecidedError: when the solver does not know.
        """
        if not self._possible():
            return None
        self._solver.push()
        try:
            for facts in self._cases.facts:
                self._make_ordinary(facts)
            self._possible()
            model = self._solver.model()
            return Found(
                tuple(_read(model, facts) for facts in self._cases.facts),
                None if self._cases.added is None else Added(*_values(model, self._cases.added)),
            )
        finally:
            self._solver.pop()

    def insist(self, of: int, facts: Facts, verdicts: Mapping[Primitive, PrimitiveVerdict]) -> None:
        """Fixes the real verdicts of these primitives in case number `of`, where it is like `facts`."""
        terms = self._cases.facts[of]
        alike = SYMBOLIC.every(*(getattr(terms, name) == getattr(facts, name) for name in JUDGED))
        for primitive, said in verdicts.items():
            term = terms.unknown[primitive]
            real = SYMBOLIC.every(*(getattr(term, f.name) == getattr(said, f.name) for f in fields(said)))
            self._solver.add(implies(SYMBOLIC, alike, real))

    def _possible(self, *conditions: Truth) -> bool:
        answer = self._solver.check(*conditions)
        if answer == z3.unknown:
            raise UndecidedError(self._solver.reason_unknown())
        return bool(answer == z3.sat)

    def _make_ordinary(self, facts: Facts) -> None:
        """Every fact, one after the other, becomes the most ordinary that is still possible."""
        for row in ORDER:
            term, ordinary = getattr(facts, row.name), row.metadata["ordinary"]
            tried = (ordinary,) if isinstance(ordinary, bool) else (ordinary, *self._candidates)
            for value in tried:
                if self._possible(term == value):
                    self._solver.add(term == value)
                    break


def _read(model: z3.ModelRef, facts: Facts) -> Facts:
    plain = {row.name: _value(model, getattr(facts, row.name)) for row in FACTS}
    return Facts(
        **plain, unknown={p: PrimitiveVerdict(*_values(model, verdict)) for p, verdict in facts.unknown.items()}
    )


def _values(model: z3.ModelRef, terms: Any) -> list[Any]:
    return [_value(model, getattr(terms, f.name)) for f in fields(terms)]


def _value(model: z3.ModelRef, term: Any) -> bool | int | Fraction:
    """Value of a term in a model; one that the formula does not speak of is false, or 0."""
    value = model.eval(term, model_completion=True)
    if z3.is_bool(value):
        return bool(z3.is_true(value))
    if z3.is_int_value(value):
        return int(value.as_long())
    fraction = Fraction(value.numerator_as_long(), value.denominator_as_long())
    return int(fraction) if fraction.denominator == 1 else fraction


def candidates(policies: PolicySet) -> tuple[int, ...]:
    """Every number of a set, and the next one above: where answers change."""
    sets = (policies, *([policies.floor] if policies.floor else []))
    instances: list[Any] = [p for each in sets for policy in each.policies for p, _ in checks(policy.predicate)]
    stated: set[int] = set(range(5))
    for holder in (*(each.parameters for each in sets), *instances):
        stated |= {value for f in fields(holder) if isinstance(value := getattr(holder, f.name), int)}
    return tuple(sorted(stated | {number + 1 for number in stated}))
