"""Request of a caller as auditors verify it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SignedRequest:
    """The caller's request, kept for auditors to verify.

    The body is in canonical form; of one that came so, the proof's `bdg` is the SHA-256.
    """

    method: str
    url: str
    body: str
    proof: str
