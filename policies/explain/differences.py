"""Differences between two policy sets: in their parts, and in their decisions. Pure.

Parts are compared by meaning: the order of policies and the spelling of a text make no difference. Decisions are
compared over given cases: no difference among them proves nothing about other cases.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Final, assert_never

from policies.decision.combine import AllOf, Always, AnyOf, Check, Not, Predicate
from policies.decision.pdp import decide
from policies.evidence.evidence import ApprovalReading
from policies.evidence.model import SEVERITY, Effect
from policies.primitives.catalog import CATALOG
from policies.words import canonical
from policies.words.parameters import GATE_PARAMETERS, PARAMETERS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from policies.decision.policy import Policy, PolicySet
    from policies.evidence.case_json import RecordedCase
    from policies.evidence.model import Decision

JUDGING: Final = (
    frozenset(
        {p.name for row in CATALOG for p in row.parameters}
        | {name for name in PARAMETERS if name.startswith("approved_")}
    )
    - GATE_PARAMETERS
)
"""Parameters that matter when evidence is judged, and then alone.

Any other parameter changes the evidence, or acts when a decision is enforced.
"""


class Change(StrEnum):
    """Change of a policy."""

    ADDED = "added"
    REMOVED = "removed"
    CHANGED = "changed"


@dataclass(frozen=True, slots=True)
class PartChange:
    """One part of a policy, or one parameter, before and after, as text."""

    part: str
    was: str
    now: str


@dataclass(frozen=True, slots=True)
class PolicyChange:
    """Policy that differs; `parts` names its changed parts, and is empty for one that is added or removed."""

    id: str
    change: Change
    parts: tuple[PartChange, ...] = ()


@dataclass(frozen=True, slots=True)
class SetChange:
    """Differences of two sets as texts.

    Attributes:
        parameters: those with another value, and which stops latch the robot.
        policies: by id.
    """

    parameters: tuple[PartChange, ...]
    policies: tuple[PolicyChange, ...]

    @property
    def same(self) -> bool:
        """True where nothing that decides differs; name and version may."""
        return not self.parameters and not self.policies


def of_sets(one: PolicySet, other: PolicySet) -> SetChange:
    """Differences of `other` from `one`, policies matched by their ids."""
    parameters = tuple(
        PartChange(row.name, f"{was} {row.unit}", f"{now} {row.unit}")
        for row in PARAMETERS.values()
        if (was := getattr(one.parameters, row.name)) != (now := getattr(other.parameters, row.name))
    )
    if one.latch != other.latch:
        parameters = (*parameters, PartChange("latch", _latch(one), _latch(other)))
    before, after = {p.id: p for p in one.policies}, {p.id: p for p in other.policies}
    changes: list[PolicyChange] = []
    for name in sorted(before.keys() | after.keys()):
        if name not in after:
            changes.append(PolicyChange(name, Change.REMOVED))
        elif name not in before:
            changes.append(PolicyChange(name, Change.ADDED))
        elif before[name] != after[name]:
            changes.append(PolicyChange(name, Change.CHANGED, _parts(before[name], after[name])))
    return SetChange(parameters, tuple(changes))


def _latch(of: PolicySet) -> str:
    return ", ".join(sorted(of.latch)) or "none"


def _parts(one: Policy, other: Policy) -> tuple[PartChange, ...]:
    was, now = part_texts(one), part_texts(other)
    return tuple(PartChange(part, was[part], now[part]) for part in was if was[part] != now[part])


def part_texts(policy: Policy) -> dict[str, str]:
    """Each part of the 7-tuple as a short text, the subject and the object in theirs."""
    return {
        "subject.agents": _names(policy.subject.agents),
        "subject.sponsors": _names(policy.subject.sponsors),
        "object.ids": _names(policy.object.ids),
        "object.operations": _names(policy.object.operations),
        "object.without": _names(policy.object.without),
        "predicate": predicate_text(policy.predicate),
        "ep": _names(policy.points),
        "effect": str(policy.effect),
        "obligation": _names(frozenset(str(o.kind) for o in policy.obligations)),
        "pit_bound": "none" if policy.pit_bound is None else str(int(policy.pit_bound)),
    }


def predicate_text(predicate: Predicate) -> str:
    """A predicate as people write it, each primitive with the values that it takes."""
    match predicate:
        case Check(primitive):
            values = ", ".join(f"{f.name}={getattr(primitive, f.name)}" for f in fields(primitive))  # type: ignore[arg-type]
            return f"{primitive.id}({values})" if values else primitive.id
        case Always():
            return "always"
        case Not(part):
            return f"not {predicate_text(part)}"
        case AllOf(parts):
            return f"all({', '.join(map(predicate_text, parts))})"
        case AnyOf(parts):
            return f"any({', '.join(map(predicate_text, parts))})"
        case _:
            assert_never(predicate)


def _names(names: frozenset[str] | None) -> str:
    return "any" if names is None else " ".join(sorted(map(str, names))) or "none"


# --- decisions -------------------------------------------------------------------------------------------------------


class Direction(StrEnum):
    """Direction of the new set beside the old one, on the compared cases."""

    SAME = "same"
    STRICTER = "stricter"
    MILDER = "milder"
    MIXED = "mixed"
    """Stricter on some and milder on others."""
    OTHERWISE = "otherwise"
    """The new set is as strict, for other reasons."""


@dataclass(frozen=True, slots=True)
class ComparedDecision:
    """Part of a decision that is compared."""

    effect: Effect
    reason: str

    @staticmethod
    def of(decision: Decision) -> ComparedDecision:
        """Compared part of a decision."""
        return ComparedDecision(decision.effect, str(decision.reason))


@dataclass(frozen=True, slots=True)
class ComparedCase:
    """One case to compare on.

    Attributes:
        name: by which people find it again.
        recorded: the request and its evidence.
        was: the earlier decision, or None: the one of the old set.
        under: digest of the set that decided it then, or "" when unknown.
    """

    name: str
    recorded: RecordedCase
    was: ComparedDecision | None = None
    under: str = ""


@dataclass(frozen=True, slots=True)
class Moved:
    """All cases that went from one verdict to another; `examples` are the first of them by name, `first` the first."""

    was: ComparedDecision
    now: ComparedDecision
    count: int
    examples: tuple[str, ...]
    first: RecordedCase


@dataclass(frozen=True, slots=True)
class Comparison:
    """Comparison of two sets, or of a record and a set, over the same cases.

    Attributes:
        cases: how many there were.
        kept: every verdict that stayed, with its count.
        moved: every other one, the most frequent first.
    """

    cases: int
    kept: tuple[tuple[ComparedDecision, int], ...]
    moved: tuple[Moved, ...]

    @property
    def direction(self) -> Direction:
        """Direction of the new set on these cases."""
        steps = [SEVERITY[m.now.effect] - SEVERITY[m.was.effect] for m in self.moved]
        up, down = any(step > 0 for step in steps), any(step < 0 for step in steps)
        if up and down:
            return Direction.MIXED
        if up or down:
            return Direction.STRICTER if up else Direction.MILDER
        return Direction.OTHERWISE if self.moved else Direction.SAME


EXAMPLES: Final = 3


def of_decisions(cases: Iterable[ComparedCase], old: PolicySet | None, new: PolicySet) -> Comparison:
    """Comparison of the decisions of `new` with earlier ones.

    An approval that counted for the set of then counts as if people had given it under the new one: it names the digest
    of the set under which it was asked for, and a change of sets would otherwise void all of them alike.

    Args:
        cases: each with its verdict, where `old` is None.
        old: decides the cases that carry no decision.
        new: decides.
    """
    kept: dict[ComparedDecision, int] = {}
    moved: dict[tuple[ComparedDecision, ComparedDecision], list[ComparedCase]] = {}
    counts: dict[tuple[ComparedDecision, ComparedDecision], int] = {}
    total = 0
    for case in cases:
        was = case.was if case.was is not None else None if old is None else _under(case, old)
        if was is None:
            continue
        total += 1
        now = _under(case, new)
        if was == now:
            kept[was] = kept.get(was, 0) + 1
            continue
        counts[was, now] = counts.get((was, now), 0) + 1
        examples = moved.setdefault((was, now), [])
        if len(examples) < EXAMPLES:
            examples.append(case)
    classes = (
        Moved(was, now, counts[was, now], tuple(case.name for case in examples), examples[0].recorded)
        for (was, now), examples in moved.items()
    )
    ordered = sorted(classes, key=lambda m: (-m.count, canonical.text((m.was, m.now))))
    held = sorted(kept.items(), key=lambda row: (-row[1], canonical.text(row[0])))
    return Comparison(total, tuple(held), tuple(ordered))


def _under(case: ComparedCase, policies: PolicySet) -> ComparedDecision:
    evidence = case.recorded.evidence
    approval = evidence.approval
    if isinstance(approval, ApprovalReading) and approval.policy_digest and case.under in ("", approval.policy_digest):
        evidence = replace(evidence, approval=replace(approval, policy_digest=policies.digest))
    return ComparedDecision.of(decide(case.recorded.request, evidence, policies))


def unseen(change: SetChange) -> tuple[str, ...]:
    """Parameters that differ and whose effect cases cannot show, or not wholly."""
    return tuple(part.part for part in change.parameters if part.part not in JUDGING)
