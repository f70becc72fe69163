"""The stop of an arm whose program is in this process: what the controller runs is ended, past that program."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from pep.rtde.motion.brake import Brake

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.base.ports import Clock
    from policies.words.reason_table import Reason


class ProgramStopper:
    """`pep.rtde.robot.judge_port.Stopper`. From any thread.

    Args:
        end_program: ends what the controller runs; `pep.rtde.robot.dashboard.stop_program` of its host, say. It may
            block.
        clock: the monotonic one counts.
    """

    def __init__(self, end_program: Callable[[], None], clock: Clock) -> None:
        self._brake = Brake("end program", end_program)
        self._clock = clock
        self._lock = threading.Lock()
        self._stopped_ms: int | None = None

    def stop(self, reason: Reason) -> None:  # noqa: ARG002 - whoever asks has it on record
        """See `Stopper.stop`."""
        self.note()
        self._brake.take()

    def note(self) -> None:
        """Somebody has stopped the arm another way: every permit of an earlier request is void."""
        with self._lock:
            self._stopped_ms = self._clock.monotonic_ms()

    @property
    def stopped_ms(self) -> int | None:
        """See `Stopper.stopped_ms`."""
        return self._stopped_ms
