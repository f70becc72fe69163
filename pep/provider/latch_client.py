"""Telling people of a latch: it is posted to the identity provider as long as it is in force."""

from __future__ import annotations

import asyncio
import json
from typing import TYPE_CHECKING, Final

from pep.base.errors import FeedError, PepError, PepFault

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.base.ports import Clock
    from pep.people.latches import Latches
    from pep.provider.ask_client import AskClient

LOOK_S: Final = 0.1
AGAIN_MS: Final = 30_000
"""Time after which it is posted again: a provider that was restored may have forgotten it."""
BACK_OFF_MS: Final = 2_000
"""Pause after a post that failed."""
REFUSAL_BYTES: Final = 4_096
"""Longest answer to a post that is read."""


class LatchClient:
    """Poster of the latch.

    Args:
        latches: of the robot.
        asking: the connection to the provider.
        clock: the monotonic one counts.
        incident: told about every post that failed.
    """

    def __init__(
        self, latches: Latches, asking: AskClient, *, clock: Clock, incident: Callable[[PepError], None]
    ) -> None:
        self._latches = latches
        self._asking = asking
        self._clock = clock
        self._incident = incident
        self._told, self._next_ms = "", 0

    async def run(self) -> None:
        """Posts the latch, and again. Runs until it is cancelled."""
        while True:
            await self.look()
            await asyncio.sleep(LOOK_S)

    async def look(self) -> None:
        """Posts the latch where it is time to."""
        found, now_ms = self._latches.in_force, self._clock.monotonic_ms()
        if found is None or not found.text or (found.text == self._told and now_ms < self._next_ms):
            return
        self._told = found.text
        try:
            status, _ = await self._asking.send(
                "POST", "/latches", body=json.dumps({"latch": found.text}).encode(), most_bytes=REFUSAL_BYTES
            )
            taken = status in {200, 201}
            if not taken:
                self._incident(FeedError(PepFault.LATCH_NOT_TAKEN, f"status {status}"))
        except FeedError as error:
            taken = False
            self._incident(error)
        self._next_ms = self._clock.monotonic_ms() + (AGAIN_MS if taken else BACK_OFF_MS)
