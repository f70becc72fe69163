"""A line of the gateway's own to its controller's ports: a client of them without a socket between.

What it says goes the way of every program's: the same registers, the same watchdog, the same stops. On one event loop.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, Final

from pep.base.errors import PepFault, RobotError
from pep.rtde.command.command_table import READS, CommandClass, Wait, encode, row_of
from pep.rtde.command.command_values import Clear
from pep.rtde.command.io_commands import MASKS, encode_io
from pep.rtde.line.command_registers import DONE, READY
from pep.rtde.line.lease_stop import PLAYING
from pep.rtde.robot.connections import RTDE
from pep.rtde.wire.messages import WireError
from pep.rtde.wire.recipes import INT, OFFSETS
from pep.rtde.wire.subscription import Subscription
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pep.rtde.command.command_values import Command
    from pep.rtde.command.io_commands import IoCommand
    from pep.rtde.robot.connections import Ports, ProgramConnection
    from pep.rtde.robot.judge_port import ProgramOwner
    from pep.rtde.wire.codec import Value

OFFSET: Final = OFFSETS[0]
COMMANDS_HZ, SWITCHES_HZ = 500.0, 10.0
"""How often the controller says what a line has to know; nothing has to, of outputs."""
BEGINS_S: Final = 2.0
"""Longest wait for the controller's first package."""
READY_S: Final = 2.0
"""Longest wait for the control script to be done with what it was told before."""
DONE_S: Final = 5.0
"""Longest wait for the control script's word; it says within some milliseconds that it has taken a command."""
_STATE, _SAID = "runtime_state", f"output_int_register_{OFFSET}"
_COMMANDS: Final = (1, 3, 9, 15, 16, 17, 29, 33, 34, 35)
"""moveJ, moveL, speedJ, speedStop, servoStop, setPayload, setTcp, stopL, stopJ, setWatchdog: all that is said here."""
_REGISTERS: Final = (INT[OFFSET], *sorted(frozenset().union(*(READS[number, OFFSET] for number in _COMMANDS))))
_SWITCHES: Final = (
    *("standard_digital_output_mask", "standard_digital_output"),
    *("speed_slider_mask", "speed_slider_fraction"),
)


class OwnLine:
    """One RTDE line; also the way back from its port.

    Args:
        inputs: variables that it writes.
        rate_hz: how often packages come.
    """

    def __init__(self, inputs: tuple[str, ...], rate_hz: float) -> None:
        self._inputs = inputs
        self._subscription = Subscription((_STATE, _SAID), rate_hz, inputs=inputs)
        self._newest: dict[str, Value] = {}
        self.expected: Command | IoCommand | None = None
        """What is about to be said: the judge permits that, once, and nothing else."""
        self.refused = False
        self._waiting: dict[asyncio.Future[None], Callable[[], bool]] = {}
        self._line: ProgramConnection | None = None
        self.gone = False
        """Whether its port has closed it, or it has left."""

    async def open(self, ports: Ports, lease: ProgramOwner) -> None:
        """Packages come, and what is written is taken.

        Raises:
            RobotError: `ROBOT_UNREACHABLE`.
        """
        line = await ports.open(lease, RTDE, self)
        if isinstance(line, Reason):
            raise RobotError(PepFault.ROBOT_UNREACHABLE, str(line))
        self._line = line
        line.received(self._subscription.begin())
        if not await self.until(lambda: bool(self._newest), within_s=BEGINS_S):
            self.leave()
            raise RobotError(PepFault.ROBOT_UNREACHABLE, "no line of our own")

    def leave(self) -> None:
        """Nothing more is said."""
        line, self._line = self._line, None
        self.gone = True
        if line is not None:
            line.left()
        self._look()

    async def until(self, seen: Callable[[], bool], *, within_s: float) -> bool:
        """Whether that was seen, in a package or when something changed here, before the line was gone."""
        if not seen() and not self.gone:
            waiting: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            self._waiting[waiting] = seen
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(waiting, within_s)
            self._waiting.pop(waiting, None)
        return seen() and not self.gone

    def write(self, values: Mapping[str, Value]) -> None:
        """These inputs are set, and all others of the line to zero."""
        if self._line is not None:
            zeros: dict[str, Value] = {
                name: 0.0 if "double" in name or "fraction" in name else 0 for name in self._inputs
            }
            self._line.received(self._subscription.write({**zeros, **values}))

    # ---- the way back

    def send(self, content: bytes) -> None:
        """See `pep.rtde.robot.connections.Back`."""
        try:
            said, packages = self._subscription.feed(content)
        except WireError:
            asyncio.get_running_loop().call_soon(self.leave)
            return
        if said:
            # Not from within the port that says this.
            asyncio.get_running_loop().call_soon(self._say, said)
        if packages:
            self._newest = packages[-1]
            self._look()

    def close(self) -> None:
        """See `pep.rtde.robot.connections.Back`."""
        self.gone = True
        self._look()

    def tell(self, text: str) -> None:
        """See `pep.rtde.robot.connections.Back`: whoever says something here learns by itself what becomes of it."""

    def _say(self, said: bytes) -> None:
        if self._line is not None:
            self._line.received(said)

    def _look(self) -> None:
        for waiting, seen in self._waiting.items():
            if not waiting.done() and (self.gone or seen()):
                waiting.set_result(None)

    def _number(self, name: str) -> Value:
        return self._newest.get(name, 0)


class OwnCommands(OwnLine):
    """The line that commands the arm, as ur_rtde's control interface does."""

    def __init__(self) -> None:
        super().__init__(_REGISTERS, COMMANDS_HZ)
        self._stops = 0

    @property
    def running(self) -> bool:
        """Whether the control script is there and listens to it."""
        return not self.gone and self._number(_STATE) == PLAYING

    async def say(self, command: Command) -> bool:
        """Whether the control script took the command; a stop waits for nothing that was said before."""
        row = row_of(command)
        if row.command_class is CommandClass.STOP:
            self._stops += 1
            self._look()
        stops = self._stops

        def over() -> bool:
            return not self.running or self._stops != stops

        if row.command_class is not CommandClass.STOP and row.wait is Wait.DONE:
            await self.until(lambda: over() or self._number(_SAID) == READY, within_s=READY_S)
            if over() or self._number(_SAID) != READY:
                return False
        if not self.running:
            return False
        self.write(encode(command, OFFSET))
        if row.wait is Wait.AT_ONCE:
            return True
        if self._number(_SAID) == DONE:  # of the command before, which a stop does not wait for
            await self.until(lambda: over() or self._number(_SAID) != DONE, within_s=DONE_S)
        await self.until(lambda: over() or self._number(_SAID) == DONE, within_s=DONE_S)
        done = not over() and self._number(_SAID) == DONE
        if self._stops == stops:
            self.clear()
        return done

    def clear(self) -> None:
        """No command stands."""
        self.write(encode(Clear(), OFFSET))


class OwnSwitches(OwnLine):
    """The line that sets outputs and the speed slider, as ur_rtde's IO interface does."""

    def __init__(self) -> None:
        super().__init__(_SWITCHES, SWITCHES_HZ)

    def say(self, command: IoCommand) -> None:
        """It is being set."""
        self.write({**{name: 0 for name in MASKS if name in _SWITCHES}, **encode_io(command, OFFSET)})
