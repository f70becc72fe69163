"""A line of the gateway's own to its controller: typed commands of the cell's tools in, register writes out.

    command ─▶ `ToolCommands` ─▶ registers ─▶ controller

What it commands goes the way of every program's: the same registers, the same watchdog, the same stops. On one event
loop.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, Final

from pep.base.errors import PepFault, RobotError
from pep.rtde.command.command_table import READS
from pep.rtde.command.io_commands import MASKS, encode_io
from pep.rtde.lease.lease import LeaseEnding
from pep.rtde.line.effects import Halt, StopWritten, Write
from pep.rtde.line.lease_stop import StopMeans
from pep.rtde.line.script_terms import brake_registers
from pep.rtde.own.tool_commands import ToolCommands
from pep.rtde.robot.connections import RTDE, SECONDARY, Upstream
from pep.rtde.script.control_script import Upload
from pep.rtde.wire.messages import WireError
from pep.rtde.wire.recipes import INT, OFFSETS, WritableVariables
from pep.rtde.wire.subscription import Subscription

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pep.rtde.command.command_values import Command
    from pep.rtde.command.io_commands import IoCommand
    from pep.rtde.line.active_lease import ActiveLease
    from pep.rtde.script.control_script import ControlScript
    from pep.rtde.wire.codec import Value
    from pep.rtde.wire.refusal import InputRefusal

OFFSET: Final = OFFSETS[0]
RATE_HZ: Final = 50.0
"""Rate of the controller's packages on these connections; they are read as signs of life alone."""
BEGINS_S: Final = 2.0
"""Longest wait for the controller's first package."""
READY_S: Final = 2.0
"""Longest wait for the control script to be done with what it was told before."""
_STATE: Final = "runtime_state"
_COMMANDS: Final = (1, 9, 11, 17, 29)
"""moveJ, speedJ, servoJ, setPayload, setTcp: all that is commanded here.

Stops and watchdog come with `brake_registers`.
"""
_REGISTERS: Final = tuple(
    dict.fromkeys(
        (INT[OFFSET], *brake_registers(OFFSET), *sorted(frozenset().union(*(READS[n, OFFSET] for n in _COMMANDS))))
    )
)
_SWITCHES: Final = (
    *("standard_digital_output_mask", "standard_digital_output"),
    *("speed_slider_mask", "speed_slider_fraction"),
)


class Inputs:
    """Variables of the controller that one connection writes.

    Args:
        names: of them.
        gone: is told when the connection has ended.
    """

    def __init__(self, names: tuple[str, ...], gone: Callable[[], None]) -> None:
        self._subscription = Subscription((_STATE,), RATE_HZ, inputs=names)
        self._zeros: dict[str, Value] = {name: 0.0 if "double" in name or "fraction" in name else 0 for name in names}
        self._there = asyncio.Event()
        self._gone = gone
        self._frame: bytes | None = None
        self.robot = Upstream(self._heard, self._lost)

    async def reach(self, host: str) -> None:
        """Reaches the controller, which takes all writes from then on.

        Raises:
            RobotError: `ROBOT_UNREACHABLE`.
        """
        refused = await self.robot.reach(host, RTDE)
        if refused is None:
            self.robot.send(self._subscription.begin())
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._there.wait(), BEGINS_S)
        if refused is not None or not self._there.is_set() or not self.robot.connected:
            raise RobotError(PepFault.ROBOT_UNREACHABLE, "no line of our own")

    def close(self) -> None:
        """Closes the connection; nothing more is written."""
        self.robot.close()
        self._there.set()

    def write(self, values: Mapping[str, Value]) -> None:
        """Sets these variables, and all others of the connection to zero."""
        self._frame = self._subscription.write({**self._zeros, **values})
        self.robot.send(self._frame)

    def rewrite(self) -> None:
        """Writes the newest values again."""
        if self._frame is not None:
            self.robot.send(self._frame)

    def _heard(self, content: bytes) -> None:
        try:
            said, packages = self._subscription.feed(content)
        except WireError:
            self.robot.close()
            self._lost()
            return
        if said:
            self.robot.send(said)
        if packages:
            self._there.set()

    def _lost(self) -> None:
        self._there.set()
        self._gone()


class _ScriptPort:
    """Connection on which our control script goes to the controller; answers are dropped."""

    def __init__(self) -> None:
        self.robot = Upstream(lambda _: None, lambda: None)


