"""The lease of the cell's own tools: nobody opens it, and it gives way to those that programs open.

    no lease of a program ─▶ our lines at the ports ─▶ our control script, our tool, our payload ─▶ the tools may move

A permit was spent for each command before it is said here; the judge of these lines looks that it is that very command.
So everything that holds for a program holds for the tools too: one writer, the controller's watchdog, the stop ladder.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeVar

from pep.base.errors import PepFault, RobotError
from pep.request.authority import NOBODY
from pep.rtde.command import command_values as v
from pep.rtde.command.io_commands import IoCommand
from pep.rtde.command.rounding import on_grid
from pep.rtde.lease.lease import LeaseEnding
from pep.rtde.line.lease_stop import StopMeans
from pep.rtde.own.control import OwnControl, OwnOutputs
from pep.rtde.own.local_line import DONE_S, OFFSET, READY_S, OwnCommands, OwnSwitches
from pep.rtde.robot.connections import SECONDARY
from pep.rtde.script.control_script import Upload
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from pep.request.authority import Credentials
    from pep.rtde.command.command_values import Command
    from pep.rtde.judge.command_requests import ToolSetup
    from pep.rtde.line.controller_ports import LeasedPorts
    from pep.rtde.robot.connections import ProgramConnection
    from pep.rtde.robot.judge_port import PendingCommand, ProgramOwner
    from pep.rtde.wire.refusal import InputRefusal

STARTS_S: Final = 6.5
"""Longest wait for the control script to run: the controller's own limits (2 s and 4 s), and a little."""
AGAIN_S: Final = 0.5
"""Pause before the lines are tried again."""
LOOK_S: Final = 0.05
"""How often it is looked whether the lines may be there."""
ANSWERS_S: Final = READY_S + DONE_S + 1.0
"""Longest wait of a thread for the loop."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class OwnLease:
    """The gateway's own hold on the controller; each is another. Behind it is no token: each command has a permit."""

    @property
    def credentials(self) -> Credentials:
        """Nobody's."""
        return NOBODY


class _Script:
    """The way back from the script port: what the controller streams there is for nobody."""

    def __init__(self) -> None:
        self.line: ProgramConnection | None = None

    def send(self, content: bytes) -> None:
        """Dropped."""

    def close(self) -> None:
        """The controller has closed it; what was uploaded runs on."""
        self.line = None

    def tell(self, text: str) -> None:
        """See `OwnLine.tell`."""


class OwnLines:
    """Our lines at the controller's ports. On the event loop on which it was made, but for `control` and `switches`.

    Args:
        ports: of the controller.
        fitted: tool and payload that the controller is to reckon with.
        free: whether no program has the lease, or is about to.
        able: whether the arm could move: powered, no safety stop, remote control.
        failed: is told each time that they could not be brought up, and why.

    Attributes:
        control: to be guarded; `RTDEControlInterface`, as far as guarded tools use it.
        switches: likewise, of `RTDEIOInterface`.
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
        self._commands, self._switches, self._script = OwnCommands(), OwnSwitches(), _Script()
        self._up = self._over = False
        self.control = OwnControl(self)
        self.switches = OwnOutputs(self)

    # ---- up and down

    async def keep(self) -> None:
        """The lines are there whenever they may be. Runs until it is cancelled."""
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
        """What our lines moved is being stopped, and they are gone."""
        lease, self._lease, self._up = self._lease, None, False
        if lease is None:
            return
        self._ports.over(lease, LeaseEnding.CLOSED)
        self._commands.leave()
        self._switches.leave()
        if self._script.line is not None:
            self._script.line.left()

    @property
    def up(self) -> bool:
        """Whether the tools have the arm: our control script runs, and the controller has our tool and payload."""
        return self._up and self._commands.running

    def undisturbed(self) -> bool:
        """See `pep.rtde.robot.readiness.Program`."""
        return self.up and self._ports.undisturbed()

    def close(self) -> None:
        """See `pep.rtde.robot.readiness.Program`. The lines go with their ports."""

    async def _bring(self) -> None:
        script = next((each for each in self._ports.scripts if each.offset == OFFSET), None)
        if script is None:
            raise RobotError(PepFault.ROBOT_UNREACHABLE, "the controller has not said what it is, or is none of ours")
        self._commands, self._switches, self._script = OwnCommands(), OwnSwitches(), _Script()
        lease = self._lease = OwnLease()
        await self._commands.open(self._ports, lease)
        await self._switches.open(self._ports, lease)
        line = await self._ports.open(lease, SECONDARY, self._script)
        if isinstance(line, Reason):
            raise RobotError(PepFault.ROBOT_UNREACHABLE, str(line))
        self._script.line = line
        line.received(Upload(script, ()).render())
        if not await self._commands.until(lambda: self._commands.running, within_s=STARTS_S):
            raise RobotError(PepFault.ROBOT_UNREACHABLE, "the control script does not run")
        tool = self._fitted()
        payload = v.SetPayload(tool.payload_kg, tool.centre_m)
        equipped = await self.said(payload) and await self.said(v.SetTcp(tool.tcp_m_rad))
        if self._lease is not lease or not equipped:
            raise RobotError(PepFault.ROBOT_UNREACHABLE, "payload or tool centre point was not taken")
        self._up = True

    # ---- what is said, and the judge of it

    async def said(self, command: Command) -> bool:
        """Whether the control script took the command."""
        line = self._commands
        if isinstance(command, v.Stop):
            return await line.say(command)
        line.expected, line.refused = on_grid(command), False
        taken = await line.say(command)
        if line.refused:
            line.clear()
        return taken and not line.refused

    async def switched(self, command: IoCommand) -> bool:
        """Whether it was written."""
        line = self._switches
        if line.gone:
            return False
        line.expected, line.refused = command, False
        line.say(command)
        return not line.refused

    def judge(self, held: PendingCommand) -> None:
        """See `pep.rtde.robot.judge_port.Judge`: what a permit was spent for, and nothing else."""
        line = self._switches if isinstance(held.command, IoCommand) else self._commands
        expected, line.expected = line.expected, None
        if held.command == expected and held.forward():
            return
        line.refused = True
        held.deny(Reason.NOT_WHAT_WAS_DECIDED, "no permit")

    def withdrawn(self, held: PendingCommand) -> None:
        """See `pep.rtde.robot.judge_port.Judge`: each was answered at once."""

    def refused(self, holder: ProgramOwner, refused: InputRefusal, what: str) -> None:
        """See `pep.rtde.robot.judge_port.Judge`: what a permit was shown for has an outcome on record."""

    async def stop(self) -> None:
        """Whatever moves the arm is being ended, whoever it is of."""
        self._ports.stop(StopMeans.PROGRAM)

    async def end(self) -> None:
        """As `give_way`, and for good."""
        self._over = True
        self.give_way()

    def from_thread(self, what: Coroutine[None, None, T]) -> T:
        """What it gives, for another thread than the loop's."""
        return asyncio.run_coroutine_threadsafe(what, self._loop).result(ANSWERS_S)
