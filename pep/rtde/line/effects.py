"""Effects of a leased program's input: the closed sum of all acts of its line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pep.rtde.command.command_values import Command
    from pep.rtde.command.io_commands import IoCommand
    from pep.rtde.script.move_path import Waypoint
    from pep.rtde.wire.codec import Value
    from pep.rtde.wire.refusal import InputRefusal


@dataclass(frozen=True, slots=True, eq=False)
class CommandQuestion:
    """Command that waits for its decision; each is itself alone.

    Attributes:
        command: command of the program.
        path: waypoints of `MovePath`.
    """

    command: Command | IoCommand
    path: tuple[Waypoint, ...] = ()


@dataclass(frozen=True, slots=True)
class Write:
    """Write these variables to the controller; the others stay as written last."""

    values: Mapping[str, Value]


@dataclass(frozen=True, slots=True)
class AskJudge:
    """Ask the judge."""

    question: CommandQuestion


@dataclass(frozen=True, slots=True)
class Withdraw:
    """Tell the judge that the program waits no longer."""

    question: CommandQuestion


@dataclass(frozen=True, slots=True)
class Tell:
    """Tell the program in a text message of a refusal, or that it waits."""

    text: str
    level: int


@dataclass(frozen=True, slots=True)
class Note:
    """Record a refusal of the line's own.

    Attributes:
        refused: the refusal.
        what: was refused: the name of a command.
    """

    refused: InputRefusal
    what: str


@dataclass(frozen=True, slots=True)
class Refresh:
    """Show the program the newest truthful package at once: its substitute is over."""


@dataclass(frozen=True, slots=True)
class StopWritten:
    """Watch a stop that was written to the registers, until the arm obeys."""


@dataclass(frozen=True, slots=True)
class Halt:
    """Replace the control script by a program that stops the arm, since no register does."""


Act: TypeAlias = Write | AskJudge | Withdraw | Tell | Note | Refresh | StopWritten | Halt

ERROR, INFORMATION = 1, 3  # levels of an RTDE text message
PATIENCE_MS: Final = 60_000
"""Time after which a waiting command is denied; ur_rtde itself waits for 300 s."""
