"""Base of the tests of the simulated controller: waiting with a deadline, and a controller without threads."""

import ctypes
import threading
import time
from pathlib import Path

from pep.rtde.script.urscript import ProgramStream
from ursim.motion.arm import Arm
from ursim.motion.robot import Robot
from ursim.ports.controller import Controller
from ursim.ports.gripper import Gripper
from ursim.ports.script_ports import compile_text

HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
TICK_S = 0.002


def until(condition, deadline_s=10.0, pause_s=0.002):
    """The first true value of `condition`; fails after the deadline."""
    due = time.monotonic() + deadline_s
    while time.monotonic() < due:
        found = condition()
        if found:
            return found
        time.sleep(pause_s)
    raise AssertionError(f"not true within {deadline_s} s")


def part_from(client):
    """Disconnects a client of ur_rtde; half a second later another may come.

    It is never destroyed: that sleeps as long once more, with the interpreter's lock held.
    """
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(client))
    client.disconnect()


def let_go(*clients):
    """Disconnects clients of ur_rtde, which are left alone with the half second for which each sleeps then."""
    for client in clients:
        threading.Thread(target=part_from, args=(client,), name="disconnect").start()
    for client in clients:
        until(lambda: not client.isConnected(), pause_s=0.001)  # noqa: B023 - called at once


def upload(major=5, minor=11, offset=0, path=()):
    """The program that the installed ur_rtde wheel sends, rebuilt from what the wheel gives away offline."""
    from script_client import ScriptClient

    text = ScriptClient("127.0.0.1", major, minor).getScript()
    for marker in ("# float register offset\n", "# int register offset\n"):
        text = text.replace(marker, f"{marker}{offset}")
    block = "".join(f"\tsignal_async_progress({i})\n\t{line}\n" for i, line in enumerate(path))
    text = text.replace("# inject move path\n", "# inject move path\n" + block)
    return f"def rtde_control():\n{text}end\n"


class Bench:
    """A controller ticked by the test: no thread, no socket, no clock."""

    def __init__(self, joints=HOME, *, stop_deceleration=8.0, object_width_m=None):
        self.robot = Robot(Arm.load(), tuple(joints), stop_deceleration_rad_s2=stop_deceleration)
        self.controller = Controller(self.robot, Gripper(object_width_m=object_width_m))
        self.exceptions = []
        self.events = []
        self.controller.on_exception = lambda line, text: self.exceptions.append((line, text))
        self.controller.on_event = lambda event, name: self.events.append((event.name, name))

    def load(self, text):
        for program in ProgramStream(10**6).feed(text):
            refusal = self.controller.load(compile_text(program))
            if refusal is not None:
                return refusal
        return None

    def tick(self, count=1):
        for _ in range(count):
            self.controller.tick()

    def until(self, condition, limit=20_000):
        """Ticks until `condition`, and how many that took."""
        for count in range(limit):
            if condition():
                return count
            self.controller.tick()
        raise AssertionError(f"not true within {limit} ticks")

    @property
    def now(self):
        return self.robot.drive.now

    def out(self, index):
        return self.robot.values[f"output_int_register_{index}"]


REPOSITORY = Path(__file__).parents[2]
