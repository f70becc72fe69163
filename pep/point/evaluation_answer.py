"""Answers to AuthZEN's evaluations: a boolean, and in its context the reason as a holder is told of a denial."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pep.gate import records
from policies.evidence.model import Effect
from policies.words.reason_table import REASONS, Reason

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pep.gate.advice import Advice
    from policies.evidence.model import Obligation


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer to one evaluation.

    Attributes:
        permits: the decision.
        context: what is told with it.
        record: body of its record, but for the members that all of one request have.
    """

    permits: bool
    context: Mapping[str, Any]
    record: dict[str, object]

    @property
    def told(self) -> dict[str, object]:
        """As it stands in the response."""
        return {"decision": self.permits, "context": dict(self.context)}


def refused(reason: Reason) -> dict[str, object]:
    """Context for a stranger: the code alone."""
    return {"effect": str(Effect.DENY), "reason": str(reason)}


def denied(reason: Reason, primitive: str, **detail: object) -> dict[str, object]:
    """Context of a denial before there was a request to decide, for the holder."""
    known = {name: value for name, value in detail.items() if value}
    return {**known, **refused(reason), "primitive": primitive, "remedy": REASONS[reason].remedy}


def advised(advice: Advice) -> dict[str, object]:
    """Context of a verdict, for the holder: reason, limit and who set it, tier, obligations, and what people do."""
    decision = advice.decision
    told = records.told(decision)
    context = {
        "remedy": REASONS[decision.reason].remedy,
        **{name: value for name, value in told.items() if name != "decision"},
        "effect": str(decision.effect),
        "obligations": [_obligation(each) for each in decision.obligations],
    }
    if decision.index is not None:
        context["index_milli"] = decision.index
    if decision.effect is Effect.DEFER:
        context |= _deferred(advice)
    return context


def _obligation(obligation: Obligation) -> dict[str, object]:
    found: dict[str, object] = {"kind": str(obligation.kind)}
    if obligation.at_most is not None:
        at_most = obligation.at_most
        found["at_most"] = {"parameter": at_most.name, "unit": str(at_most.unit), "value": at_most.value}
    return found


def _deferred(advice: Advice) -> dict[str, object]:
    """An evaluation asks nobody: it says what the call did that did, or that the call itself will."""
    if advice.ask is None:
        return {"asked": False}
    return {
        "asked": True,
        "approval_id": advice.ask.ask_id,
        "url": advice.ask.url,
        "expires_at": int(advice.ask.expires_at),
    }
