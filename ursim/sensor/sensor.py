"""Simulated sensors: they see a scene told on standard input, and push it as signed frames.

    python -m ursim.sensor.sensor --to HOST:PORT [--hz 30] [--paused] --sensor ID --calibration HEX --key-file F
                             [--to HOST2:PORT2 ...] [--sensor ID2 ...]

Each sensor has its own key, connection, boot id and sequence. Commands are JSON lines; all positions are metres in the
robot's base frame:

    {"people": [...], "objects": [...]}   these and nobody and nothing else are there
    {"walk": {"id", "from": [x, y], "to": [x, y], "speed_m_s"}}   a person walks there, straight, and then stands;
                                          "from" may be left out for a person who is there
    {"move": {"id", "to_m": [x, y, z], "speed_m_s"}}   an object's middle moves there, straight
    {"hold": {"id"}}                      the arm holds an object: no sensor shows it as standing around
    {"place": {"id", "at_m": [x, y, z]}}  an object that was held (or stood elsewhere) stands there
    {"complete": false}                   the frames no longer claim to cover all that the sensor watches
    {"pause": true}                       the stream stops, until {"pause": false}

A person is `{"id", "x_m", "y_m"}` (a standing adult) with an optional `"facing_rad"`; an object is `{"id", "kind",
"shape"}` with `{"type": "sphere", "center_m", "radius_m"}`, `{"type": "box", "center_m", "half_m"}` or `{"type":
"capsule", "a_m", "b_m", "radius_m"}`. Every command goes to all sensors; with a member `"sensor": ID` beside it only to
that one. When the first frame after a command has been sent, `{"shown_ms": CLOCK_MONOTONIC}` is written to standard
output.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pep.base.errors import ConfigError
from pep.base.key_file import read_key
from pep.base.tcp_place import tcp_place
from pep.base.thread_priority import goes_first
from pep.sensor.frame_sender import FrameSender
from pep.sensor.frame_writer import FrameWriter
from ursim.sensor.sensor_scene import SceneCommandError, Seen, parse

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capabilities.keys.keys import PrivateKey

HZ: Final = 30.0
"""Frames a second, as an ordinary depth camera gives.

Each with one person costs the receiver 1.5 ms of a core.
"""
HIGHEST_HZ: Final = 500.0


class Sensor:
    """Sensor with a view of the scene, which it signs frame by frame.

    Args:
        key: signs every frame.
        name: its registered id.
        calibration: digest (hex) of its calibration.
    """

    def __init__(self, key: PrivateKey, *, name: str, calibration: str) -> None:
        self._writer = FrameWriter(key, name=name, calibration=calibration)
        self.name = name
        self.seen = Seen.nothing()
        self.changed = False

    def frame(self, *, captured_s: float) -> str:
        """The next frame, signed.

        Args:
            captured_s: wall clock at capture, seconds since the epoch.
        """
        self.seen, people, objects = self.seen.at(captured_s)
        return self._writer.frame(people, objects, captured_s=captured_s, complete=self.seen.complete)


def obey(sensors: Sequence[Sensor], line: str, *, at_s: float) -> None:
    """Applies a line to every sensor that it is for, or to none.

    Args:
        sensors: all of this process.
        line: one JSON object.
        at_s: wall clock, seconds since the epoch.

    Raises:
        SceneCommandError: the line is no command, or names a sensor that is not here.
    """
    command = parse(line)
    if isinstance(command, dict) and "sensor" in command:
        name = command.pop("sensor")
        sensors = [sensor for sensor in sensors if sensor.name == name]
        if not sensors:
            raise SceneCommandError("no sensor of that id")
    told = [sensor.seen.told(command, now_s=at_s) for sensor in sensors]
    for sensor, seen in zip(sensors, told, strict=True):
        sensor.seen, sensor.changed = seen, True


async def push(sensor: Sensor, receivers: Sequence[FrameSender], *, period_s: float) -> None:
    """Frames go to every perception point for ever, the same to each; without any nothing is seen."""
    loop = asyncio.get_running_loop()
    due = loop.time()
    while True:
        if not sensor.seen.paused and any(receiver.connected for receiver in receivers):
            shows_change, sensor.changed = sensor.changed, False
            line = sensor.frame(captured_s=time.time()).encode() + b"\n"
            sent = [receiver.send(line) for receiver in receivers]
            sent_ms = time.monotonic_ns() / 1e6
            if shows_change and any(sent):
                sys.stdout.write(json.dumps({"shown_ms": sent_ms}) + "\n")
                sys.stdout.flush()
            elif shows_change:
                sensor.changed = True
        due = max(due + period_s, loop.time())
        await asyncio.sleep(due - loop.time())


async def listen(sensors: Sequence[Sensor]) -> None:
    """Commands from standard input are obeyed until it ends."""
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    while line := await reader.readline():
        try:
            obey(sensors, line.decode(), at_s=time.time())
        except ValueError as error:
            sys.stderr.write(f"ignored: {error}\n")


async def run(sensors: Sequence[Sensor], to: Sequence[tuple[str, int]], *, hz: float) -> None:
    """The sensors run until they are told to end (SIGTERM, SIGINT)."""
    loop = asyncio.get_running_loop()
    ended = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    tasks = []
    for sensor in sensors:
        receivers = [FrameSender(host, port) for host, port in to]
        tasks += [asyncio.create_task(receiver.keep()) for receiver in receivers]
        tasks.append(asyncio.create_task(push(sensor, receivers, period_s=1 / hz)))
    tasks.append(asyncio.create_task(listen(sensors)))
    sys.stdout.write(json.dumps({"ready": True}) + "\n")
    sys.stdout.flush()
    await ended.wait()
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m ursim.sensor.sensor",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--sensor", required=True, action="append", help="its id; once for each sensor")
    parser.add_argument("--calibration", required=True, action="append", help="in the same order")
    parser.add_argument("--key-file", required=True, action="append", type=Path, help="in the same order")
    parser.add_argument(
        "--to", required=True, action="append", metavar="HOST:PORT", help="where frames go; as often as needed"
    )
    parser.add_argument("--hz", type=float, default=HZ, help=f"frames a second of each (default {HZ:g})")
    parser.add_argument("--paused", action="store_true", help="send nothing before a command says so")
    options = parser.parse_args()
    if not len(options.sensor) == len(options.calibration) == len(options.key_file):
        parser.error("--sensor, --calibration and --key-file belong together")
    if not 1 / HIGHEST_HZ <= options.hz <= HIGHEST_HZ:
        parser.error("--hz must be a number that a sensor can keep")
    try:
        places = [tcp_place(text, name="--to") for text in options.to]
        sensors = [
            Sensor(read_key(path, name="--key-file"), name=name, calibration=calibration)
            for name, calibration, path in zip(options.sensor, options.calibration, options.key_file, strict=True)
        ]
    except ConfigError as error:
        parser.exit(2, f"{error}\n")
    if options.paused:
        obey(sensors, '{"pause": true}', at_s=time.time())
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(run(sensors, places, hz=options.hz))


if __name__ == "__main__":
    goes_first(with_all_it_begins=True)  # as the simulated controller
    main()
