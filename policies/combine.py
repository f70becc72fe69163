"""Predicates over primitives, and the one way in which the answers of policies are combined.

A verdict has three values, and `all`, `any` and `not` are the minimum, the maximum and the mirror of them: Fails <
Defers < Holds. Answers of policies are combined by deny-overrides, then DEFER over PERMIT; nothing is permitted that no
policy permits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, assert_never

from policies import canonical
from policies.errors import PolicyError, PolicyFault
from policies.model import Effect, Finding
from policies.primitives.base import Case, Defers, Fails, Holds, Primitive, Verdict, found
from policies.reasons import PRECEDENCE, REASONS, Reason

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


@dataclass(frozen=True, slots=True)
class Check:
    """One primitive with its parameters."""

    primitive: Primitive


@dataclass(frozen=True, slots=True)
class AllOf:
    """Every part holds. Never empty: a conjunction of nothing would hold without asking anything."""

    parts: tuple[Predicate, ...]

    def __post_init__(self) -> None:
        if not self.parts:
            raise PolicyError(PolicyFault.EMPTY, "all")


@dataclass(frozen=True, slots=True)
class AnyOf:
    """One part holds. Never empty."""

    parts: tuple[Predicate, ...]

    def __post_init__(self) -> None:
        if not self.parts:
            raise PolicyError(PolicyFault.EMPTY, "any")


@dataclass(frozen=True, slots=True)
class Not:
    """The part does not hold."""

    part: Predicate


@dataclass(frozen=True, slots=True)
class Always:
    """Holds for every case: the predicate of a policy that forbids, or asks, whatever the evidence."""


Predicate = Check | AllOf | AnyOf | Not | Always


def evaluate(predicate: Predicate, case: Case) -> Verdict:
    """The verdict of `predicate` on `case`. Every part is asked: findings do not depend on the order of parts."""
    match predicate:
        case Check(primitive):
            return primitive.judge(case)
        case Always():
            return Holds()
        case Not(part):
            return _mirror(evaluate(part, case))
        case AllOf(parts):
            verdicts = [evaluate(part, case) for part in parts]
            return _worst(verdicts)
        case AnyOf(parts):
            # by De Morgan: the mirror of the worst of the mirrors
            return _mirror(_worst([_mirror(evaluate(part, case)) for part in parts]))
        case _:
            assert_never(predicate)


def _mirror(verdict: Verdict) -> Verdict:
    """`not`: Holds and Fails change places and keep their findings."""
    match verdict:
        case Holds(because):
            return Fails(because)
        case Fails(findings):
            return Holds(findings)
        case Defers():
            return verdict
        case _:
            assert_never(verdict)


def _worst(verdicts: list[Verdict]) -> Verdict:
    """`all`: the least verdict, with the findings of all that are not better than Defers."""
    failed = [f for v in verdicts if isinstance(v, Fails) for f in v.findings]
    deferred = [f for v in verdicts if isinstance(v, Defers) for f in v.findings]
    if any(isinstance(v, Fails) for v in verdicts):
        return Fails((*failed, *deferred))
    if any(isinstance(v, Defers) for v in verdicts):
        return Defers(tuple(deferred))
    return Holds(tuple(f for v in verdicts if isinstance(v, Holds) for f in v.because))


def checks(predicate: Predicate, *, negated: bool = False) -> Iterator[tuple[Primitive, bool]]:
    """Every primitive of `predicate`, with True where an odd number of `not` stands above it."""
    match predicate:
        case Check(primitive):
            yield primitive, negated
        case Always():
            return
        case Not(part):
            yield from checks(part, negated=not negated)
        case AllOf(parts) | AnyOf(parts):
            for part in parts:
                yield from checks(part, negated=negated)
        case _:
            assert_never(predicate)


def conjuncts(predicate: Predicate) -> Iterator[Primitive]:
    """The primitives without which `predicate` cannot hold: those that only `all` stands above."""
    match predicate:
        case Check(primitive):
            yield primitive
        case AllOf(parts):
            for part in parts:
                yield from conjuncts(part)
        case AnyOf() | Not() | Always():
            return
        case _:
            assert_never(predicate)


@dataclass(frozen=True, slots=True)
class Answer:
    """What one policy says: an effect and its findings, None for no opinion; `grants` where it may permit."""

    effect: Effect | None
    findings: tuple[Finding, ...] = ()
    grants: bool = False


def deny_overrides(answers: Iterable[Answer]) -> tuple[Effect, tuple[Finding, ...]]:
    """The effect of all answers, and the findings with the leading one first, whatever the order of answers.

    DENY over DEFER over PERMIT. Where no policy that may permit concerns the request, the effect is DENY with
    `NO_POLICY`.
    """
    answers = tuple(answers)
    denied = [f for a in answers if a.effect is Effect.DENY for f in a.findings]
    deferred = [f for a in answers if a.effect is Effect.DEFER for f in a.findings]
    effects = {a.effect for a in answers}
    if not any(a.grants for a in answers):
        effects.add(Effect.DENY)
        denied.append(found("", Reason.NO_POLICY))
    if Effect.DENY in effects:
        return Effect.DENY, (*_ranked(denied), *(f for f in _ranked(deferred) if f not in denied))
    if Effect.DEFER in effects:
        return Effect.DEFER, _ranked(deferred)
    return Effect.PERMIT, ()


def _ranked(findings: list[Finding]) -> tuple[Finding, ...]:
    """One finding for each (primitive, reason), the one that says most, in the order of `PRECEDENCE`."""
    fullest: dict[tuple[str, Reason], Finding] = {}
    for finding in sorted(findings, key=lambda f: (len(f.detail), canonical.text(f.detail))):
        fullest[finding.primitive, finding.reason] = finding
    return tuple(sorted(fullest.values(), key=_rank))


def _rank(finding: Finding) -> tuple[int, int, str]:
    """Sort key: the reason's precedence, then the owner that leads, then the id."""
    owners = REASONS[finding.reason].owners
    owner = owners.index(finding.primitive) if finding.primitive in owners else len(owners)
    return PRECEDENCE.index(finding.reason), owner, finding.primitive
