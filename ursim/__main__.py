"""`python -m ursim`: a simulated controller of a UR e-Series arm in a process of its own.

Prints one JSON line when every port listens, and another with its timing when it ends; with `--words` both are for
people. SIGTERM and SIGINT end it, and so does a client's `shutdown`. With `--commands` it also reads faults as JSON
lines (`ursim.ports.faults`) from standard input, and ends when that does. `--fault` has some come by themselves.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import sys
import threading
import time
import traceback
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from pep.base.stop_model import STOP_DECELERATION_RAD_S2
from pep.base.thread_priority import goes_first
from pep.rtde.wire.messages import ControlVersion
from ursim.ports.arm_kinds import KINDS
from ursim.ports.faults import USAGE, FaultError, Faults, PlannedFault
from ursim.ports.server import HOME, Settings, Simulator

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


EXIT_FAILED, EXIT_USAGE = 1, 2


def main(arguments: list[str] | None = None) -> int:
    """Runs until told to end.

    Exit status 0 after a clean end, 1 after a failure, 2 for settings that cannot be.
    """
    options = _parser().parse_args(arguments)
    over, say = threading.Event(), _tell if options.words else _say
    settings = Settings(
        host=options.host,
        joints=options.joints,
        stop_deceleration_rad_s2=options.stop_deceleration,
        version=options.polyscope,
        object_width_m=options.gripper_object,
        tcp_m=options.tcp,
        payload=(options.payload[0], options.payload[1:]),
        robot=options.robot,
        programs=options.programs,
    )
    try:
        simulator = Simulator(settings, over.set)
    except OSError as error:
        if not options.words:
            say({"ready": False, "error": "PORT_UNUSABLE", "address": error.filename})
        step = "End the program that has it, or choose another --host."
        sys.stderr.write(f"PORT_UNUSABLE: {error.filename}: {error.strerror}. {step}\n")
        return EXIT_FAILED
    except ValueError as error:
        if not options.words:
            say({"ready": False, "error": "SETTINGS"})
        sys.stderr.write(f"ursim: {error}\n")
        return EXIT_USAGE
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: over.set())
    simulator.start()
    if options.commands:
        threading.Thread(target=_obey, args=(simulator, over.set), name="commands", daemon=True).start()
    version = f"{options.polyscope.major}.{options.polyscope.minor}"
    ports = [port.number for port in simulator.ports]
    say({"ready": True, "robot": options.robot, "host": options.host, "polyscope": version, "ports": ports})
    _befall(simulator, options.fault, over)
    over.wait()
    simulator.stop()
    with suppress(BrokenPipeError):  # nobody may be left to hear it
        say({"ready": False, **simulator.clock.report()})
    if simulator.clock.error is not None:
        traceback.print_exception(simulator.clock.error)
        return EXIT_FAILED
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m ursim", description="A simulated controller of a UR arm.")
    parser.add_argument("--host", required=True, help="IPv4 address to listen on; the ports are fixed")
    parser.add_argument(
        "--joints", type=_numbers(6), default=HOME, help="j1,..,j6 [rad] to start at; write --joints=..."
    )
    parser.add_argument(
        "--stop-deceleration",
        type=float,
        default=STOP_DECELERATION_RAD_S2,
        help="of stops that do not say their own [rad/s2]",
    )
    parser.add_argument("--polyscope", type=_version, default="5.11.6.1010327", help="PolyScope version, 5.11 to 5.22")
    parser.add_argument(
        "--tcp", type=_numbers(3), default=(0.0,) * 3, help="x,y,z [m] of the installation's tool point"
    )
    parser.add_argument(
        "--payload", type=_numbers(4), default=(0.0,) * 4, help="kg,x,y,z [m] of the installation's payload"
    )
    parser.add_argument("--robot", choices=sorted(KINDS), default="ur3e", help="arm of the controller")
    parser.add_argument("--programs", type=Path, help="folder of saved programs: NAME.urp with NAME.script beside it")
    parser.add_argument("--words", action="store_true", help="say it in words instead of JSON")
    parser.add_argument("--gripper-object", type=float, default=None, help="width between the gripper's fingers [m]")
    parser.add_argument(
        "--fault",
        type=_fault,
        action="append",
        default=[],
        metavar="NAME[=VALUE][@SECONDS]",
        help=f"comes when the controller is ready, or so long after; again for more: {USAGE}",
    )
    parser.add_argument("--commands", action="store_true", help="read faults from standard input; end with it")
    return parser


def _numbers(count: int) -> Callable[[str], tuple[float, ...]]:
    def read(text: str) -> tuple[float, ...]:
        numbers = tuple(float(part) for part in text.split(","))
        if len(numbers) != count or not all(map(math.isfinite, numbers)):
            raise argparse.ArgumentTypeError(f"{count} numbers, separated by commas")
        return numbers

    return read


def _version(text: str) -> ControlVersion:
    numbers = [int(part) for part in text.split(".")]
    if not 2 <= len(numbers) <= 4 or not all(0 <= number < 2**31 for number in numbers):
        raise argparse.ArgumentTypeError("two to four numbers, separated by dots")
    return ControlVersion(*numbers, *[0] * (4 - len(numbers)))


def _fault(text: str) -> PlannedFault:
    try:
        return PlannedFault.parse(text)
    except FaultError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def _befall(simulator: Simulator, planned: list[PlannedFault], over: threading.Event) -> None:
    """Each fault at its time, those of one time in the order they were given, until it is over."""
    begun = time.monotonic()
    for fault in sorted(planned, key=lambda each: each.at_s):
        if over.wait(max(0.0, begun + fault.at_s - time.monotonic())):
            return
        fault.deed(simulator)


def _obey(simulator: Simulator, end: Callable[[], None]) -> None:
    faults = Faults(simulator)
    for line in _standard_input():
        try:
            faults.inject(line)
        except FaultError as error:
            sys.stderr.write(f"ursim: {error}\n")
    end()


def _standard_input() -> Iterator[str]:
    """Lines until the end. Unbuffered: a thread waiting inside a buffered reader can crash the interpreter's exit."""
    held = b""
    while received := os.read(sys.stdin.fileno(), 4096):
        *lines, held = (held + received).split(b"\n")
        yield from (line.decode("utf-8", "replace") for line in lines)


def _tell(told: dict[str, object]) -> None:
    if told["ready"]:
        arm, version = str(told["robot"]).upper().replace("E", "e"), told["polyscope"]
        text = f"A simulated {arm} with PolyScope {version} listens on {told['host']}. Ctrl-C ends it."
    else:
        text = "; ".join(f"{name} {value}" for name, value in told.items() if name != "ready")
    print(text, flush=True)  # noqa: T201  standard output is this program's interface


def _say(told: dict[str, object]) -> None:
    print(json.dumps(told), flush=True)  # noqa: T201  standard output is this program's interface


if __name__ == "__main__":
    goes_first(with_all_it_begins=True)  # a controller has a computer of its own
    raise SystemExit(main())
