"""What is decided: 25 primitives, 7-tuple policies, tiers, trust, and the one pure function `decide`."""

from policies.catalog import CATALOG, ROWS
from policies.counsel import Means, Remedy, remedies
from policies.errors import PolicyError, PolicyFault
from policies.evidence import (
    NOT_COLLECTED,
    ApprovalReading,
    Contribution,
    Evidence,
    ImpactFault,
    ImpactReading,
    NotCollected,
    OpeningReading,
    RobotReading,
    ToolReading,
    TrustReading,
)
from policies.load import SHIPPED, load, load_shipped
from policies.model import ApprovalUse, Decision, Effect, Finding, Obligation, ObligationKind, Point, Request
from policies.parameters import PARAMETERS, Parameters
from policies.pdp import decide
from policies.policy import Object, Policy, PolicySet, Requirement, Subject, requirement
from policies.reasons import REASONS, Reason
from policies.row import Row
from policies.trust import chain_trust, edge_trust

__all__ = [
    "CATALOG",
    "NOT_COLLECTED",
    "PARAMETERS",
    "REASONS",
    "ROWS",
    "SHIPPED",
    "ApprovalReading",
    "ApprovalUse",
    "Contribution",
    "Decision",
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
    "Row",
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
