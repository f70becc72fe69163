"""Command registers of a program with the lease: its commands on their way to the control script.

The program writes into an image of its own; the controller has another one, and only this module writes it. Questions,
ends of modes and stops pass; everything else waits for the judge, and a permitted command is written out whole. A stop
is raised to the cell's, and stays until the script has carried it out. Pure: the time is an argument, acts the result.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pep.rtde.command import command_values as v
from pep.rtde.command.command_table import EVERY_CYCLE, ROWS, CommandClass, Wait, decode, encode, row_of
from pep.rtde.command.image_changes import Cleared, Commanded, Drifted, Staged, Swapped, Unchanged, changes
from pep.rtde.command.register_image import RegisterImage
from pep.rtde.command.rounding import on_grid
from pep.rtde.command.stop_rules import MODES, STOPS, STREAMS, ended_by, of_stream, raised
from pep.rtde.lease.lease import LEASE_OVER, LeaseEnding
from pep.rtde.line.client_registers import ClientRegisters
from pep.rtde.line.effects import (
    ERROR,
    INFORMATION,
    PATIENCE_MS,
    Act,
    AskJudge,
    CommandQuestion,
    Halt,
    Note,
    Refresh,
    StopWritten,
    Tell,
    Withdraw,
    Write,
)
from pep.rtde.line.refused_stream import FOLLOWS, UNWAITED, RefusedStream
from pep.rtde.line.register_echo import QUIET, RegisterEcho
from pep.rtde.line.script_terms import DONE, END_MS, NO_SCRIPT, NOT_OVER, READY, TAKEN_MS, WATCHDOG_HZ, occupies
from pep.rtde.wire.client_texts import said, told
from pep.rtde.wire.recipes import INT
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from pep.rtde.command.command_values import Command, Stop
    from pep.rtde.robot.judge_port import Steps
    from pep.rtde.script.move_path import Waypoint
    from pep.rtde.wire.codec import Value
    from pep.rtde.wire.recipes import Offset, WritableVariables


class LeasedCommands:
    """Commands of one control connection.

    Args:
        profile: variables that it may write.
        claimed: variables that it has from the controller.
        stop_deceleration_rad_s2: of the cell's stop model.

    Attributes:
        denied: whether the program sees its command as failed, until it clears it; never one that it does not wait for.
        script_over: whether a script of the program's own was refused, for whose end it may wait ([LSD-30]).
        stands: a value of a stream that goes on, where the controller has nothing newer but what follows it; else None.
    """

    def __init__(
        self, profile: WritableVariables, claimed: Collection[str], *, stop_deceleration_rad_s2: float
    ) -> None:
        self._claimed = frozenset(claimed)
        self._deceleration = stop_deceleration_rad_s2
        self._blank, self._client = RegisterImage.blank(profile), ClientRegisters(profile)
        self._zeros = {name: value for name, value in self._blank.values.items() if name in self._claimed}
        self._acts: list[Act] = []
        self._running = self._left = False
        self._path: tuple[Waypoint, ...] = ()
        self._held: CommandQuestion | None = None
        self._held_ms = self._wrote_ms = self._quiet = 0
        self._early: tuple[str, int] | None = None  # a command that came before the last one's end, and when
        self._last: CommandQuestion | None = None  # forwarded
        self._stream: tuple[int, Steps | None] | None = None
        self._refused = RefusedStream()
        self._modes: set[int] = set()
        self._sent = 0  # id that the controller has
        # A command that the script carries out once, until the script is seen idle; whether it may still be in it.
        self._once: int | None = None
        self._inside = False
        self._echo = RegisterEcho()
        self._stop_next: tuple[Stop, int | None] | None = None  # and since when it has waited for the script
        self._wanted_ms: float | None = None  # the program's own watchdog
        self.denied = self.script_over = False
        self.stands: Command | None = None

    def take(self) -> list[Act]:
        """Acts that follow from all input since the last call, in order."""
        acts, self._acts = self._acts, []
        return acts

    @property
    def offset(self) -> Offset:
        """Offset at which its registers begin."""
        return self._blank.profile.offset

    # ---- the control script

    def arm(self) -> None:
        """Sets the watchdog of our control script, which has just started, before any other command."""
        self._write(v.SetWatchdog(WATCHDOG_HZ))

    def disarm(self) -> None:
        """Clears the command register."""
        self._write(v.Clear())

    def begin(self, path: tuple[Waypoint, ...]) -> None:
        """Notes that our control script runs, with that path in it, and listens to us alone."""
        self._running, self._path = True, path
        self._sent, self._once, self._inside, self.stands = 0, None, False, None
        self._echo, self._stop_next = RegisterEcho(), None
        self._modes.clear()
        if self.denied:
            self.denied = False
            self._acts.append(Refresh())

    def end(self, reason: Reason) -> None:
        """Notes that the script runs no longer, or is about to be replaced: nothing is sent but zeros."""
        waited = self._held is not None or self._early is not None
        self._over()
        if waited:
            self._fail(said(reason, "the control script has ended"), stopped=True)
        if self._running or self._sent:
            self._running = False
            self.disarm()

    def script_refused(self) -> None:
        """Notes that a script of the program's own was refused; one that waits for a command goes on waiting."""
        self.script_over = self._client.command in (0, v.StopKind.PROGRAM.value)
        self._acts.append(Refresh())

    def _over(self) -> None:
        self._end_stream()
        self._withdraw()
        self._last = None
        self._modes.clear()
        self._once, self._inside, self._stop_next = None, False, None
        self._wanted_ms = None

    def leave(self, ending: LeaseEnding = LeaseEnding.LEFT) -> None:
        """Ends the commands with their program or its lease: stops a motion under way, and asks nothing any more.

        A program that is still there hears that its command has failed: without its connection it would wait for that.
        """
        if self._running:
            self._brake()
        running, self._running, self._left = self._running, False, True
        self._over()
        if running:
            self._fail(f"{LEASE_OVER}: {ending}", stopped=True)
            self._acts += (Refresh(), Halt())

    # ---- the program

    def package(self, values: Mapping[str, Value], *, at_ms: int) -> None:
        """Takes in these variables, as the program wrote them."""
        if self._left:
            return
        self.stands = None
        before, after = self._merged({}), self._merged(values)
        if INT[self.offset] in values:
            self._wrote_ms = at_ms
        match changes(before, after):
            case Unchanged():
                self._again(after, at_ms)
            case Staged():
                pass
            case Cleared():
                self._cleared()
            case Commanded(command):
                self._commanded(command, before.whole(0), at_ms)
            case Drifted(command):
                self._drifted(command, at_ms)
            case Swapped(command):
                if not isinstance(command, v.Stop):  # a stop is carried out as it was first said
                    changed = InputRefusal(Reason.NOT_WHAT_WAS_DECIDED, "it was changed after it was given")
                    self._refuse(changed, row_of(command).name)
            case InputRefusal() as refused:
                self._misread(refused, at_ms)

    def follow(self, six: v.Six, *, at_ms: int) -> bool:
        """Takes in the six doubles that follow those that `stand`: true where they are to be written as those were."""
        assert self.stands is not None
        self._client.later(six)
        self._wrote_ms = at_ms
        return self._certain(self.stands, six)

    def _merged(self, values: Mapping[str, Value]) -> RegisterImage:
        return self._client.merged(values)  # the only way in which they are read, since limits may be lowered in it

    def _again(self, image: RegisterImage, at_ms: int) -> None:
        """Steps a stream whose value the program repeats, or asks again where it was refused."""
        command = decode(image)
        if self._held is not None or self.denied or isinstance(command, InputRefusal):
            return
        number = row_of(command).id
        if self._stream is not None and self._stream[1] is not None and number == self._stream[0]:
            self._step(command)
        elif number and number == self._refused.command:
            self._drifted(command, at_ms)

    def _cleared(self) -> None:
        self._withdraw()
        self._refused.over()
        if self.denied:
            self.denied = False
            self._acts.append(Refresh())
        if self._sent and not (self._sent in STOPS and self._inside):
            self.disarm()

    def _misread(self, refused: InputRefusal, at_ms: int) -> None:
        if refused.command is not None and refused.command in STOPS:
            self._stop(STOPS[refused.command], at_ms)
        else:
            row = ROWS.get(-1 if refused.command is None else refused.command)
            self._refuse(refused, "command" if row is None else row.name)

    def _commanded(self, command: Command, before: int, at_ms: int) -> None:
        self._withdraw()
        self.script_over = False
        row = row_of(command)
        before = self._refused.turns(row.id, before)
        if isinstance(command, v.Stop):
            self._stop(command, at_ms)
        elif self.denied:
            pass  # told already; a clear ends that
        elif not self._running:
            self._refuse(NO_SCRIPT, row.name)
        elif self._stop_next is not None or (before and before not in EVERY_CYCLE and not row.every_cycle):
            # The script would carry this one out late.
            self._refuse(NOT_OVER, row.name)
        elif self._inside:
            self._early = (row.name, at_ms)
        elif not self._claimed.issuperset(encode(command, self.offset)):
            self._refuse(InputRefusal(Reason.NOT_GRANTED, "its registers were not set up"), row.name)
        elif isinstance(command, v.SetWatchdog):
            # The script has one watchdog, and it is ours; the program's is kept here.
            self._wanted_ms, self._wrote_ms = 1000.0 / command.least_hz, at_ms
            self._write(v.SetWatchdog(WATCHDOG_HZ))
        elif row.command_class is CommandClass.GETTER or isinstance(command, v.StopContactDetection):
            self._write(command)
        elif self._stream is not None and self._stream[0] == row.id:
            self._step(command)
        else:
            self._held = CommandQuestion(on_grid(command), self._path if isinstance(command, v.MovePath) else ())
            self._held_ms = at_ms
            self._acts.append(AskJudge(self._held))

    def _drifted(self, command: Command, at_ms: int) -> None:
        row = row_of(command)
        if self._held is not None or self._early is not None or self.denied:
            return  # what stands when it is forwarded is judged then
        if row.command_class is CommandClass.GETTER:
            self._write(command)
        elif self._stream is not None and self._stream[0] == row.id:
            self._step(command)
        elif self._refused.due(row.id, at_ms=at_ms):
            self._commanded(command, 0, at_ms)

    def _step(self, command: Command) -> None:
        if self._certain(command):
            self._write(self._stream[1].written(command))  # type: ignore[index,union-attr]  # it has just judged this one
            self.stands = command

    def renew(self) -> None:
        """Writes the value that stands anew, where its judge says another command for it by now."""
        steps = None if self._stream is None else self._stream[1]
        again = steps.renewed() if steps is not None and self._sent in STREAMS else None
        if again is not None:
            self._write(again)

    def _certain(self, command: Command, six: v.Six | None = None) -> bool:
        """True where the stream goes on with this value, or these six doubles in it; else it has ended."""
        assert self._stream is not None
        steps = self._stream[1]
        if steps is None:
            self._refuse(FOLLOWS, row_of(command).name)
            return False
        try:
            reason = steps.step(command) if six is None else steps.follow(six)
        except Exception:  # noqa: BLE001 - a judgement that breaks has not permitted
            self._refuse(InputRefusal(Reason.POLICY_ERROR, "the judgement broke"), row_of(command).name)
            return False
        if reason is not None:
            self._break_off()
            self._deny(reason, told(reason, row_of(command).name))  # on record with the stream
        return reason is None

    def _refuse(self, refused: InputRefusal, what: str) -> None:
        """Refuses input of the program and records that, since nobody else was asked."""
        self._break_off()
        if not self.denied:
            self._acts.append(Note(refused, what))
        self._deny(refused.reason, f"{what}: {refused.place}")

    def _break_off(self) -> None:
        """Withdraws the waiting command and stops the stream: the program's input is no longer as permitted."""
        self._withdraw()
        if self._stream is not None:
            self._brake()

    # ---- the judge

    def forward(
        self, question: CommandQuestion, steps: Steps | None, *, at_ms: int, written: Command | None = None
    ) -> bool:
        """True once the permitted command, or `written` for it ([LSD-14]), is written; False where nobody takes it."""
        if question is not self._held:
            return False
        self._held = None
        command = question.command
        if self._busy or not self._running:
            self._deny(Reason.BUSY, "a stop is under way")
            return False
        assert isinstance(command, v.Command)
        row = row_of(command)
        self._end_stream()
        self._write(written or command)
        self._last = question
        if row.every_cycle:
            self._stream = (row.id, steps)
            latest = decode(self._merged({}))
            if isinstance(latest, InputRefusal):
                self._misread(latest, at_ms)
            elif on_grid(latest) != command:
                self._drifted(latest, at_ms)
        elif steps is not None:
            steps.ended()
        return True

    def deny(self, question: CommandQuestion, reason: Reason, told: str) -> None:
        """Tells the program that its waiting command has failed."""
        if question is self._held:
            self._held = None
            self._deny(reason, told)
            latest = decode(self._merged({}))
            if not self.denied and not isinstance(latest, InputRefusal) and on_grid(latest) != question.command:
                self._drifted(latest, self._wrote_ms)  # the program has gone on meanwhile

    def defer(self, question: CommandQuestion, told: str) -> None:
        """Tells the program that its command waits; one that would go on as if it moved fails instead."""
        if question is not self._held:
            return
        assert isinstance(question.command, v.Command)
        if row_of(question.command).wait is Wait.AT_ONCE:
            self._withdraw()
            self._deny(Reason.APPROVAL_REQUIRED, told)
        else:
            self._acts.append(Tell(told, INFORMATION))

    def stop(self, question: CommandQuestion, reason: Reason, told: str) -> None:
        """Stops the command that was forwarded last, and tells the program why."""
        if question is self._last and self._running:
            self._brake()
            self._fail(said(reason, told), stopped=True)

    def robot(self, command: int, said: int, *, still: bool) -> None:
        """Takes in one report: id in the command register, state of the script, standstill of the arm."""
        self._echo.told(command)
        idle, newest = command == 0 and said == READY, self._echo.newest
        # A move goes on when the program clears it, and may be over before we hear so; a stop is cleared after its end.
        over = (newest and command == 0 and self._once not in STOPS) or (self._echo.ending and command == self._once)
        self._quiet = self._quiet + 1 if idle and still else 0
        # A controller may skip the package that says DONE.
        if self._inside and ((said == DONE and over) or (newest and self._quiet > QUIET)):
            self._inside = False
            if command in STOPS and self._client.command not in STOPS:
                self.disarm()  # the program did not wait for its end, or the stop was ours
            self._hear_early()
        if idle and newest and not self._inside:
            self._once = None
            if self._stop_next is not None and not self._sent:
                stop, _ = self._stop_next
                self._stop_next = None
                self._write(stop)
                self._acts.append(StopWritten())

    def _hear_early(self) -> None:
        """Takes in the command that has waited for the end of the one before, as it stands now."""
        early, self._early = self._early, None
        if early is None:
            return
        command = decode(self._merged({}))
        if isinstance(command, InputRefusal):
            self._misread(command, early[1])
        else:
            self._commanded(command, 0, early[1])

    def look(self, *, at_ms: int) -> None:
        """Acts on the passing of time alone."""
        if self._early is not None and at_ms - self._early[1] > END_MS:
            self._refuse(NOT_OVER, self._early[0])
        if self._held is not None and at_ms - self._held_ms > PATIENCE_MS:
            self._withdraw()
            self._deny(Reason.APPROVAL_TIMEOUT, "nobody decided in time")
        if self._stop_next is not None and (since := self._stop_next[1]) is not None and at_ms - since > TAKEN_MS:
            self._halt()
        if self._wanted_ms is not None and at_ms - self._wrote_ms > self._wanted_ms:
            self._wanted_ms = None
            self._halt()  # what its own watchdog would have done

    @property
    def stopping(self) -> bool:
        """True while the script is in a stop, or about to be."""
        return self._stop_next is not None or (self._inside and self._once in STOPS)

    def carried_out(self, question: CommandQuestion) -> bool:
        """True once the script is through with the command that was forwarded last."""
        return question is self._last and not self._inside

    @property
    def _busy(self) -> bool:
        """True while the script reads no register: it is in a move or a stop, or about to stop."""
        return self._stop_next is not None or self._inside

    def _stop(self, stop: Stop, at_ms: int) -> None:
        """The program's own stop: at once, at least as hard as the cell's, and of the stream that goes on."""
        fits = of_stream(stop, self._modes)
        stop = raised(fits or stop, self._deceleration)
        self._withdraw()
        self._end_stream()
        if fits is None or not self._running or (self._inside and self._once not in STOPS):
            self._halt()  # nobody reads the registers, or the script is in the midst of a move
        elif self._once is None:
            self._write(stop)
            self._acts.append(StopWritten())
        elif self._inside:
            if ended_by(stop, self._modes):
                self._stop_next = (stop, None)  # after the one that it is in
        else:
            # The script carries nothing out before it has seen that what it did last was cleared.
            self._stop_next = (stop, at_ms)
            self.disarm()

    def _brake(self) -> None:
        """Stops all forwarded motion, by our own decision."""
        self._end_stream()
        ends = {MODES[mode] for mode in self._modes}
        if self._stop_next is not None or (self._inside and self._once in STOPS):
            return
        if self._inside or self._once is not None or len(ends) > 1:
            self._halt()
        else:
            self._write(raised(ends.pop() if ends else STOPS[34], self._deceleration))
            self._acts.append(StopWritten())

    def _halt(self) -> None:
        self._end_stream()
        self._stop_next = None
        self._acts.append(Halt())

    def _write(self, command: Command) -> None:
        """Writes the whole image with that command in it, from our own copy."""
        row = row_of(command)
        self._sent, self.stands = row.id, None
        self._echo.wrote(row.id)
        if not row.every_cycle and row.id:
            self._once = row.id
            self._inside = occupies(command)
        if isinstance(command, v.Stop):
            self._modes -= ended_by(command, self._modes)
        elif row.id in MODES:
            self._modes.add(row.id)
        said = encode(command, self.offset)
        # The order is the blank's, and what the connection does not have is not written.
        self._acts.append(Write({**self._zeros, **{name: said[name] for name in said if name in self._claimed}}))

    def _deny(self, reason: Reason, told: str) -> None:
        self._fail(said(reason, told))

    def _fail(self, text: str, *, stopped: bool = False) -> None:
        """Tells the program why its command has failed, and shows it that where it waits or its motion was stopped."""
        self.stands = None
        if not stopped and self._client.command in UNWAITED:
            # It has gone on already: what it were shown would fail its next call, and not this one.
            self._refused.refused(self._client.command, asked_ms=self._wrote_ms)
        elif self.denied:
            return
        else:
            self.denied = True
        self._acts.append(Tell(text, ERROR))

    def _withdraw(self) -> None:
        self._early = None
        question, self._held = self._held, None
        if question is not None:
            self._acts.append(Withdraw(question))

    def _end_stream(self) -> None:
        stream, self._stream, self.stands = self._stream, None, None
        if stream is not None and stream[1] is not None:
            stream[1].ended()
