"""Rules that make a hop a valid child of the hop before it.

Issuing and verifying ask the very same functions.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Final, assert_never

from capabilities.token.checks import REMEMBERED
from capabilities.values import algebra, budgets
from capabilities.values.chain import EvidenceKind, make_hop
from capabilities.values.errors import FaultCode, TokenError
from capabilities.values.scope import tier
from capabilities.values.text import ROLE_PREFIX

if TYPE_CHECKING:
    from capabilities.token.block import AuthorityBlock, HopBlock
    from capabilities.values.caps import Caps
    from capabilities.values.chain import Hop, HopGrant
    from capabilities.values.scope import Scope, Tier, Widening


class NotNarrowerError(TokenError):
    """A hop that has more than its parent in any dimension, or strictly less in none.

    Attributes:
        widenings: every place where the hop would have more.
    """

    def __init__(self, widenings: tuple[Widening, ...]) -> None:
        super().__init__(FaultCode.NOT_NARROWER, "wider, or nowhere strictly narrower")
        self.widenings = widenings


def first_hop(block: AuthorityBlock, *, reserved: frozenset[bytes], caps: Caps) -> Hop:
    """The hop of an authority block.

    Args:
        block: well formed.
        reserved: keys that have another role, so that no agent may hold them.
        caps: the bounds.

    Raises:
        TokenError: `CHAIN_BROKEN` when the first holder was not delegated to by the sponsor; otherwise as `next_hop`.
    """
    if block.index != 0 or block.hop.delegator != block.sponsor.subject:
        raise TokenError(FaultCode.CHAIN_BROKEN, "hop 0 does not continue the sponsor")
    _check_holder(block.hop, 0, (), reserved)
    hop = _hop(0, block.hop, block.scope)
    _check_ceiling(hop, caps)
    return hop


def next_hop(parents: tuple[Hop, ...], block: HopBlock, *, reserved: frozenset[bytes], caps: Caps) -> Hop:
    """The hop that `block` adds to `parents`.

    Raises:
        TokenError: `CHAIN_BROKEN` for a wrong index or delegator, an agent, key or hop id that occurs before, or a
            budget of no quantity or without a share for each audience;
            `KEY_WRONG_ROLE` for a key with another role; `TOO_MANY_HOPS` when no depth is left; `DELEGATE_NOT_ALLOWED`;
            `NOT_NARROWER` (`NotNarrowerError`) for a hop that is wider anywhere or strictly narrower nowhere;
            `HOP_NOT_ATTESTED` for a ceiling above what its evidence carries.
    """
    parent, added = parents[-1], block.hop
    if block.index != len(parents) or added.delegator != parent.agent:
        raise TokenError(FaultCode.CHAIN_BROKEN, f"hop {len(parents)} does not continue the holder before it")
    _check_holder(added, block.index, parents, reserved)
    if parent.scope.depth < 1:
        raise TokenError(FaultCode.TOO_MANY_HOPS, "no depth is left")
    delegates = parent.scope.delegates
    if added.agent not in delegates and not (added.role and ROLE_PREFIX + added.role in delegates):
        raise TokenError(FaultCode.DELEGATE_NOT_ALLOWED, f"hop {parent.index} does not name this delegate")
    hop = _hop(block.index, added, _narrower(parent.scope, block))
    _check_ceiling(hop, caps)
    defect = budgets.defect(hop.scope)
    if defect is not None:
        raise TokenError(FaultCode.CHAIN_BROKEN, defect)
    return hop


def check_lifetimes(hops: tuple[Hop, ...], caps: Caps) -> None:
    """Checks that the token and each hop live no longer than the profile and their evidence allow.

    Raises:
        TokenError: `LIFETIME_TOO_LONG`.
    """
    whole = hops[0].scope
    if whole.not_after - whole.not_before > caps.lifetime_s:
        raise TokenError(FaultCode.LIFETIME_TOO_LONG, f"longer than {caps.lifetime_s} s")
    for hop in hops:
        longest = longest_s(hop.attestation.kind, caps)
        if hop.scope.not_after - hop.attestation.at > longest:
            raise TokenError(
                FaultCode.LIFETIME_TOO_LONG, f"hop {hop.index} outlives its evidence by more than {longest} s"
            )


def highest(kind: EvidenceKind, caps: Caps) -> Tier:
    """The highest ceiling that a hop attested by this kind of evidence may carry."""
    match kind:
        case EvidenceKind.KEY:
            return tier(caps.key_evidence_ceiling)
        case EvidenceKind.JWT:
            return tier(caps.jwt_evidence_ceiling)
        case EvidenceKind.CLIENT:
            return tier(caps.client_evidence_ceiling)
        case EvidenceKind.BEARER:
            return tier(caps.bearer_evidence_ceiling)
        case EvidenceKind.X509:
            return tier(caps.x509_evidence_ceiling)
        case EvidenceKind.RELEASE:
            return tier(caps.release_evidence_ceiling)
        case _:
            assert_never(kind)


def longest_s(kind: EvidenceKind, caps: Caps) -> int:
    """The longest life, in seconds, of a hop attested by this kind of evidence."""
    match kind:
        case EvidenceKind.KEY:
            return caps.key_evidence_lifetime_s
        case EvidenceKind.JWT:
            return caps.jwt_evidence_lifetime_s
        case EvidenceKind.CLIENT:
            return caps.client_evidence_lifetime_s
        case EvidenceKind.BEARER:
            return caps.bearer_evidence_lifetime_s
        case EvidenceKind.X509:
            return caps.x509_evidence_lifetime_s
        case EvidenceKind.RELEASE:
            return caps.release_evidence_lifetime_s
        case _:
            assert_never(kind)


# Results are remembered: a renewed token has the same grants at each hop, and so has the next agent's.
_lay_over: Final = functools.lru_cache(maxsize=REMEMBERED)(algebra.lay_over)


def _narrower(parent: Scope, block: HopBlock) -> Scope:
    child = algebra.hop(parent, block.restriction, lay=_lay_over)
    if isinstance(child, algebra.Narrowing):
        raise NotNarrowerError(child.widenings)
    return child


def _hop(index: int, grant: HopGrant, scope: Scope) -> Hop:
    return make_hop(
        index,
        grant.hop_id,
        grant.agent,
        grant.key,
        grant.delegator,
        grant.purpose,
        grant.request_digest,
        grant.attestation,
        scope,
        grant.role,
    )


def _check_holder(hop: HopGrant, index: int, parents: tuple[Hop, ...], reserved: frozenset[bytes]) -> None:
    if hop.key in reserved:
        raise TokenError(FaultCode.KEY_WRONG_ROLE, f"the key of hop {index} has another role")
    for parent in parents:
        if hop.agent == parent.agent or hop.key == parent.key or hop.hop_id == parent.hop_id:
            raise TokenError(FaultCode.CHAIN_BROKEN, f"hop {index} repeats hop {parent.index}")


def _check_ceiling(hop: Hop, caps: Caps) -> None:
    if hop.scope.ceiling > highest(hop.attestation.kind, caps):
        raise TokenError(FaultCode.HOP_NOT_ATTESTED, f"the evidence of hop {hop.index} does not carry its ceiling")
