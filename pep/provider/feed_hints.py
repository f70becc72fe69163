"""Hints of the next revocation: one request that waits at the provider, so that nobody waits for a pull's period.

A hint decides nothing by itself. The signed news in it is in force at once, as is all that the feed's key signs
([STM-14], [STM-20]); it makes no view young, and the mark and the chain are the pull's. A hint without news makes the
next pull come at once. A forged one causes a pull, four a second at most beyond those of revocations; a suppressed one
leaves the ordinary period to find out.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from capabilities.values import strict_json
from capabilities.values.errors import CapabilityError
from pep.base.errors import FeedError, PepFault

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from pep.base.ports import Clock

HINT_TIMEOUT_S: Final = 25.0
"""Longest wait for a hint: the provider answers within 20 s."""
HINT_ROOM: Final = 256
"""Bytes of a hint beside its news, at most."""
BACKOFF_S: Final = 0.25
"""Shortest pause after a hint that failed, brought nothing new at once, or was not borne out."""
LONGEST_BACKOFF_S: Final = 8.0
"""Longest pause after hints that failed one after another; they are a convenience, and the pull goes on."""


class Newest(Protocol):
    """Place of the newest accepted index."""

    @property
    def line(self) -> int:
        """Line of the feed."""
        ...

    @property
    def epoch(self) -> int:
        """Its epoch."""
        ...


@dataclass(frozen=True, slots=True)
class Hint:
    """Answer to who waits for a revocation.

    Attributes:
        epoch: the provider's, as it says.
        news: signed index of everything after the epoch that was asked for; empty where there is none.
    """

    epoch: int
    news: str


@dataclass(frozen=True, slots=True)
class Heard:
    """Place up to which verified news is in force."""

    line: int
    epoch: int


def read_hint(text: str) -> Hint:
    """The hint of an answer.

    Raises:
        FeedError: `FEED_UNREACHABLE` for no hint.
    """
    try:
        members = strict_json.parse_object(text.encode())
    except CapabilityError as error:
        raise FeedError(PepFault.FEED_UNREACHABLE, "not a hint") from error
    epoch, news = members.get("epoch"), members.get("news", "")
    if isinstance(epoch, bool) or not isinstance(epoch, int) or not isinstance(news, str):
        raise FeedError(PepFault.FEED_UNREACHABLE, "not a hint")
    return Hint(epoch, news)


class FeedHints:
    """Keeps one request waiting for the next revocation.

    Args:
        ask: the provider's answer to who knows this epoch; a FeedError where there is none.
        hear: puts verified news in force; None for what is no news after this epoch.
        newest: place of the newest accepted index; None before the first.
        pulled: waits for the end of the next pull.
        pull: makes a pull begin now, and waits for its end.
        clock: both clocks.
    """

    def __init__(
        self,
        *,
        ask: Callable[[int], Awaitable[str]],
        hear: Callable[[str, int], Heard | None],
        newest: Callable[[], Newest | None],
        pulled: Callable[[], Awaitable[None]],
        pull: Callable[[], Awaitable[None]],
        clock: Clock,
    ) -> None:
        self._ask = ask
        self._hear = hear
        self._newest = newest
        self._pulled = pulled
        self._pull = pull
        self._clock = clock
        self._heard = Heard(0, 0)

    async def run(self) -> None:
        """Asks for ever."""
        backoff_s = BACKOFF_S
        while True:
            known = self._newest()
            if known is None:  # there is no question before the first view
                await self._pulled()
                continue
            since, asked_ms = self._since(known), self._clock.monotonic_ms()
            try:
                hint = read_hint(await self._ask(since))
            except FeedError:
                # No incident: only the pull matters, and it tells its own failures.
                await asyncio.sleep(backoff_s)
                backoff_s = min(2 * backoff_s, LONGEST_BACKOFF_S)
                continue
            backoff_s = BACKOFF_S
            if hint.epoch <= since:
                borne_out = self._clock.monotonic_ms() - asked_ms >= BACKOFF_S * 1000
            elif hint.news and (heard := self._hear(hint.news, since)) is not None and heard.line == known.line:
                self._heard, borne_out = heard, heard.epoch > since
            else:
                await self._pull()
                newest = self._newest()
                borne_out = newest is not None and newest.epoch > since
            if not borne_out:
                await asyncio.sleep(BACKOFF_S)

    def _since(self, known: Newest) -> int:
        """The epoch up to which everything of this line is in force."""
        return max(known.epoch, self._heard.epoch) if self._heard.line == known.line else known.epoch
