"""The cell's camera, in place of the simulated sensor: it casts rays, detects, and signs its findings.

    python -m cobot_claw.camera --to HOST:PORT --sensor ID --calibration HEX --key-file F [--also HOST:PORT ID KEYFILE]

Standard input takes the commands of `python -m ursim.sensor.sensor`; here they say what truly is there, which only the
rays see. The gateway gets frames under one key (they are the world of its physics), the admission point under another.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from cobot_claw.depth import DepthCamera, Following, commands_of
from pep.base.errors import ConfigError
from pep.base.key_file import read_key
from pep.base.thread_priority import goes_first
from pep.sensor.frame_sender import FrameSender
from ursim.sensor.sensor import Sensor, listen

if TYPE_CHECKING:
    from collections.abc import Sequence

HZ: Final = 30.0
"""Frames a second, as an ordinary depth camera gives.

A moving arm is stopped when its view is older than 150 ms.
"""


async def look(truth: Sensor, sensors: Sequence[tuple[Sensor, FrameSender]]) -> None:
    """Frames go out for ever.

    Args:
        truth: holds what truly is there; it never sends.
        sensors: who signs, and where to.
    """
    loop, camera, following = asyncio.get_running_loop(), DepthCamera(), Following()
    due, shown, told = loop.time(), None, commands_of(())
    while True:
        now_s = time.time()
        truth.seen, people, objects = truth.seen.at(now_s)
        if not truth.seen.paused:
            shows_change, truth.changed = truth.changed, False
            if (people, objects) != shown:  # the same scene has the same depths
                shown = people, objects
                told = commands_of(following.named(camera.detect(camera.capture(people, objects))))
            for sensor, receiver in sensors:
                sensor.seen = sensor.seen.told(told, now_s=now_s)
                receiver.send(sensor.frame(captured_s=now_s).encode() + b"\n")
            if shows_change:
                sys.stdout.write(json.dumps({"shown_ms": time.monotonic_ns() / 1e6}) + "\n")
                sys.stdout.flush()
        due = max(due + 1 / HZ, loop.time())
        await asyncio.sleep(due - loop.time())


async def run(truth: Sensor, sensors: Sequence[tuple[Sensor, FrameSender]]) -> None:
    """The camera runs until it is told to end (SIGTERM, SIGINT)."""
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    tasks = [asyncio.create_task(receiver.keep()) for _, receiver in sensors]
    tasks += [asyncio.create_task(look(truth, sensors)), asyncio.create_task(listen([truth]))]
    sys.stdout.write(json.dumps({"ready": True}) + "\n")
    sys.stdout.flush()
    await ended.wait()
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m cobot_claw.camera", description=__doc__)
    parser.add_argument("--sensor", required=True)
    parser.add_argument("--calibration", required=True)
    parser.add_argument("--key-file", required=True, type=Path)
    parser.add_argument("--to", required=True, metavar="HOST:PORT")
    parser.add_argument("--also", action="append", default=[], nargs=3, metavar=("HOST:PORT", "ID", "KEYFILE"))
    options = parser.parse_args()
    wanted = [(options.to, options.sensor, options.key_file)]
    wanted += [(to, name, Path(key)) for to, name, key in options.also]
    sensors = []
    try:
        for to, name, path in wanted:
            host, _, port = to.rpartition(":")
            key = read_key(path, name="--key-file")
            sensors.append((Sensor(key, name=name, calibration=options.calibration), FrameSender(host, int(port))))
    except (ConfigError, ValueError) as error:
        parser.exit(2, f"{error}\n")
    truth = Sensor(read_key(options.key_file, name="--key-file"), name="truth", calibration=options.calibration)
    asyncio.run(run(truth, sensors))


if __name__ == "__main__":
    goes_first(with_all_it_begins=True)  # a camera has a computer of its own
    main()
