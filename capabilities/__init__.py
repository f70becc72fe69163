"""Authority as values: scopes that only shrink, tokens that carry them, proofs of possession, signed statements.

A person lends a scope to an agent (`mint`), an agent lends part of it on (`delegate`), a server finds out what it holds
(`verify`), and the agent shows that the token is its own (`prove`, `check_proof`). Nothing here reads a clock, a file
or a socket.
"""

from capabilities.keys.keys import from_pem as key_from_pem
from capabilities.keys.keys import generate as generate_key
from capabilities.keys.keys import public_raw
from capabilities.keys.trust import TrustBundle
from capabilities.keys.windows import Role
from capabilities.proof.proof import Proof, check_proof, prove
from capabilities.rotation.rotation import KeyRing
from capabilities.rotation.rotation import begin as begin_key_ring
from capabilities.statements.revocation import RevocationView
from capabilities.token.delegate import delegate
from capabilities.token.mint import mint
from capabilities.token.token_text import token_from_text, token_to_text
from capabilities.token.verify import Verifier, inspect_token, tightest, verify
from capabilities.values.algebra import Narrowing, apply, hop, meet, narrows, stated
from capabilities.values.arguments import Argument, Fingerprint, argument
from capabilities.values.bounds import one_of
from capabilities.values.boxes import box
from capabilities.values.caps import DEFAULT as DEFAULT_CAPS
from capabilities.values.caps import Caps
from capabilities.values.chain import Attestation, Chain, EvidenceKind, Hop, HopGrant, Refusal, Sponsor
from capabilities.values.errors import CapabilityError, Fault, FaultCode, ScopeError, StatementError, TokenError
from capabilities.values.explanation import Explanation, explain, explanation_to_json, repair
from capabilities.values.scope import (
    Budget,
    Each,
    Flags,
    Grant,
    Limit,
    OneOf,
    Range,
    Restriction,
    Scope,
    Stems,
    Tier,
    Widening,
    Words,
)
from capabilities.values.scope_json import restriction_from_json, restriction_to_json, scope_from_json, scope_to_json
from capabilities.values.units import DeclaredUnit, ListOf, Parameter, Quantity, Sort, Unit

__all__ = [
    "DEFAULT_CAPS",
    "Argument",
    "Attestation",
    "Budget",
    "CapabilityError",
    "Caps",
    "Chain",
    "DeclaredUnit",
    "Each",
    "EvidenceKind",
    "Explanation",
    "Fault",
    "FaultCode",
    "Fingerprint",
    "Flags",
    "Grant",
    "Hop",
    "HopGrant",
    "KeyRing",
    "Limit",
    "ListOf",
    "Narrowing",
    "OneOf",
    "Parameter",
    "Proof",
    "Quantity",
    "Range",
    "Refusal",
    "Restriction",
    "RevocationView",
    "Role",
    "Scope",
    "ScopeError",
    "Sort",
    "Sponsor",
    "StatementError",
    "Stems",
    "Tier",
    "TokenError",
    "TrustBundle",
    "Unit",
    "Verifier",
    "Widening",
    "Words",
    "apply",
    "argument",
    "begin_key_ring",
    "box",
    "check_proof",
    "delegate",
    "explain",
    "explanation_to_json",
    "generate_key",
    "hop",
    "inspect_token",
    "key_from_pem",
    "meet",
    "mint",
    "narrows",
    "one_of",
    "prove",
    "public_raw",
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
