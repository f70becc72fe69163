"""Starts and ends of programs, as the controller tells of them on its primary port (30001).

It tells of each one, from every sender and under every name. Together with the input registers, which the controller
lends to one client alone, these are all known facts about the arm's commander.
"""

from __future__ import annotations

from typing import Final

from pep.rtde.wire.primary_frames import MESSAGE, Key, decode_message

OURS: Final = "rtde_control"
"""Name of the control script in ur_rtde's upload."""
HEARD_S: Final = 0.5
"""Silence of the port that may hide a start.

The port sends the robot's state ten times a second.
"""
STARTED, STOPPED = "PROGRAM_XXX_STARTED", "PROGRAM_XXX_STOPPED"


def event_of(kind: int, body: bytes) -> Key | None:
    """Start or end of a program in a frame of the port, if it has one.

    A state of the robot is not read: what a younger controller says in it is none of ours.

    Raises:
        WireError: a message that contradicts itself.
    """
    content = decode_message(body).content if kind == MESSAGE else None
    return content if isinstance(content, Key) and content.title in (STARTED, STOPPED) else None
