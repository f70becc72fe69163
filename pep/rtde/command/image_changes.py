"""Change that a package makes: the difference between the images before and after it.

Never look at the package alone. Parameters may be staged while no command stands, changed under a command that the
script reads again in each cycle, and swapped after a command was judged and before the script has read it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from pep.rtde.command.command_table import READS, ROWS, decode
from pep.rtde.wire.refusal import InputRefusal

if TYPE_CHECKING:
    from pep.rtde.command.command_values import Command
    from pep.rtde.command.register_image import RegisterImage


@dataclass(frozen=True, slots=True)
class Unchanged:
    """No variable was changed."""


@dataclass(frozen=True, slots=True)
class Cleared:
    """The command that stood no longer does."""


@dataclass(frozen=True, slots=True)
class Commanded:
    """A command stands that did not stand before."""

    command: Command


@dataclass(frozen=True, slots=True)
class Drifted:
    """The standing command has other parameters now, and the script reads them again in each cycle."""

    command: Command


@dataclass(frozen=True, slots=True)
class Swapped:
    """The standing command has other parameters now, which the script reads once, perhaps later."""

    command: Command


@dataclass(frozen=True, slots=True)
class Staged:
    """Variables were written that no standing command uses."""

    names: tuple[str, ...]


Change: TypeAlias = Unchanged | Cleared | Commanded | Drifted | Swapped | Staged


def changes(before: RegisterImage, after: RegisterImage) -> Change | InputRefusal:
    """Change that a package makes to the command.

    Args:
        before: the image when it came.
        after: the same image with it merged.

    Returns:
        Refused when the command that stands afterwards is none. Changes of outputs and of free registers work beside
        every command: `pep.rtde.command.io_commands` reads them.
    """
    was, stands = before.whole(0), after.whole(0)
    if stands == 0 and was != 0:
        return Cleared()
    command = decode(after)
    if isinstance(command, InputRefusal):
        return command
    if stands != was:
        return Commanded(command)
    old, new = before.values, after.values
    # A command reads variables that its profile does not have as zeros.
    if any(name in new and new[name] != old[name] for name in READS[stands, after.profile.offset]):
        return Drifted(command) if ROWS[stands].every_cycle else Swapped(command)
    # What nothing reads may be NaN, which is another than itself.
    changed = [name for name, value in new.items() if value != old[name] and repr(value) != repr(old[name])]
    return Staged(tuple(changed)) if changed else Unchanged()
