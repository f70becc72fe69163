"""Baseline of an agent's acts: twelve yes-or-no questions about each, and the reference that they are asked against.

A question is asked of one act at a time, and its share of yes is known from the baseline. So one kind of detector
(policies.conduct.cusum) with one stated false-alarm rate serves all questions. The reference is fixed once and never
follows the agent: a drift so slow that a moving reference would learn it as usual still leaves a fixed one.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from policies.conduct.report import ReportError, is_count, is_text, is_whole, keyed, listed
from policies.conduct.trust_changes import UNIT, charge
from policies.evidence.conduct_readings import Feature
from policies.words.canonical import EXACT

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from policies.conduct.report import Report
    from policies.words.parameters import Parameters

BLOCK: Final = 4
"""Acts that are timed together: reports are stamped in whole seconds."""
SAMPLES_MIN: Final = 16
"""Values of a parameter from which its range is known."""
OPERATIONS_MAX: Final = 16
"""Operations with ranges of their own; a robot has about twenty, and an agent uses few of them."""
NAMES_MAX: Final = 32
"""Parameters with ranges, of one operation: as many as it can have (capabilities.values.caps)."""


class Watch(IntEnum):
    """The questions. A yes is a hit; each is one-sided: fewer hits than usual are never bad."""

    RARE_TOOL = 0
    """Is it an operation that the reference saw at most once?"""
    SELDOM_TOOL = 1
    """Is it one of the less used half of its acts?"""
    FIRST_TOOL = 2
    """Is it the operation that it uses most?"""
    SECOND_TOOL = 3
    """Is it the operation that it uses second most?"""
    THIRD_TOOL = 4
    """Is it the operation that it uses third most?"""
    OUTSIDE = 5
    """Is any value well outside all that the reference saw?"""
    TAIL = 6
    """Are more than a quarter of its values in the outer tenths?"""
    QUICK = 7
    """Did the last four acts take less time than nine in ten of such blocks?"""
    REFUSED = 8
    """Was it refused for something that is charged to its agent (policies.conduct.trust_changes)?"""
    PROBED = 9
    """Was that a whole wrong or more: did it ask for more than it was lent?"""
    NEAR = 10
    """Was it close to a limit?"""
    HIGH = 11
    """Is its tier, and within the tier its closeness to a limit, above that of three in four acts?"""


TOP_TOOLS: Final = (Watch.FIRST_TOOL, Watch.SECOND_TOOL, Watch.THIRD_TOOL)

FEATURES: Final[Mapping[Watch, Feature]] = MappingProxyType(
    {
        Watch.RARE_TOOL: Feature.TOOLS,
        Watch.SELDOM_TOOL: Feature.TOOLS,
        Watch.FIRST_TOOL: Feature.TOOLS,
        Watch.SECOND_TOOL: Feature.TOOLS,
        Watch.THIRD_TOOL: Feature.TOOLS,
        Watch.OUTSIDE: Feature.PARAMETERS,
        Watch.TAIL: Feature.PARAMETERS,
        Watch.QUICK: Feature.RATE,
        Watch.REFUSED: Feature.REFUSALS,
        Watch.PROBED: Feature.REFUSALS,
        Watch.NEAR: Feature.NEAR_BOUNDARY,
        Watch.HIGH: Feature.ESCALATION,
    }
)
"""The feature of each question. Its false alarms are those of all its questions together."""


@dataclass(frozen=True, slots=True)
class Act:
    """Part of a report that the questions are about.

    Attributes:
        operation, values: as reported.
        level: 1000 * tier + near_permille; None when neither is known.
        near, refused, probed: answers that need no reference; None when they are not to be asked.
        span_s: how long the last `BLOCK` acts took, on the act that ends a block; else None.
    """

    operation: str
    values: tuple[tuple[str, int], ...]
    level: int | None
    near: bool | None
    refused: bool | None
    probed: bool | None
    span_s: int | None

    def to_json(self) -> list[Any]:
        """Plain JSON of the act."""
        values = [list(entry) for entry in self.values]
        return [self.operation, values, self.level, self.near, self.refused, self.probed, self.span_s]

    @classmethod
    def from_json(cls, body: object) -> Act:
        """Act that `to_json` wrote.

        Raises:
            ReportError: it is not that.
        """
        row = listed(body, "act")
        if len(row) != 7 or not is_text(row[0]):
            raise ReportError("act")
        operation, values, level, near, refused, probed, span_s = row
        pairs = [listed(value, "act") for value in listed(values, "act")]
        if not all(len(pair) == 2 and is_text(pair[0]) and is_whole(pair[1]) for pair in pairs):
            raise ReportError("act")
        numbers = all(number is None or is_count(number, EXACT) for number in (level, span_s))
        if not numbers or not {type(near), type(refused), type(probed)} <= {bool, type(None)}:
            raise ReportError("act")
        return cls(operation, tuple((name, number) for name, number in pairs), level, near, refused, probed, span_s)


def act_of(report: Report, parameters: Parameters, *, span_s: int | None) -> Act:
    """Act that one report tells of, as the questions see it."""
    tier, near = report.tier, report.near_permille
    charged = charge(report).milli
    permitted = False if report.effect == "PERMIT" else None  # a refusal without a charge says nothing of the agent
    return Act(
        operation=report.operation,
        values=report.values[:NAMES_MAX],
        level=None if tier is None and near is None else 1000 * (tier or 0) + (near or 0),
        near=None if near is None else near >= parameters.behaviour_near_permille,
        refused=True if charged else permitted,
        probed=charged >= UNIT if charged else permitted,
        span_s=span_s,
    )


Range = tuple[int, int, int, int]
"""Lowest, lower tenth, upper tenth, highest; the outer two with a margin."""


@dataclass(frozen=True, slots=True)
class Reference:
    """Reference that acts are compared with.

    Attributes:
        known: operations that were seen more than once.
        usual: the more used half of the acts.
        top: the three that are used most, in order; "" where there is none.
        ranges: by operation and parameter.
        quick_s: a block that took less time is quick; None when no block was timed.
        high: a level above it is high; None when none was known.
    """

    known: frozenset[str]
    usual: frozenset[str]
    top: tuple[str, str, str]
    ranges: Mapping[str, Mapping[str, Range]]
    quick_s: int | None
    high: int | None

    def answers(self, act: Act) -> dict[Watch, bool]:
        """Yes or no to each question that can be asked of this act."""
        found = {
            Watch.RARE_TOOL: act.operation not in self.known,
            Watch.SELDOM_TOOL: act.operation not in self.usual,
        }
        for watch, operation in zip(TOP_TOOLS, self.top, strict=True):
            if operation:
                found[watch] = act.operation == operation
        ranges = self.ranges.get(act.operation, {})
        placed = [(value, ranges[name]) for name, value in act.values if name in ranges]
        if placed:
            beyond = sum(not low <= value <= high for value, (_, low, high, _) in placed)
            found[Watch.OUTSIDE] = any(not low <= value <= high for value, (low, _, _, high) in placed)
            found[Watch.TAIL] = 4 * beyond > len(placed)
        if act.span_s is not None and self.quick_s is not None:
            found[Watch.QUICK] = act.span_s < self.quick_s
        if act.level is not None and self.high is not None:
            found[Watch.HIGH] = act.level > self.high
        return found | bare_answers(act)

    def to_json(self) -> dict[str, Any]:
        """Plain JSON of the reference, ordered."""
        return {
            "known": sorted(self.known),
            "usual": sorted(self.usual),
            "top": list(self.top),
            "ranges": [
                [operation, [[name, *bounds] for name, bounds in sorted(ranges.items())]]
                for operation, ranges in sorted(self.ranges.items())
            ],
            "quick_s": self.quick_s,
            "high": self.high,
        }

    @classmethod
    def from_json(cls, body: object) -> Reference:
        """Reference that `to_json` wrote.

        Raises:
            ReportError: it is not that.
        """
        fields = keyed(body, set(cls.__slots__), "reference")
        names = {key: listed(fields[key], key) for key in ("known", "usual", "top")}
        if not all(is_text(name) or name == "" for each in names.values() for name in each):
            raise ReportError("reference")
        match names["top"]:
            case [first, second, third]:
                pass
            case _:
                raise ReportError("top")
        if not all(fields[key] is None or is_count(fields[key], EXACT) for key in ("quick_s", "high")):
            raise ReportError("reference")
        ranges = {}
        for row in listed(fields["ranges"], "ranges"):
            match row:
                case [operation, list(rows)] if is_text(operation):
                    ranges[operation] = MappingProxyType(dict(map(_range, rows)))
                case _:
                    raise ReportError("ranges")
        return cls(
            frozenset(names["known"]),
            frozenset(names["usual"]),
            (first, second, third),
            MappingProxyType(ranges),
            fields["quick_s"],
            fields["high"],
        )


def bare_answers(act: Act) -> dict[Watch, bool]:
    """The answers that need no reference."""
    bare = {Watch.REFUSED: act.refused, Watch.PROBED: act.probed, Watch.NEAR: act.near}
    return {watch: answer for watch, answer in bare.items() if answer is not None}


def reference(acts: Sequence[Act]) -> Reference:
    """The reference that these acts make."""
    uses = Counter(act.operation for act in acts)
    by_use = sorted(uses, key=lambda operation: (-uses[operation], operation))
    first, second, third = (*by_use, "", "", "")[:3]
    usual, before = set(), 0
    for operation in by_use:
        if 2 * before < len(acts):
            usual.add(operation)
        before += uses[operation]
    values: dict[str, dict[str, list[int]]] = {}
    for act in acts:
        for name, value in act.values:
            values.setdefault(act.operation, {}).setdefault(name, []).append(value)
    ranges = {
        operation: MappingProxyType(
            {name: _placed(found) for name, found in values[operation].items() if len(found) >= SAMPLES_MIN}
        )
        for operation in by_use[:OPERATIONS_MAX]
        if operation in values
    }
    spans = sorted(act.span_s for act in acts if act.span_s is not None)
    levels = sorted(act.level for act in acts if act.level is not None)
    return Reference(
        known=frozenset(operation for operation, count in uses.items() if count > 1),
        usual=frozenset(usual),
        top=(first, second, third),
        ranges=MappingProxyType(ranges),
        quick_s=spans[len(spans) // 10] if spans else None,
        high=levels[len(levels) * 3 // 4] if levels else None,
    )


def widest(one: Reference, other: Reference) -> Reference:
    """Reference in which everything counts as usual that is usual for either."""
    ranges: dict[str, dict[str, Range]] = {}
    for operation in sorted(one.ranges.keys() | other.ranges.keys())[: 2 * OPERATIONS_MAX]:
        here, there = one.ranges.get(operation, {}), other.ranges.get(operation, {})
        merged = {name: _hull(here.get(name), there.get(name)) for name in sorted(here.keys() | there.keys())}
        ranges[operation] = dict(list(merged.items())[: 2 * NAMES_MAX])
    quick = [each.quick_s for each in (one, other) if each.quick_s is not None]
    high = [each.high for each in (one, other) if each.high is not None]
    return Reference(
        one.known | other.known,
        one.usual | other.usual,
        one.top if one.top == other.top else ("", "", ""),  # the most used ones differ within a role: not asked
        MappingProxyType({operation: MappingProxyType(bounds) for operation, bounds in ranges.items()}),
        min(quick, default=None),
        max(high, default=None),
    )


def _placed(found: list[int]) -> Range:
    """Range, a quarter of its width wider to each side, and outer tenths of some values."""
    found = sorted(found)
    tenth, margin = len(found) // 10, (found[-1] - found[0]) // 4
    return found[0] - margin, found[tenth], found[-1 - tenth], found[-1] + margin


def _hull(one: Range | None, other: Range | None) -> Range:
    known = [bounds for bounds in (one, other) if bounds is not None]
    lowest, low, high, highest = zip(*known, strict=True)
    return min(lowest), min(low), max(high), max(highest)


def _range(body: object) -> tuple[str, Range]:
    row = listed(body, "ranges")
    if len(row) != 5 or not is_text(row[0]) or not all(map(is_whole, row[1:])):
        raise ReportError("ranges")
    name, lowest, low, high, highest = row
    return name, (lowest, low, high, highest)
