"""The lease of the cell's own tools: nobody opens it, and it gives way to those that programs open.

    no lease of a program ─▶ our line to the controller ─▶ our control script, tool and payload ─▶ the tools may move

A permit was spent for each command before it is given here. Everything that holds for a program holds for the tools
too: one writer, the controller's watchdog, the stop ladder.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.base.errors import PepFault, RobotError
from pep.request.authority import NOBODY
from pep.rtde.command import command_values as v
from pep.rtde.lease.lease import LeaseEnding
from pep.rtde.line.lease_stop import StopMeans
from pep.rtde.own.tool_line import OFFSET, ToolLine
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.request.authority import Credentials
    from pep.rtde.command.command_values import Command
    from pep.rtde.command.io_commands import IoCommand
    from pep.rtde.judge.command_requests import ToolSetup
    from pep.rtde.line.controller_ports import LeasedPorts

STARTS_S: Final = 6.5
"""Longest wait for the control script to run: the controller's own limits (2 s and 4 s), and a little."""
AGAIN_S: Final = 0.5
"""Pause before the lines are tried again."""
LOOK_S: Final = 0.05
"""Pause between two checks that the line may be there."""


@dataclass(frozen=True, slots=True, eq=False)
class OwnLease:
    """The gateway's own hold on the controller; each is another. Behind it is no token: each command has a permit."""

    @property
    def credentials(self) -> Credentials:
        """Credentials of nobody."""
        return NOBODY


class OwnLines:
    """Our line at the controller. On the event loop on which it was made, but for `stop`.

    Args:
        ports: of the controller.
        fitted: tool and payload that the controller is to reckon with.
        free: whether no program has the lease, or is about to.
        able: whether the arm could move: powered, no safety stop, remote control.
        failed: is told each time that it could not be brought up, and why.
    """

    def __init__(
        self,
        ports: LeasedPorts,
        *,
        fitted: Callable[[], ToolSetup],
        free: Callable[[], bool],
        able: Callable[[], bool],
        failed: Callable[[Exception], None],
    ) -> None:
        self._ports = ports
        self._fitted = fitted
        self._free = free
        self._able = able
        self._failed = failed
        self._loop = asyncio.get_running_loop()
        self._lease: OwnLease | None = None
        self._line: ToolLine | None = None
        self._up = self._over = False

    # ---- up and down

    async def keep(self) -> None:
        """Keeps the line up whenever it may be. Runs until it is cancelled."""
        while True:
            if self._lease is None and not self._over and self._free() and self._able():
                try:
                    await self._bring()
                except Exception as error:  # noqa: BLE001 - a narrower net would leave the tools without an arm
                    self.give_way()
                    self._failed(error)
                    await asyncio.sleep(AGAIN_S)
            elif self._lease is not None and not self._ports.undisturbed():
                self.give_way()  # somebody has stopped it, or the controller has: begun anew, and nothing moves by that
            await asyncio.sleep(LOOK_S)

    def give_way(self) -> None:
        """Begins to stop the motion of our line, and closes it."""
        lease, line = self._lease, self._line
        self._lease, self._line, self._up = None, None, False
        if lease is not None:
            self._ports.over(lease, LeaseEnding.CLOSED)
        if line is not None:
            line.close()

    def end(self) -> None:
        """Gives way for good, as `give_way`."""
        self._over = True
        self.give_way()

    @property
    def up(self) -> bool:
        """True while the tools have the arm: the control script runs, and the controller has our tool and payload."""
        return self._up and self._line is not None and self._line.up

    def undisturbed(self) -> bool:
        """See `pep.rtde.robot.readiness.RunningProgram`."""
        return self.up and self._ports.undisturbed()

    def close(self) -> None:
        """See `pep.rtde.robot.readiness.RunningProgram`. The line goes with its ports."""

    async def _bring(self) -> None:
        script = next((each for each in self._ports.scripts if each.offset == OFFSET), None)
        if script is None:
            raise RobotError(PepFault.ROBOT_UNREACHABLE, "the controller has not said what it is, or is none of ours")
        lease = self._lease = OwnLease()
        tenant = self._ports.taken(lease)
        if isinstance(tenant, Reason):
            raise RobotError(PepFault.ROBOT_UNREACHABLE, str(tenant))
        line = self._line = ToolLine(tenant)
        refused = await line.reach(self._ports.robot, script)
        if refused is not None or not await line.until(lambda: line.running, within_s=STARTS_S):
            raise RobotError(PepFault.ROBOT_UNREACHABLE, "the control script does not run")
        tool = self._fitted()
        payload = v.SetPayload(tool.payload_kg, tool.centre_m)
        equipped = await self._done(line, payload) and await self._done(line, v.SetTcp(tool.tcp_m_rad))
        if self._lease is not lease or not equipped:
            raise RobotError(PepFault.ROBOT_UNREACHABLE, "payload or tool centre point was not taken")
        self._up = True

    async def _done(self, line: ToolLine, command: Command) -> bool:
        """Gives the command; True once the control script has carried it out."""
        return await line.ready() and line.give(command) and await line.ready()

    # ---- what is said

    async def ready(self) -> bool:
        """True once the control script waits for a command of the tools; False where it does not soon."""
        return self._line is not None and self.up and await self._line.ready()

    def give(self, command: Command) -> bool:
        """True once the command is written. Its follower sees whether it is carried out."""
        return self._line is not None and self.up and self._line.give(command)

    def follow(self, command: Command) -> bool:
        """True once the next value of the stream under way is written; False where it has ended."""
        return self._line is not None and self.up and self._line.follow(command)

    async def equip(self, mass_kg: float, centre_m: v.Three) -> bool:
        """True once the controller reckons with a payload of that mass in kg and centre in m."""
        line = self._line
        return line is not None and self.up and await self._done(line, v.SetPayload(mass_kg, centre_m))

    def switch(self, command: IoCommand) -> bool:
        """True once the outputs or the speed slider are written."""
        return self._line is not None and self._up and self._line.switch(command)

    def stop(self) -> None:
        """Begins to stop all motion of the arm, a program's too. From any thread; never waits."""
        self._ports.counted()
        self._loop.call_soon_threadsafe(self._stop)

    def _stop(self) -> None:
        if self._line is not None and self.up:
            self._line.brake()
        else:
            self._ports.stop(StopMeans.PROGRAM)
