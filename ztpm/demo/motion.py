"""One move that is called, watched over a connection of its own while it lasts, and measured afterwards."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Self

from ztpm.stage.samples import StateRecorder
from ztpm.stage.stage import ACCELERATION_RAD_S2, WAIT_S, StageError, until
from ztpm.stage.stopping import read_stop

if TYPE_CHECKING:
    from types import TracebackType

    from ztpm.stage.calls import Answer
    from ztpm.stage.stage import Stage
    from ztpm.stage.stopping import Stopped


class Motion:
    """Agent's move under way, as a context.

    At its end the call has been answered and the recorder is closed.

    Args:
        stage: the running stage.
        agent: the caller.
        to: target, 6 angles in rad.
        speed: of the leading axis, rad/s.
        token: another than the agent's own.
    """

    def __init__(
        self, stage: Stage, agent: str, *, to: tuple[float, ...], speed: float, token: str | None = None
    ) -> None:
        self._eyes = StateRecorder(stage.cell.addresses.host)
        self._began_s = time.monotonic()
        self._caller = ThreadPoolExecutor(1, "call")
        self._start = self._eyes.now().q_rad
        self._answer = self._caller.submit(stage.move, agent, to=to, speed=speed, token=token)

    def under_way(self, way_rad: float) -> None:
        """Waits until some joint has come that far.

        Raises:
            StageError: it does not, or the call was answered before.
        """

        def far() -> bool:
            if self._answer.done():
                raise StageError(f"the move was over at once: {self._answer.result().content}")
            return max(abs(a - b) for a, b in zip(self._eyes.now().q_rad, self._start, strict=True)) >= way_rad

        until(far, "the arm under way")

    def answer(self) -> Answer:
        """Answer to the call; the arm stands then."""
        answer = self._answer.result(timeout=WAIT_S)
        until(lambda: self._eyes.now().still, "standstill")
        return answer

    def stop_after(self, at_s: float) -> Stopped:
        """Stop that followed an event, once the arm stands.

        Args:
            at_s: CLOCK_MONOTONIC of the event.

        Raises:
            StageError: the arm was not stopped, or had ended before.
        """
        until(lambda: self._eyes.now().still, "standstill")
        stopped = read_stop(self._eyes.since(self._began_s), at_s=at_s, acceleration_rad_s2=ACCELERATION_RAD_S2)
        if stopped is None:
            raise StageError("no stop was seen")
        return stopped

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._caller.shutdown(wait=True)
        self._eyes.close()
