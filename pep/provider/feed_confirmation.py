"""Confirming to the provider how far its feed is followed here, so that people who revoke see it ([STM-17]).

A convenience of people: no decision waits for it, and what cannot be confirmed is in force all the same.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final, Protocol

from capabilities.statements import mark as statement
from capabilities.values import strict_json
from pep.base.errors import FeedError

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from capabilities.keys.keys import PrivateKey
    from pep.base.ports import Clock

PERIOD_S: Final = 10.0
"""Time between confirmations of one view: a third of that after which a point counts as gone."""
BACKOFF_S: Final = 1.0
LONGEST_BACKOFF_S: Final = 60.0
"""Pause after a confirmation that failed, and the longest after several: an earlier provider takes none."""


class Followed(Protocol):
    """Mark of a view that is in force and on disk."""

    @property
    def line(self) -> int:
        """Line of the feed."""
        ...

    @property
    def epoch(self) -> int:
        """Epoch of its newest accepted index."""
        ...

    @property
    def head(self) -> str:
        """Head of the line's chain there."""
        ...


class FeedConfirmation:
    """Confirms each new mark of a follower, the newest alone where several came at once.

    Args:
        post: sends a body to the provider's path for marks; a FeedError where it is not taken.
        issuer: base URL of the provider.
        key: of this enforcement point.
        clock: both clocks.
    """

    def __init__(self, post: Callable[[bytes], Awaitable[None]], *, issuer: str, key: PrivateKey, clock: Clock) -> None:
        self._post = post
        self._issuer = issuer
        self._key = key
        self._clock = clock

    async def run(self, newest: Callable[[], Followed | None], pulled: Callable[[], Awaitable[None]]) -> None:
        """Confirms for ever.

        Args:
            newest: the mark as it is now; None before the first view.
            pulled: waits for the end of the next pull.
        """
        told: tuple[int, int] | None = None
        told_ms, backoff_s = 0, BACKOFF_S
        while True:
            await pulled()
            mark, now_ms = newest(), self._clock.monotonic_ms()
            if mark is None or ((mark.line, mark.epoch) == told and now_ms - told_ms < PERIOD_S * 1_000):
                continue
            try:
                await self._post(self._body(mark))
            except FeedError:
                await asyncio.sleep(backoff_s)
                backoff_s = min(2 * backoff_s, LONGEST_BACKOFF_S)
                continue
            told, told_ms, backoff_s = (mark.line, mark.epoch), now_ms, BACKOFF_S

    def _body(self, mark: Followed) -> bytes:
        at = int(self._clock.wall_s())
        text = statement.sign(statement.Mark(self._issuer, mark.line, mark.epoch, mark.head, (), 0, at), self._key)
        return strict_json.canonical({"mark": text})
