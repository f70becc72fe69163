"""Terms with the control script: its states, its watchdog, and the times within which it acts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pep.rtde.command import command_values as v
from pep.rtde.command.command_table import encode
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from pep.rtde.command.command_values import Command
    from pep.rtde.wire.recipes import Offset

READY, DONE = 1, 2
"""States of the control script, as told in its output register 0."""
TAKEN_MS: Final = 50
"""Longest time until the control script begins with a stop, when it can hear it at all."""
END_MS: Final = 250
"""Ours, as in [LSD-6]: longest wait of a command for the end of the one before.

Its client may hear of that end first. It is more than the 0.1 s after which an untold end is taken as one.
"""
NO_SCRIPT: Final = InputRefusal(Reason.ROBOT_NOT_RUNNING, "no control script runs: call reuploadScript()")
NOT_OVER: Final = InputRefusal(Reason.BUSY, "the command before is not over")
WATCHDOG_HZ: Final = 8.0
"""Ours: the controller ends the program 125 ms after our last write."""


def brake_registers(offset: Offset) -> tuple[str, ...]:
    """Variables of stops and the watchdog: one that is not written would keep its stale value."""
    stops = (v.StopJ(0.0, asynchronous=False), v.SpeedStop(0.0), v.ServoStop(0.0), v.SetWatchdog(WATCHDOG_HZ))
    return tuple(dict.fromkeys(name for command in stops for name in encode(command, offset)))


def occupies(command: Command) -> bool:
    """True where the script reads no register before it has carried the command out."""
    if isinstance(command, v.Stop | v.MoveUntilContact):
        return True
    return isinstance(command, v.Move) and not command.asynchronous
