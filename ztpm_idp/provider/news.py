"""News of revocations for those who wait: what a hint is about, signed once for all of them ([STM-20])."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

from ztpm_idp.provider.feed import index_after

if TYPE_CHECKING:
    from ztpm_idp.provider.feed import Deployment

NONCE: Final = "0" * 16
"""Nonce of news: nobody's, so that no view is made young by it."""
REMEMBERED: Final = 64
"""Most epochs after which news is remembered; nearly all who wait know the same one."""


class News:
    """Signed indexes by the epoch that they come after, each made once."""

    def __init__(self) -> None:
        self._made: dict[int, tuple[int, int, str]] = {}
        self._turn = asyncio.Lock()

    async def after(self, provider: Deployment, since: int, *, epoch: int) -> str:
        """Signed index of everything after `since`, up to `epoch` at least.

        Args:
            provider: of this deployment.
            since: what the caller knows.
            epoch: that the store has reached, above `since`.

        Raises:
            StoreUnavailableError: the store cannot be read.
            Problem: `RESTORING`.
        """
        async with self._turn:  # the others find it made
            version = provider.keys.bundle_version
            made = self._made.get(since)
            if made is not None and made[0] == version and made[1] >= epoch:
                return made[2]
            text, reached = await index_after(provider, since=since, nonce=NONCE)
            self._made.pop(since, None)
            while len(self._made) >= REMEMBERED:
                del self._made[next(iter(self._made))]
            self._made[since] = version, reached, text
            return text
