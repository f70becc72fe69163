"""Starts and ends of programs, as the controller tells of them on its primary port (30001).

It tells of each one, whoever sent it and whatever its name. Together with the input registers, which the controller
lends to one client alone, that is what there is to know about who commands the arm.
"""

from __future__ import annotations

from typing import Final

from pep.rtde.wire.primary_frames import MESSAGE, Key, decode_message

OURS: Final = "rtde_control"
"""Name of the control script in ur_rtde's upload."""
HEARD_S: Final = 0.5
"""The port sends the robot's state ten times a second; a port that is silent for longer may hide a start."""
STARTED, STOPPED = "PROGRAM_XXX_STARTED", "PROGRAM_XXX_STOPPED"


def event_of(kind: int, body: bytes) -> Key | None:
    """A program's start or end, if that is what a frame of the port tells.

    A state of the robot is not read: what a younger controller says in it is none of ours.

    Raises:
        WireError: a message that contradicts itself.
    """
    content = decode_message(body).content if kind == MESSAGE else None
    return content if isinstance(content, Key) and content.title in (STARTED, STOPPED) else None
