"""Our own lines with the methods of ur_rtde, for whoever stands before them: `PermittedControl`, outputs, the slider.

From any thread but the event loop's. Only what guarded tools say is here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, TypeVar

from pep.rtde.command import command_values as v
from pep.rtde.command.io_commands import Bank, SetDigitalOutputs, SetSpeedSlider

if TYPE_CHECKING:
    from collections.abc import Coroutine, Sequence

    from pep.rtde.command.command_values import Command, Six
    from pep.rtde.command.io_commands import IoCommand

T = TypeVar("T")


class CommandLines(Protocol):
    """Lines of the event loop's own to the controller, asked from another thread."""

    @property
    def up(self) -> bool:
        """True while commands reach the controller."""

    async def said(self, command: Command) -> bool:
        """Send a command; True once the control script has taken it."""

    async def switched(self, command: IoCommand) -> bool:
        """Switch outputs or the speed slider; True once the controller has it."""

    async def stop(self) -> None:
        """Stop the arm."""

    async def end(self) -> None:
        """End the control script."""

    def from_thread(self, what: Coroutine[None, None, T]) -> T:
        """Run a coroutine on the event loop, and wait for its result."""


class OwnControl:
    """`RTDEControlInterface`, as far as guarded tools use it.

    Args:
        lines: the way to the controller.
    """

    def __init__(self, lines: CommandLines) -> None:
        self._lines = lines

    def moveJ(self, q: Sequence[float], speed: float, acceleration: float, asynchronous: bool) -> bool:  # noqa: N802, FBT001
        """Whether the move was begun."""
        return self._said(v.MoveJ(_six(q), speed, acceleration, asynchronous))

    def moveL(self, pose: Sequence[float], speed: float, acceleration: float, asynchronous: bool) -> bool:  # noqa: N802, FBT001
        """Whether the move was begun."""
        return self._said(v.MoveL(_six(pose), speed, acceleration, asynchronous))

    def speedJ(self, qd: Sequence[float], acceleration: float, time: float) -> bool:  # noqa: N802
        """Whether the speeds were taken."""
        return self._said(v.SpeedJ(_six(qd), acceleration, time))

    def stopJ(self, a: float, asynchronous: bool) -> None:  # noqa: N802, FBT001
        """Whatever moves is being stopped, a program's motion too."""
        self._stop(v.StopJ(a, asynchronous))

    def stopL(self, a: float, asynchronous: bool) -> None:  # noqa: N802, FBT001
        """As `stopJ`."""
        self._stop(v.StopL(a, asynchronous))

    def speedStop(self, a: float) -> None:  # noqa: N802
        """As `stopJ`."""
        self._stop(v.SpeedStop(a))

    def servoStop(self, a: float) -> None:  # noqa: N802
        """As `stopJ`."""
        self._stop(v.ServoStop(a))

    def stopScript(self) -> None:  # noqa: N802
        """Whatever program runs is being ended."""
        self._lines.from_thread(self._lines.stop())

    def setWatchdog(self, least_hz: float) -> bool:  # noqa: N802
        """Whether the arm is stopped from now on when nothing is said for so long."""
        return self._said(v.SetWatchdog(least_hz))

    def setPayload(self, mass_kg: float, centre_m: Sequence[float]) -> bool:  # noqa: N802
        """Whether the controller reckons with it."""
        x, y, z = centre_m
        return self._said(v.SetPayload(mass_kg, (x, y, z)))

    def isProgramRunning(self) -> bool:  # noqa: N802
        """Whether our control script does."""
        return self._lines.up

    def isConnected(self) -> bool:  # noqa: N802
        """Whether our lines are there."""
        return self._lines.up

    def disconnect(self) -> None:
        """Our lines are gone."""
        self._lines.from_thread(self._lines.end())

    def _said(self, command: Command) -> bool:
        return self._lines.from_thread(self._lines.said(command))

    def _stop(self, command: v.Stop) -> None:
        if self._lines.up:
            self._lines.from_thread(self._lines.said(command))
        else:
            self.stopScript()


class OwnOutputs:
    """`RTDEIOInterface`, likewise.

    Args:
        lines: the way to the controller.
    """

    def __init__(self, lines: CommandLines) -> None:
        self._lines = lines

    def setStandardDigitalOut(self, pin: int, value: bool) -> bool:  # noqa: N802, FBT001
        """Whether it was written."""
        mask = 1 << pin
        return self._lines.from_thread(
            self._lines.switched(SetDigitalOutputs(Bank.STANDARD, mask, mask if value else 0))
        )

    def setSpeedSlider(self, fraction: float) -> bool:  # noqa: N802
        """Whether it was written."""
        return self._lines.from_thread(self._lines.switched(SetSpeedSlider(fraction)))

    def disconnect(self) -> None:
        """Nothing: the lines are the control connection's."""


def _six(numbers: Sequence[float]) -> Six:
    a, b, c, d, e, f = map(float, numbers)
    return a, b, c, d, e, f
