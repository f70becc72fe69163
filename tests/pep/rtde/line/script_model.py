"""Main loop of ur_rtde's control script, without an arm: it carries out the registers, cycle by cycle."""

from pep.rtde.command.command_table import EVERY_CYCLE, decode, row_of
from pep.rtde.command.register_image import RegisterImage
from pep.rtde.line.script_terms import DONE, READY

from pep.rtde.command import command_values as v

LASTS = 3
"""Cycles of a move, and of a stop, that the script waits for."""


class Script:
    """One run of it after another over the same registers."""

    def __init__(self, profile):
        self.image = RegisterImage.blank(profile)
        self.said, self.inside, self.executing, self.running = 0, 0, False, False
        self.done = []

    def write(self, values):
        after = self.image.merge(values)
        assert isinstance(after, RegisterImage)
        self.image = after

    def start(self):
        self.running, self.executing, self.inside, self.said = True, False, 0, READY

    def tick(self):
        """One cycle; what the controller says after it."""
        number = self.image.whole(0)
        if not self.running:
            return number, self.said
        if self.inside:
            self.inside -= 1
            if not self.inside:
                self.said = DONE
        elif number in EVERY_CYCLE:
            self._carry_out(decode(self.image))
            self.said = READY
        elif number == 0:
            self.executing, self.said = False, READY
        elif not self.executing:
            self.executing = True
            self._carry_out(decode(self.image))
        return number, self.said

    def _carry_out(self, command):
        self.done.append(command)
        if command == v.End(v.StopKind.PROGRAM):
            self.running = False
        elif isinstance(command, v.Stop) or (
            isinstance(command, v.Move) and not getattr(command, "asynchronous", False)
        ):
            self.inside = LASTS
        elif row_of(command).id not in EVERY_CYCLE:
            self.said = DONE
