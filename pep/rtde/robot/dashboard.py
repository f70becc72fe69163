"""Use of the dashboard: ending any program, and asking whether the robot is in remote control."""

from __future__ import annotations

import socket
import time
from typing import TYPE_CHECKING, Final

from pep.base.errors import ConfigError, PepFault, RobotError
from pep.rtde.robot.listener import Listener

if TYPE_CHECKING:
    from io import BufferedIOBase

PORT: Final = 29999  # UR dashboard server
TIMEOUT_S: Final = 2.0
SAID_S: Final = 1.0
"""Age of a question beyond which its answer does not count."""
SHOWN: Final = 32
"""Characters of a strange answer that a message repeats."""
PERIOD_S: Final = 0.3
"""Pause between two questions: an answer that is late by half a second is still in time."""


def stop_program(host: str) -> None:
    """Ends the running program; the arm brakes.

    Args:
        host: of the controller.

    Raises:
        RobotError: `ROBOT_UNREACHABLE` when the dashboard does not answer, or not as it should.
    """
    try:
        with socket.create_connection((host, PORT), timeout=TIMEOUT_S) as link, link.makefile("rwb") as lines:
            lines.readline(256)
            lines.write(b"stop\n")
            lines.flush()
            answer = lines.readline(256)
    except OSError as error:
        raise RobotError(PepFault.ROBOT_UNREACHABLE, type(error).__name__) from error
    if not answer.lower().startswith((b"stopped", b"failed to execute: stop")):
        raise RobotError(PepFault.ROBOT_UNREACHABLE, "another answer than to stop")


SAID_OF: Final = {"ur3e": b"UR3", "ur5e": b"UR5", "ur10e": b"UR10", "ur16e": b"UR16"}
"""Answers of the dashboard to `get robot model`, by the name of the model that is reckoned with."""


def confirm_model(host: str, name: str) -> None:
    """Checks that the controller's arm is of the model.

    Args:
        host: of the controller.
        name: of the model.

    Raises:
        ConfigError: `CONFIG_INVALID`: the controller says that its arm is another one, or no controller says anything
            of an arm of this name.
        RobotError: `ROBOT_UNREACHABLE` when the dashboard does not answer.
    """
    wanted = SAID_OF.get(name)
    if wanted is None:
        known = ", ".join(SAID_OF)
        raise ConfigError(
            PepFault.CONFIG_INVALID, f"robot: no controller is known of an arm named {name}; there are {known}"
        )
    try:
        with socket.create_connection((host, PORT), timeout=TIMEOUT_S) as link, link.makefile("rwb") as lines:
            _line(lines)
            lines.write(b"get robot model\n")
            lines.flush()
            said = _line(lines)
    except OSError as error:
        raise RobotError(PepFault.ROBOT_UNREACHABLE, type(error).__name__) from error
    if said != wanted:
        told = said.decode("ascii", "replace")[:SHOWN]
        raise ConfigError(
            PepFault.CONFIG_INVALID,
            f"robot: the controller says {told!r} of its arm, and {name} would be {wanted.decode()!r}; "
            "set robot to the arm that is there",
        )


class RemoteControl:
    """Remote control of the controller, as its dashboard tells it, asked again and again in the background.

    Args:
        host: of the controller.
    """

    def __init__(self, host: str) -> None:
        self._said: tuple[bool, float] | None = None
        self._listener = Listener("remote-control", host, PORT, self._talk)
        self._listener.start()

    def state(self) -> bool | None:
        """Answer of the dashboard; None when the newest is to a question over 1 s old.

        Never waits.
        """
        said = self._said
        if said is None or time.monotonic() - said[1] > SAID_S:
            return None
        return said[0]

    def close(self) -> None:
        """Ends the connection."""
        self._listener.close()

    def _talk(self, link: socket.socket) -> None:
        try:
            with link.makefile("rwb") as lines:
                _line(lines)
                while True:
                    asked_s = time.monotonic()
                    lines.write(b"is in remote control\n")
                    lines.flush()
                    known = _ANSWERS.get(_line(lines))
                    self._said = None if known is None else (known, asked_s)
                    if not self._listener.pause(PERIOD_S):
                        return
        finally:
            self._said = None


_ANSWERS: Final = {b"true": True, b"false": False}


def _line(lines: BufferedIOBase) -> bytes:
    told = lines.readline(256)
    if not told:
        raise ConnectionResetError("closed by the dashboard")
    return told.strip()
