"""Freshness of a proof: its age, the verifier's own start, and how long its id must be kept. Arithmetic only.

Clauses [PRF-6] to [PRF-9] in docs/spec.md. All of it rests on [PRF-9]: the wall time that a verifier judges by never
falls more than the skew behind the highest one that it judged by before. A monotonic clock carries that time on, over
restarts too (`pep.base.clock` holds it so). Then no proof is accepted twice, even when a clock is set back or a
verifier is restarted; a property test plays that out.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import TYPE_CHECKING

from capabilities.values.errors import Fault, FaultCode

if TYPE_CHECKING:
    from capabilities.values.caps import Caps


class Memory(Enum):
    """Knowledge that a starting verifier has of the proofs that an earlier process accepted."""

    KEPT = "kept"
    """Every proof that had an effect in the last `retention_ms`, whichever process took it, from a durable record."""
    LOST = "lost"
    """The record is missing, cut, or younger than that."""


def stale(iat: int, *, at: float, caps: Caps) -> Fault | None:
    """None for a proof made just now; else `PROOF_STALE` of [PRF-6].

    Args:
        iat: when the proof says that it was made, seconds since the epoch.
        at: the time that the verifier judges by, seconds since the epoch.
        caps: greatest age and skew, both included.
    """
    if not -caps.skew_s <= at - iat <= caps.proof_age_s:
        return Fault(FaultCode.PROOF_STALE, "PRF-6")
    return None


def earliest_iat_s(started_s: float, *, memory: Memory, caps: Caps) -> int:
    """The earliest `iat` that a verifier accepts which started at `started_s` ([PRF-8]), seconds since the epoch.

    The first whole second after the start, since a proof counts whole seconds: one made before the start must not pass
    for one made after it. A verifier that remembers too little adds the skew twice: an earlier process may have taken
    proofs from that far in the future, and its time may have been that far ahead of the present one.

    Args:
        started_s: the time that is judged by at the start, seconds since the epoch.
        memory: the verifier's knowledge of earlier proofs.
        caps: the skew.
    """
    lost_s = 2 * caps.skew_s if memory is Memory.LOST else 0
    return math.floor(started_s) + 1 + lost_s


def before_start(iat: int, *, earliest_s: float) -> Fault | None:
    """None for a proof made since `earliest_s` (see `earliest_iat_s`); else `PROOF_STALE` of [PRF-8]."""
    if not iat >= earliest_s:
        return Fault(FaultCode.PROOF_STALE, "PRF-8", "the proof is older than this verifier")
    return None


def retention_ms(caps: Caps) -> int:
    """Milliseconds for which the id of an accepted proof is kept, on a monotonic clock from its acceptance ([PRF-7]).

    The proof may come from the future by the skew, lives for the greatest age after that, and the time may then be set
    back by the skew. One second more covers whole milliseconds and a clock that runs slow by 2 %.
    """
    return (caps.proof_age_s + 2 * caps.skew_s + 1) * 1000
