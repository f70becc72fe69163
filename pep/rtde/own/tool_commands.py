"""Commands of the cell's own tools, typed, on the registers that a program's are written with. Pure, as those.

A permit was spent for each before it comes here, so nobody is asked again. There is no program that would clear a
command which the control script has taken: that is done here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pep.rtde.command import command_values as v
from pep.rtde.command.command_table import row_of
from pep.rtde.command.rounding import on_grid
from pep.rtde.line.command_registers import LeasedCommands
from pep.rtde.line.script_terms import DONE, READY

if TYPE_CHECKING:
    from pep.rtde.command.command_values import Command


class ToolCommands(LeasedCommands):
    """The tools' commands: written when the control script waits for one, and cleared when it has taken it.

    Attributes:
        ready: whether the control script waits for a command.
    """

    ready = False

    def give(self, command: Command) -> bool:
        """True once the command is written; False while the script does something else. Stops go through `brake`."""
        if not self.ready:
            return False
        self._write(on_grid(command))
        return True

    def go_on(self, command: Command) -> bool:
        """True once the next value of the stream under way is written; False where none of its kind goes on."""
        if row_of(command).id not in self._modes or self._busy or not self._running:
            return False
        self._write(on_grid(command))
        return True

    def brake(self, *, at_ms: int) -> None:
        """Begins to stop all motion of the arm, as the cell's stop model says."""
        self._stop(v.StopJ(self._deceleration, asynchronous=False), at_ms)

    def robot(self, command: int, said: int, *, still: bool) -> None:
        """See `LeasedCommands.robot`."""
        super().robot(command, said, still=still)
        newest = self._echo.newest
        if self._running and newest and said == DONE and command == self._sent != 0 and not self._inside:
            self.disarm()
        self.ready = self._running and newest and (command, said) == (0, READY) and not (self._busy or self._sent)

    def _write(self, command: Command) -> None:
        self.ready = False
        super()._write(command)

    def _over(self) -> None:
        self.ready = False
        super()._over()