class ToolLine:
    """The tools' commands, outputs and speed slider: `pep.rtde.line.active_lease.CommandPort`, and its own line.

    Args:
        tenant: the lease of the tools.
    """

    def __init__(self, tenant: ActiveLease) -> None:
        self._tenant = tenant
        profile = WritableVariables.of(OFFSET, control=True, io=False)
        self.commands = ToolCommands(profile, _REGISTERS, stop_deceleration_rad_s2=tenant.ports.deceleration)
        self.running = False
        self.wrote_ms = 0
        self.gone = False
        """True once the lease is over, or the controller has closed a connection."""
        self._registers = Inputs(_REGISTERS, self._lost)
        self._switches = Inputs(_SWITCHES, self._lost)
        self._script = _ScriptPort()
        self._waiting: dict[asyncio.Future[None], Callable[[], bool]] = {}
        tenant.lines.add(self)

    async def reach(self, host: str, script: ControlScript) -> InputRefusal | None:
        """Begins the upload of the control script; returns its refusal, or None.

        Args:
            host: of the controller.
            script: ours.

        Raises:
            RobotError: `ROBOT_UNREACHABLE`.
        """
        try:
            await asyncio.gather(self._registers.reach(host), self._switches.reach(host))
            reached = await self._script.robot.reach(host, SECONDARY) is None and not self.gone
        except BaseException:
            self.close()
            raise
        if not reached or not self._tenant.claim(self):
            self.close()
            raise RobotError(PepFault.ROBOT_UNREACHABLE, "no line of our own")
        self.commands.disarm()  # what somebody has left in the registers is over
        self.settle()
        return self._tenant.uploaded(self._script, Upload(script, ()))

    def close(self) -> None:
        """Closes all connections; nothing more is written."""
        self.gone = True
        self._tenant.lines.discard(self)
        for connection in (self._registers, self._switches, self._script.robot):
            connection.close()
        self._look()

    # ---- what the tools say

    @property
    def up(self) -> bool:
        """True while the control script runs and listens to this line."""
        return self.running and not self.gone

    async def ready(self) -> bool:
        """True once the control script waits for a command; False where it does not within `READY_S`."""
        return await self.until(lambda: self.commands.ready, within_s=READY_S)

    def give(self, command: Command) -> bool:
        """True once the command is written; a script that waits for none is given none."""
        given = self.up and self.commands.give(command)
        self.settle()
        return given

    def follow(self, command: Command) -> bool:
        """True once the next value of the stream is written; False where it has ended."""
        given = self.up and self.commands.go_on(command)
        self.settle()
        return given

    def brake(self) -> None:
        """Begins to stop the motion of our line."""
        self.commands.brake(at_ms=self._now())
        self.settle()

    def switch(self, command: IoCommand) -> bool:
        """True once the command is written; it sets nothing else."""
        if self.gone:
            return False
        masks: dict[str, Value] = {name: 0 for name in MASKS if name in _SWITCHES}
        self._switches.write({**masks, **encode_io(command, OFFSET)})
        return True

    async def until(self, seen: Callable[[], bool], *, within_s: float) -> bool:
        """True once `seen` holds on a line that is there; False where it does not in time."""
        if not seen() and not self.gone:
            waiting: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            self._waiting[waiting] = seen
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(waiting, within_s)
            self._waiting.pop(waiting, None)
        return seen() and not self.gone

    # ---- the lease's side

    @property
    def line(self) -> ToolLine:
        """This line itself: no program is behind it."""
        return self

    def rewrite(self) -> None:
        """Writes the newest registers again, for the watchdog."""
        self._registers.rewrite()
        self.wrote_ms = self._now()

    def refresh(self) -> None:
        """Does nothing: no program is shown a package."""

    def tell(self, text: str) -> None:
        """Does nothing: each permit has its outcome on record."""

    def settle(self) -> None:
        """Carries out the acts that have come together: writes registers, begins stops."""
        for act in self.commands.take():
            match act:
                case Write(values):
                    self._registers.write(values)
                    self.wrote_ms = self._now()
                case StopWritten():
                    self._tenant.ports.stop(StopMeans.REGISTERS)
                case Halt():
                    self._tenant.ports.stop(StopMeans.PROGRAM)
                case _:
                    pass  # of a program
        self._look()

    def look(self, at_ms: int) -> None:
        """Acts on the passing of time."""
        self.commands.look(at_ms=at_ms)
        self.settle()

    def leave(self, ending: LeaseEnding) -> None:
        """Ends the line with its lease: its motion is stopped, and nothing further is passed on."""
        self.commands.leave(ending)
        self.settle()
        self.close()

    def lose(self, ending: LeaseEnding) -> None:
        """Ends the lease after a failure of the line."""
        self._tenant.lost(ending)

    def _lost(self) -> None:
        self.lose(LeaseEnding.ROBOT)

    def _look(self) -> None:
        for waiting, seen in self._waiting.items():
            if not waiting.done() and (self.gone or seen()):
                waiting.set_result(None)

    def _now(self) -> int:
        return self._tenant.ports.clock.monotonic_ms()
