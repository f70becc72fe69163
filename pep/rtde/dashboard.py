"""The last rung of the stop ladder: the dashboard's `stop`, which ends any program, whoever started it."""

from __future__ import annotations

import socket
from typing import Final

from pep.errors import PepFault, RobotError

PORT: Final = 29999  # UR dashboard server
TIMEOUT_S: Final = 2.0


def stop_program(host: str) -> None:
    """The running program has ended, and the arm brakes.

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
