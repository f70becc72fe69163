"""Two clocks of a running PEP, and a wall time that cannot be set back.

Proofs, tokens and statements are judged by the wall clock. Setting that clock back would make an old proof fresh again
and an expired token valid. So the wall time that the PEP judges by never goes back by more than the allowed skew: not
while the process runs, and not over its restarts.
"""

from __future__ import annotations

import asyncio
import json
import math
import threading
import time
from typing import TYPE_CHECKING, Final

from pep.base.errors import PepError, PepFault
from pep.base.files import replace_file

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from pep.base.ports import Clock

MARK_PERIOD_S: Final = 2.0
"""Time between writings of the mark.

Less than the skew of 5 s, so that a crash loses less than the skew.
"""
TOLD_S: Final = 0.1
"""Held time above which an incident is told.

Well above the millisecond in which the monotonic clock counts.
"""
MARK_BYTES: Final = 256
"""Largest mark."""


class SystemClock:
    """The machine's clocks behind the `Clock` port."""

    def wall_s(self) -> float:
        """Seconds since the epoch."""
        return time.time()

    def monotonic_ms(self) -> int:
        """Milliseconds of the clock that never goes back."""
        return time.monotonic_ns() // 1_000_000


class TimeMark:
    """Latest wall time that the PEP judged by, on disk.

    Args:
        path: of the file, in the PEP's state directory.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()

    def read(self) -> float:
        """The stored time, seconds since the epoch; minus infinity when there is none yet.

        Raises:
            PepError: `STATE_UNREADABLE` when there is one that cannot be read: to start without it would let a clock
                that was set back revive what is over.
        """
        try:
            with self._path.open("rb") as file:
                stored = json.loads(file.read(MARK_BYTES))["wall_ms"]
        except FileNotFoundError:
            return -math.inf
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise PepError(PepFault.STATE_UNREADABLE, str(self._path)) from error
        if isinstance(stored, bool) or not isinstance(stored, int):
            raise PepError(PepFault.STATE_UNREADABLE, str(self._path))
        return stored / 1000

    def write(self, wall_s: float) -> None:
        """The time is on disk, rounded down to a millisecond.

        Raises:
            OSError: when it could not be made durable.
        """
        with self._lock:  # a writing whose waiter was cancelled goes on in its thread
            replace_file(self._path, json.dumps({"wall_ms": math.floor(wall_s * 1000)}).encode())


class HeldClock:
    """`Clock` port over another one, with a wall time that does not follow a clock that was set back.

    A wall time that falls behind by more than the skew is replaced by the highest one seen, less the skew, carried on
    by the monotonic clock. It is carried on, not stopped: a time that stood still would keep every token alive for as
    long as it stands, and would let proofs outlive the memory of their replays, which the monotonic clock counts.

    It does not follow a clock back that was wrong before and is right now, since it cannot know which of the two is the
    case: honest proofs are then refused as too old. Who knows that the clock is right now stops the PEP, removes the
    mark and starts it again.

    Args:
        machine: the clocks underneath.
        mark: the latest time that an earlier process judged by.
        skew_s: most by which the wall time may go back; as for proofs (`Caps.skew_s`), and more than `MARK_PERIOD_S`.

    Raises:
        PepError: `STATE_UNREADABLE`.
    """

    def __init__(self, machine: Clock, *, mark: TimeMark, skew_s: int) -> None:
        self._machine = machine
        self._mark = mark
        self._skew_s = skew_s
        self._lock = threading.Lock()
        # Seconds from the monotonic clock's zero to the epoch: only a step of the wall clock changes it. An earlier
        # process wrote its mark at most a period before it ended, so nothing is taken off that mark here.
        self._highest_s = mark.read() + skew_s - machine.monotonic_ms() / 1000

    def wall_s(self) -> float:
        """Seconds since the epoch, never more than the skew below any earlier value."""
        with self._lock:
            passed_s = self._machine.monotonic_ms() / 1000
            stated_s = self._machine.wall_s()
            self._highest_s = max(self._highest_s, stated_s - passed_s)
            return max(stated_s, passed_s + self._highest_s - self._skew_s)

    def monotonic_ms(self) -> int:
        """Milliseconds of the clock that never goes back."""
        return self._machine.monotonic_ms()

    @property
    def held_s(self) -> float:
        """Lead of the held wall time over the machine's wall clock, in seconds; mostly 0."""
        return max(0.0, self.wall_s() - self._machine.wall_s())

    async def run(self, *, failed: Callable[[OSError], None], set_back: Callable[[float], None]) -> None:
        """Keeps the time for ever.

        Args:
            failed: told of each mark that could not be written.
            set_back: told once of each time that the machine's clock is found to be set back, with `held_s`.
        """
        told = False
        while True:
            try:
                await asyncio.to_thread(self.keep)
            except OSError as error:
                failed(error)
            held_s = self.held_s
            if held_s > TOLD_S and not told:
                set_back(held_s)
            told = held_s > TOLD_S
            await asyncio.sleep(MARK_PERIOD_S)

    def keep(self) -> None:
        """Writes the time up to now to disk. To be called every `MARK_PERIOD_S`, and at the end.

        Raises:
            OSError: when it could not be made durable.
        """
        self._mark.write(self.wall_s())
