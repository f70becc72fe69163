"""Check that a controller is the simulated one, on its dashboard with a word that no robot knows.

A robot's dashboard answers an unknown line with "could not understand"; the simulator repeats the nonce. Besides, the
address must be on loopback: a simulator elsewhere is nobody's business here, and a robot is never at 127.0.0.0/8.
"""

from __future__ import annotations

import ipaddress
import secrets
import socket
from typing import Final

from pep.base.errors import PepFault, RobotError
from pep.gate.observe_only import Simulated
from ursim.ports.dashboard import ANSWER, QUESTION

PORT: Final = 29999  # UR dashboard server
TIMEOUT_S: Final = 2.0


def recognise(host: str) -> Simulated:
    """The proof that the controller at `host` is simulated.

    Raises:
        RobotError: `NOT_SIMULATED` for an address that is not loopback, and for any other answer or none.
    """
    try:
        loopback = ipaddress.ip_address(host).is_loopback
    except ValueError:
        loopback = False  # a name may lead anywhere
    if not loopback:
        raise RobotError(PepFault.NOT_SIMULATED, f"{host} is no loopback address")
    nonce = secrets.token_hex(16)
    try:
        with socket.create_connection((host, PORT), timeout=TIMEOUT_S) as link, link.makefile("rwb") as lines:
            lines.readline(256)
            lines.write(f"{QUESTION} {nonce}\n".encode())
            lines.flush()
            said = lines.readline(256)
    except OSError as error:
        raise RobotError(PepFault.NOT_SIMULATED, type(error).__name__) from error
    if said != f"{ANSWER}{nonce}\n".encode():
        raise RobotError(PepFault.NOT_SIMULATED, "another answer than the simulator's")
    return Simulated(host)
