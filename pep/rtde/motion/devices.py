"""All that the tools ask of a cell's devices, and the slot in which one of them acts at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pep.base.errors import ActuationRefusedError
from pep.base.operations import JOINTS, Moves, targets_of
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Sequence

    from pep.base.operations import Operation
    from pep.request.permit import Permit
    from pep.rtde.motion.drive import Drive, MotionEnd
    from pep.rtde.motion.jog import Jog
    from pep.rtde.robot.digital_outputs import DigitalOutputs
    from pep.rtde.robot.gripper import GripResult
    from pep.rtde.robot.state_receiver import JointState
    from policies.evidence.model import Request


@dataclass(frozen=True, slots=True)
class Devices:
    """Arm, gripper and outputs; also the `MotionSlot` port.

    Attributes:
        drive: of arm and gripper; it alone stops.
        jog: streams of joint speeds.
        outputs: of the controller.
        gripped: told how each grip has ended, before anything else is decided.
    """

    drive: Drive
    jog: Jog
    outputs: DigitalOutputs
    gripped: Callable[[GripResult], Awaitable[None]]

    def reserve(self, request_id: str) -> bool:
        """True when nothing acts and the slot is now this request's."""
        return self.drive.reserve(request_id)

    def joins(self, request: Request, *, agent: str) -> bool:
        """Whether the request, of that agent, only prolongs the stream that holds the slot."""
        return self.jog.joins(request, agent=agent)

    def release(self, request_id: str) -> None:
        """The slot is free again, if it was this request's."""
        self.drive.release(request_id)

    async def act(
        self, operation: Operation, numbers: Sequence[float], permit: Permit
    ) -> MotionEnd | GripResult | None:
        """See `pep.mcp.arm_server.ArmDriver.act`; what is held after a move of the fingers is committed."""
        match operation.moves:
            case Moves.TO_JOINTS:
                speed, acceleration = numbers[JOINTS:]
                return await self.drive.move_joint(numbers[:JOINTS], speed, acceleration, permit)
            case Moves.THROUGH_JOINTS:
                speed, acceleration = numbers[-2:]
                return await self.drive.move_path(targets_of(operation, numbers), speed, acceleration, permit)
            case Moves.AT_JOINT_SPEEDS:
                acceleration, duration_s = numbers[JOINTS:]
                return await self.jog.speed_joint(numbers[:JOINTS], acceleration, duration_s, permit)
            case Moves.FINGERS:
                width_m, speed_m_s, force_n = numbers
                grip = await self.drive.gripper_move(width_m, speed_m_s, force_n, permit)
            case Moves.FINGERS_WHOLE:
                grip = await self.drive.gripper_activate(permit)
            case Moves.OUTPUT:
                pin, value = numbers
                await self.outputs.set(int(pin), bool(value), permit)
                return None
            case _:
                raise ActuationRefusedError(Reason.NOT_GRANTED, f"no tool sends {operation.name}")
        await self.gripped(grip)
        return grip

    async def stop(self) -> MotionEnd:
        """See `Drive.stop`."""
        return await self.drive.stop()

    async def read_state(self) -> JointState:
        """See `Drive.read_state`."""
        return await self.drive.read_state()

    async def close(self) -> None:
        """Everything stands still, and nothing can be sent any more."""
        await self.drive.close()
        self.jog.close()
        self.outputs.close()
