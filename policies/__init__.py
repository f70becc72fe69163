"""Decisions: 25 primitives, 7-tuple policies, tiers, trust, and the one pure function `decide`."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from policies.conduct.trust import chain_trust, edge_trust
    from policies.decision.load import SHIPPED, load, load_shipped
    from policies.decision.pdp import decide
    from policies.decision.policy import Object, Policy, PolicySet, Requirement, Subject, requirement
    from policies.evidence.evidence import (
        NOT_COLLECTED,
        ApprovalReading,
        Contribution,
        DeclaredImpact,
        Evidence,
        ImpactFault,
        ImpactReading,
        NotCollected,
        OpeningReading,
        RobotReading,
        ToolReading,
        TrustReading,
    )
    from policies.evidence.model import (
        ApprovalUse,
        Decision,
        Effect,
        Finding,
        Obligation,
        ObligationKind,
        Point,
        Request,
    )
    from policies.explain.remedies import Means, Remedy, remedies
    from policies.primitives.catalog import CATALOG, ROWS
    from policies.primitives.catalog_row import CatalogRow
    from policies.words.errors import PolicyError, PolicyFault
    from policies.words.parameters import PARAMETERS, Parameters
    from policies.words.reason_table import REASONS, Reason

__all__ = [
    "CATALOG",
    "NOT_COLLECTED",
    "PARAMETERS",
    "REASONS",
    "ROWS",
    "SHIPPED",
    "ApprovalReading",
    "ApprovalUse",
    "CatalogRow",
    "Contribution",
    "Decision",
    "DeclaredImpact",
    "Effect",
    "Evidence",
    "Finding",
    "ImpactFault",
    "ImpactReading",
    "Means",
    "NotCollected",
    "Object",
    "Obligation",
    "ObligationKind",
    "OpeningReading",
    "Parameters",
    "Point",
    "Policy",
    "PolicyError",
    "PolicyFault",
    "PolicySet",
    "Reason",
    "Remedy",
    "Request",
    "Requirement",
    "RobotReading",
    "Subject",
    "ToolReading",
    "TrustReading",
    "chain_trust",
    "decide",
    "edge_trust",
    "load",
    "load_shipped",
    "remedies",
    "requirement",
]
_HOMES: Final = {
    "CATALOG": "policies.primitives.catalog",
    "NOT_COLLECTED": "policies.evidence.evidence",
    "PARAMETERS": "policies.words.parameters",
    "REASONS": "policies.words.reason_table",
    "ROWS": "policies.primitives.catalog",
    "SHIPPED": "policies.decision.load",
    "ApprovalReading": "policies.evidence.evidence",
    "ApprovalUse": "policies.evidence.model",
    "CatalogRow": "policies.primitives.catalog_row",
    "Contribution": "policies.evidence.evidence",
    "Decision": "policies.evidence.model",
    "DeclaredImpact": "policies.evidence.evidence",
    "Effect": "policies.evidence.model",
    "Evidence": "policies.evidence.evidence",
    "Finding": "policies.evidence.model",
    "ImpactFault": "policies.evidence.evidence",
    "ImpactReading": "policies.evidence.evidence",
    "Means": "policies.explain.remedies",
    "NotCollected": "policies.evidence.evidence",
    "Object": "policies.decision.policy",
    "Obligation": "policies.evidence.model",
    "ObligationKind": "policies.evidence.model",
    "OpeningReading": "policies.evidence.evidence",
    "Parameters": "policies.words.parameters",
    "Point": "policies.evidence.model",
    "Policy": "policies.decision.policy",
    "PolicyError": "policies.words.errors",
    "PolicyFault": "policies.words.errors",
    "PolicySet": "policies.decision.policy",
    "Reason": "policies.words.reason_table",
    "Remedy": "policies.explain.remedies",
    "Request": "policies.evidence.model",
    "Requirement": "policies.decision.policy",
    "RobotReading": "policies.evidence.evidence",
    "Subject": "policies.decision.policy",
    "ToolReading": "policies.evidence.evidence",
    "TrustReading": "policies.evidence.evidence",
    "chain_trust": "policies.conduct.trust",
    "decide": "policies.decision.pdp",
    "edge_trust": "policies.conduct.trust",
    "load": "policies.decision.load",
    "load_shipped": "policies.decision.load",
    "remedies": "policies.explain.remedies",
    "requirement": "policies.decision.policy",
}
"""Module of each name, and behind a colon the name that it has there, where it is another."""

if not TYPE_CHECKING:  # a type checker would take any name

    def __getattr__(name: str) -> Any:
        # Loaded when asked for: who wants one word of it loads no token library.
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        module, _, theirs = _HOMES[name].partition(":")
        value = globals()[name] = getattr(import_module(module), theirs or name)
        return value
