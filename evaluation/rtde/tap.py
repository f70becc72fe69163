"""Tap: a controller's ports once more, passed on as they are, with the time at which each command came.

    python -m evaluation.rtde.tap --listen HOST --robot HOST

It stands before the controller whether there is a gateway or not, so that its own cost is on both sides. On a
line on standard input it prints the values since the last one: `[[ns, value], ...]`, the first time that each value of
the first input double register was written, by CLOCK_MONOTONIC.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import sys
import threading
import time
from contextlib import suppress
from typing import Final

from evaluation.rtde.client import first_of_all
from pep.rtde.robot.connections import PORTS, RTDE
from pep.rtde.wire.codec import Framer, Recipe, decode_request
from pep.rtde.wire.messages import SetupInputs, Values
from pep.rtde.wire.variables import INPUTS

REGISTER: Final = "input_double_register_0"
PIECE: Final = 65_536
VERSION: Final = 2

Heard = list[tuple[int, bytes]]


class Tap:
    """All connections of one address."""

    def __init__(self, listen: str, robot: str) -> None:
        self._listen = listen
        self._robot = robot
        self._heard: list[Heard] = []
        self._told: set[float] = set()

    def begin(self) -> None:
        """Listens from now on."""
        for port in PORTS:
            server = socket.create_server((self._listen, port))
            threading.Thread(target=self._accept, args=(server, port), daemon=True).start()

    def written(self) -> list[tuple[int, float]]:
        """Values that came for the first time since the last call, with their times in ns."""
        found: dict[float, int] = {}
        for heard in self._heard:
            for came_ns, value in _values(list(heard)):
                if value not in self._told:
                    found[value] = min(came_ns, found.get(value, came_ns))
        self._told.update(found)
        self._heard = []
        return sorted((came_ns, value) for value, came_ns in found.items())

    def _accept(self, server: socket.socket, port: int) -> None:
        while True:
            client, _ = server.accept()
            robot = socket.create_connection((self._robot, port))
            heard: Heard = []
            if port == RTDE:
                self._heard.append(heard)
            for source, target, kept in ((client, robot, heard if port == RTDE else None), (robot, client, None)):
                source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=_pump, args=(source, target, kept), daemon=True).start()


def _pump(source: socket.socket, target: socket.socket, heard: Heard | None) -> None:
    with suppress(OSError):
        while piece := source.recv(PIECE):
            if heard is not None:
                # As promptly as the gateway does: else its sender holds the next one back.
                source.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
                heard.append((time.monotonic_ns(), piece))
            target.sendall(piece)
    for end in (source, target):
        with suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)


def _values(heard: Heard) -> list[tuple[int, float]]:
    """Values of the register in one connection, with the time of the piece that completed each."""
    framer, protocol = Framer(), 1
    recipes: dict[int, Recipe] = {}
    found: list[tuple[int, float]] = []
    for came_ns, piece in heard:
        for frame in framer.feed(piece):
            match decode_request(frame, protocol):
                case SetupInputs(names):
                    # Controllers number a connection's recipes from 1.
                    recipes[len(recipes) + 1] = Recipe(names, [INPUTS[name] for name in names])
                case Values(number, packed) if number in recipes and REGISTER in recipes[number].names:
                    value = recipes[number].unpack(packed)[REGISTER]
                    assert isinstance(value, float)
                    found.append((came_ns, value))
                case _:
                    protocol = VERSION  # every client of ours begins with asking for it
    return found


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m evaluation.rtde.tap", description=__doc__)
    parser.add_argument("--listen", required=True)
    parser.add_argument("--robot", required=True)
    options = parser.parse_args()
    first_of_all()
    tap = Tap(options.listen, options.robot)
    tap.begin()
    sys.stdout.write(json.dumps({"ready": True}) + "\n")
    sys.stdout.flush()
    for _ in sys.stdin:
        sys.stdout.write(json.dumps({"answer": {"written": tap.written()}}) + "\n")
        sys.stdout.flush()
    os._exit(0)  # pumps wait in the kernel


if __name__ == "__main__":
    main()
