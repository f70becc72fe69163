"""Reports made from an enforcement point's journal: from the record of a decision and that of its outcome.

The one home of that step, for the identity provider that is shipped the records and for the enforcement point that
keeps them. Total: a malformed record makes no report.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

from capabilities.values.errors import ScopeError
from capabilities.values.units import DeclaredUnit, Unit, kind_of
from policies.conduct.report import Report, ReportError
from policies.evidence.model import Effect
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Mapping

_OUTCOMES: Final = {"done": "done", "failed": "failed", "refused": "refused", "cancelled": "failed"}
"""Outcomes in a record, and in a report. An unknown outcome (the enforcement point died) makes no report."""
_CANCELLED: Final = "CANCELLED"
"""Reason of an act whose caller went away while it lasted."""


@dataclass(frozen=True, slots=True)
class RecordedDecision:
    """A decision as it was recorded.

    Attributes:
        report: of it; while it is open, as if nothing had been sent.
        open: a PERMIT, of which an outcome is to come.
        audience: at which it was asked.
        hop_id: of the leaf: the authority under which it was asked.
        role: of the leaf's agent, as its hop states it; "" for none.
    """

    report: Report
    open: bool
    audience: str
    hop_id: str
    role: str


def _is_quantity(spelled: str) -> bool:
    """True for the kind of a number: what a report has of values, since only numbers have a usual range."""
    return isinstance(kind_of(spelled), (Unit, DeclaredUnit))


def decided(body: Mapping[str, Any], *, reporter: str, at_ms: int) -> RecordedDecision | None:
    """Decision that a record states; None for another record, or where no agent was proven to have asked.

    Args:
        body: of the record.
        reporter: the enforcement point whose journal it is in.
        at_ms: its time, milliseconds since the epoch.
    """
    try:
        request, decision, evidence = body["request"], body["decision"], body["evidence"]
        chain, tool = evidence["chain"], evidence["tool"]
        # A chain that was verified, and a proof that its leaf's key made for this very request: an agent acted.
        if chain["type"] != "Chain" or evidence["proof"] is not True:
            return None
        parties = (chain["sponsor"]["subject"], *(hop["agent"] for hop in chain["hops"]))
        report = Report(
            reporter=reporter,
            request_id=request["id"],
            agent=parties[-1],
            delegators=parties,
            at=at_ms // 1_000,
            operation=request["operation"],
            base_tier=tool["base_tier"] if type(tool) is dict else None,
            runtime_tier=decision["tier"],
            effect=decision["effect"],
            reason=decision["reason"],
            outcome="none",
            values=tuple((name, value) for name, kind, value in request["values"] if _is_quantity(kind)),
            near_permille=body.get("near_permille"),
        )
        audience, hop_id, role = request["audience"], chain["hops"][-1]["hop_id"], chain["hops"][-1]["role"]
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, ReportError, ScopeError):
        return None
    if not all(type(name) is str for name in (audience, hop_id, role)):
        return None
    return RecordedDecision(report, report.effect == Effect.PERMIT, audience, hop_id, role)


def concluded(open_: Report, body: Mapping[str, Any], *, at_ms: int) -> Report | None:
    """Report of a request whose PERMIT is on record, with this outcome; None while it is not concluded.

    A verdict that was not acted on in time concludes nothing: the request is decided afresh, or comes again.

    Args:
        open_: of the decision.
        body: of the record of the outcome.
        at_ms: its time, milliseconds since the epoch.
    """
    outcome, reason = body.get("outcome"), body.get("reason")
    if type(outcome) is not str or outcome not in _OUTCOMES:
        return None
    if outcome == "refused" and reason == Reason.VERDICT_EXPIRED:
        return None
    if reason is None:
        reason = open_.reason if outcome == "done" else _CANCELLED if outcome == "cancelled" else outcome.upper()
    try:
        return replace(open_, at=at_ms // 1_000, outcome=_OUTCOMES[outcome], reason=reason)
    except ReportError:
        return None
