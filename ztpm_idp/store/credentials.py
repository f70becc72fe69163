"""Tokens of platforms that were shown: each counts once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import sqlalchemy as sa

from ztpm_idp.store import schema as t
from ztpm_idp.store.errors import OnceOnlyError

if TYPE_CHECKING:
    from sqlalchemy.ext.asyncio import AsyncConnection

GRACE_MS: Final = 3_600_000
"""Milliseconds for which a spent token is remembered after its end: a clock that jumps back an hour revives none."""


async def spend(connection: AsyncConnection, credential: bytes, *, until_ms: int, at_ms: int) -> None:
    """Spends a platform's token, remembered for as long as it could be shown, and a clock's jump more.

    Raises:
        OnceOnlyError: it was spent before.
    """
    c = t.spent_credentials.c
    await connection.execute(sa.delete(t.spent_credentials).where(c.until_ms < at_ms - GRACE_MS))
    known = await connection.execute(sa.select(c.digest).where(c.digest == credential))
    if known.first() is not None:
        raise OnceOnlyError
    await connection.execute(sa.insert(t.spent_credentials).values(digest=credential, until_ms=until_ms))
