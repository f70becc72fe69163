"""Server of the gripper's port for a lease ([LSD-28]): what moves its fingers is decided, and sent by the gateway."""

from __future__ import annotations

import re
from collections import deque
from typing import TYPE_CHECKING, Final

from pep.rtde.command.gripper_commands import (
    MAX_LINE,
    ActivateFingers,
    MoveFingers,
    ReadRegister,
    SetRegisters,
    parse_gripper_line,
)
from pep.rtde.robot.connections import Conversation
from pep.rtde.wire.client_texts import said
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pep.rtde.command.command_values import Command
    from pep.rtde.command.gripper_commands import GripperCommand
    from pep.rtde.line.active_lease import ActiveLease
    from pep.rtde.robot.connections import ReplyChannel
    from pep.rtde.robot.judge_port import ProgramOwner, Steps
    from pep.rtde.script.move_path import Waypoint

TAKEN, NOT_TAKEN = b"ack\n", b"?\n"
"""Answers of the gripper to a line that it carries out, and to any other."""
READY: Final = "3"  # G1: STA register of a gripper that was activated
LINES: Final = 64
"""Most lines that wait: a client library sends one, and waits for its answer."""
ANSWER_BYTES: Final = 64
"""Longest answer of the gripper."""
_ANSWER: Final = re.compile(rb"[A-Z]{3} [0-9]{1,3}\r?")


