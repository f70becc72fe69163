"""What authority is: scopes that only shrink, tokens that carry them, proofs of possession, signed statements.

A person lends a scope to an agent (`mint`), an agent lends part of it on (`delegate`), a server finds out what it holds
(`verify`), and the agent shows that the token is its own (`prove`, `check_proof`). Nothing here reads a clock, a file
or a socket.
"""

from capabilities.algebra import Narrowing, apply, hop, meet, narrows, stated
from capabilities.bounds import one_of
from capabilities.boxes import box
from capabilities.carriage import token_from_text, token_to_text
from capabilities.chain import Attestation, Chain, EvidenceKind, Hop, HopGrant, Refusal, Sponsor
from capabilities.delegate import delegate
from capabilities.errors import CapabilityError, Fault, FaultCode, ScopeError, StatementError, TokenError
from capabilities.explanation import Explanation, explain, explanation_to_json, repair
from capabilities.mint import mint
from capabilities.proof import Proof, check_proof, prove
from capabilities.scope import Grant, Limit, OneOf, Range, Restriction, Scope, Tier, Widening
from capabilities.scope_json import restriction_from_json, restriction_to_json, scope_from_json, scope_to_json
from capabilities.trust import TrustBundle
from capabilities.verify import Verifier, inspect_token, tightest, verify

__all__ = [
    "Attestation",
    "CapabilityError",
    "Chain",
    "EvidenceKind",
    "Explanation",
    "Fault",
    "FaultCode",
    "Grant",
    "Hop",
    "HopGrant",
    "Limit",
    "Narrowing",
    "OneOf",
    "Proof",
    "Range",
    "Refusal",
    "Restriction",
    "Scope",
    "ScopeError",
    "Sponsor",
    "StatementError",
    "Tier",
    "TokenError",
    "TrustBundle",
    "Verifier",
    "Widening",
    "apply",
    "box",
    "check_proof",
    "delegate",
    "explain",
    "explanation_to_json",
    "hop",
    "inspect_token",
    "meet",
    "mint",
    "narrows",
    "one_of",
    "prove",
    "repair",
    "restriction_from_json",
    "restriction_to_json",
    "scope_from_json",
    "scope_to_json",
    "stated",
    "tightest",
    "token_from_text",
    "token_to_text",
    "verify",
]
