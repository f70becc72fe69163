"""Speed slider of the controller, set on its line's event loop: no look at the arm waits for it."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from pep.rtde.command.io_commands import SetSpeedSlider

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future

    from pep.rtde.command.io_commands import IoCommand


class SpeedSlider:
    """The `Slider` port over the line of the cell's tools. Made on its event loop, used from other threads.

    Args:
        switch: writes the setting; true once it is written. On that event loop.
    """

    def __init__(self, switch: Callable[[IoCommand], bool]) -> None:
        self._switch = switch
        self._loop = asyncio.get_running_loop()
        self._newest: Future[bool] | None = None

    def set(self, fraction: float) -> None:
        """Sets the slider after all earlier settings, without waiting; only the robot can say whether it has it."""
        self._newest = asyncio.run_coroutine_threadsafe(self._set(fraction), self._loop)

    @property
    def failed(self) -> bool:
        """True where the controller did not take the newest setting."""
        newest = self._newest
        if newest is None or not newest.done():
            return False
        return newest.cancelled() or newest.exception() is not None or not newest.result()

    async def _set(self, fraction: float) -> bool:
        return self._switch(SetSpeedSlider(fraction))
