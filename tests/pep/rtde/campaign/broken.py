"""A gateway with one of its defences taken out: does the campaign see that?

`python -m tests.pep.rtde.campaign.broken LISTEN ROBOT FILE` is the gateway of `tests.pep.rtde.campaign.rule`, but for what the
environment's BROKEN names.
"""

import asyncio
import os
import sys

from pep.rtde.line.active_lease import ActiveLease
from pep.rtde.line.command_registers import LeasedCommands
from pep.rtde.line.controller_ports import LeasedPorts
from pep.rtde.line.rtde_line import LeasedLine
from pep.rtde.wire.recipes import INT, OFFSETS
from tests.pep.rtde.campaign.rule import Rule
from tests.pep.rtde.leased_gateway import serve

VARIABLE = "BROKEN"
MOVE = 1


def swapped_images():
    """A command written over a standing one goes through, and nobody is asked."""
    LeasedCommands._drifted = lambda self, command, at_ms: self._write(command)


def no_stops():
    """Stops are heard, and nothing comes of them."""
    LeasedCommands._stop = lambda self, stop, at_ms: None
    LeasedPorts.stop = lambda self, rung: None


def no_record():
    """Any command is sent, and not written down."""
    Rule.judge = lambda self, held: held.forward(self)


def breaking():
    """Something is raised on the event loop, again and again."""
    heard = ActiveLease.heard

    def raising(self, sample, at_ms):
        heard(self, sample, at_ms)
        asyncio.get_running_loop().call_soon(lambda: 1 / 0)

    ActiveLease.heard = raising


def stale_rewrites():
    """The keep-alive writes the last move, after any clear."""
    write = LeasedLine._write

    def keeping(self, values):
        write(self, values)
        if any(values.get(INT[offset]) == MOVE for offset in OFFSETS):
            self.stale = self._last_written

    LeasedLine._write = keeping
    LeasedLine.rewrite = lambda self: self._to_robot.extend(getattr(self, "stale", self._last_written or b""))


NAMES = {each.__name__: each for each in (swapped_images, no_stops, no_record, breaking, stale_rewrites)}

if __name__ == "__main__":
    NAMES[os.environ[VARIABLE]]()
    asyncio.run(serve(*sys.argv[1:], judged=Rule))
