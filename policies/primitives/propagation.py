"""Domain CATP, cross-agent trust and propagation: authority and trust along the edges of a chain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, assert_never

from capabilities.values.chain import Chain
from capabilities.values.scope import Tier
from policies.evidence.evidence import NotCollected, TrustReading
from policies.primitives.base import (
    Case,
    Defers,
    Holds,
    Verdict,
    age_within,
    fails,
    found,
    missing,
    verified_chain,
)
from policies.words.reason_table import Reason


@dataclass(frozen=True, slots=True)
class NonTransitiveTrust:
    """CATP-1: trust belongs to one edge; nothing flows along the chain, which is as trusted as its weakest edge."""

    trust_prior_permille: int
    id: ClassVar[str] = "CATP-1"

    def judge(self, case: Case) -> Verdict:
        """Holds when trust was read for exactly the edges of this chain, and the chain has no more than any.

        An edge above the prior is no reading that can be believed: nothing makes an agent more trusted than a stranger.
        """
        chain = verified_chain(self.id, case)
        if not isinstance(chain, Chain):
            return chain
        match case.evidence.trust:
            case NotCollected():
                return missing(self.id, "trust")
            case TrustReading() as trust:
                return self._reading(chain, trust)
            case _:
                assert_never(case.evidence.trust)

    def _reading(self, chain: Chain, trust: TrustReading) -> Verdict:
        wanted = [(hop.delegator, hop.agent) for hop in chain.hops]
        stated = [(edge.delegator, edge.delegate) for edge in trust.edges]
        if stated != wanted:
            return fails(self.id, Reason.TRUST_NOT_OF_EDGE, edges=[list(edge) for edge in wanted])
        if not all(0 <= edge.score_permille <= self.trust_prior_permille for edge in trust.edges):
            return fails(self.id, Reason.TRUST_NOT_OF_EDGE, trust_prior_permille=self.trust_prior_permille)
        weakest = min(edge.score_permille for edge in trust.edges)
        if not 0 <= trust.score_permille <= weakest:
            return fails(self.id, Reason.TRUST_NOT_OF_EDGE, trust_permille=trust.score_permille, weakest=weakest)
        return Holds()


@dataclass(frozen=True, slots=True)
class ScopeNarrowing:
    """CATP-2: every delegation is strictly narrower than its parent."""

    id: ClassVar[str] = "CATP-2"

    def judge(self, case: Case) -> Verdict:
        """Holds for a verified chain: verification refuses a hop that is wider anywhere, or narrower nowhere."""
        chain = verified_chain(self.id, case)
        return Holds() if isinstance(chain, Chain) else chain


@dataclass(frozen=True, slots=True)
class DynamicTrust:
    """CATP-3: from tier 2, trust in the weakest edge, from history, anomalies and time, is at least theta."""

    trust_theta_permille: int
    id: ClassVar[str] = "CATP-3"

    def judge(self, case: Case) -> Verdict:
        """Holds at theta and above, or while the tier is known to need no trust; else defers."""
        trust = case.evidence.trust
        match trust:
            case NotCollected():
                return missing(self.id, "trust")
            case TrustReading(score):
                return self._score(score, case)
            case _:
                assert_never(trust)

    def _score(self, score: int, case: Case) -> Verdict:
        if self.trust_theta_permille <= score <= 1000:
            return Holds()
        if not 0 <= score <= 1000:
            return missing(self.id, "trust")
        if case.tier is not None and case.tier < Tier.CONSEQUENTIAL:
            return Holds()
        return Defers(
            (
                found(
                    self.id,
                    Reason.TRUST_TOO_LOW,
                    tier=None if case.tier is None else int(case.tier),
                    trust_permille=score,
                    trust_theta_permille=self.trust_theta_permille,
                ),
            )
        )


@dataclass(frozen=True, slots=True)
class BoundaryAttestation:
    """CATP-4: every hop of the chain was attested at its boundary, and recently enough."""

    attestation_age_s: int
    skew_s: int
    id: ClassVar[str] = "CATP-4"

    def judge(self, case: Case) -> Verdict:
        """Holds for a verified chain in which each hop's attestation is at most `attestation_age_s` old."""
        chain = verified_chain(self.id, case)
        if not isinstance(chain, Chain):
            return chain
        for hop in chain.hops:
            if (
                age_within(case.evidence.at, hop.attestation.at, bound_s=self.attestation_age_s, skew_s=self.skew_s)
                is None
            ):
                return fails(
                    self.id,
                    Reason.ATTESTATION_OLD,
                    hop=hop.index,
                    agent=hop.agent,
                    attestation_age_s=self.attestation_age_s,
                )
        return Holds()
