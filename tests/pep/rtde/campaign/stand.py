"""A controller, a gateway with the campaign's judge before it, eyes of our own, and what both processes complain of."""

import contextlib
import json
import os
import sys
import time

from pep.rtde.robot.dashboard import stop_program
from tests.pep.rtde.campaign.rule import HOME
from tests.pep.rtde.leased_gateway import leased_gateway
from ursim.ports.launch import SimulatedController
from ztpm.stage.samples import StateRecorder

STANDS_S = 3.0
"""Ours: a stop that took longer was none."""
LOST = "socket.send() raised exception."
"""asyncio's word for frames to a client that has just gone: none was raised."""
QUIET = 5
"""Samples of a standing arm: one alone may lie between two motions."""


class Stand:
    """The processes, for many sequences."""

    def __init__(self, controller, gateway, eyes, errors):
        self.controller, self.gateway, self.eyes, self.errors = controller, gateway, eyes, errors
        self.read = 0

    def complaints(self):
        """Exceptions that the processes printed, and the exit codes of those that ended."""
        text = self.errors.read_text()
        ended = [p for p in (self.controller.process, self.gateway.process) if p.poll() is not None]
        return [f"a process ended with {p.returncode}" for p in ended] + [
            line for line in text.splitlines() if ("Traceback" in line or "exception" in line.lower()) and line != LOST
        ]

    def permits(self):
        """Permits that the judge has written down since the last call, without those taken back."""
        with self.gateway.file.open() as file:
            file.seek(self.read)
            text = file.read()
        whole = text[: text.rfind("\n") + 1]
        self.read += len(whole)
        rows = [json.loads(line) for line in whole.splitlines()]
        unsent = {row["unsent"] for row in rows if "unsent" in row}
        return [row for row in rows if "number" in row and row["number"] not in unsent]

    def stands(self, since_s, wait_s=STANDS_S):
        """Seconds after `since_s` at which the arm stood for good; None where it did not in time."""
        while time.monotonic() < since_s + wait_s:
            last = self.eyes.after(since_s)
            if len(last) >= QUIET and all(s.still and s.commanded_rad_s == 0.0 for s in last[-QUIET:]):
                moving = [s for s in last if not s.still]
                return max(moving[-1].arrived_s - since_s, 0.0) if moving else 0.0
            time.sleep(0.002)
        return None

    def anybody_stops(self):
        """Stops by the dashboard at the gateway, without a lease."""
        stop_program(self.gateway.host)


class Seen(StateRecorder):
    """Eyes that forget only what they are told to."""

    def after(self, arrived_s):
        with self._lock:
            first = len(self._samples)
            while first and self._samples[first - 1].arrived_s >= arrived_s:
                first -= 1
            return self._samples[first:]


@contextlib.contextmanager
def complaining_to(path):
    """Sends the standard error of processes that are started here to that file."""
    sys.stderr.flush()
    before = os.dup(2)
    with path.open("ab") as file:
        os.dup2(file.fileno(), 2)
        try:
            yield file
        finally:
            os.dup2(before, 2)
            os.close(before)


@contextlib.contextmanager
def stand(folder, module="tests.pep.rtde.campaign.rule"):
    """Controller and gateway run, the arm at home."""
    errors = folder / "errors"
    errors.touch()
    with contextlib.ExitStack() as ends:
        with complaining_to(errors):
            controller = ends.enter_context(SimulatedController.start(joints=HOME))
        file = ends.enter_context(errors.open("ab"))
        gateway = ends.enter_context(leased_gateway(controller.host, folder / "permits", module, errors=file))
        yield Stand(controller, gateway, ends.enter_context(Seen(controller.host)), errors)
