"""The one row of counters: read without waiting, locked only when something is appended, written once."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Final

import sqlalchemy as sa

from ztpm_idp.store import schema as t
from ztpm_idp.store.database import postgres_trips

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sqlalchemy.ext.asyncio import AsyncConnection


@dataclass(frozen=True, slots=True)
class Counters:
    """The one row of counters, as this transaction sees it."""

    epoch: int
    registry_version: int
    ledger_size: int
    ledger_head: str
    conduct_version: int
    revocation_line: int
    revocation_head: str
    restoring: bool


_NAMES: Final = tuple(field.name for field in fields(Counters))
READ: Final = sa.select(*(t.counters.c[name] for name in _NAMES))
"""The row, in the order of `Counters`."""
_LOCK: Final = f"SELECT {', '.join(_NAMES)} FROM counters FOR UPDATE"  # noqa: S608 - names of ours


class Counting:
    """Access of one transaction to the counters.

    Args:
        connection: of the transaction.
        waits: True where others may append meanwhile: the row is locked, and read anew, before it is changed.
    """

    def __init__(self, connection: AsyncConnection, *, waits: bool) -> None:
        self._connection = connection
        self._waits = waits
        self._read: Counters | None = None
        self._stored: Counters | None = None

    async def now(self) -> Counters:
        """The counters as they were first read, with the transaction's own changes."""
        if self._read is None:
            self._read = Counters(*(await self._connection.execute(READ)).one())
        return self._read

    def seen(self, row: Iterable[Any]) -> Counters:
        """The counters, of which this row of `READ` was read in the transaction; its own changes stay."""
        if self._read is None:
            self._read = Counters(*row)
        return self._read

    async def locked(self) -> Counters:
        """The counters, which this transaction alone changes from now on until its end."""
        if self._stored is None:
            if self._waits:
                self._read = Counters(*(await postgres_trips.fetch(self._connection, _LOCK))[0])
            self._stored = await self.now()
        return await self.now()

    async def change(self, **changes: Any) -> None:
        """The counters have these values, for this transaction; `write` stores them."""
        self._read = replace(await self.locked(), **changes)

    async def next(self, name: str) -> int:
        """The next value of a version: later in commit order than every one before."""
        value: int = getattr(await self.locked(), name) + 1
        await self.change(**{name: value})
        return value

    @property
    def changed(self) -> bool:
        """True where this transaction has changes that are not in the row."""
        return self._stored is not None and self._read != self._stored

    async def stored(self) -> Counters:
        """The counters after the changes, all of which the caller puts into the row."""
        self._stored = await self.locked()
        return self._stored

    async def write(self) -> Counters:
        """The changes are in the row; the counters after them."""
        if not self.changed:
            return await self.now()
        now, stored = await self.locked(), self._stored
        changed = {name: value for name in _NAMES if (value := getattr(now, name)) != getattr(stored, name)}
        if changed:
            await self._connection.execute(sa.update(t.counters).values(**changed))
        self._stored = now
        return now
