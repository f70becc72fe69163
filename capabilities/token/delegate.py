"""Adding a hop to a token."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

from capabilities.keys import keys
from capabilities.keys.signing_key import SigningKey
from capabilities.token import biscuit, block, block_signatures, hop_rules
from capabilities.values.chain import Chain, Hop, HopGrant
from capabilities.values.errors import FaultCode, TokenError

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    from capabilities.keys.trust import TrustBundle
    from capabilities.values.caps import Caps
    from capabilities.values.scope import Restriction

__all__ = ["HopGrant", "delegate", "next_leaf"]


def next_leaf(
    chain: Chain,
    hop: HopGrant,
    restriction: Restriction,
    *,
    trust: TrustBundle,
    caps: Caps,
    reserved: frozenset[bytes] = frozenset(),
) -> Hop:
    """The leaf that one more hop would make, after every check of a verifier but time, audience and revocation.

    Args:
        chain: verified.
        hop: the delegate, already attested; its delegator is the leaf's agent.
        restriction: of the new hop.
        trust: the bundle that the chain was verified with; no agent may hold one of its keys.
        caps: the bounds.
        reserved: further keys that no agent may hold.

    Raises:
        CapabilityError: `NOT_NARROWER` (with the widenings), `DELEGATE_NOT_ALLOWED`, `TOO_MANY_HOPS`, `CHAIN_BROKEN`,
            `HOP_NOT_ATTESTED`, `LIFETIME_TOO_LONG`, `KEY_WRONG_ROLE` for a delegate whose key has another role, or the
            code of the value that is malformed.
    """
    added = block.HopBlock(len(chain.hops), hop, restriction)
    try:
        block.well_formed(added, caps)
    except ValueError as error:
        raise TokenError(FaultCode.TOKEN_MALFORMED, str(error)) from None
    leaf = hop_rules.next_hop(chain.hops, added, reserved=trust.all_keys | reserved, caps=caps)
    hop_rules.check_lifetimes((*chain.hops, leaf), caps)
    return leaf


def delegate(
    token: bytes,
    *,
    chain: Chain,
    attester: Ed25519PrivateKey | SigningKey,
    trust: TrustBundle,
    hop: HopGrant,
    restriction: Restriction,
    caps: Caps,
    reserved: frozenset[bytes] = frozenset(),
) -> bytes:
    """The token with one more hop, strictly narrower than its leaf.

    Args:
        token: the bytes that `verify` made `chain` of.
        chain: the verified chain.
        attester: the attestation key, here or where it signs, one of `trust.attesters`.
        trust: the bundle that the token was verified with.
        hop: the delegate, already attested; its delegator is the leaf's agent.
        restriction: of the new hop.
        caps: the bounds.
        reserved: further keys that no agent may hold.

    Raises:
        CapabilityError: as `next_leaf`; `TOKEN_TOO_LARGE`, `UNKNOWN_ROOT_KEY`, and `KEY_WRONG_ROLE` also for an
            attester that is none of the bundle's.
    """
    if hashlib.sha256(token).digest() != chain.digest:
        raise TokenError(FaultCode.CHAIN_BROKEN, "the chain is of another token")
    if keys.public_raw(attester) not in trust.attesters:
        raise TokenError(FaultCode.KEY_WRONG_ROLE, "not an attester of this bundle")
    root = trust.roots.get(chain.root_key_id)
    if root is None:
        raise TokenError(FaultCode.UNKNOWN_ROOT_KEY, "the root key is no longer trusted")
    if len(chain.hops) > caps.hops:
        raise TokenError(FaultCode.TOO_MANY_HOPS, f"more than {caps.hops} hops")
    next_leaf(chain, hop, restriction, trust=trust, caps=caps, reserved=reserved)
    added = block.HopBlock(len(chain.hops), hop, restriction)
    here = keys.generate() if isinstance(attester, SigningKey) else attester
    extended = biscuit.append_hop(
        biscuit.open_token(token, root), block.fact(added), block.checks(added, chain.scope), attester=here
    )
    if here is not attester:
        extended = block_signatures.by_attester(token, extended, attester)
    if len(extended) > caps.token_bytes:
        raise TokenError(FaultCode.TOKEN_TOO_LARGE, f"{len(extended)} bytes of at most {caps.token_bytes}")
    return extended
