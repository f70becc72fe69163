"""Robot's side of a cell, composed: its readiness, its kinematics, and its held object."""

from __future__ import annotations

import asyncio
import contextlib
from functools import partial
from typing import TYPE_CHECKING, Final

from capabilities.values.units import Unit
from pep.base.errors import ConfigError, PepFault, RobotError
from pep.pit.robot.calibration import nominal_error_m, own_kinematics
from pep.rtde.line.lease_stop import StopMeans
from pep.rtde.robot.readiness import OWN_POSE_M, RobotReadiness
from pep.world.world import tool_position

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit import Robot
    from pep.rtde.line.controller_ports import LeasedPorts
    from pep.rtde.own.tool_lease import OwnLines
    from pep.rtde.robot.dashboard import RemoteControl
    from pep.rtde.robot.gripper import GripResult, RobotiqGripper
    from pep.rtde.robot.readiness import RunningProgram
    from pep.rtde.robot.state_receiver import StateReceiver
    from pep.world.held_object import CommittedGrip
    from pep.world.world import CellPhysics
    from policies.words.reason_table import Reason

PROGRAM_S: Final = 1.0
"""Longest wait for the controller to tell where its tool is; it takes some milliseconds."""


class PortStopper:
    """`pep.rtde.robot.judge_port.Stopper` over the ports, from any thread."""

    def __init__(self, ports: LeasedPorts, loop: asyncio.AbstractEventLoop) -> None:
        self._ports = ports
        self._loop = loop

    def stop(self, reason: Reason) -> None:  # noqa: ARG002 - the caller has it on record
        """See `Stopper.stop`."""
        self._loop.call_soon_threadsafe(self._ports.stop, StopMeans.PROGRAM)

    @property
    def stopped_ms(self) -> int | None:
        """See `Stopper.stopped_ms`."""
        return self._ports.stopped_ms


def found_holding(holding: CommittedGrip, gripper: RobotiqGripper) -> None:
    """Commits an unknown held object where the fingers hold something since before this process.

    A gripper that does not answer, or is not active, says nothing: it does not move either until it is made ready, and
    that commits its held object.
    """
    with contextlib.suppress(RobotError):
        if gripper.holds():
            holding.closed_on_unknown()


def readiness(
    state: StateReceiver,
    remote: RemoteControl,
    program: RunningProgram,
    commanding: Callable[[], bool],
    *,
    robot: Robot,
    holding: CommittedGrip,
) -> RobotReadiness:
    """The robot's readiness, by connections beside the one that commands it.

    Args:
        state: of the controller.
        remote: of the controller.
        program: what the controller runs.
        commanding: whether the connection that commands stands.
        robot: its model.
        holding: what it holds.
    """
    return RobotReadiness(
        state=state,
        remote=remote,
        program=program,
        commanding=commanding,
        tool_position=partial(tool_position, robot),
        tcp_m=robot.tool.tcp_m,
        pose_m=nominal_error_m(robot.model) if own_kinematics(robot.model) is None else OWN_POSE_M,
        expected_payload_g=lambda: round(holding.carried_kg * Unit.GRAM.per_si),
    )


def confirm_kinematics(readiness: RobotReadiness) -> None:
    """Checks that the controller has the tool at the place of the arm's own kinematics.

    Raises:
        ConfigError: `CONFIG_INVALID`: it has not, so the calibration is another arm's, or has another tool than the
            model.
        RobotError: the controller does not tell.
    """
    if not readiness.confirmed(within_s=PROGRAM_S):
        raise ConfigError(PepFault.CONFIG_INVALID, "calibration_file: the controller has the tool elsewhere")


async def committed(physics: CellPhysics, lines: OwnLines, holding: CommittedGrip, grip: GripResult) -> None:
    """Commits the outcome of a grip, and sets the controller's payload by it, also when the caller is cancelled.

    A controller that does not take the new payload contradicts the committed grip, and TEA-5 denies every motion.
    """

    async def commit() -> None:
        before = holding.carried_kg
        try:
            await asyncio.to_thread(physics.grip_ended, on_something=grip.object, arrived=grip.arrived)
        finally:
            if holding.carried_kg != before:
                await lines.equip(holding.carried_kg, holding.centre_m)

    await asyncio.shield(asyncio.ensure_future(commit()))
