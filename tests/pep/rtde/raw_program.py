"""A program that speaks RTDE by itself, in a lease."""

import socket
import struct
import time

from pep.rtde.robot.connections import REALTIME, RTDE
from pep.rtde.wire.codec import Framer, Recipe, decode_answer, encode_request
from pep.rtde.wire.messages import FrameKind, RequestProtocol, SetupInputs, SetupOutputs, Start, Values
from pep.rtde.wire.recipes import EXTERNAL_WRENCH, control_recipes
from pep.rtde.wire.variables import INPUTS
from tests.ursim.cell import until, upload

VECTOR = (0.0,) * 6


class Raw:
    """A connection without any library: it writes what it likes, in one piece."""

    RECIPES = (("input_int_register_0",), tuple(f"input_double_register_{i}" for i in range(18)), control_recipes(0)[0])

    def __init__(self, host, *more):
        """At the gateway of that host; `more` recipes than `RECIPES`."""
        self.names = (*self.RECIPES, *more)
        self.framer, self.recipes = Framer(0xFFFF), [Recipe(r, [INPUTS[n] for n in r]) for r in self.names]
        self.link = socket.create_connection((host, RTDE), timeout=5)
        self.ask(RequestProtocol(2), protocol=1)
        for names in self.names:
            self.ask(SetupInputs(names))
        self.ask(SetupOutputs(("runtime_state", "timestamp"), 500.0))
        self.ask(Start())
        self.script = socket.create_connection((host, REALTIME), timeout=5)
        self.script.sendall(upload().encode())
        until(lambda: self.newest()[:4] == bytes((0, 0, 0, 2)))

    def ask(self, request, protocol=2):
        self.link.sendall(encode_request(request, protocol))
        frames = []
        while not frames:
            frames = self.framer.feed(self.link.recv(65_536))

    def newest(self):
        frames = self.framer.feed(self.link.recv(65_536))
        return next((f.payload[1:] for f in reversed(frames) if f.kind is FrameKind.VALUES), b"")

    def say(self, *packages):
        """Each is the number of a recipe and the values in it."""
        self.link.sendall(
            b"".join(
                encode_request(Values(n, self.recipes[n - 1].pack({**self.zeros(n), **values})), 2)
                for n, values in packages
            )
        )

    def zeros(self, number):
        """Package without content."""
        return {name: VECTOR if name == EXTERNAL_WRENCH else 0 for name in self.names[number - 1]}

    def heard(self):
        """The text messages, and the newest `runtime_state`, of the next packages."""
        frames = self.framer.feed(self.link.recv(65_536))
        told = [decode_answer(f, 2).text for f in frames if f.kind is FrameKind.TEXT]
        states = [int.from_bytes(f.payload[1:5], "big") for f in frames if f.kind is FrameKind.VALUES]
        return told, states[-1:]

    def until(self, condition):
        """`runtime_state` and `timestamp` of each package until it is so."""
        found, due = [], time.monotonic() + 10
        while not condition():
            assert time.monotonic() < due
            frames = self.framer.feed(self.link.recv(65_536))
            found += [struct.unpack(">Id", f.payload[1:13]) for f in frames if f.kind is FrameKind.VALUES]
        return found

    def close(self):
        for link in (self.link, self.script):
            link.close()
