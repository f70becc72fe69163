"""Shells of a lease's lines: its program on RTDE, on a script port and on the dashboard."""

from __future__ import annotations

import contextlib
import math
from typing import TYPE_CHECKING, Final

from pep.rtde.command.led_limits import granted
from pep.rtde.lease.lease import LeaseEnding
from pep.rtde.line.effects import AskJudge, Halt, Note, StopWritten, Tell, Withdraw
from pep.rtde.line.gateway import DashboardPort, StreamPort
from pep.rtde.line.lease_stop import StopMeans
from pep.rtde.line.rtde_line import LeasedLine
from pep.rtde.line.script_uploads import LeasedScripts
from pep.rtde.robot.connections import Conversation
from pep.rtde.robot.state_receiver import SURE_MS
from pep.rtde.script.control_script import Upload
from pep.rtde.wire.client_texts import said
from pep.rtde.wire.messages import WireError
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.rtde.command.command_values import Command
    from pep.rtde.command.io_commands import IoCommand
    from pep.rtde.line.active_lease import ActiveLease
    from pep.rtde.line.effects import Act, CommandQuestion
    from pep.rtde.line.relay import OutgoingFrames
    from pep.rtde.robot.connections import ReplyChannel
    from pep.rtde.robot.judge_port import ProgramOwner, Steps
    from pep.rtde.script.control_script import ControlScript
    from pep.rtde.script.move_path import Waypoint


OWN_SCRIPT: Final = "sendCustomScript"
"""Name of ur_rtde's call that sends a script as it is; all of its kind send that one."""


class LeasedRtdePort(Conversation):
    """Server of RTDE for a lease: the shell of `LeasedLine`."""

    def __init__(self, tenant: ActiveLease, back: ReplyChannel) -> None:
        super().__init__(back)
        self._tenant = tenant
        self.line = LeasedLine(
            lambda: tenant.claim(self),
            stop_deceleration_rad_s2=tenant.ports.deceleration,
            granted=lambda operation: granted(tenant.lease.credentials.chain, operation),
        )
        self.wrote_ms = 0
        self._asked: dict[CommandQuestion, _Held] = {}
        self._over = False
        tenant.lines.add(self)

    def received(self, content: bytes) -> None:
        """Takes bytes of the program."""
        if self._over:
            return
        slider = math.nan if self.line.commands is not None else self._slider()
        try:
            said = self.line.said(content, slider=slider, at_ms=self._now())
        except WireError:
            self.lose(LeaseEnding.MALFORMED)
            return
        self._send(said)

    def left(self) -> None:
        """Ends: the program has closed the line, or the lease is over."""
        try:
            self._gone_from(LeaseEnding.LEFT)
        finally:
            super().left()

    def lose(self, ending: LeaseEnding) -> None:
        """Ends the line after a failure, and the lease with it where the line commands."""
        try:
            self._gone_from(ending)
        finally:
            self.end()

    def settle(self) -> None:
        """Sends all frames that have come together, and carries out the other acts."""
        self._send(self.line.settle())

    def leave(self, ending: LeaseEnding = LeaseEnding.LEFT) -> None:
        """Ends the line with its lease: its motion is stopped, and nothing further is passed on.

        Args:
            ending: ending of the lease.
        """
        for part in self.line.parts:
            part.leave(ending)
        self.settle()

    def look(self, at_ms: int) -> None:
        """Acts on the passing of time."""
        for part in self.line.parts:
            part.look(at_ms=at_ms)
        self.settle()

    def answer(self, question: CommandQuestion, steps: Steps | None, written: Command | None = None) -> bool:
        """Forwards a permitted command, or what was judged in its place; true where it was sent."""
        self._asked.pop(question, None)
        if self.line.commands is not None:
            sent = self.line.commands.forward(question, steps, at_ms=self._now(), written=written)
        else:
            sent = self.line.outputs is not None and self.line.outputs.forward(question)
        self.settle()
        return sent

    def refuse(self, question: CommandQuestion, reason: Reason, told: str) -> None:
        """Denies a command."""
        self._asked.pop(question, None)
        for part in self.line.parts:
            part.deny(question, reason, told)
        self.settle()

    def _heard(self, content: bytes) -> None:
        try:
            said = self.line.answered(content)
        except WireError:
            self.lose(LeaseEnding.ROBOT)
            return
        self._send(said)

    def _gone(self) -> None:
        self._gone_from(LeaseEnding.ROBOT)
        super()._gone()

    def _gone_from(self, ending: LeaseEnding) -> None:
        self._over = True
        self._tenant.lines.discard(self)
        try:
            self.leave(ending)
        finally:
            if self._tenant.control is self:
                self._tenant.lost(ending)
                self._tenant.control = None

    def _send(self, said: OutgoingFrames) -> None:
        if said.to_robot:
            self.robot.send(said.to_robot)
            self.wrote_ms = self._now()
        if said.to_client:
            self._back.send(said.to_client)
        ports, acts = self._tenant.ports, self.line.take()
        for act in acts:
            match act:
                case AskJudge(question):
                    held = self._asked[question] = _Held(self, question, self._tenant.lease)
                    try:
                        ports.judge.judge(held)
                    except Exception:  # noqa: BLE001 - a judgement that breaks has not permitted
                        held.deny(Reason.POLICY_ERROR, "the judgement broke")
                case Withdraw(question):
                    if (asked := self._asked.pop(question, None)) is not None:  # else it was answered in between
                        with contextlib.suppress(Exception):
                            ports.judge.withdrawn(asked)
                case StopWritten():
                    ports.stop(StopMeans.REGISTERS)
                case Halt():
                    ports.stop(StopMeans.PROGRAM)
                case Tell() | Note():
                    pass
                case _:
                    raise AssertionError(act)
        self._account(acts)

    def _account(self, acts: list[Act]) -> None:
        """Tells and records refusals, after their acts."""
        for act in acts:
            if isinstance(act, Tell):
                with contextlib.suppress(Exception):
                    self._back.tell(act.text)
            elif isinstance(act, Note):
                self._tenant.note(act.refused, act.what)

    def _slider(self) -> float:
        """Position of the slider; NaN when that is not known."""
        newest = self._tenant.ports.state.current(SURE_MS)
        return math.nan if newest is None or newest.state is None else newest.state.slider

    def _now(self) -> int:
        return self._tenant.ports.clock.monotonic_ms()


