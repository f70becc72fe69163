"""Decisions without enforcement, for the simulator alone: parts that gate and composition need for `unsafe_observe`.

Everything is decided and recorded as ever, and what is denied or deferred happens all the same. So it takes a
`Simulated`, which exists because a controller proved that nothing moves behind it (`ztpm.point.simulator_check`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.watch.watch import Watch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.base.ports import Journal
    from pep.watch.governor import ReportedSpeeds
    from pep.watch.watch import Alarm

OBSERVED: Final = "observed"
"""Key in the body of every record, and in answers to callers, for unenforced decisions."""
LASTS_MS: Final = 1_000
"""Longest time from a decision to the beginning of its observed effect."""
HIGHEST_MILLI: Final = 4_000
"""Highest impact index: the rest of every observed motion is under it."""


@dataclass(frozen=True, slots=True)
class Simulated:
    """A controller that is simulated. Made by `ztpm.point.simulator_check.recognise` alone: its existence is the proof.

    Attributes:
        host: its address, on loopback.
    """

    host: str


class Marked:
    """Journal that marks each record as not enforced."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal

    def append(self, kind: str, body: dict[str, object]) -> str:
        """Appends to the journal with the mark."""
        return self._journal.append(kind, {**body, OBSERVED: True})

    def note(self, kind: str, body: dict[str, object]) -> str:
        """As `append`; nothing waits for it."""
        return self._journal.note(kind, {**body, OBSERVED: True})

    def settle(self) -> None:
        """Every note survives a power cut."""
        self._journal.settle()


class Unwatched(Watch):
    """The watch of an observed motion: it sees nothing that would end it."""

    def look(self, q_rad: Sequence[float], speeds: ReportedSpeeds | None = None) -> Alarm | None:  # noqa: ARG002 - as the watch's
        """Nothing."""
        return None
