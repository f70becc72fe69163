"""Envelopes as the identity provider keeps them, and the events about them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class EnvelopeRecord:
    """Part of an envelope that decides; all the rest is in its text.

    Attributes:
        envelope_id: 32 hex digits.
        digest: SHA-256 (hex) of its text.
        approver: the person who signed it.
        audience, agent: whose acts it approves.
        not_before, not_after: seconds since the epoch.
        revoked: a person revoked it.
        text: as it was signed.
    """

    envelope_id: str
    digest: str
    approver: str
    audience: str
    agent: str
    not_before: int
    not_after: int
    revoked: bool
    text: str

    def over(self, at_ms: int) -> bool:
        """Revoked, or past its end."""
        return self.revoked or not at_ms <= self.not_after * 1_000


@dataclass(frozen=True, slots=True)
class EnvelopeSigned:
    """An envelope is in force from its beginning on."""

    envelope: EnvelopeRecord


@dataclass(frozen=True, slots=True)
class EnvelopeRevoked:
    """An envelope is over before its time."""

    envelope_id: str
    reason: str


EnvelopeEvent = EnvelopeSigned | EnvelopeRevoked


def ended_with(
    envelopes: tuple[EnvelopeRecord, ...], person: str, agents: frozenset[str], reason: str
) -> tuple[EnvelopeRevoked, ...]:
    """The end of this person's envelopes, and of those for these agents."""
    return tuple(
        EnvelopeRevoked(envelope.envelope_id, reason)
        for envelope in envelopes
        if envelope.approver == person or envelope.agent in agents
    )