class _Held:
    """Held question, as the judge has it."""

    def __init__(self, port: LeasedRtdePort, question: CommandQuestion, lease: ProgramOwner) -> None:
        self._port = port
        self._question = question
        self._lease = lease

    @property
    def command(self) -> Command | IoCommand:
        return self._question.command

    @property
    def path(self) -> tuple[Waypoint, ...]:
        return self._question.path

    @property
    def lease(self) -> ProgramOwner:
        return self._lease

    @property
    def carried_out(self) -> bool:
        commands = self._port.line.commands
        return commands is not None and commands.carried_out(self._question)

    def forward(self, steps: Steps | None = None, *, written: Command | None = None) -> bool:
        return self._port.answer(self._question, steps, written)

    def deny(self, reason: Reason, told: str) -> None:
        self._port.refuse(self._question, reason, told)

    def defer(self, told: str) -> None:
        for part in self._port.line.parts:
            part.defer(self._question, told)
        self._port.settle()

    def stop(self, reason: Reason, told: str) -> None:
        if self._port.line.commands is not None:
            self._port.line.commands.stop(self._question, reason, told)
        self._port.settle()


class LeasedScriptPort(StreamPort):
    """Server of a script port for a lease: the stream of states, and the programs of `LeasedScripts`."""

    def __init__(self, tenant: ActiveLease, back: ReplyChannel, scripts: Sequence[ControlScript]) -> None:
        super().__init__(back)
        self._tenant = tenant
        self._scripts = scripts
        self._programs = LeasedScripts(scripts)

    def received(self, content: bytes) -> None:
        """Takes bytes of the program."""
        found = self._programs.feed(content)
        if isinstance(found, InputRefusal):
            if found.reason is Reason.NOT_GRANTED:
                self._refuse_own(found)
            else:
                self._refuse(found)
            return
        for program in found:
            if not isinstance(program, Upload):
                self._tenant.ports.stop(StopMeans.PROGRAM)
            elif (refused := self._tenant.uploaded(self, program)) is not None:
                self._refuse(refused)

    def left(self) -> None:
        """Ends: the program has closed the line, or the lease is over."""
        self._tenant.left(self)
        super().left()

    def _refuse_own(self, refused: InputRefusal) -> None:
        """Tells the refusal of a script of the program's own; its control script may follow on the same line."""
        self._programs = LeasedScripts(self._scripts)
        _refuse(self._tenant, self._back, refused, OWN_SCRIPT)
        self._tenant.script_refused()

    def _refuse(self, refused: InputRefusal) -> None:
        """Tells the refusal where the program listens, and closes the line."""
        _refuse(self._tenant, self._back, refused, "script")
        self._tenant.left(self)
        self.end()


class LeasedDashboardPort(DashboardPort):
    """Server of the dashboard as without a lease, which also tells the program of refusals."""

    def __init__(self, tenant: ActiveLease, back: ReplyChannel) -> None:
        super().__init__(back, stopping=tenant.ports.note)
        self._tenant = tenant

    def _refused(self, words: str) -> None:
        _refuse(self._tenant, self._back, InputRefusal(Reason.NOT_GRANTED, words), "dashboard")


def _refuse(tenant: ActiveLease, back: ReplyChannel, refused: InputRefusal, what: str) -> None:
    """Records a refusal and tells it on the commanding line, or else beside the connection."""
    tenant.note(refused, what)
    text = said(refused.reason, f"{what}: {refused.place}")
    if tenant.control is not None:
        tenant.control.line.tell(text)
        tenant.control.settle()
    else:
        with contextlib.suppress(Exception):
            back.tell(text)
