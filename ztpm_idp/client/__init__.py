"""The identity provider as programs of people and agents call it: `Agent`, `Operator` and their errors."""

from ztpm_idp.client.caller import ClientError, Issued, Revocation
from ztpm_idp.client.callers import Agent, Evidence, Operator, delegate_request, issue_request
from ztpm_idp.client.denials import Deferred, Denied, raise_refused, refusal_in
from ztpm_idp.client.dpop_auth import DPoPAuth
from ztpm_idp.client.renewal import Renewal, RenewingAuth
from ztpm_idp.client.signing import ProofAuth

__all__ = [
    "Agent",
    "ClientError",
    "DPoPAuth",
    "Deferred",
    "Denied",
    "Evidence",
    "Issued",
    "Operator",
    "ProofAuth",
    "Renewal",
    "RenewingAuth",
    "Revocation",
    "delegate_request",
    "issue_request",
    "raise_refused",
    "refusal_in",
]