class LeasedGripperPort(Conversation):
    """One line of a lease's program to the gripper: a question after the other, each answered before the next.

    Registers that a program only sets (speed, force, a position without a way to it) are kept here. A position that is
    to be gone to, and an activation, are asked of the judge as operations of the cell. A stop passes.

    Args:
        tenant: the lease.
        back: the way back to the program.
    """

    def __init__(self, tenant: ActiveLease, back: ReplyChannel) -> None:
        super().__init__(back)
        self._tenant = tenant
        self._incoming, self._coming = bytearray(), bytearray()
        self._lines: deque[bytes] = deque()
        self._awaits: Callable[[bytes], None] | None = None
        self._held: _HeldGrip | None = None
        self._set: dict[str, int] = {"SPE": 0, "FOR": 0}
        self._goes = False

    def received(self, content: bytes) -> None:
        """Takes bytes of the program."""
        self._incoming += content
        *lines, rest = bytes(self._incoming).split(b"\n")
        self._incoming[:] = rest
        self._lines += lines
        if len(self._lines) > LINES or len(self._incoming) > MAX_LINE:
            self.left()
            self._back.close()
            return
        self._go_on()

    def left(self) -> None:
        """Ends: the program has closed the line, or its lease is over. Fingers that move for it stop."""
        held, self._held = self._held, None
        if held is not None:
            held.over = True
            self._tenant.ports.judge.withdrawn(held)
        if self._goes:
            self.robot.send(b"SET GTO 0\n")
        super().left()

    # ---- the program's lines

    def _go_on(self) -> None:
        while self._lines and self._awaits is None and self._held is None:
            self._said(parse_gripper_line(self._lines.popleft()))

    def _said(self, line: ReadRegister | SetRegisters | InputRefusal) -> None:
        match line:
            case InputRefusal():
                self._refuse(line)
            case ReadRegister("PRE") if "POS" in self._set:
                self._back.send(b"PRE %d\n" % self._set["POS"])
            case ReadRegister("SPE" | "FOR" as name):
                self._back.send(b"%s %d\n" % (name.encode(), self._set[name]))
            case ReadRegister(name):
                self._ask(b"GET " + name.encode() + b"\n", lambda answer: self._back.send(answer + b"\n"))
            case SetRegisters(values):
                self._changed(values)

    def _changed(self, values: Mapping[str, int]) -> None:
        """Carries out a line that sets registers, as the gripper would: a stop first, an activation alone."""
        if values.get("ATR"):
            self._refuse(InputRefusal(Reason.NOT_GRANTED, "an automatic release"))
        elif "ACT" in values:
            self._keep(values)
            active = values["ACT"]
            self._ask(b"GET STA\n", lambda answer: self._activation(active, ready=answer.split(b" ")[1].strip()))
        elif values.get("GTO") == 0:
            self._goes = False
            self._keep(values)
            self._ask(b"SET GTO 0\n", lambda answer: self._back.send(answer + b"\n"))
        else:
            before = dict(self._set), self._goes
            self._keep(values)
            self._goes = self._goes or "GTO" in values
            moves = MoveFingers(self._set.get("POS", 0), self._set["SPE"], self._set["FOR"])
            if self._goes and "POS" in self._set and (dict(self._set), self._goes) != before:
                self._judged(moves)
            else:
                self._back.send(TAKEN)

    def _keep(self, values: Mapping[str, int]) -> None:
        self._set |= {name: value for name, value in values.items() if name in ("SPE", "FOR", "POS")}

    def _activation(self, active: int, *, ready: bytes) -> None:
        """Activates a gripper that is not ready, and takes nothing from one that is."""
        if bool(active) is (ready == READY.encode()):
            self._back.send(TAKEN)
        elif active:
            self._judged(ActivateFingers())
        else:
            self._refuse(InputRefusal(Reason.NOT_GRANTED, "a reset, which lets go of what is held"))

    # ---- the judge

    def _judged(self, command: GripperCommand) -> None:
        self._held = held = _HeldGrip(self, command, self._tenant.lease)
        try:
            self._tenant.ports.judge.judge(held)
        except Exception:  # noqa: BLE001 - a judgement that breaks has not permitted
            held.deny(Reason.POLICY_ERROR, said(Reason.POLICY_ERROR, "the judgement broke"))

    def answer(self, held: _HeldGrip, content: bytes) -> bool:
        """Answers the line that was held; false where nobody waits for that any more."""
        if self._held is not held:
            return False
        self._held = None
        self._back.send(content)
        self._go_on()
        return True

    def refused(self, held: _HeldGrip, told: str) -> None:
        """Answers as the gripper does to a line that it does not take, and tells why."""
        self._goes = False
        self._set.pop("POS", None)
        if self.answer(held, NOT_TAKEN):
            self.tell(told)

    def tell(self, text: str) -> None:
        """Tells the program's operator."""
        self._back.tell(text)

    def _refuse(self, refused: InputRefusal) -> None:
        self._tenant.note(refused, "gripper")
        self._back.send(NOT_TAKEN)
        self.tell(said(refused.reason, f"gripper: {refused.place}"))

    # ---- the gripper

    def _ask(self, line: bytes, then: Callable[[bytes], None]) -> None:
        self._awaits = then
        self.robot.send(line)

    def _heard(self, content: bytes) -> None:
        self._coming += content
        while (end := self._coming.find(b"\n")) >= 0:
            answer = bytes(self._coming[:end])
            del self._coming[: end + 1]
            then, self._awaits = self._awaits, None
            if then is None or not (_ANSWER.fullmatch(answer) or answer == TAKEN.strip()):
                self.end()
                return
            then(answer)
            self._go_on()
        if len(self._coming) > ANSWER_BYTES:
            self.end()


class _HeldGrip:
    """Line to the gripper that waits for its decision: `pep.rtde.robot.judge_port.PendingCommand`."""

    path: tuple[Waypoint, ...] = ()

    def __init__(self, port: LeasedGripperPort, command: GripperCommand, lease: ProgramOwner) -> None:
        self._port = port
        self._command = command
        self._lease = lease
        self.over = False

    @property
    def command(self) -> GripperCommand:
        return self._command

    @property
    def lease(self) -> ProgramOwner:
        return self._lease

    @property
    def carried_out(self) -> bool:
        return self.over

    def forward(self, steps: Steps | None = None, *, written: Command | None = None) -> bool:  # noqa: ARG002 - no values follow
        return not self.over and self._port.answer(self, TAKEN)

    def deny(self, reason: Reason, told: str) -> None:  # noqa: ARG002 - the text begins with it
        self._port.refused(self, told)

    def defer(self, told: str) -> None:
        self._port.tell(told)

    def stop(self, reason: Reason, told: str) -> None:  # noqa: ARG002 - likewise
        self._port.tell(told)
