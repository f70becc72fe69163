"""Every reason for which the identity provider refuses, closed.

`capabilities.values.errors.FaultCode` joins it for what concerns tokens, `policies.words.reason_table.Reason` for what
policies decide.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from capabilities.values.errors import FaultCode
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from capabilities.values.explanation import Explanation
    from ztpm_idp.domain.events import Event


class IdpCode(StrEnum):
    """Reasons of this package; the values are stable and safe for strangers."""

    # who calls
    CALLER_UNKNOWN = "CALLER_UNKNOWN"
    CALLER_INACTIVE = "CALLER_INACTIVE"
    NOT_PERMITTED = "NOT_PERMITTED"
    # the body
    BODY_MALFORMED = "BODY_MALFORMED"
    BODY_TOO_LARGE = "BODY_TOO_LARGE"
    QUERY_MALFORMED = "QUERY_MALFORMED"
    TEXT_REFUSED = "TEXT_REFUSED"
    # the registry
    ALREADY_REGISTERED = "ALREADY_REGISTERED"
    KEY_IN_USE = "KEY_IN_USE"
    NOT_FOUND = "NOT_FOUND"
    SPONSOR_INACTIVE = "SPONSOR_INACTIVE"
    AGENT_INACTIVE = "AGENT_INACTIVE"
    AGENT_SUSPENDED = "AGENT_SUSPENDED"
    AGENT_HELD = "AGENT_HELD"
    CALLER_SUSPENDED = "CALLER_SUSPENDED"
    PARTY_ENDED = "PARTY_ENDED"
    WORKLOAD_UNKNOWN = "WORKLOAD_UNKNOWN"
    NOTHING_TO_RESTORE = "NOTHING_TO_RESTORE"
    REGISTRY_FULL = "REGISTRY_FULL"
    TOO_MANY_NONCES = "TOO_MANY_NONCES"
    STORE_NOT_EMPTY = "STORE_NOT_EMPTY"
    NO_ADMINISTRATOR = "NO_ADMINISTRATOR"
    # changes of people
    TWO_PEOPLE_NEEDED = "TWO_PEOPLE_NEEDED"
    LAST_ADMINISTRATOR = "LAST_ADMINISTRATOR"
    CHANGE_UNKNOWN = "CHANGE_UNKNOWN"
    CHANGE_OVER = "CHANGE_OVER"
    CHANGE_YOURS = "CHANGE_YOURS"
    TOO_MANY_CHANGES = "TOO_MANY_CHANGES"
    # passkeys
    PASSKEYS_UNAVAILABLE = "PASSKEYS_UNAVAILABLE"
    PASSKEY_UNKNOWN = "PASSKEY_UNKNOWN"
    PASSKEY_REFUSED = "PASSKEY_REFUSED"
    ENROLMENT_UNKNOWN = "ENROLMENT_UNKNOWN"
    TOO_MANY_ENROLMENTS = "TOO_MANY_ENROLMENTS"
    # records of enforcement points
    RECORD_GAP = "RECORD_GAP"
    RECORD_FORKED = "RECORD_FORKED"
    RECORD_CHAIN_BROKEN = "RECORD_CHAIN_BROKEN"
    RECORD_OF_ANOTHER = "RECORD_OF_ANOTHER"
    # auditing
    ENTRY_UNKNOWN = "ENTRY_UNKNOWN"
    # asking people
    ASK_UNKNOWN = "ASK_UNKNOWN"
    ASK_DIFFERS = "ASK_DIFFERS"
    ASK_NOT_YOURS = "ASK_NOT_YOURS"
    ASK_CONTRADICTS_REGISTRY = "ASK_CONTRADICTS_REGISTRY"
    ASK_OUT_OF_TIME = "ASK_OUT_OF_TIME"
    ASK_BUDGET_SPENT = "ASK_BUDGET_SPENT"
    ASK_OVER = "ASK_OVER"
    ASK_ANSWERED = "ASK_ANSWERED"
    VOTE_NOT_FOR_THIS_ASK = "VOTE_NOT_FOR_THIS_ASK"
    VOTE_NOT_YOURS = "VOTE_NOT_YOURS"
    VOTE_OUT_OF_TIME = "VOTE_OUT_OF_TIME"
    VOTED_BEFORE = "VOTED_BEFORE"
    NOTHING_TO_WITHDRAW = "NOTHING_TO_WITHDRAW"
    CLEAR_NOT_SEEN = "CLEAR_NOT_SEEN"
    OPENING_UNKNOWN = "OPENING_UNKNOWN"
    OPENING_DIFFERS = "OPENING_DIFFERS"
    OPENING_NOT_YOURS = "OPENING_NOT_YOURS"
    OPENING_OUT_OF_TIME = "OPENING_OUT_OF_TIME"
    OPENING_NOT_IN_FORCE = "OPENING_NOT_IN_FORCE"
    TOO_MANY_OPENINGS = "TOO_MANY_OPENINGS"
    ENVELOPE_UNKNOWN = "ENVELOPE_UNKNOWN"
    ENVELOPE_DIFFERS = "ENVELOPE_DIFFERS"
    ENVELOPE_NOT_YOURS = "ENVELOPE_NOT_YOURS"
    ENVELOPE_OUT_OF_TIME = "ENVELOPE_OUT_OF_TIME"
    TOO_MANY_ENVELOPES = "TOO_MANY_ENVELOPES"
    # mandates
    MANDATE_UNKNOWN = "MANDATE_UNKNOWN"
    MANDATE_DIFFERS = "MANDATE_DIFFERS"
    MANDATE_NOT_YOURS = "MANDATE_NOT_YOURS"
    MANDATE_OUT_OF_TIME = "MANDATE_OUT_OF_TIME"
    MANDATE_OVER = "MANDATE_OVER"
    MANDATE_REVOKED = "MANDATE_REVOKED"
    MANDATE_NEEDS_PLATFORM = "MANDATE_NEEDS_PLATFORM"
    MANDATE_TOKENS_LIVE = "MANDATE_TOKENS_LIVE"
    MANDATE_LEAVES_NOTHING = "MANDATE_LEAVES_NOTHING"
    TOO_MANY_MANDATES = "TOO_MANY_MANDATES"
    # OAuth
    CLIENT_UNKNOWN = "CLIENT_UNKNOWN"
    SCOPE_UNKNOWN = "SCOPE_UNKNOWN"
    SCOPE_UNFIT = "SCOPE_UNFIT"
    TARGET_REFUSED = "TARGET_REFUSED"
    CODE_REFUSED = "CODE_REFUSED"
    REFRESH_REFUSED = "REFRESH_REFUSED"
    FAMILY_UNKNOWN = "FAMILY_UNKNOWN"
    FAMILY_OVER = "FAMILY_OVER"
    # people in a browser
    NOT_LOGGED_IN = "NOT_LOGGED_IN"
    LOGIN_OVER = "LOGIN_OVER"
    LOGIN_OLD = "LOGIN_OLD"
    LOGIN_UNKNOWN = "LOGIN_UNKNOWN"
    LOGIN_DECLINED = "LOGIN_DECLINED"
    TOO_MANY_LOGINS = "TOO_MANY_LOGINS"
    SESSION_KEY_TOO_WEAK = "SESSION_KEY_TOO_WEAK"
    LOGIN_IN_USE = "LOGIN_IN_USE"
    LOGIN_FAILED = "LOGIN_FAILED"
    LOGIN_PROVIDER_SILENT = "LOGIN_PROVIDER_SILENT"
    FORM_FORGED = "FORM_FORGED"
    FORM_MALFORMED = "FORM_MALFORMED"
    # the service
    EPOCH_AHEAD = "EPOCH_AHEAD"
    TOO_MANY_WAITERS = "TOO_MANY_WAITERS"
    REFUSALS_SPENT = "REFUSALS_SPENT"
    ALLOWANCE_SPENT = "ALLOWANCE_SPENT"
    RATE_EXCEEDED = "RATE_EXCEEDED"
    CONFLICT = "CONFLICT"
    RESTORING = "RESTORING"
    NOT_RESTORING = "NOT_RESTORING"
    POINTS_UNHEARD = "POINTS_UNHEARD"
    STORE_UNAVAILABLE = "STORE_UNAVAILABLE"
    SIGNER_UNAVAILABLE = "SIGNER_UNAVAILABLE"
    PATH_UNKNOWN = "PATH_UNKNOWN"
    METHOD_NOT_ALLOWED = "METHOD_NOT_ALLOWED"
    INTERNAL = "INTERNAL"


Code = FaultCode | IdpCode | Reason


@dataclass(frozen=True, slots=True)
class Refusal:
    """Refusal of a command: the negative half of `events | refusal`.

    Attributes:
        code: the reason.
        detail: for the caller, once authenticated, and for the record; holds no token, no key and no text of a
            stranger.
        recorded: the records of the attempt, for refusals that the ledger must show.
        charge: events by which it costs trust, once its caller's budget of refusals is spent.
        explanation: of `NOT_NARROWER`, for the holder whose scope it compares with.
    """

    code: Code
    detail: str = ""
    recorded: tuple[Event, ...] = ()
    explanation: Explanation | None = None
    charge: tuple[Event, ...] = ()
