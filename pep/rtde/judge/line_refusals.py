"""Refusals of a lease's lines, on record as the judge's refusals are: never many in a second.

A faulty program repeats the same mistake five hundred times a second. A refusal without a record of its own is counted
in the next one.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.base.errors import JournalError
from pep.gate import records

if TYPE_CHECKING:
    from pep.base.ports import Clock
    from pep.rtde.judge.execution import Recording
    from pep.rtde.robot.judge_port import ProgramOwner
    from pep.rtde.wire.refusal import InputRefusal

MOST: Final = 4
"""Most records in a second, of one lease."""
SECOND_S: Final = 1.0


@dataclass(eq=False, slots=True)
class _Second:
    """One second of a lease.

    Attributes:
        holder: of it.
        records: there were so many.
        newest: of what has no record yet, and what was refused.
        without: so many have no record yet.
        timer: at its end.
    """

    holder: ProgramOwner
    timer: asyncio.TimerHandle
    records: int = 0
    newest: tuple[InputRefusal, str] | None = None
    without: int = 0


class LineRefusals:
    """Records of the lines' refusals. On one event loop.

    Args:
        record: durable, on a worker of its own.
        clock: both clocks.
    """

    def __init__(self, record: Recording, clock: Clock) -> None:
        self._record = record
        self._clock = clock
        self._seconds: dict[int, _Second] = {}  # by identity of the holder, which may have no hash
        self._tasks: set[asyncio.Task[None]] = set()

    def note(self, holder: ProgramOwner, refused: InputRefusal, what: str) -> None:
        """Records the refusal, or counts it in a record, within a second. Returns at once.

        Args:
            holder: owner of the program.
            refused: the refusal.
            what: was refused.
        """
        second = self._seconds.get(id(holder)) or self._begun(holder)
        if second.records < MOST:
            self._write(second, refused, what, more=0)
        else:
            second.newest = (refused, what)
            second.without += 1

    async def close(self) -> None:
        """Waits until all noted refusals are on record, or could not be."""
        for key, second in tuple(self._seconds.items()):
            del self._seconds[key]
            second.timer.cancel()
            self._count(second)
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _begun(self, holder: ProgramOwner) -> _Second:
        timer = asyncio.get_running_loop().call_later(SECOND_S, self._over, id(holder))
        second = self._seconds[id(holder)] = _Second(holder, timer)
        return second

    def _over(self, key: int) -> None:
        second = self._seconds.pop(key)
        if second.newest is not None:
            # The first record of the next second.
            following = self._begun(second.holder)
            following.newest, following.without = second.newest, second.without
            self._count(following)

    def _count(self, second: _Second) -> None:
        """Gives the newest refusal a record, and counts all others without one in it."""
        if second.newest is not None:
            refused, what = second.newest
            second.newest, more, second.without = None, second.without - 1, 0
            self._write(second, refused, what, more=more)

    def _write(self, second: _Second, refused: InputRefusal, what: str, *, more: int) -> None:
        second.records += 1
        task = asyncio.get_running_loop().create_task(self._written(second.holder, refused, what, more))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _written(self, holder: ProgramOwner, refused: InputRefusal, what: str, more: int) -> None:
        # Refused either way. A gate that has ended takes no record.
        with suppress(JournalError, RuntimeError):
            await self._record("refusal", refusal_of(holder, refused, what, clock=self._clock, more=more))


def refusal_of(
    holder: ProgramOwner, refused: InputRefusal, what: str, *, clock: Clock, more: int = 0
) -> dict[str, object]:
    """Record of a refusal before there was a request to decide.

    Args:
        holder: owner of the program.
        refused: the refusal.
        what: was refused.
        clock: both clocks.
        more: number of other refusals, of any reason, since the record before.
    """
    where: dict[str, object] = {"command": what, "detail": refused.place}
    return records.refusal(
        at=clock.wall_s(),
        at_ms=clock.monotonic_ms(),
        reason=refused.reason,
        status=200,
        credentials=holder.credentials,
        where=where | {"more": more} if more else where,
    )
