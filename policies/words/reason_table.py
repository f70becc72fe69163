"""Texts about each reason, safe for strangers too, and the order in which reasons lead a decision."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["PRECEDENCE", "REASONS", "Reason", "ReasonRow", "reasons_of"]


@dataclass(frozen=True, slots=True)
class ReasonRow:
    """Texts and owners of one reason.

    Attributes:
        text: one fixed sentence, safe for strangers: no name, number or limit of this request.
        remedy: an act of the holder that may help.
        owners: ids of the primitives that find it, the one that leads first; empty for one that no primitive finds.
    """

    text: str
    remedy: str
    owners: tuple[str, ...] = ()


_RENEW = "Ask the delegator, or the sponsor, for a new token."
_PROVE = "Sign a new proof with the key of the token's last hop, for exactly this request."
_SEND = "Send every parameter of the operation, of its own kind; a number is finite and on its unit's grid."
_AT_THE_ROBOT = "A person looks at the robot and sets it right; no approval replaces that."
_REPORT = "Nothing the caller can do; the record holds the cause for the operator."
_AFRESH = "Ask again: the motion is decided afresh in the world as it is now."

REASONS: Final[Mapping[Reason, ReasonRow]] = MappingProxyType(
    {
        Reason.NOT_A_NUMBER: ReasonRow("A parameter is not a number.", _SEND, ("TEA-2",)),
        Reason.NOT_FINITE: ReasonRow("A number is not finite.", _SEND, ("TEA-2", "TEA-4")),
        Reason.NOT_ON_GRID: ReasonRow("A parameter is finer than its unit.", _SEND, ("TEA-2",)),
        Reason.OUT_OF_RANGE: ReasonRow("A number is outside what can be represented.", _SEND, ("TEA-2", "TEA-4")),
        Reason.TOKEN_MISSING: ReasonRow("No token was presented.", "Present a token and a proof.", ("AID-1",)),
        Reason.TOKEN_TOO_LARGE: ReasonRow("The token is too large.", "Delegate fewer grants or hops.", ("AID-5",)),
        Reason.TOKEN_MALFORMED: ReasonRow("The token cannot be read.", _RENEW, ("AID-3",)),
        Reason.TOO_MANY_HOPS: ReasonRow("The chain is too long.", "Delegate over fewer hops.", ("AID-5",)),
        Reason.SIGNATURE_INVALID: ReasonRow("A signature is not valid.", _RENEW, ("AID-3",)),
        Reason.UNKNOWN_ROOT_KEY: ReasonRow("The token's root key is not trusted here.", _RENEW, ("AID-3",)),
        Reason.HOP_NOT_ATTESTED: ReasonRow(
            "A hop of the chain was not attested by the identity provider.",
            "Delegate through the identity provider, which attests the delegate.",
            ("CATP-4",),
        ),
        Reason.NOT_CANONICAL: ReasonRow(
            "The token, or an argument, is not in its one canonical form.",
            "Spell the argument in its one form, without hidden characters; where it is the token, renew it.",
            ("AID-3",),
        ),
        Reason.WRONG_PROFILE: ReasonRow("The token is of another profile.", _RENEW, ("AID-3",)),
        Reason.CHAIN_BROKEN: ReasonRow("The chain does not hold together.", _RENEW, ("AID-3", "AID-2")),
        Reason.NOT_NARROWER: ReasonRow(
            "A hop of the chain is not narrower than its parent.",
            "Delegate strictly less than what is held.",
            ("CATP-2", "AID-4"),
        ),
        Reason.NOT_YET_VALID: ReasonRow("The token is not valid yet.", "Wait until its window begins.", ("AID-3",)),
        Reason.EXPIRED: ReasonRow("The token has expired.", _RENEW, ("AID-3",)),
        Reason.LIFETIME_TOO_LONG: ReasonRow(
            "The token lives longer than is allowed.", "Ask for a shorter window.", ("AID-5",)
        ),
        Reason.WRONG_AUDIENCE: ReasonRow(
            "The token is not for this server.", "Ask for a token that names this server.", ("AID-5",)
        ),
        Reason.REVOKED: ReasonRow("The authority was revoked.", _RENEW, ("AID-3", "AID-2")),
        Reason.REVOCATION_VIEW_STALE: ReasonRow(
            "The enforcement point's view of revocations is too old.", "Try again once the feed is back.", ("AID-3",)
        ),
        Reason.PROOF_MISSING: ReasonRow("No proof of possession was presented.", _PROVE, ("AID-1",)),
        Reason.PROOF_MALFORMED: ReasonRow("The proof of possession cannot be read.", _PROVE, ("AID-1",)),
        Reason.PROOF_WRONG_KEY: ReasonRow("The proof is not by the holder of the token.", _PROVE, ("AID-1",)),
        Reason.PROOF_STALE: ReasonRow("The proof is too old, or from the future.", _PROVE, ("AID-1",)),
        Reason.PROOF_NOT_FOR_THIS_REQUEST: ReasonRow("The proof is for another request.", _PROVE, ("AID-1",)),
        Reason.REPLAYED: ReasonRow("The proof was used before.", _PROVE, ("AID-1",)),
        Reason.NOT_GRANTED: ReasonRow(
            "The token does not grant this operation.",
            "Ask the delegator for this grant; where no operation stands for a command, nobody can give it.",
            ("TEA-1",),
        ),
        Reason.PARAMETERS_WRONG: ReasonRow(
            "The parameters are not those of the operation.",
            "Send exactly the operation's parameters, each in its unit.",
            ("TEA-2",),
        ),
        Reason.LIMIT_EXCEEDED_BY_REQUEST: ReasonRow(
            "A parameter is outside what the token allows.",
            "Stay inside the limit, or ask the hop that set it for more.",
            ("TEA-2",),
        ),
        Reason.ABOVE_CEILING: ReasonRow(
            "The physical impact is above the token's ceiling.",
            "Reduce speed, or keep away from people and fragile things; no approval raises a ceiling.",
            ("TEA-4",),
        ),
        Reason.DELEGATE_NOT_ALLOWED: ReasonRow(
            "The delegate may not hold this authority.", "Delegate to an agent that the scope names.", ("CATP-4",)
        ),
        Reason.LIMIT_EXCEEDED: ReasonRow("The token takes too long to evaluate.", _RENEW, ("AID-3", "TEA-1")),
        Reason.ENGINES_DISAGREE: ReasonRow("Two independent computations disagree.", _REPORT, ("TEA-4", "TEA-1")),
        Reason.STATEMENT_MALFORMED: ReasonRow("A signed statement cannot be read.", _REPORT, ("AID-3", "TEA-4")),
        Reason.STATEMENT_WRONG_KIND: ReasonRow("A signed statement is of another kind.", _REPORT, ("AID-3", "TEA-4")),
        Reason.STATEMENT_UNTRUSTED: ReasonRow(
            "A statement is not signed by a trusted key.", _REPORT, ("AID-3", "TEA-4")
        ),
        Reason.KEY_MALFORMED: ReasonRow("A key cannot be read.", "Register a valid Ed25519 or P-256 key.", ("AID-1",)),
        Reason.KEY_WRONG_ROLE: ReasonRow(
            "A key is used outside its role.", "Use the key of the right role.", ("AID-1",)
        ),
        Reason.ATTESTATION_INVALID: ReasonRow(
            "An attestation is not valid.", "Attest again through the identity provider.", ("CATP-4",)
        ),
        Reason.PERMITTED: ReasonRow("Permitted.", "Nothing is needed."),
        Reason.NO_POLICY: ReasonRow("No policy permits this.", "Ask the operator for a policy that covers it."),
        Reason.POLICY_ERROR: ReasonRow("A policy could not be evaluated.", _REPORT),
        Reason.PROHIBITED: ReasonRow("A policy forbids this.", "Ask the operator who wrote the policy."),
        Reason.APPROVAL_REQUIRED: ReasonRow("A policy wants a person's approval.", "Wait for a person's answer."),
        Reason.EVIDENCE_MISSING: ReasonRow("Evidence that the decision needs is missing.", _REPORT),
        Reason.EVIDENCE_MALFORMED: ReasonRow("A reading is not of the shape that it declares.", _REPORT),
        Reason.SPONSOR_AUTHENTICATION_OLD: ReasonRow(
            "The human sponsor has not been authenticated recently enough.",
            "The sponsor logs in again and issues a new token.",
            ("AID-2",),
        ),
        Reason.ATTESTATION_OLD: ReasonRow(
            "An agent of the chain has not been attested recently enough.",
            "Attest again, and delegate anew.",
            ("AID-1", "CATP-4"),
        ),
        Reason.CHAIN_OUT_OF_BOUNDS: ReasonRow(
            "The chain is outside this policy's bounds.", "Delegate over fewer hops, for a shorter time.", ("AID-5",)
        ),
        Reason.ROBOT_LIMIT: ReasonRow(
            "A parameter is outside what the robot can do.", "Stay inside the robot's own limit.", ("TEA-2", "TEA-4")
        ),
        Reason.TOOL_UNKNOWN: ReasonRow(
            "The tool is not registered.", "An administrator registers the tool.", ("TEA-3",)
        ),
        Reason.TOOL_DEFINITION_CHANGED: ReasonRow(
            "The tool's definition is not the approved one.", "An administrator reviews and registers it.", ("TEA-3",)
        ),
        Reason.TRUST_TOO_LOW: ReasonRow(
            "Trust in the chain is too low for this impact.",
            "Wait for a person's answer, or lower the impact to tier 1.",
            ("CATP-3",),
        ),
        Reason.TIER_NEEDS_APPROVAL: ReasonRow(
            "The physical impact needs a person's approval.",
            "Wait for a person's answer, or lower the impact.",
            ("TEA-4",),
        ),
        Reason.TIER_SAFETY_CRITICAL: ReasonRow(
            "The physical impact is safety critical.",
            "Lower the impact; two people can authorise it beforehand.",
            ("TEA-4",),
        ),
        Reason.PHYSICS_VIOLATION: ReasonRow(
            "The motion breaks a physical rule that no authority lifts.",
            "Choose another path, or clear the cell.",
            ("TEA-4",),
        ),
        Reason.PHYSICS_FAULT: ReasonRow("The physical impact could not be computed.", _REPORT, ("TEA-4",)),
        Reason.UNPROVEN: ReasonRow(
            "The motion could not be proven to its end.",
            "Ask for the motion another way: a shorter line, another path, or a joint move.",
            ("TEA-4",),
        ),
        Reason.PERCEPTION_INVALID: ReasonRow("The view of the cell must not be believed.", _REPORT, ("CII-4", "TEA-4")),
        Reason.PERCEPTION_MISSING: ReasonRow(
            "There is no fresh view of what this depends on.",
            "Wait for a person's answer, or for the sensor.",
            ("TEA-4",),
        ),
        Reason.ROBOT_LATCHED: ReasonRow(
            "The robot was stopped, and waits for a person to clear it.",
            "A person looks at the cell and clears the latch with `ztpm latch clear`; then ask again.",
        ),
        Reason.ROBOT_SAFETY_STOP: ReasonRow("The robot is stopped for safety.", _AT_THE_ROBOT, ("TEA-5",)),
        Reason.ROBOT_NOT_RUNNING: ReasonRow("The robot is not running, or says nothing.", _AT_THE_ROBOT, ("TEA-5",)),
        Reason.ROBOT_NOT_REMOTE: ReasonRow(
            "The robot is not known to be in remote control.", _AT_THE_ROBOT, ("TEA-5",)
        ),
        Reason.ROBOT_NOT_EXCLUSIVE: ReasonRow(
            "The enforcement point is not known to command the robot alone.",
            "Wait until the program that has the lease ends; where none has it, a person looks at the robot.",
            ("TEA-5",),
        ),
        Reason.PAYLOAD_MISMATCH: ReasonRow(
            "The robot reckons with another payload than is known to be carried.", _AT_THE_ROBOT, ("TEA-5",)
        ),
        Reason.FRAMES_MISMATCH: ReasonRow("The robot's frames are not those of its model.", _AT_THE_ROBOT, ("TEA-5",)),
        Reason.APPROVAL_DENIED: ReasonRow("A person denied this.", "Ask for something else."),
        Reason.APPROVED_TOO_FAST: ReasonRow(
            "What people approved is faster than an approved act may be.", "Ask for a lower speed."
        ),
        Reason.APPROVAL_USED: ReasonRow("The approval for this is used up.", "Wait for a person's new answer."),
        Reason.APPROVAL_NOT_USABLE: ReasonRow(
            "The approval does not fit what is so now.", "Wait for a person's new answer, or restore what was shown."
        ),
        Reason.INSTRUCTION_UNAUTHENTIC: ReasonRow(
            "The instruction is not from an authenticated person.", "A person signs the instruction.", ("CII-1",)
        ),
        Reason.INSTRUCTION_MALFORMED: ReasonRow(
            "The instruction is not well formed.", "State it in its schema, with finite numbers.", ("CII-1",)
        ),
        Reason.INSTRUCTION_OLD: ReasonRow("The instruction is too old.", "A person states it again.", ("CII-1",)),
        Reason.INTENT_NOT_BOUND: ReasonRow(
            "The delegation is not bound to what the person signed.",
            "Delegate with the digest of the person's intent.",
            ("CII-1",),
        ),
        Reason.TEXT_WITHOUT_AUTHORITY: ReasonRow(
            "A text that is not from a principal was offered as authority.",
            "Use it as content; a person gives instructions.",
            ("CII-2",),
        ),
        Reason.TEXT_SUSPICIOUS: ReasonRow(
            "A text has instructions or hidden characters in it.",
            "Leave it out, or have a curator look at it and sign it.",
            ("CII-2",),
        ),
        Reason.DOCUMENT_UNSIGNED: ReasonRow(
            "A document is not signed by a curator, or was changed.", "A curator signs the document.", ("CII-3",)
        ),
        Reason.DOCUMENT_NOT_LISTED: ReasonRow(
            "A document is not in the audited manifest.", "A curator lists the document.", ("CII-3",)
        ),
        Reason.MANIFEST_OLD: ReasonRow(
            "The manifest of the documents is too old.", "A curator signs the manifest again.", ("CII-3",)
        ),
        Reason.PROVENANCE_MISSING: ReasonRow(
            "Nobody who may vouches for what would be remembered or returned.",
            "Write it under a token that grants writing, through the enforcement point.",
            ("CII-5",),
        ),
        Reason.RESPONSE_MISMATCH: ReasonRow(
            "A tool's response is not that of the approved tool to this request.", "Call the tool again.", ("CII-5",)
        ),
        Reason.ARGUMENT_NOT_VOUCHED: ReasonRow(
            "An argument derives from something that is not believed for this impact.",
            "Take the value from a person, a sensor or a signed document, or lower the impact.",
            ("CII-5",),
        ),
        Reason.MESSAGE_UNAUTHENTIC: ReasonRow(
            "The message is not signed by the holder that it names.",
            "The sender signs it with its own key.",
            ("CII-6",),
        ),
        Reason.MESSAGE_MALFORMED: ReasonRow("The message is not of its schema.", "Send it in its schema.", ("CII-6",)),
        Reason.MESSAGE_MISDIRECTED: ReasonRow(
            "The message is for somebody else.", "Address it to the receiver.", ("CII-6",)
        ),
        Reason.MESSAGE_OUT_OF_SEQUENCE: ReasonRow(
            "The message is out of sequence.", "Send each message once, in order.", ("CII-6",)
        ),
        Reason.MESSAGE_OUT_OF_DELEGATION: ReasonRow(
            "The message asks for more than its delegation holds.", "Ask for what was delegated.", ("CII-6",)
        ),
        Reason.MESSAGE_OLD: ReasonRow("The message is too old.", "Send it again.", ("CII-6",)),
        Reason.SEQUENCE_DRIFT: ReasonRow(
            "The arm is not where the sequence assumes.",
            "Read the state, and ask from there. A program that has the lease is begun again.",
            ("TEA-6",),
        ),
        Reason.SEQUENCE_ALTERNATES: ReasonRow(
            "Acts undo each other too often.", "Wait, or ask for one act that does it.", ("TEA-6",)
        ),
        Reason.SEQUENCE_UNKNOWN: ReasonRow("What the gripper holds is not known.", _AT_THE_ROBOT, ("TEA-6",)),
        Reason.SEQUENCE_TOO_HIGH: ReasonRow(
            "The acts taken together have more impact than the token allows.",
            "Wait, slow down, or keep away from people and fragile things.",
            ("TEA-6",),
        ),
        Reason.SEQUENCE_NEEDS_APPROVAL: ReasonRow(
            "The acts taken together need a person's approval.",
            "Wait for a person's answer, or let time pass between the acts.",
            ("TEA-6",),
        ),
        Reason.TRUST_NOT_OF_EDGE: ReasonRow(
            "Trust was stated for another edge than the chain's, or for more than its weakest.", _REPORT, ("CATP-1",)
        ),
        Reason.BEHAVIOUR_DEVIATES: ReasonRow(
            "The agent does not behave as usual.", "Wait for a person's answer.", ("ABG-1",)
        ),
        Reason.BEHAVIOUR_DRIFTS: ReasonRow(
            "The agent's acts draw near to a bound.", "A person looks at it and restores the agent.", ("ABG-2",)
        ),
        Reason.BEHAVIOUR_OLD: ReasonRow(
            "What is known of the agent's behaviour is too old.",
            "Try again once the feed is back.",
            ("ABG-1", "ABG-2", "ABG-3", "ABG-4"),
        ),
        Reason.REATTESTATION_NEEDED: ReasonRow(
            "The agent has to be attested again after it deviated.", "Attest again, and delegate anew.", ("ABG-3",)
        ),
        Reason.SCOPE_CONTRACTED: ReasonRow(
            "The agent holds the minimum safe set after it deviated.", "A person restores the agent.", ("ABG-4",)
        ),
        Reason.ASK_BUDGET_SPENT: ReasonRow(
            "People are asked too often.", "Wait until earlier questions are answered or over."
        ),
        Reason.BUDGET_SPENT: ReasonRow(
            "The budget of this operation is spent.", "Ask for less, or wait until there is more."
        ),
        Reason.APPROVAL_TIMEOUT: ReasonRow("Nobody answered in time.", "Ask again while an approver is present."),
        Reason.BUSY: ReasonRow("A motion is not finished.", "Wait until it ends, or stop it.", ("TEA-6", "TEA-4")),
        Reason.LEASE_HELD: ReasonRow(
            "Somebody else holds the motion lease of this robot, or a tool is moving it.",
            "Ask again when that is over.",
        ),
        Reason.LEASE_UNKNOWN: ReasonRow("No open lease has this id.", "Open a lease."),
        Reason.LEASE_OF_ANOTHER: ReasonRow(
            "The lease was opened by another agent, or with another key.", "Renew it as the agent that opened it."
        ),
        Reason.MANDATE_MISSING: ReasonRow(
            "A lease is renewed only between tokens of one mandate, and one of the two is of none.",
            "Have a mandate signed, and open the lease with a token that was drawn from it.",
        ),
        Reason.MANDATE_DIFFERS: ReasonRow(
            "The token was drawn from another mandate than the one the lease was opened with.",
            "Draw a token from the lease's mandate, or open a lease of its own.",
        ),
        Reason.VERDICT_EXPIRED: ReasonRow("The decision was too old to act on.", "Send the request again."),
        Reason.NOT_WHAT_WAS_DECIDED: ReasonRow("What was about to be sent is not what was decided.", _REPORT),
        Reason.RECORD_FAILED: ReasonRow("The decision could not be recorded.", _REPORT),
        Reason.OBLIGATION_UNMET: ReasonRow(
            "A permit would oblige to something that is not done here.",
            "Ask the operator for a policy that obliges to what this point does.",
        ),
        Reason.BODY_MALFORMED: ReasonRow("The request cannot be read.", "Send well-formed JSON, each key once."),
        Reason.BODY_TOO_LARGE: ReasonRow("The request is too large.", "Send less."),
        Reason.EFFECT_FAILED: ReasonRow("The effect did not happen as decided.", _REPORT),
        Reason.IMPACT_ROSE: ReasonRow(
            "The world changed: what was left of the motion had more impact than was authorised.", _AFRESH
        ),
        Reason.WATCH_BLIND: ReasonRow("The view of the cell was lost during the motion.", _AFRESH),
        Reason.WATCH_LATE: ReasonRow("The moving arm could not be looked at often enough.", _AFRESH),
        Reason.LED_OUT_OF_BOUNDS: ReasonRow(
            "The arm, led by a force or a hand, went faster or farther than was granted.",
            "Lead it more slowly, or begin nearer; a wider grant has to be lent.",
        ),
        Reason.LIMITS_LOWERED: ReasonRow(
            "The command goes on, with lower limits than it asked for.",
            "Ask for no more than the grant has; a wider one has to be lent.",
        ),
        Reason.TICKET_MISSING: ReasonRow(
            "No tool server of this cell passed the request on.", "Send the request to the cell's tool server."
        ),
        Reason.GATEWAY_UNREACHABLE: ReasonRow(
            "The robot's gateway does not answer.", "Try again; where it stays so, the operator looks at the gateway."
        ),
        Reason.UPSTREAM_UNREACHABLE: ReasonRow(
            "The tool's own server does not answer.", "Try again; where it stays so, the operator looks at that server."
        ),
        Reason.SUBJECT_NOT_HOLDER: ReasonRow(
            "The subject is not the agent that holds the token.",
            "Ask about the token's last agent, as a subject of type `agent`.",
        ),
        Reason.NOT_EVALUATED: ReasonRow("The time of the request was over before this one's turn.", "Ask about fewer."),
    }
)
"""Every reason with its fixed text, remedy and owners."""

PRECEDENCE: Final[tuple[Reason, ...]] = (
    # first the faults of the authority, in the order in which verification finds them
    *(r for r in tuple(Reason)[tuple(Reason).index(Reason.TOKEN_MISSING) : tuple(Reason).index(Reason.NOT_GRANTED)]),
    Reason.KEY_MALFORMED,
    Reason.KEY_WRONG_ROLE,
    Reason.ATTESTATION_INVALID,
    Reason.DELEGATE_NOT_ALLOWED,
    Reason.CHAIN_OUT_OF_BOUNDS,
    Reason.SPONSOR_AUTHENTICATION_OLD,
    Reason.ATTESTATION_OLD,
    Reason.TRUST_NOT_OF_EDGE,
    Reason.REATTESTATION_NEEDED,
    # then the texts and their authors
    Reason.INSTRUCTION_UNAUTHENTIC,
    Reason.INSTRUCTION_MALFORMED,
    Reason.INSTRUCTION_OLD,
    Reason.INTENT_NOT_BOUND,
    Reason.MESSAGE_UNAUTHENTIC,
    Reason.MESSAGE_MALFORMED,
    Reason.MESSAGE_MISDIRECTED,
    Reason.MESSAGE_OUT_OF_SEQUENCE,
    Reason.MESSAGE_OUT_OF_DELEGATION,
    Reason.MESSAGE_OLD,
    Reason.DOCUMENT_UNSIGNED,
    Reason.DOCUMENT_NOT_LISTED,
    Reason.MANIFEST_OLD,
    Reason.PROVENANCE_MISSING,
    Reason.RESPONSE_MISMATCH,
    Reason.TEXT_WITHOUT_AUTHORITY,
    Reason.TEXT_SUSPICIOUS,
    # then the tool, the grant and the parameters
    Reason.TOOL_UNKNOWN,
    Reason.TOOL_DEFINITION_CHANGED,
    Reason.LIMIT_EXCEEDED,
    Reason.NOT_GRANTED,
    Reason.NOT_A_NUMBER,
    Reason.NOT_FINITE,
    Reason.NOT_ON_GRID,
    Reason.OUT_OF_RANGE,
    Reason.PARAMETERS_WRONG,
    Reason.LIMIT_EXCEEDED_BY_REQUEST,
    Reason.ROBOT_LIMIT,
    Reason.ARGUMENT_NOT_VOUCHED,
    # then how the agent has behaved
    Reason.SCOPE_CONTRACTED,
    Reason.BEHAVIOUR_DRIFTS,
    Reason.BEHAVIOUR_OLD,
    # then the state of the robot
    Reason.ROBOT_LATCHED,
    Reason.ROBOT_SAFETY_STOP,
    Reason.ROBOT_NOT_RUNNING,
    Reason.ROBOT_NOT_REMOTE,
    Reason.ROBOT_NOT_EXCLUSIVE,
    Reason.PAYLOAD_MISMATCH,
    Reason.FRAMES_MISMATCH,
    # then physics: faults, violations that nothing lifts, the token's ceiling, and questions for people
    Reason.ENGINES_DISAGREE,
    Reason.STATEMENT_MALFORMED,
    Reason.STATEMENT_WRONG_KIND,
    Reason.STATEMENT_UNTRUSTED,
    Reason.PERCEPTION_INVALID,
    Reason.PHYSICS_FAULT,
    Reason.UNPROVEN,
    Reason.BUSY,
    Reason.SEQUENCE_UNKNOWN,
    Reason.SEQUENCE_DRIFT,
    Reason.SEQUENCE_ALTERNATES,
    Reason.PHYSICS_VIOLATION,
    Reason.ABOVE_CEILING,
    Reason.APPROVAL_DENIED,
    Reason.APPROVED_TOO_FAST,
    Reason.APPROVAL_USED,
    Reason.APPROVAL_NOT_USABLE,
    Reason.TIER_SAFETY_CRITICAL,
    Reason.SEQUENCE_TOO_HIGH,
    Reason.PROHIBITED,
    Reason.TIER_NEEDS_APPROVAL,
    Reason.SEQUENCE_NEEDS_APPROVAL,
    Reason.PERCEPTION_MISSING,
    Reason.BEHAVIOUR_DEVIATES,
    Reason.TRUST_TOO_LOW,
    Reason.APPROVAL_REQUIRED,
    # last, reasons that only say that another fact was not known
    Reason.EVIDENCE_MALFORMED,
    Reason.POLICY_ERROR,
    Reason.NO_POLICY,
    Reason.EVIDENCE_MISSING,
)
"""Order of findings, by which one leads a decision when there are several.

It is total, so no order of policies matters.
"""


def reasons_of(primitive: str) -> tuple[Reason, ...]:
    """The reasons that a primitive can find, in the enum's order."""
    return tuple(reason for reason, row in REASONS.items() if primitive in row.owners)
