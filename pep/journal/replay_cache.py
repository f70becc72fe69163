"""Proof ids seen, in memory.

A proof that an earlier process accepted is too old now, or comes back by the journal.
"""

from __future__ import annotations

import hashlib
import heapq
import threading
from typing import TYPE_CHECKING, Final

from pep.base.errors import PepFault, ReplayStoreError

if TYPE_CHECKING:
    from pep.base.ports import Clock

DEFAULT_CAPACITY: Final = 200_000
"""Capacity for proofs that are kept for 41 s (capabilities.proof.freshness.retention_ms).

It admits 4,800 a second, in about 40 MB.
"""


def proof_name(key: bytes, jti: str) -> bytes:
    """Name of a proof: SHA-256 over the length byte of its raw public key, the key, and its id."""
    return hashlib.sha256(bytes([len(key)]) + key + jti.encode("utf-8", "surrogatepass")).digest()


class ReplayCache:
    """The `ReplayStore` port in memory: bounded, atomic, fail-closed.

    It forgets nothing early: when it is full of proofs that are still alive it raises, and the request is denied.
    """

    def __init__(self, clock: Clock, *, capacity: int = DEFAULT_CAPACITY) -> None:
        self._clock = clock
        self._capacity = capacity
        self._lock = threading.Lock()
        self._seen: set[bytes] = set()
        self._by_expiry: list[tuple[int, bytes]] = []

    def first_use(self, jti: str, *, key: bytes, expires_ms: int) -> bool:
        """True exactly once for each (key, jti) until `expires_ms`.

        Args:
            jti: the proof's id.
            key: the proof's raw public key, 32 or 33 bytes.
            expires_ms: on the monotonic clock; after it the proof is refused for its age.

        Raises:
            ReplayStoreError: `REPLAY_STORE_FULL`.
        """
        return self._store(proof_name(key, jti), expires_ms)

    def remember(self, name: bytes, *, expires_ms: int) -> None:
        """The proof of that name counts as used: it stands in the journal of an earlier process.

        Raises:
            ReplayStoreError: `REPLAY_STORE_FULL`.
        """
        self._store(name, expires_ms)

    def _store(self, name: bytes, expires_ms: int) -> bool:
        with self._lock:
            now = self._clock.monotonic_ms()
            while self._by_expiry and self._by_expiry[0][0] < now:
                self._seen.discard(heapq.heappop(self._by_expiry)[1])
            if name in self._seen:
                return False
            if len(self._seen) >= self._capacity:
                raise ReplayStoreError(PepFault.REPLAY_STORE_FULL, f"{self._capacity} proofs are alive")
            self._seen.add(name)
            heapq.heappush(self._by_expiry, (expires_ms, name))
            return True
