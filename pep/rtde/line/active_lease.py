"""One lease at the controller: the line that commands, the control script it uploads, and how far that has come."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import TYPE_CHECKING, Final, Protocol

from pep.rtde.line.control_program import ControlProgram, ControlStep, Phase
from pep.rtde.line.lease_stop import StopMeans
from pep.rtde.script.move_path import path_on_grid
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from pep.base.ports import Clock
    from pep.rtde.lease.lease import LeaseEnding
    from pep.rtde.line.command_registers import LeasedCommands
    from pep.rtde.line.lease_stop import LeaseStopLadder
    from pep.rtde.robot.connections import Upstream
    from pep.rtde.robot.judge_port import Judge, ProgramOwner
    from pep.rtde.robot.state_receiver import Package, StateReceiver
    from pep.rtde.script.control_script import Upload

REWRITE_MS: Final = 20
"""Time after which the last package is written again, for the watchdog; it waits for 125 ms."""
PAUSED: Final = (3, 4, 5)
"""Values of `runtime_state` of a program that a person may let go on."""


class CommandLine(Protocol):
    """A line on which commands of the lease reach the controller: of its program, or of the cell's own tools."""

    running: bool

    @property
    def commands(self) -> LeasedCommands | None:
        """The registers that it commands with, if it does."""

    def rewrite(self) -> None:
        """Write again, so that the watchdog hears it."""

    def refresh(self) -> None:
        """Show the newest package again."""

    def tell(self, text: str) -> None:
        """Tell the program."""


class CommandPort(Protocol):
    """An RTDE connection of the lease."""

    @property
    def line(self) -> CommandLine:
        """The line that it serves."""

    @property
    def wrote_ms(self) -> int:
        """Monotonic time of the last write to the controller."""

    def settle(self) -> None:
        """Carry out the effects that the line has decided."""

    def leave(self, ending: LeaseEnding) -> None:
        """Tell the client that the lease is over."""

    def look(self, at_ms: int) -> None:
        """Let time pass."""

    def lose(self, ending: LeaseEnding) -> None:
        """End the connection, and the lease with it."""


class UploadPort(Protocol):
    """A connection on which the lease's program uploads its control script."""

    @property
    def robot(self) -> Upstream:
        """The line to the controller behind it."""


class Controller(Protocol):
    """The controller's side of every lease: its state, its stop, its judge."""

    clock: Clock
    judge: Judge
    state: StateReceiver
    ladder: LeaseStopLadder
    deceleration: float

    def stop(self, rung: StopMeans) -> None:
        """Begin to stop the arm, from that rung of the ladder on."""

    def closed(self, lease: ProgramOwner, ending: LeaseEnding) -> None:
        """End the lease for that reason."""

    def note(self, rung: StopMeans) -> None:
        """Count a stop that came past the ladder."""


