"""The identity provider as programs of people and agents call it: `Agent`, `Operator` and their errors."""

from ztpm_idp.client.callers import (
    Agent,
    ClientError,
    Evidence,
    Issued,
    Operator,
    ProofAuth,
    delegate_request,
    issue_request,
)

__all__ = [
    "Agent",
    "ClientError",
    "Evidence",
    "Issued",
    "Operator",
    "ProofAuth",
    "delegate_request",
    "issue_request",
]
