"""Authority as values: scopes that only shrink, tokens that carry them, proofs of possession, signed statements.

A person lends a scope to an agent (`mint`), an agent lends part of it on (`delegate`), a server finds out what it holds
(`verify`), and the agent shows that the token is its own (`prove`, `check_proof`). Nothing here reads a clock, a file
or a socket.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
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
    from capabilities.values.scope_json import (
        restriction_from_json,
        restriction_to_json,
        scope_from_json,
        scope_to_json,
    )
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
_HOMES: Final = {
    "DEFAULT_CAPS": "capabilities.values.caps:DEFAULT",
    "Argument": "capabilities.values.arguments",
    "Attestation": "capabilities.values.chain",
    "Budget": "capabilities.values.scope",
    "CapabilityError": "capabilities.values.errors",
    "Caps": "capabilities.values.caps",
    "Chain": "capabilities.values.chain",
    "DeclaredUnit": "capabilities.values.units",
    "Each": "capabilities.values.scope",
    "EvidenceKind": "capabilities.values.chain",
    "Explanation": "capabilities.values.explanation",
    "Fault": "capabilities.values.errors",
    "FaultCode": "capabilities.values.errors",
    "Fingerprint": "capabilities.values.arguments",
    "Flags": "capabilities.values.scope",
    "Grant": "capabilities.values.scope",
    "Hop": "capabilities.values.chain",
    "HopGrant": "capabilities.values.chain",
    "KeyRing": "capabilities.rotation.rotation",
    "Limit": "capabilities.values.scope",
    "ListOf": "capabilities.values.units",
    "Narrowing": "capabilities.values.algebra",
    "OneOf": "capabilities.values.scope",
    "Parameter": "capabilities.values.units",
    "Proof": "capabilities.proof.proof",
    "Quantity": "capabilities.values.units",
    "Range": "capabilities.values.scope",
    "Refusal": "capabilities.values.chain",
    "Restriction": "capabilities.values.scope",
    "RevocationView": "capabilities.statements.revocation",
    "Role": "capabilities.keys.windows",
    "Scope": "capabilities.values.scope",
    "ScopeError": "capabilities.values.errors",
    "Sort": "capabilities.values.units",
    "Sponsor": "capabilities.values.chain",
    "StatementError": "capabilities.values.errors",
    "Stems": "capabilities.values.scope",
    "Tier": "capabilities.values.scope",
    "TokenError": "capabilities.values.errors",
    "TrustBundle": "capabilities.keys.trust",
    "Unit": "capabilities.values.units",
    "Verifier": "capabilities.token.verify",
    "Widening": "capabilities.values.scope",
    "Words": "capabilities.values.scope",
    "apply": "capabilities.values.algebra",
    "argument": "capabilities.values.arguments",
    "begin_key_ring": "capabilities.rotation.rotation:begin",
    "box": "capabilities.values.boxes",
    "check_proof": "capabilities.proof.proof",
    "delegate": "capabilities.token.delegate",
    "explain": "capabilities.values.explanation",
    "explanation_to_json": "capabilities.values.explanation",
    "generate_key": "capabilities.keys.keys:generate",
    "hop": "capabilities.values.algebra",
    "inspect_token": "capabilities.token.verify",
    "key_from_pem": "capabilities.keys.keys:from_pem",
    "meet": "capabilities.values.algebra",
    "mint": "capabilities.token.mint",
    "narrows": "capabilities.values.algebra",
    "one_of": "capabilities.values.bounds",
    "prove": "capabilities.proof.proof",
    "public_raw": "capabilities.keys.keys",
    "repair": "capabilities.values.explanation",
    "restriction_from_json": "capabilities.values.scope_json",
    "restriction_to_json": "capabilities.values.scope_json",
    "scope_from_json": "capabilities.values.scope_json",
    "scope_to_json": "capabilities.values.scope_json",
    "stated": "capabilities.values.algebra",
    "tightest": "capabilities.token.verify",
    "token_from_text": "capabilities.token.token_text",
    "token_to_text": "capabilities.token.token_text",
    "verify": "capabilities.token.verify",
}
"""Module of each name, and behind a colon the name that it has there, where it is another."""

if not TYPE_CHECKING:  # a type checker would take any name

    def __getattr__(name: str) -> Any:
        # Loaded when asked for: who wants one word of it loads no token library.
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        module, _, theirs = _HOMES[name].partition(":")
        value = globals()[name] = getattr(import_module(module), theirs or name)
        return value
