"""Revocation horizon: from the answer to who revoked until a follower has read it in a signed index."""

from __future__ import annotations

import asyncio
import secrets
import time
from typing import TYPE_CHECKING, Final

from capabilities.statements import revocation
from capabilities.values.caps import DEFAULT
from evaluation.idp.load import Connection, ready

if TYPE_CHECKING:
    from collections.abc import Iterable

    from evaluation.idp.load import Answered
    from evaluation.idp.place import IdpPlace

NONCE_BYTES: Final = 24
PERIOD_S: Final = 0.25
"""Time between two pulls of an enforcement point (`pep.provider.feed`)."""


class Follower:
    """One follower of the feed, as an enforcement point is: it waits for the hint, and pulls the signed index.

    Attributes:
        seen: monotonic time at which each epoch was read, seconds.
    """

    def __init__(self, at: IdpPlace, worker: int) -> None:
        self._issuer = at.issuer
        self._place = at.provider[worker % len(at.provider)]
        self._keys = at.feed_keys
        self._epoch = 0
        self._news = asyncio.Event()
        self.seen: dict[int, float] = {}

    async def follow(self) -> None:
        """Follows until it is cancelled."""
        pulls, hints = await Connection.to(self._place), await Connection.to(self._place)
        try:
            await self._pull(pulls)  # all that was revoked before it began
            while True:
                hint = asyncio.ensure_future(hints.answer(self._asked("/revocations/wait")))
                try:
                    while not hint.done():
                        await asyncio.wait([hint], timeout=PERIOD_S)
                        await self._pull(pulls)
                finally:
                    hint.cancel()
        finally:
            pulls.close()
            hints.close()

    async def has_read(self, epoch: int) -> None:
        """Returns once it has read this epoch."""
        while epoch not in self.seen:
            self._news.clear()
            await self._news.wait()

    async def _pull(self, connection: Connection) -> None:
        more = True
        while more:
            text = await connection.answer(
                self._asked("/revocations", f"&nonce={secrets.token_urlsafe(NONCE_BYTES)}")
            )  # fmt: skip
            index = revocation.open(text, self._keys, DEFAULT)
            now = time.monotonic()
            for entry in index.entries:
                self.seen.setdefault(entry.epoch, now)
            last = index.entries[-1].epoch if index.entries else index.epoch
            more = self._epoch < last < index.epoch
            self._epoch = max(self._epoch, last)
        self._news.set()

    def _asked(self, path: str, more: str = "") -> bytes:
        return ready("GET", f"{self._issuer}{path}?since={self._epoch}{more}", b"", {}).raw


def horizons_ms(followers: Iterable[Follower], revoked: Answered) -> list[float]:
    """For each follower and each revocation: milliseconds from its acknowledgement until it was read.

    A revocation that was read before its own answer came counts as none.

    Raises:
        KeyError: a follower has not read one of them.
    """
    return [
        max(0.0, (follower.seen[answer["epoch"]] - ended) * 1e3)
        for follower in followers
        for answer, ended in zip(revoked.bodies, revoked.ended, strict=True)
    ]
