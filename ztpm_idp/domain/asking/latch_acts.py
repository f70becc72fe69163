"""Latches of robots and people's clearings as the identity provider keeps them, and the events about them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LatchRecord:
    """Part of a latch that decides; all the rest is in its text.

    Attributes:
        latch_id: 32 hex digits.
        digest: SHA-256 (hex) of its text.
        pep, audience, robot, cause: as it states them.
        approvers: how many different people have to clear it.
        at: seconds since the epoch.
        text: as the enforcement point signed it.
        released: enough people have cleared it at the same time.
    """

    latch_id: str
    digest: str
    pep: str
    audience: str
    robot: str
    cause: str
    approvers: int
    at: int
    text: str
    released: bool = False


@dataclass(frozen=True, slots=True)
class ClearingRecord:
    """A clearing: its approver, until when it counts, the latch's text that it binds, and its own text."""

    approver: str
    not_after: int
    latch_digest: str
    text: str

    def counts(self, latch: LatchRecord, at_ms: int) -> bool:
        """True where it is for this text of the latch, and not over."""
        return self.latch_digest == latch.digest and at_ms <= self.not_after * 1_000


@dataclass(frozen=True, slots=True)
class LatchTaken:
    """An enforcement point has told of its latch, or tells of it again: it waits for people."""

    latch: LatchRecord


@dataclass(frozen=True, slots=True)
class ClearingSigned:
    """A person has cleared a latch; `number` is the place of the clearing, and `released` says that it was enough."""

    latch_id: str
    audience: str
    number: int
    clearing: ClearingRecord
    released: bool


LatchEvent = LatchTaken | ClearingSigned
