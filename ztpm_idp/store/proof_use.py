"""One use of a proof of possession, as the store keeps it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ProofUse:
    """The use of a proof, which happens once over all processes and restarts.

    Attributes:
        key: raw public key that signed the proof.
        jti: its id.
        expires_ms: when the proof is too old anyway, wall clock.
        at_ms: now; ids that expired long ago are forgotten from time to time.
    """

    key: bytes
    jti: str
    expires_ms: int
    at_ms: int
