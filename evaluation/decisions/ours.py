"""`policies.decide` with the shipped set, as a measured engine."""

from __future__ import annotations

from importlib import metadata
from typing import TYPE_CHECKING, Final

from evaluation.decisions.engine import Said
from policies import decide

if TYPE_CHECKING:
    from evaluation.decisions.facts import Situation
    from policies import Decision, Evidence, PolicySet, Request

NAME: Final = "ztpm"
RECORDED: Final = "ztpm, recorded"


class OurDecisions:
    """See the module."""

    name = NAME
    version = metadata.version("ztpm")
    checks = (
        "effect, every finding with its detail, obligations, tier, SHA-256 of the request; "
        "the shape of every reading, and ages and tier worked out from them"
    )

    def __init__(self, policies: PolicySet) -> None:
        self._policies = policies

    def ready(self, situation: Situation) -> tuple[Request, Evidence]:
        """Request and evidence."""
        return situation.request, situation.evidence

    def ask(self, question: tuple[Request, Evidence]) -> Decision:
        """The decision."""
        request, evidence = question
        return decide(request, evidence, self._policies)

    def read(self, answer: Decision) -> Said:
        """Its effect, and who found something."""
        return Said(answer.effect, tuple(finding.primitive for finding in answer.findings))


class Recorded(OurDecisions):
    """Our engine with the extra work of a record: the digest of all evidence."""

    name = RECORDED
    checks = f"{OurDecisions.checks}; SHA-256 of all evidence"

    def ask(self, question: tuple[Request, Evidence]) -> Decision:
        """The decision, whose evidence has a digest."""
        decision = super().ask(question)
        assert decision.evidence_digest
        return decision
