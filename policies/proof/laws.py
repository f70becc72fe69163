"""Laws that hold for the facts of every case.

A law that is not stated here is left open, which never proves too much.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from policies.evidence.model import Point
from policies.proof.facts import FACTS, NAMES_OF, NO_APPROVAL, Facts, Names, PrimitiveVerdict
from policies.proof.logic import Logic, Truth, implies

if TYPE_CHECKING:
    from collections.abc import Iterator


def laws(facts: Facts, names: Names, logic: Logic) -> Iterator[Truth]:
    """Each law for these facts; all are true of the facts of any real case."""
    yield from _ranges(facts, names)
    yield logic.some(*(facts.stands_for(point) for point in Point))
    # the holder's attestation is one of the chain's; of two, it is the youngest or the oldest
    yield facts.youngest_age_s <= facts.leaf_age_s
    yield facts.leaf_age_s <= facts.oldest_age_s
    yield implies(logic, facts.delegations == 0, facts.youngest_age_s == facts.oldest_age_s)
    at_an_end = logic.some(facts.leaf_age_s == facts.youngest_age_s, facts.leaf_age_s == facts.oldest_age_s)
    yield implies(logic, facts.delegations == 1, at_an_end)
    # a window that has begun and has not ended has a length
    yield implies(logic, logic.every(facts.begun, facts.unexpired), facts.lifetime_s > 0)
    yield logic.no(logic.every(facts.request_free, facts.after_the_grant))
    yield implies(logic, facts.tool_pinned, facts.base_known)
    yield logic.no(logic.every(facts.impact_read, facts.impact_fault))
    yield implies(logic, facts.view_invalid, logic.every(facts.view_known, facts.view_late))
    yield implies(logic, facts.robot_ready, facts.robot_known)
    yield implies(logic, facts.opening_its_own, logic.no(facts.approval == NO_APPROVAL))
    for verdict in facts.unknown.values():
        yield from one_answer(verdict, logic)


def one_answer(verdict: PrimitiveVerdict, logic: Logic) -> Iterator[Truth]:
    """A verdict is one of four: it holds, fails, defers or is not given."""
    yield logic.no(logic.every(verdict.holds, verdict.fails))
    yield logic.no(logic.every(verdict.raises, logic.some(verdict.holds, verdict.fails)))


def _ranges(facts: Facts, names: Names) -> Iterator[Truth]:
    for row in FACTS:
        value = getattr(facts, row.name)
        low = row.metadata.get("low")
        high = len(names.of(row.name)) - 1 if row.name in NAMES_OF else row.metadata.get("high")
        if low is not None:
            yield low <= value
        if high is not None:
            yield value <= high
