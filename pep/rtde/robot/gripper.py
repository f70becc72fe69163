"""A Robotiq 2F-85 over its text port on the controller: widths, speeds and forces in integers of our units."""

from __future__ import annotations

import socket
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.base.errors import PepFault, RobotError
from pep.base.operations import FINGER_SPEED_UM_S, GRIP_MN, STROKE_UM
from pep.rtde.command.gripper_commands import CLOSED, byte_of
from pep.rtde.robot.connections import GRIPPER
from pep.watch.watch import MotionOutcome

if TYPE_CHECKING:
    from collections.abc import Callable

DRIVEN: Final = "robotiq_2f85"  # of the model's tools: another one has another stroke and other forces per register
ACTIVE: Final = 3  # G1: STA register
ACTIVATION_S: Final = 10.0
TIMEOUT_S: Final = 2.0
MOVE_S: Final = 8.0
"""Longest move: 85 mm at 20 mm/s takes 4.3 s."""
POLL_S: Final = 0.02
SETTLED_S: Final = 0.15
"""Rest of the fingers, without report, after which their move counts as ended."""
MOVING: Final = 0  # G1: OBJ register, moving
BY_OBJECT: Final = (1, 2)  # G1: OBJ register, stopped by an object while opening or closing


@dataclass(frozen=True, slots=True)
class GripResult:
    """End of a gripper move.

    Attributes:
        width_um: opening now.
        object: whether the fingers were stopped by something.
        arrived: whether the move has ended by itself.
        end: end of the move.
        reason: reason code of an early end; "" for none.
    """

    width_um: int
    object: bool
    arrived: bool
    end: MotionOutcome = MotionOutcome.REACHED
    reason: str = ""


class RobotiqGripper:
    """One connection for each command: the gripper's port serves several clients, and keeps nothing between them.

    Args:
        host: of the controller.
    """

    def __init__(self, host: str) -> None:
        self._host = host

    def move(self, *, width_um: int, speed_um_s: int, force_mn: int, stopped: Callable[[], bool]) -> GripResult:
        """Moves the fingers to `width_um`, against something, or to a stop.

        Args:
            width_um: opening.
            speed_um_s: of the fingers.
            force_mn: of the grip.
            stopped: whether a stop has come since this was decided. Asked after the command too, so that a stop that
                overtook the command is given again behind it.

        Raises:
            RobotError: when the gripper cannot be reached or does not answer in its protocol.
        """
        with self._connected() as link:
            if self._get(link, "STA") != ACTIVE:
                # Activation opens and closes the fingers once: a motion without a decision here.
                raise RobotError(PepFault.GRIPPER_INACTIVE, "a person has to activate it")
            self._set(
                link,
                POS=round((STROKE_UM - width_um) * CLOSED / STROKE_UM),
                SPE=byte_of(speed_um_s, *FINGER_SPEED_UM_S),
                FOR=byte_of(force_mn, *GRIP_MN),
                GTO=1,
            )
            deadline = time.monotonic() + MOVE_S
            settled_at, position = time.monotonic(), self._get(link, "POS")
            while not stopped() and time.monotonic() < deadline:
                time.sleep(POLL_S)
                here, state = self._get(link, "POS"), self._get(link, "OBJ")
                if here != position or state == MOVING:
                    settled_at, position = time.monotonic(), here
                # Right after a command the gripper still reports the end of the move before it.
                elif time.monotonic() - settled_at >= SETTLED_S:
                    return GripResult(self._width(link), state in BY_OBJECT, arrived=True)
            self._set(link, GTO=0)
            return GripResult(self._width(link), object=False, arrived=False)

    def activate(self, *, stopped: Callable[[], bool] = lambda: False) -> GripResult:
        """Makes the gripper ready; without power to its fingers when a stop came.

        They close and open once.

        Args:
            stopped: whether a stop has come since this was decided.

        Raises:
            RobotError: when it cannot be reached, or does not become ready.
        """
        with self._connected() as link:
            if self._get(link, "STA") != ACTIVE:
                # Activation begins at the edge of ACT. GTO stays off, so that no older command is taken up behind it.
                self._set(link, ACT=0, GTO=0, FOR=0)
                self._set(link, ACT=1)
            deadline = time.monotonic() + ACTIVATION_S
            while self._get(link, "STA") != ACTIVE:
                if stopped() or time.monotonic() > deadline:
                    self._set(link, ACT=0)
                    if stopped():
                        return GripResult(self._width(link), object=False, arrived=False)
                    raise RobotError(PepFault.GRIPPER_INACTIVE, "not ready in time")
                time.sleep(POLL_S)
            return GripResult(self._width(link), object=False, arrived=True)

    def holds(self) -> bool:
        """True where something stops an active gripper's fingers now.

        Raises:
            RobotError: when the gripper cannot be reached.
        """
        with self._connected() as link:
            return self._get(link, "STA") == ACTIVE and self._get(link, "OBJ") in BY_OBJECT

    def halt(self) -> None:
        """Stops the fingers in their place.

        Raises:
            RobotError: when the gripper cannot be reached.
        """
        with self._connected() as link:
            self._set(link, GTO=0)

    def _width(self, link: socket.socket) -> int:
        return max(0, STROKE_UM - round(self._get(link, "POS") * STROKE_UM / CLOSED))

    def _connected(self) -> socket.socket:
        try:
            return socket.create_connection((self._host, GRIPPER), timeout=TIMEOUT_S)
        except OSError as error:
            raise RobotError(PepFault.GRIPPER_UNREACHABLE, type(error).__name__) from error

    def _set(self, link: socket.socket, **registers: int) -> None:
        words = " ".join(f"{name} {value}" for name, value in registers.items())
        if self._ask(link, f"SET {words}") != "ack":
            raise RobotError(PepFault.GRIPPER_UNREACHABLE, "not acknowledged")

    def _get(self, link: socket.socket, register: str) -> int:
        name, _, value = self._ask(link, f"GET {register}").partition(" ")
        if name != register or not (value.isascii() and value.isdigit()):
            raise RobotError(PepFault.GRIPPER_UNREACHABLE, "another answer than asked for")
        return int(value)

    def _ask(self, link: socket.socket, line: str) -> str:
        try:
            link.sendall(f"{line}\n".encode("ascii"))
            answer = link.recv(256)
        except OSError as error:
            raise RobotError(PepFault.GRIPPER_UNREACHABLE, type(error).__name__) from error
        return answer.decode("ascii", "replace").strip()