class ActiveLease:
    """One lease: its control line, its control script, and who sends that."""

    def __init__(self, ports: Controller, lease: ProgramOwner) -> None:
        self.ports = ports
        self.lease = lease
        self.program = ControlProgram()
        self.control: CommandPort | None = None
        self.lines: set[CommandPort] = set()
        self._sender: UploadPort | None = None
        self._over = False

    @property
    def stopping(self) -> bool:
        """True while its control script has a stop to carry out."""
        return (
            self.control is not None and self.control.line.commands is not None and self.control.line.commands.stopping
        )

    def claim(self, port: CommandPort) -> bool:
        """Makes that line the one that commands; False where another is, or the lease is over."""
        if self._over or (self.control is not None and self.control is not port):
            return False
        self.control = port
        return True

    def uploaded(self, port: UploadPort, upload: Upload) -> InputRefusal | None:
        """Begins to send the control script that came on that line; returns its refusal, or None."""
        commands = None if self.control is None else self.control.line.commands
        if commands is None or commands.offset != upload.script.offset:
            return InputRefusal(Reason.NOT_GRANTED, "a control script without its registers")
        if self._sender is not None and self._sender is not port and self.program.starting:
            return InputRefusal(Reason.BUSY, "another control script")
        self.ports.stop(StopMeans.PROGRAM)
        self.script_over(Reason.BUSY)
        self._sender = port
        # What is judged is what is sent, to the last digit ([LSD-16]).
        upload = replace(upload, path=path_on_grid(upload.path))
        self.program.begin(upload, at_ms=self.ports.clock.monotonic_ms())
        self._show()
        return None

    def script_refused(self) -> None:
        """Ends the program's wait for a script of its own, which was not sent ([LSD-30])."""
        if self.control is not None and self.control.line.commands is not None:
            self.control.line.commands.script_refused()
            self.control.settle()

    def left(self, port: UploadPort) -> None:
        """Forgets that line, which is gone."""
        if self._sender is port:
            self._sender = None

    def script_over(self, reason: Reason) -> None:
        """Notes that the control script runs no longer, or will not for long."""
        self.program.end()
        if self.control is not None and self.control.line.commands is not None:
            self.control.line.commands.end(reason)
            self._show()

    def end(self, ending: LeaseEnding) -> None:
        """Ends the lease and begins to stop the arm; a second call changes nothing."""
        if self._over:
            return
        self._over = True
        try:
            for line in tuple(self.lines):
                line.leave(ending)
        finally:  # whatever a line is in: the arm is stopped
            if self.program.sent:
                self.ports.stop(StopMeans.PROGRAM)
            self.program.end()

    def lost(self, ending: LeaseEnding) -> None:
        """Ends the lease after the loss of its control line."""
        if not self._over:
            try:
                self.end(ending)
            finally:
                self.ports.closed(self.lease, ending)

    def note(self, refused: InputRefusal, what: str) -> None:
        """Records a refusal of one of its lines, which holds also without a record."""
        with contextlib.suppress(Exception):
            self.ports.judge.refused(self.lease, refused, what)

    def heard(self, package: Package, at_ms: int) -> None:
        """Takes in a package of the controller."""
        control = self.control
        if control is None or control.line.commands is None:
            return
        if self.program.sent or self.ports.ladder.over:  # no script begins while a stop is under way
            self._turn(self.program.look(package, at_ms=at_ms), package)
        commands = control.line.commands
        commands.robot(*package.registers[commands.offset], still=package.still)
        commands.renew()
        if self.program.phase is not Phase.NONE and at_ms - control.wrote_ms >= REWRITE_MS:
            control.line.rewrite()
        control.settle()

    def look(self, at_ms: int) -> None:
        """Acts on the passing of time."""
        self._turn(self.program.late(at_ms=at_ms), self.ports.state.newest())
        for line in tuple(self.lines):
            line.look(at_ms)

    def _turn(self, turn: ControlStep | None, package: Package) -> None:
        if turn is None or self.control is None or self.control.line.commands is None:
            return
        commands, upload = self.control.line.commands, self.program.upload
        match turn:
            case ControlStep.SEND if upload is not None and self._sender is not None:
                self._sender.robot.send(upload.render())
            case ControlStep.ARM:
                commands.arm()
            case ControlStep.CLEAR:
                commands.disarm()
            case ControlStep.BEGIN if upload is not None:
                commands.begin(upload.path)
            case ControlStep.END:
                commands.end(Reason.ROBOT_NOT_RUNNING)
                if package.runtime_state in PAUSED:
                    self.ports.stop(StopMeans.DASHBOARD)  # nobody lets it go on behind our back
            case _:
                self.control.line.tell(f"{Reason.EFFECT_FAILED}: the control script was not started")
                commands.end(Reason.EFFECT_FAILED)
                self.program.end()
                self.ports.stop(StopMeans.DASHBOARD)
        self._show()

    def _show(self) -> None:
        assert self.control is not None
        line = self.control.line
        running = self.program.phase is Phase.RUNNING
        if line.running is not running:
            line.running = running
            line.refresh()
        self.control.settle()
