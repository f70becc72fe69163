"""Rules that the deployment fixes for the domain: its name, its keys' public halves and its bounds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from capabilities.token.verify import Verifier
from ztpm_idp.domain.lending.amounts import AllowanceTable

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.keys.trust import TrustBundle
    from capabilities.statements.workload import AnyPlatform
    from capabilities.values.caps import Caps
    from policies.decision.policy import PolicySet

REMEMBERED: Final = 256
"""Tokens that are remembered: those of the requests under way, and of holders that delegate again and again."""


@dataclass(frozen=True, slots=True)
class Rules:
    """Frozen; others take its place when keys or platforms change.

    Attributes:
        issuer: base URL of this identity provider.
        trust: the bundle of verifiers; this provider verifies tokens with it, too.
        caps: bounds of the profile.
        own_keys: raw public keys of the provider itself; nobody else may have one of them.
        token_lifetime_s: longest life of a token issued here, at most that of the caps.
        nonce_age_s: oldest accepted attestation nonce.
        open_nonces: nonces that one agent may hold unused at a time.
        platforms: those whose word on workloads is trusted now, none of them for the workloads of another.
        publishers: raw public keys by name of each whose releases are trusted.
        open_asks: asks that may wait for people at a time; one agent's at most a third of them.
        asks_a_minute, asks_an_hour: asks that are shown for each active approver.
        policies: the set that decides on delegations, and whose parameters trust and behaviour use.
        root_key: raw public key that signs tokens now, and that recovers an administrator; empty: there is no recovery.
        allowances: how much of each thing a sponsor may have.
        verifier: of tokens under `trust`; it remembers what asks nothing of the moment ([TOK-1] to [TOK-6]).
    """

    issuer: str
    trust: TrustBundle
    caps: Caps
    own_keys: frozenset[bytes]
    token_lifetime_s: int
    nonce_age_s: int
    open_nonces: int
    open_asks: int
    asks_a_minute: int
    asks_an_hour: int
    policies: PolicySet
    platforms: tuple[AnyPlatform, ...] = ()
    publishers: Mapping[str, frozenset[bytes]] = field(default_factory=dict)
    root_key: bytes = b""
    allowances: AllowanceTable = field(default_factory=AllowanceTable)
    verifier: Verifier = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        # A memory, and no state: another bundle or other bounds are other rules, and so have a verifier of their own.
        object.__setattr__(self, "verifier", Verifier(self.trust, self.caps, remembered=REMEMBERED))

    def platform_of(self, workload: str) -> AnyPlatform | None:
        """The platform that a workload id belongs to, when it is trusted now."""
        return next((platform for platform in self.platforms if platform.holds(workload)), None)
