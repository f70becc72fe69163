"""The controller's speed slider: set in a thread of its own, so that nobody who looks at the arm waits for it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from concurrent.futures import Future


class SpeedSlider:
    """The `Slider` port over ur_rtde.

    The connection may be that of the digital outputs: one motion or one output acts at a time, so they never meet.

    Args:
        io: the raw `RTDEIOInterface`; keep no other reference to its slider.
    """

    def __init__(self, io: Any) -> None:
        self._io = io
        self._sender = ThreadPoolExecutor(1, "slider")
        self._newest: Future[Any] | None = None

    def set(self, fraction: float) -> None:
        """It is being set, after what was asked for before; whether the robot has it, only the robot can say."""
        self._newest = self._sender.submit(self._io.setSpeedSlider, fraction)

    @property
    def failed(self) -> bool:
        """Whether the controller did not take the newest setting."""
        newest = self._newest
        if newest is None or not newest.done():
            return False
        return newest.cancelled() or newest.exception() is not None or not newest.result()

    def close(self) -> None:
        """Nothing is set any more."""
        self._sender.shutdown(wait=False, cancel_futures=True)
