"""Rules that the deployment fixes for the domain: its name, its keys' public halves and its bounds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from capabilities.keys.trust import TrustBundle
    from capabilities.statements.workload import Platform
    from capabilities.values.caps import Caps
    from policies.decision.policy import PolicySet


@dataclass(frozen=True, slots=True)
class Rules:
    """Frozen for the life of the process.

    Attributes:
        issuer: base URL of this identity provider.
        trust: what verifiers trust; also what this provider verifies tokens with.
        caps: bounds of the profile.
        own_keys: raw public keys of the provider itself; nobody else may have one of them.
        token_lifetime_s: longest life of what is issued here, at most what the caps say.
        nonce_age_s: oldest accepted attestation nonce.
        open_nonces: nonces that one agent may hold unused at a time.
        platform: whose word on workloads counts, or None: there is no evidence of kind `jwt` then.
        open_asks: asks that may wait for people at a time; one agent's at most a third of them.
        policies: by what delegations are decided, and whose parameters trust and behaviour are reckoned with.
    """

    issuer: str
    trust: TrustBundle
    caps: Caps
    own_keys: frozenset[bytes]
    token_lifetime_s: int
    nonce_age_s: int
    open_nonces: int
    open_asks: int
    policies: PolicySet
    platform: Platform | None = None
