"""Changes of trust by an act: one row for each reason, with the sentence that says why.

**The edge that is charged.** It is the edge into the agent that acted, and no other. Delegators are not charged: trust
does not flow along the chain, so neither does blame (CATP-1). Otherwise a delegate could pull down the agent that it
works for. A delegator lends no more than its own scope, and the chain is as weak as its weakest edge in any case.

**Acts that nobody is charged for.** A stranger can bring some refusals about by using another agent's name (a bad
signature, another key's proof, a late copy). The world or the house brings others about (a person walked in, the feed
was down). Some follow from low trust itself, which would otherwise feed on itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Mapping

    from policies.conduct.report import Report

UNIT: Final = 1_000
"""Charges are in thousandths of one plain wrong."""


@dataclass(frozen=True, slots=True)
class TrustChange:
    """Charge of one refusal against the edge, in thousandths, and its reason."""

    milli: int
    because: str


_STRANGER: Final = TrustChange(0, "Nobody is proven to have sent it: a stranger could use any agent's name.")
_COPY: Final = TrustChange(0, "An eavesdropper can send an agent's own bytes late, or elsewhere.")
_HOUSE: Final = TrustChange(0, "The house or the world brought it about, not the agent.")
_WAITING: Final = TrustChange(0, "Time or a person has to do something; asking meanwhile is no wrong.")
_CONSEQUENCE: Final = TrustChange(0, "It follows from low trust or a deviation: charging it would feed on itself.")
_VICTIM: Final = TrustChange(0, "Somebody else wrote the text: whoever poisons a text must not choose who is charged.")
_SLIP: Final = TrustChange(50, "An honest agent gets a number wrong now and then: twenty slips are one wrong.")
_PHYSICS: Final = TrustChange(200, "The world surprised its planner, or it tried: five times is one wrong.")
_WRONG: Final = TrustChange(1_000, "An agent knows what it was lent; it asked for something else.")
_PERSON: Final = TrustChange(1_000, "A person looked at what it wanted and said no.")
_AGAIN: Final = TrustChange(
    1_000, "The proof is the agent's own, used twice; only that it sent it itself is not proven."
)
_BEYOND: Final = TrustChange(5_000, "It tried to get, or to pass on, more authority than it has.")
_UNLISTED: Final = TrustChange(50, "A refusal of which nothing is known counts as a slip.")

CHARGES: Final[Mapping[str, TrustChange]] = MappingProxyType(
    {
        Reason.NOT_A_NUMBER: _SLIP,
        Reason.NOT_FINITE: _SLIP,
        Reason.NOT_ON_GRID: _SLIP,
        Reason.OUT_OF_RANGE: _SLIP,
        Reason.TOKEN_MISSING: _STRANGER,
        Reason.TOKEN_TOO_LARGE: _STRANGER,
        Reason.TOKEN_MALFORMED: _STRANGER,
        Reason.TOO_MANY_HOPS: _STRANGER,
        Reason.SIGNATURE_INVALID: _STRANGER,
        Reason.UNKNOWN_ROOT_KEY: _STRANGER,
        Reason.HOP_NOT_ATTESTED: _STRANGER,
        Reason.NOT_CANONICAL: _STRANGER,
        Reason.WRONG_PROFILE: _STRANGER,
        Reason.CHAIN_BROKEN: _STRANGER,
        Reason.NOT_NARROWER: _BEYOND,
        Reason.NOT_YET_VALID: _WAITING,
        Reason.EXPIRED: _WAITING,
        Reason.LIFETIME_TOO_LONG: _SLIP,
        Reason.WRONG_AUDIENCE: _COPY,
        Reason.REVOKED: _WAITING,
        Reason.REVOCATION_VIEW_STALE: _HOUSE,
        Reason.PROOF_MISSING: _STRANGER,
        Reason.PROOF_MALFORMED: _STRANGER,
        Reason.PROOF_WRONG_KEY: _STRANGER,
        Reason.PROOF_STALE: _COPY,
        Reason.PROOF_NOT_FOR_THIS_REQUEST: _COPY,
        Reason.REPLAYED: _AGAIN,
        Reason.NOT_GRANTED: _WRONG,
        Reason.PARAMETERS_WRONG: _SLIP,
        Reason.LIMIT_EXCEEDED_BY_REQUEST: _SLIP,
        Reason.ABOVE_CEILING: _SLIP,
        Reason.DELEGATE_NOT_ALLOWED: _BEYOND,
        Reason.LIMIT_EXCEEDED: _HOUSE,
        Reason.ENGINES_DISAGREE: _HOUSE,
        Reason.STATEMENT_MALFORMED: _STRANGER,
        Reason.STATEMENT_WRONG_KIND: _STRANGER,
        Reason.STATEMENT_UNTRUSTED: _STRANGER,
        Reason.KEY_MALFORMED: _STRANGER,
        Reason.KEY_WRONG_ROLE: _STRANGER,
        Reason.ATTESTATION_INVALID: _STRANGER,
        Reason.PERMITTED: _HOUSE,
        Reason.NO_POLICY: _HOUSE,
        Reason.POLICY_ERROR: _HOUSE,
        Reason.PROHIBITED: _SLIP,
        Reason.APPROVAL_REQUIRED: _WAITING,
        Reason.EVIDENCE_MISSING: _HOUSE,
        Reason.SPONSOR_AUTHENTICATION_OLD: _WAITING,
        Reason.ATTESTATION_OLD: _WAITING,
        Reason.CHAIN_OUT_OF_BOUNDS: _WAITING,
        Reason.ROBOT_LIMIT: _SLIP,
        Reason.TOOL_UNKNOWN: _HOUSE,
        Reason.TOOL_DEFINITION_CHANGED: _HOUSE,
        Reason.TRUST_TOO_LOW: _CONSEQUENCE,
        Reason.TIER_NEEDS_APPROVAL: _WAITING,
        Reason.TIER_SAFETY_CRITICAL: _SLIP,
        Reason.PHYSICS_VIOLATION: _PHYSICS,
        Reason.PHYSICS_FAULT: _HOUSE,
        Reason.UNPROVEN: _SLIP,
        Reason.PERCEPTION_INVALID: _HOUSE,
        Reason.PERCEPTION_MISSING: _HOUSE,
        Reason.ROBOT_LATCHED: _WAITING,
        Reason.ROBOT_SAFETY_STOP: _HOUSE,
        Reason.ROBOT_NOT_RUNNING: _HOUSE,
        Reason.ROBOT_NOT_REMOTE: _HOUSE,
        Reason.ROBOT_NOT_EXCLUSIVE: _HOUSE,
        Reason.PAYLOAD_MISMATCH: _HOUSE,
        Reason.FRAMES_MISMATCH: _HOUSE,
        Reason.APPROVAL_DENIED: _PERSON,
        Reason.APPROVED_TOO_FAST: _SLIP,
        Reason.APPROVAL_USED: _SLIP,
        Reason.APPROVAL_NOT_USABLE: _WAITING,
        Reason.INSTRUCTION_UNAUTHENTIC: _STRANGER,
        Reason.INSTRUCTION_MALFORMED: _SLIP,
        Reason.INSTRUCTION_OLD: _WAITING,
        Reason.INTENT_NOT_BOUND: _WRONG,
        Reason.TEXT_WITHOUT_AUTHORITY: _VICTIM,
        Reason.TEXT_SUSPICIOUS: _VICTIM,
        Reason.DOCUMENT_UNSIGNED: _VICTIM,
        Reason.DOCUMENT_NOT_LISTED: _VICTIM,
        Reason.MANIFEST_OLD: _HOUSE,
        Reason.PROVENANCE_MISSING: _SLIP,
        Reason.RESPONSE_MISMATCH: _VICTIM,
        Reason.ARGUMENT_NOT_VOUCHED: _SLIP,
        Reason.MESSAGE_UNAUTHENTIC: _STRANGER,
        Reason.MESSAGE_MALFORMED: _SLIP,
        Reason.MESSAGE_MISDIRECTED: _COPY,
        Reason.MESSAGE_OUT_OF_SEQUENCE: _COPY,
        Reason.MESSAGE_OUT_OF_DELEGATION: _BEYOND,
        Reason.MESSAGE_OLD: _COPY,
        Reason.SEQUENCE_DRIFT: _HOUSE,
        Reason.SEQUENCE_ALTERNATES: _PHYSICS,
        Reason.SEQUENCE_UNKNOWN: _HOUSE,
        Reason.SEQUENCE_TOO_HIGH: _PHYSICS,
        Reason.SEQUENCE_NEEDS_APPROVAL: _WAITING,
        Reason.TRUST_NOT_OF_EDGE: _HOUSE,
        Reason.BEHAVIOUR_DEVIATES: _CONSEQUENCE,
        Reason.BEHAVIOUR_DRIFTS: _CONSEQUENCE,
        Reason.BEHAVIOUR_OLD: _HOUSE,
        Reason.REATTESTATION_NEEDED: _CONSEQUENCE,
        Reason.SCOPE_CONTRACTED: _CONSEQUENCE,
        Reason.APPROVAL_TIMEOUT: _WAITING,
        Reason.ASK_BUDGET_SPENT: _SLIP,
        Reason.BUDGET_SPENT: _WAITING,
        Reason.BUSY: _WAITING,
        Reason.LEASE_HELD: _WAITING,
        Reason.LEASE_UNKNOWN: _SLIP,
        Reason.LEASE_OF_ANOTHER: _WRONG,
        Reason.MANDATE_MISSING: _SLIP,
        Reason.MANDATE_DIFFERS: _SLIP,
        Reason.VERDICT_EXPIRED: _HOUSE,
        Reason.NOT_WHAT_WAS_DECIDED: _WRONG,
        Reason.RECORD_FAILED: _HOUSE,
        Reason.OBLIGATION_UNMET: _HOUSE,
        Reason.BODY_MALFORMED: _SLIP,
        Reason.BODY_TOO_LARGE: _SLIP,
        Reason.EVIDENCE_MALFORMED: _HOUSE,
        Reason.EFFECT_FAILED: _HOUSE,
        Reason.IMPACT_ROSE: _HOUSE,
        Reason.WATCH_BLIND: _HOUSE,
        Reason.WATCH_LATE: _HOUSE,
        Reason.LED_OUT_OF_BOUNDS: _HOUSE,
        Reason.LIMITS_LOWERED: _WAITING,
        Reason.TICKET_MISSING: _STRANGER,
        Reason.GATEWAY_UNREACHABLE: _HOUSE,
        Reason.UPSTREAM_UNREACHABLE: _HOUSE,
        Reason.SUBJECT_NOT_HOLDER: _STRANGER,
        Reason.NOT_EVALUATED: _HOUSE,
    }
)
"""Charge against the edge for a refusal, by reason."""

CREDITS_MILLI: Final = (0, 500, 1_000, 1_000, 1_000)
"""Credit of a done act for the edge, by tier.

Looking costs nothing, so it earns nothing: nobody can buy back an attack with a thousand reads.
"""


def charge(report: Report) -> TrustChange:
    """Charge of a report against the edge.

    Only refusals count, and permits that were not carried out.
    """
    if report.effect == "DENY":
        return CHARGES.get(report.reason, _UNLISTED)
    return CHARGES.get(report.reason, _HOUSE) if report.outcome in {"failed", "refused"} else _HOUSE


def credit_milli(report: Report) -> int:
    """Credit of a report for the edge, in thousandths."""
    tier = report.tier
    return CREDITS_MILLI[tier] if report.outcome == "done" and tier is not None else 0
