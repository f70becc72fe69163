"""Decisions: 25 primitives, 7-tuple policies, tiers, trust, and the one pure function `decide`."""

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
from policies.evidence.model import ApprovalUse, Decision, Effect, Finding, Obligation, ObligationKind, Point, Request
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
