"""Faults of a token, a proof, a statement or a quantity: one small tree, each with a reason code.

The code is stable and safe for strangers. The detail is for the record and for the token's own holder; it never holds a
token, a key or text from one.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class FaultCode(StrEnum):
    """Reasons of this package. `policies.words.reason_codes.Reason` repeats each by the same name (a test compares)."""

    # quantities
    NOT_A_NUMBER = "NOT_A_NUMBER"
    NOT_FINITE = "NOT_FINITE"
    NOT_ON_GRID = "NOT_ON_GRID"
    OUT_OF_RANGE = "OUT_OF_RANGE"
    # tokens, in the order in which `verify` finds them
    TOKEN_MISSING = "TOKEN_MISSING"  # noqa: S105 - a reason, not a secret
    TOKEN_TOO_LARGE = "TOKEN_TOO_LARGE"  # noqa: S105 - a reason, not a secret
    TOKEN_MALFORMED = "TOKEN_MALFORMED"  # noqa: S105 - a reason, not a secret
    TOO_MANY_HOPS = "TOO_MANY_HOPS"
    SIGNATURE_INVALID = "SIGNATURE_INVALID"
    UNKNOWN_ROOT_KEY = "UNKNOWN_ROOT_KEY"
    HOP_NOT_ATTESTED = "HOP_NOT_ATTESTED"
    NOT_CANONICAL = "NOT_CANONICAL"
    WRONG_PROFILE = "WRONG_PROFILE"
    CHAIN_BROKEN = "CHAIN_BROKEN"
    NOT_NARROWER = "NOT_NARROWER"
    NOT_YET_VALID = "NOT_YET_VALID"
    EXPIRED = "EXPIRED"
    LIFETIME_TOO_LONG = "LIFETIME_TOO_LONG"
    WRONG_AUDIENCE = "WRONG_AUDIENCE"
    REVOKED = "REVOKED"
    REVOCATION_VIEW_STALE = "REVOCATION_VIEW_STALE"
    # proof of possession
    PROOF_MISSING = "PROOF_MISSING"
    PROOF_MALFORMED = "PROOF_MALFORMED"
    PROOF_WRONG_KEY = "PROOF_WRONG_KEY"
    PROOF_STALE = "PROOF_STALE"
    PROOF_NOT_FOR_THIS_REQUEST = "PROOF_NOT_FOR_THIS_REQUEST"
    REPLAYED = "REPLAYED"
    # the request against the scope
    NOT_GRANTED = "NOT_GRANTED"
    PARAMETERS_WRONG = "PARAMETERS_WRONG"
    LIMIT_EXCEEDED_BY_REQUEST = "LIMIT_EXCEEDED_BY_REQUEST"
    ABOVE_CEILING = "ABOVE_CEILING"
    DELEGATE_NOT_ALLOWED = "DELEGATE_NOT_ALLOWED"
    # engines
    LIMIT_EXCEEDED = "LIMIT_EXCEEDED"
    ENGINES_DISAGREE = "ENGINES_DISAGREE"
    # statements and keys
    STATEMENT_MALFORMED = "STATEMENT_MALFORMED"
    STATEMENT_WRONG_KIND = "STATEMENT_WRONG_KIND"
    STATEMENT_UNTRUSTED = "STATEMENT_UNTRUSTED"
    KEY_MALFORMED = "KEY_MALFORMED"
    KEY_WRONG_ROLE = "KEY_WRONG_ROLE"
    ATTESTATION_INVALID = "ATTESTATION_INVALID"


class CapabilityError(Exception):
    """Root of the tree. `code` is the reason; `detail` is for the record."""

    def __init__(self, code: FaultCode, detail: str = "") -> None:
        super().__init__(f"{code}: {detail}" if detail else str(code))
        self.code = code
        self.detail = detail


class QuantityError(CapabilityError):
    """A number that cannot be an integer quantity."""


class ScopeError(CapabilityError):
    """A scope, or a restriction of one, that cannot be."""


class TokenError(CapabilityError):
    """A token that cannot be minted, extended or read."""


class StatementError(CapabilityError):
    """A signed statement that is refused."""


class BadKeyError(CapabilityError):
    """Key material that is refused."""


@dataclass(frozen=True, slots=True)
class Fault:
    """Fault for which a token or proof is refused: the negative half of `Chain | Fault`.

    Attributes:
        code: the reason.
        clause: id of the normative clause in docs/spec.md, e.g. "TOK-4".
        detail: for the record; never shown to strangers.
    """

    code: FaultCode
    clause: str
    detail: str = ""
