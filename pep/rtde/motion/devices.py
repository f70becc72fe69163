"""All that the tools ask of a cell's devices, and the slot in which one of them acts at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Sequence

    from pep.request.permit import Permit
    from pep.rtde.motion.drive import Drive, MotionEnd
    from pep.rtde.motion.jog import Jog
    from pep.rtde.robot.digital_outputs import DigitalOutputs
    from pep.rtde.robot.gripper import Grip
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
    gripped: Callable[[Grip], Awaitable[None]]

    def reserve(self, request_id: str) -> bool:
        """True when nothing acts and the slot is now this request's."""
        return self.drive.reserve(request_id)

    def joins(self, request: Request, *, agent: str) -> bool:
        """Whether the request, of that agent, only prolongs the stream that holds the slot."""
        return self.jog.joins(request, agent=agent)

    def release(self, request_id: str) -> None:
        """The slot is free again, if it was this request's."""
        self.drive.release(request_id)

    async def move_joint(
        self, q_rad: Sequence[float], speed_rad_s: float, acceleration_rad_s2: float, permit: Permit
    ) -> MotionEnd:
        """See `Drive.move_joint`."""
        return await self.drive.move_joint(q_rad, speed_rad_s, acceleration_rad_s2, permit)

    async def move_path(
        self, waypoints_rad: Sequence[Sequence[float]], speed_rad_s: float, acceleration_rad_s2: float, permit: Permit
    ) -> MotionEnd:
        """See `Drive.move_path`."""
        return await self.drive.move_path(waypoints_rad, speed_rad_s, acceleration_rad_s2, permit)

    async def speed_joint(
        self, qd_rad_s: Sequence[float], acceleration_rad_s2: float, duration_s: float, permit: Permit
    ) -> MotionEnd:
        """See `Jog.speed_joint`."""
        return await self.jog.speed_joint(qd_rad_s, acceleration_rad_s2, duration_s, permit)

    async def gripper_move(self, width_m: float, speed_m_s: float, force_n: float, permit: Permit) -> Grip:
        """See `Drive.gripper_move`; what is held afterwards is committed."""
        grip = await self.drive.gripper_move(width_m, speed_m_s, force_n, permit)
        await self.gripped(grip)
        return grip

    async def gripper_activate(self, permit: Permit) -> Grip:
        """See `Drive.gripper_activate`; what is held afterwards is committed."""
        grip = await self.drive.gripper_activate(permit)
        await self.gripped(grip)
        return grip

    async def set_digital_output(self, pin: int, value: bool, permit: Permit) -> None:  # noqa: FBT001
        """See `DigitalOutputs.set`."""
        await self.outputs.set(pin, value, permit)

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
