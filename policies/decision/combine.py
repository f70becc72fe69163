"""Predicates over primitives, and the one way in which the answers of policies are combined.

A verdict has three values, and `all`, `any` and `not` are the minimum, the maximum and the mirror of them: Fails <
Defers < Holds. Answers of policies are combined by deny-overrides, then DEFER over PERMIT; nothing is permitted that no
policy permits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, assert_never

from policies.evidence.model import Effect, Finding
from policies.primitives.base import Case, Defers, Fails, Holds, Primitive, Verdict, found
from policies.words import canonical
from policies.words.errors import PolicyError, PolicyFault
from policies.words.reason_table import PRECEDENCE, REASONS, Reason

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
    """Predicate that holds for every case, for a policy that forbids or asks on any evidence."""


Predicate = Check | AllOf | AnyOf | Not | Always


def evaluate(predicate: Predicate, case: Case) -> Verdict:
    """The verdict of `predicate` on `case`. Every part is asked: findings do not depend on the order of parts."""
    match predicate:
        case Check():
            return predicate.primitive.judge(case)
        case AllOf():
            return _worst([evaluate(part, case) for part in predicate.parts])
        case AnyOf():
            # by De Morgan: the mirror of the worst of the mirrors
            return _mirror(_worst([_mirror(evaluate(part, case)) for part in predicate.parts]))
        case Not():
            return _mirror(evaluate(predicate.part, case))
        case Always():
            return Holds()
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
    if all(type(verdict) is Holds and not verdict.because for verdict in verdicts):
        return verdicts[0]  # the usual case, where nobody has anything to say
    held: list[Holds] = []
    failed: list[Fails] = []
    deferred: list[Defers] = []
    for verdict in verdicts:
        match verdict:
            case Holds():
                held.append(verdict)
            case Fails():
                failed.append(verdict)
            case Defers():
                deferred.append(verdict)
            case _:
                assert_never(verdict)
    asked = tuple(finding for verdict in deferred for finding in verdict.findings)
    if failed:
        return Fails((*(finding for verdict in failed for finding in verdict.findings), *asked))
    if deferred:
        return Defers(asked)
    return Holds(tuple(finding for verdict in held for finding in verdict.because))


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
class PolicyAnswer:
    """Answer of one policy: an effect and its findings, None for no opinion; `grants` where it may permit."""

    effect: Effect | None
    findings: tuple[Finding, ...] = ()
    grants: bool = False


SILENT: Final = PolicyAnswer(None)
PERMITS: Final = PolicyAnswer(Effect.PERMIT, grants=True)


def deny_overrides(answers: Iterable[PolicyAnswer]) -> tuple[Effect, tuple[Finding, ...]]:
    """Effect of all answers, and the findings with the leading one first, in any order of the answers.

    DENY over DEFER over PERMIT. Where no policy that may permit concerns the request, the effect is DENY with
    `NO_POLICY`.
    """
    effects, granted = set(), False
    denied: list[Finding] = []
    deferred: list[Finding] = []
    for answer in answers:
        effects.add(answer.effect)
        granted = granted or answer.grants
        if answer.effect is Effect.DENY:
            denied += answer.findings
        elif answer.effect is Effect.DEFER:
            deferred += answer.findings
    if not granted:
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
    for finding in findings:
        about = finding.primitive, finding.reason
        fullest[about] = _fuller(fullest.get(about, finding), finding)
    return tuple(sorted(fullest.values(), key=_rank))


def _fuller(one: Finding, other: Finding) -> Finding:
    """Finding of the two that says more.

    Between two that say as much it is the same one in either order.
    """
    if one is other:
        return one
    return max(one, other, key=lambda finding: (len(finding.detail), canonical.text(finding.detail)))


_ORDER: Final = {reason: place for place, reason in enumerate(PRECEDENCE)}


def _rank(finding: Finding) -> tuple[int, int, str]:
    """Sort key: the reason's precedence, then the owner that leads, then the id."""
    owners = REASONS[finding.reason].owners
    owner = owners.index(finding.primitive) if finding.primitive in owners else len(owners)
    return _ORDER[finding.reason], owner, finding.primitive
