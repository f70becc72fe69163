"""What an enforcement point reports of its robot and of what its sensors see."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, Final, assert_never

from pep.context.frames import Distrusted, Seen, Unseen
from pep.errors import RobotError
from pep.pit.calibration import own_kinematics

if TYPE_CHECKING:
    from ztpm.robot_point import RobotPoint

MILLIMETRES: Final = 1e3  # to the metre


async def report_of(server: RobotPoint) -> dict[str, object]:
    """What a running enforcement point reports of its robot and perception, each as of now."""
    return {"robot": await asyncio.to_thread(_robot, server), "perception": _perception(server)}


def _robot(server: RobotPoint) -> dict[str, object]:
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


def _perception(server: RobotPoint) -> dict[str, Any]:
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
