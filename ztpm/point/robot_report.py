"""Report of an enforcement point about its robot and its sensors' view."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, Final, assert_never

from pep.base.errors import RobotError
from pep.perception.sensor_frames import Distrusted, Seen, Unseen
from pep.pit.robot.calibration import own_kinematics

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pep.perception.sensor_frames import View
    from pep.pit import CellParameters, Robot
    from pep.rtde.robot.state_receiver import StateReceiver

MILLIMETRES: Final = 1e3  # to the metre


async def report_of(
    robot: Robot,
    cell: CellParameters,
    state: StateReceiver,
    perception: Mapping[str, object],
    view: View,
    *,
    at_ms: int,
) -> dict[str, object]:
    """Robot and perception, as of now.

    Args:
        robot: the model in use.
        cell: the signed cell's parameters.
        state: read in a worker thread.
        perception: state of the sensors by physics and registry, plain JSON.
        view: the newest frames.
        at_ms: monotonic time of the view.
    """
    return {
        "robot": await asyncio.to_thread(_robot, robot, cell, state),
        "perception": {**perception, **_seen(view, at_ms)},
    }


def _robot(robot: Robot, cell: CellParameters, state: StateReceiver) -> dict[str, object]:
    kinematics = {
        "model_digest": robot.model_digest,
        "calibration": own_kinematics(robot.model),
        "uncertainty_mm": cell.robot_uncertainty_m * MILLIMETRES,
    }
    try:
        now = state.read()
    except RobotError as error:
        return {**kinematics, "fault": str(error.code)}
    return {
        **kinematics,
        "q_rad": list(now.q_rad),
        "moving": not now.still,
        "robot_mode": now.robot_mode,
        "safety_mode": now.safety_mode,
    }


def _seen(view: View, at_ms: int) -> dict[str, Any]:
    match view:
        case Distrusted(rejected):
            return {"seen": [], "fault": str(rejected.fault)}
        case Unseen():
            return {"seen": []}
        case Seen(frames, _):
            return {
                "seen": [
                    {
                        "sensor": frame.observation.sensor,
                        "age_ms": at_ms - frame.arrived_ms + frame.transit_ms,
                        "people": [person.id for person in frame.observation.people],
                        "objects": [{"id": thing.id, "kind": thing.kind} for thing in frame.observation.objects],
                    }
                    for frame in frames
                ]
            }
        case _:
            assert_never(view)
