"""Domain AID, agent identity and delegation: the caller, its sponsor, and the links between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, assert_never

from capabilities.values.chain import Chain
from capabilities.values.errors import Fault
from capabilities.values.scope import Tier
from policies.evidence.evidence import NotCollected
from policies.evidence.tiers import base_tier
from policies.primitives.base import (
    Case,
    Fails,
    Holds,
    Verdict,
    age_within,
    chain_fault,
    fails,
    missing,
    verified_chain,
)
from policies.words.errors import PolicyError, PolicyFault
from policies.words.reason_table import Reason


@dataclass(frozen=True, slots=True)
class AgentAuthentication:
    """AID-1: the caller is freshly attested and proves, for this request, that it holds the key of the last hop."""

    attestation_age_s: int
    skew_s: int
    id: ClassVar[str] = "AID-1"

    def judge(self, case: Case) -> Verdict:
        """Holds for a verified chain, a valid first-use proof and a leaf attested at most `attestation_age_s` ago."""
        chain = verified_chain(self.id, case)
        if not isinstance(chain, Chain):
            return chain
        match case.evidence.proof:
            case Fault() as fault:
                return chain_fault(self.id, fault)
            case NotCollected():
                return missing(self.id, "proof")
            case True:
                pass
            case _:
                return fails(self.id, Reason.PROOF_MISSING)
        leaf = chain.leaf
        if (
            age_within(case.evidence.at, leaf.attestation.at, bound_s=self.attestation_age_s, skew_s=self.skew_s)
            is None
        ):
            return fails(
                self.id,
                Reason.ATTESTATION_OLD,
                hop=leaf.index,
                agent=leaf.agent,
                attestation_age_s=self.attestation_age_s,
            )
        return Holds()


@dataclass(frozen=True, slots=True)
class HumanRoot:
    """AID-2: the chain starts at a human principal who was authenticated recently enough for the tier."""

    sponsor_age_tier_0_s: int
    sponsor_age_tier_1_s: int
    sponsor_age_tier_2_s: int
    sponsor_age_tier_3_s: int
    sponsor_age_tier_4_s: int
    skew_s: int
    id: ClassVar[str] = "AID-2"

    def __post_init__(self) -> None:
        bounds = [self.bound_s(tier) for tier in Tier]
        if bounds != sorted(bounds, reverse=True):
            raise PolicyError(
                PolicyFault.NOT_MONOTONE, "primitive", "a higher tier would allow an older authentication"
            )

    def bound_s(self, tier: Tier) -> int:
        """Oldest authentication for `tier`, in seconds."""
        match tier:
            case Tier.NO_EFFECT:
                return self.sponsor_age_tier_0_s
            case Tier.REVERSIBLE:
                return self.sponsor_age_tier_1_s
            case Tier.CONSEQUENTIAL:
                return self.sponsor_age_tier_2_s
            case Tier.HIGH_CONSEQUENCE:
                return self.sponsor_age_tier_3_s
            case Tier.SAFETY_CRITICAL:
                return self.sponsor_age_tier_4_s
            case _:
                assert_never(tier)

    def judge(self, case: Case) -> Verdict:
        """Holds when the sponsor's authentication is inside the bound of the tier.

        The tier is the runtime tier, or the base tier while that one is not known (TEA-4 and the PITBound deny then);
        without either the evidence is missing.
        """
        chain = verified_chain(self.id, case)
        if not isinstance(chain, Chain):
            return chain
        sponsor = chain.sponsor
        if not sponsor.subject or not sponsor.issuer:
            return fails(self.id, Reason.CHAIN_BROKEN)
        tier = base_tier(case.evidence) if case.tier is None else case.tier
        if tier is None:
            return missing(self.id, "tool")
        bound_s = self.bound_s(tier)
        if age_within(case.evidence.at, sponsor.authenticated_at, bound_s=bound_s, skew_s=self.skew_s) is None:
            return fails(
                self.id,
                Reason.SPONSOR_AUTHENTICATION_OLD,
                sponsor=sponsor.subject,
                tier=int(tier),
                sponsor_age_s=bound_s,
            )
        return Holds()


@dataclass(frozen=True, slots=True)
class LinkValidity:
    """AID-3: a trusted attester signed every link, in its window and unrevoked, on a fresh revocation view."""

    lease_motion_ms: int
    lease_other_ms: int
    id: ClassVar[str] = "AID-3"

    def judge(self, case: Case) -> Verdict:
        """Holds for a verified chain whose window contains now and whose revocation view is no older than the lease."""
        chain = verified_chain(self.id, case)
        if not isinstance(chain, Chain):
            return chain
        scope, at = chain.scope, case.evidence.at
        # once more than in `verify`: a cached chain may outlive its window between collecting and deciding
        if not scope.not_before <= at:
            return fails(self.id, Reason.NOT_YET_VALID, not_before=scope.not_before)
        if not at < scope.not_after:
            return fails(self.id, Reason.EXPIRED, not_after=scope.not_after)
        lease_ms = self.lease_motion_ms if case.physical else self.lease_other_ms
        if not 0 <= chain.view_age_ms <= lease_ms:
            return fails(self.id, Reason.REVOCATION_VIEW_STALE, view_age_ms=chain.view_age_ms, lease_ms=lease_ms)
        return Holds()


@dataclass(frozen=True, slots=True)
class NoScopeEscalation:
    """AID-4: no link has more than its parent; an attempt is refused and leaves its reason in the record."""

    id: ClassVar[str] = "AID-4"

    def judge(self, case: Case) -> Verdict:
        """Holds for a verified chain: verification compares each hop with its parent; an attempt is its fault."""
        chain = verified_chain(self.id, case)
        return Holds() if isinstance(chain, Chain) else chain


@dataclass(frozen=True, slots=True)
class BoundedChain:
    """AID-5: depth, audience and lifetime are inside their bounds; the size was bounded before anything was parsed."""

    hops_max_count: int
    lifetime_max_s: int
    id: ClassVar[str] = "AID-5"

    def judge(self, case: Case) -> Verdict:
        """Holds for a chain for this audience whose delegations and window are inside the two bounds, both included."""
        chain = verified_chain(self.id, case)
        if isinstance(chain, Fails):
            return chain
        scope, delegations = chain.scope, len(chain.hops) - 1
        if case.request.audience not in scope.audiences:
            return fails(self.id, Reason.WRONG_AUDIENCE)
        if not 0 <= delegations <= self.hops_max_count:
            return fails(self.id, Reason.CHAIN_OUT_OF_BOUNDS, hops=delegations, hops_max_count=self.hops_max_count)
        lifetime_s = scope.not_after - scope.not_before
        if not 0 < lifetime_s <= self.lifetime_max_s:
            return fails(self.id, Reason.CHAIN_OUT_OF_BOUNDS, lifetime_s=lifetime_s, lifetime_max_s=self.lifetime_max_s)
        return Holds()
