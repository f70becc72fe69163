"""Pictures of motions are kept for as long, and in as much room, as the settings state."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Final

from ztpm_idp.store.errors import ConflictError, StoreUnavailableError
from ztpm_idp.store.pictures.pictures import FORGOTTEN, Pictures

if TYPE_CHECKING:
    from ztpm_idp.provider.provider import Provider

logger = logging.getLogger(__name__)
PERIOD_S: Final = 60.0
"""Ours: time between two looks; between them there may be more than there is room for."""
DAY_MS: Final = 86_400_000
YOUNG_MS: Final = 3_600_000
"""Life of the longest ask: while people may answer, they are shown what they answer."""
MEGABYTE: Final = 1_000_000


async def forget(provider: Provider) -> int:
    """Forgets every picture whose time is over, or for which there is no room; the number of them.

    Raises:
        StoreUnavailableError: some may be left.
        ConflictError: likewise.
    """
    kept, at_ms, forgotten = provider.settings.pictures, provider.now_ms(), 0
    while True:
        async with provider.store.beside() as connection:
            some = await Pictures(connection).forget(
                before_ms=at_ms - kept.days * DAY_MS,
                young_ms=at_ms - YOUNG_MS,
                most_bytes=kept.megabytes * MEGABYTE,
            )
        forgotten += some
        if some < FORGOTTEN:
            return forgotten


async def keep_pictures(provider: Provider, *, period_s: float = PERIOD_S) -> None:
    """Forgets for ever, one look after the other."""
    while True:
        try:
            await forget(provider)
        except (StoreUnavailableError, ConflictError) as error:
            logger.warning("pictures were not looked at: %s", type(error).__name__)
        await asyncio.sleep(period_s)
