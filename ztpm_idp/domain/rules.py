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
        trust: the bundle of verifiers; this provider verifies tokens with it, too.
        caps: bounds of the profile.
        own_keys: raw public keys of the provider itself; nobody else may have one of them.
        token_lifetime_s: longest life of a token issued here, at most that of the caps.
        nonce_age_s: oldest accepted attestation nonce.
        open_nonces: nonces that one agent may hold unused at a time.
        platform: the platform whose word on workloads is trusted, or None: there is no evidence of kind `jwt` then.
        open_asks: asks that may wait for people at a time; one agent's at most a third of them.
        policies: the set that decides on delegations, and whose parameters trust and behaviour use.
        root_key: raw public key that signs tokens now, and that recovers an administrator; empty: there is no recovery.
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
    root_key: bytes = b""
