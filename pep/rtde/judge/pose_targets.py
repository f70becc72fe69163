"""Commands that leave joint angles or a pose to the controller, rewritten so that the command itself says them.

What is sent is what was assessed: the controller's own choice of joint angles for a pose never counts. Pure but for the
model's kinematics, which are a port.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Protocol

from pep.rtde.command import command_values as v
from pep.rtde.command.rounding import on_grid
from pep.rtde.wire.refusal import InputRefusal
from policies.evidence.evidence import ImpactFault
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from pep.rtde.command.command_values import Command, Six
    from pep.rtde.command.io_commands import IoCommand


class Posing(Protocol):
    """Kinematics of the arm's model: `pep.world.tool_poses.ToolPoses`. Radians and metres, in the base frame."""

    def nearest(self, pose: Six, near: Six) -> Six | ImpactFault:
        """Joint angles of a pose, of all found the nearest to others; a fault without a clear one."""
        ...

    def followed(self, pose: Six, near: Six) -> Six | ImpactFault:
        """Joint angles of a pose a short way from others, on the same branch; a fault without any."""
        ...

    def speeds(self, twist: Six, at: Six) -> Six | ImpactFault:
        """Joint speeds that make a tool speed, m/s and rad/s, at joint angles; a fault where one is too fast."""
        ...

    def pose_of(self, q_rad: Six) -> Six:
        """Pose of the tool at joint angles."""
        ...


POSED: Final = (v.MoveJIk, v.MoveLFk)
"""Commands that are rewritten before they are asked about."""


def rewritten(command: Command | IoCommand, posing: Posing, here: Six) -> Command | IoCommand | InputRefusal:
    """Command that says its own target: [LSD-14]. Every other is returned as it is.

    Args:
        command: of the program, on its grid.
        posing: kinematics of the arm.
        here: joint angles where it stands, rad.

    Returns:
        Refused as `UNPROVEN` where the model has no joint angles for the pose, or no clear ones.
    """
    match command:
        case v.MoveJIk(pose, speed, acceleration, asynchronous):
            q = posing.nearest(pose, here)
            if isinstance(q, ImpactFault):
                return unposed(q)
            return on_grid(v.MoveJ(q, speed, acceleration, asynchronous))
        case v.MoveLFk(q, speed, acceleration, asynchronous):
            return on_grid(v.MoveL(posing.pose_of(q), speed, acceleration, asynchronous))
        case _:
            return command


def unposed(fault: ImpactFault) -> InputRefusal:
    """Refusal of a pose without joint angles of its own."""
    return InputRefusal(Reason(fault.reason), f"joint angles of the pose: {fault.detail}")
