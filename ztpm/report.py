"""What a robot's enforcement point tells the process that started it, when asked: robot, perception, revocation view.

The question `{"report": true}` comes as a line on standard input, and the answer goes to standard output. That pipe is
nobody else's, so joint angles are told here that the server keeps from strangers on its HTTP port.
"""

from __future__ import annotations

import asyncio
import json
import sys
from typing import TYPE_CHECKING, Any, Final, assert_never

from capabilities.statements.revocation import NEVER_MS
from pep.context.frames import Distrusted, Seen, Unseen
from pep.errors import RobotError
from pep.pit.calibration import own_kinematics

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from ztpm.enforcement import EnforcementPoint

MILLIMETRES: Final = 1e3  # to the metre


async def serve_reports(report: Callable[[], Awaitable[dict[str, object]]]) -> None:
    """Every question on standard input is answered, until it ends.

    Args:
        report: makes an answer; plain JSON.
    """
    reader = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    try:
        await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    except ValueError:  # a file: nobody asks
        return
    while line := await reader.readline():
        if line.strip() == b'{"report": true}':
            answer = json.dumps({"answer": await report()}, allow_nan=False)
            sys.stdout.write(answer + "\n")
            sys.stdout.flush()


async def report_of(server: EnforcementPoint) -> dict[str, object]:
    """The report of a running enforcement point: robot, perception and revocation view, each as of now."""
    return {"robot": await asyncio.to_thread(_robot, server), "perception": _perception(server), "view": _view(server)}


def _robot(server: EnforcementPoint) -> dict[str, object]:
    kinematics = {
        "model_digest": server.robot.model_digest,
        "calibration": own_kinematics(server.robot.model),
        "uncertainty_mm": server.cell.robot_uncertainty_m * MILLIMETRES,
    }
    try:
        state = server.state.read()
    except RobotError as error:
        return {**kinematics, "fault": str(error.code)}
    return {
        **kinematics,
        "q_rad": list(state.q_rad),
        "moving": not state.still,
        "robot_mode": state.robot_mode,
        "safety_mode": state.safety_mode,
    }


def _perception(server: EnforcementPoint) -> dict[str, Any]:
    told: dict[str, Any] = {**server.physics.summary(), "sensors": sorted(server.follower.sensors()), "seen": []}
    view = server.frames.view()
    match view:
        case Distrusted(rejected):
            told["fault"] = str(rejected.fault)
        case Unseen():
            pass
        case Seen(frames, _):
            now_ms = server.clock.monotonic_ms()
            told["seen"] = [
                {
                    "sensor": frame.observation.sensor,
                    "age_ms": now_ms - frame.arrived_ms + frame.transit_ms,
                    "people": [person.id for person in frame.observation.people],
                    "objects": [{"id": thing.id, "kind": thing.kind} for thing in frame.observation.objects],
                }
                for frame in frames
            ]
        case _:
            assert_never(view)
    return told


def _view(server: EnforcementPoint) -> dict[str, object]:
    """Epoch and age of the revocation view; None while there is none."""
    view = server.follower.view()
    return {"epoch": None, "age_ms": None} if view.age_ms >= NEVER_MS else {"epoch": view.epoch, "age_ms": view.age_ms}
