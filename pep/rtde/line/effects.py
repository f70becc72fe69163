"""What follows from what the program of a lease says: the closed sum of all that its line does about it."""

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
    """A command that waits for its decision; each is itself alone.

    Attributes:
        command: what the program asks for.
        path: where `MovePath` goes.
    """

    command: Command | IoCommand
    path: tuple[Waypoint, ...] = ()


@dataclass(frozen=True, slots=True)
class Write:
    """These variables are written to the controller; what they do not name stays as it was written last."""

    values: Mapping[str, Value]


@dataclass(frozen=True, slots=True)
class AskJudge:
    """The judge is asked."""

    question: CommandQuestion


@dataclass(frozen=True, slots=True)
class Withdraw:
    """The judge is told that nobody waits any more."""

    question: CommandQuestion


@dataclass(frozen=True, slots=True)
class Tell:
    """The program is told, in a text message: why something was refused, or that it waits."""

    text: str
    level: int


@dataclass(frozen=True, slots=True)
class Note:
    """The line has refused this by itself, and that goes on record.

    Attributes:
        refused: why.
        what: was refused: the name of a command.
    """

    refused: InputRefusal
    what: str


@dataclass(frozen=True, slots=True)
class Refresh:
    """The program sees the newest truthful package at once: what it was shown instead is over."""


@dataclass(frozen=True, slots=True)
class StopWritten:
    """A stop was written to the registers: whether the arm obeys is to be watched."""


@dataclass(frozen=True, slots=True)
class Halt:
    """No register stops the arm: the control script is to be replaced by a program that does."""


Act: TypeAlias = Write | AskJudge | Withdraw | Tell | Note | Refresh | StopWritten | Halt

ERROR, INFORMATION = 1, 3  # levels of an RTDE text message
PATIENCE_MS: Final = 60_000
"""What waits for a decision is denied then; ur_rtde itself waits for 300 s."""
