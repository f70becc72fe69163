"""A simulated sensor: it sees what it is told on standard input, and pushes it as signed frames.

    python -m pep.sim.sensor --key-file F --sensor ID --calibration HEX --to HOST:PORT [--hz 20]

Commands are JSON lines: `{"people": [...], "objects": [...]}` sets the scene, `{"pause": true}` and `{"pause": false}`
stop and resume the stream. A person is `{"id", "x_m", "y_m"}` (a standing adult there) with an optional `"facing_rad"`;
an object is `{"id", "kind", "shape"}` with one of the shapes `{"type": "sphere", "center_m", "radius_m"}`, `{"type":
"box", "center_m", "half_m"}`, `{"type": "capsule", "a_m", "b_m", "radius_m"}`.

When the first frame that shows a new scene has been sent, `{"shown_ms": CLOCK_MONOTONIC}` is said on standard output.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import secrets
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from capabilities.statements import observation as wire
from pep.errors import ConfigError
from pep.key_file import read_key
from pep.pit import observed, standing_adult

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

MICRO: Final = 1e6
RETRY_S: Final = 0.1


class SceneCommandError(ValueError):
    """A command line that is none."""


class Sensor:
    """What the sensor sees and how it says it.

    Args:
        key: signs every frame.
        name: its registered id.
        calibration: digest (hex) of its calibration.

    Attributes:
        people, objects: what it sees.
        paused: whether it sends nothing.
        changed: whether no frame has shown the scene as it is now.
    """

    def __init__(self, key: Ed25519PrivateKey, *, name: str, calibration: str) -> None:
        self._key = key
        self._name = name
        self._calibration = calibration
        self._boot_id = secrets.token_hex(16)
        self._sequence = 0
        self.people: tuple[wire.ObservedPerson, ...] = ()
        self.objects: tuple[wire.ObservedObject, ...] = ()
        self.paused = False
        self.changed = False

    def obey(self, line: str) -> None:
        """The scene is as the line says.

        Raises:
            SceneCommandError: the line is no command; the scene is as it was.
        """
        try:
            command = json.loads(line)
            if "pause" in command:
                self.paused = command["pause"] is True
                return
            people = tuple(person(entry) for entry in command.get("people", []))
            objects = tuple(thing(entry) for entry in command.get("objects", []))
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise SceneCommandError(f"{type(error).__name__}: {error}") from error
        self.people, self.objects, self.changed = people, objects, True

    def frame(self, *, captured_s: float) -> str:
        """The next frame, signed.

        Args:
            captured_s: wall clock at capture, seconds since the epoch.
        """
        self._sequence += 1
        return wire.sign(
            wire.Observation(
                sensor=self._name,
                boot_id=self._boot_id,
                sequence=self._sequence,
                captured_ms=int(captured_s * 1000),
                calibration=self._calibration,
                complete=True,
                people=self.people,
                objects=self.objects,
            ),
            self._key,
        )


def person(entry: dict[str, Any]) -> wire.ObservedPerson:
    """A standing adult, as a sensor says it."""
    x_m, y_m, facing_rad = (float(number) for number in (entry["x_m"], entry["y_m"], entry.get("facing_rad", 0.0)))
    if not all(map(math.isfinite, (x_m, y_m, facing_rad))):
        raise SceneCommandError("not finite")
    return observed(standing_adult(x_m, y_m, facing_rad=facing_rad, name=str(entry.get("id", "person"))))


def thing(entry: dict[str, Any]) -> wire.ObservedObject:
    """An object of one shape."""
    shape = entry["shape"]
    return wire.ObservedObject(str(entry.get("id", "object")), str(entry["kind"]), _SHAPES[shape["type"]](shape))


def _um(metre: float) -> int:
    if not math.isfinite(metre):
        raise SceneCommandError("not finite")
    return round(metre * MICRO)


def _point(numbers: Any) -> tuple[int, int, int]:
    x, y, z = (_um(float(number)) for number in numbers)
    return (x, y, z)


def _sphere(entry: dict[str, Any]) -> wire.Shape:
    return wire.Sphere(_point(entry["center_m"]), _um(float(entry["radius_m"])))


def _box(entry: dict[str, Any]) -> wire.Shape:
    return wire.Box(_point(entry["center_m"]), _point(entry["half_m"]), (1_000_000, 0, 0, 0))


def _capsule(entry: dict[str, Any]) -> wire.Shape:
    return wire.Capsule(_point(entry["a_m"]), _point(entry["b_m"]), _um(float(entry["radius_m"])))


_SHAPES: Final = {"sphere": _sphere, "box": _box, "capsule": _capsule}


async def push(sensor: Sensor, host: str, port: int, *, period_s: float) -> None:
    """Frames go to the perception point for ever; a lost connection is made again, and nothing is kept for later."""
    loop = asyncio.get_running_loop()
    while True:
        try:
            _, writer = await asyncio.open_connection(host, port)
        except OSError:
            await asyncio.sleep(RETRY_S)
            continue
        due = loop.time()
        try:
            while True:
                if not sensor.paused:
                    shows_change, sensor.changed = sensor.changed, False
                    writer.write(sensor.frame(captured_s=time.time()).encode() + b"\n")
                    sent_ms = time.monotonic_ns() / 1e6
                    await writer.drain()
                    if shows_change:
                        sys.stdout.write(json.dumps({"shown_ms": sent_ms}) + "\n")
                        sys.stdout.flush()
                due = max(due + period_s, loop.time())
                await asyncio.sleep(due - loop.time())
        except OSError:
            continue
        finally:
            writer.close()


async def listen(sensor: Sensor) -> None:
    """Commands from standard input are obeyed until it ends."""
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    while line := await reader.readline():
        try:
            sensor.obey(line.decode())
        except ValueError as error:
            sys.stderr.write(f"ignored: {error}\n")


async def run(sensor: Sensor, host: str, port: int, *, hz: float) -> None:
    """The sensor runs until it is told to end (SIGTERM, SIGINT)."""
    loop = asyncio.get_running_loop()
    ended = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    tasks = [asyncio.create_task(push(sensor, host, port, period_s=1 / hz)), asyncio.create_task(listen(sensor))]
    sys.stdout.write(json.dumps({"ready": True}) + "\n")
    sys.stdout.flush()
    await ended.wait()
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m pep.sim.sensor", description="A simulated sensor.")
    parser.add_argument("--key-file", type=Path, required=True)
    parser.add_argument("--sensor", required=True)
    parser.add_argument("--calibration", required=True)
    parser.add_argument("--to", required=True, metavar="HOST:PORT")
    parser.add_argument("--hz", type=float, default=20.0)
    options = parser.parse_args()
    host, _, port = options.to.rpartition(":")
    try:
        key = read_key(options.key_file, name="--key-file")
    except ConfigError as error:
        parser.exit(1, f"{error}\n")
    sensor = Sensor(key, name=options.sensor, calibration=options.calibration)
    asyncio.run(run(sensor, host, int(port), hz=options.hz))


if __name__ == "__main__":
    main()
