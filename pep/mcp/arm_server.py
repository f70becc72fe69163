"""The tools of a UR3e cell as an MCP server: move, grip, stop, look. Their wording is what people approve.

The tools decide nothing. Without the guard around them they refuse to move, since they find no permit.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol

from mcp.server import MCPServer
from mcp.server.mcpserver.exceptions import ToolError
from pydantic import Field
from typing_extensions import TypedDict

from capabilities.values.well_formed import LIST_LENGTH
from pep.base import operations as ops
from pep.base.errors import ActuationRefusedError, RobotError
from pep.base.operations import JOINTS, WAYPOINTS
from pep.mcp.mapping import ARM_TOOLS
from pep.mcp.tool_digest import ToolPin, definition_digest
from pep.request.permit import current_permit
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pep.base.operation_row import Operation
    from pep.request.permit import Permit
    from pep.rtde.motion.standstill import MotionEnd
    from pep.rtde.robot.gripper import GripResult
    from pep.rtde.robot.state_receiver import JointState

NAME = "ur3e-cell"
Joints = Annotated[list[float], Field(min_length=6, max_length=6, description="Six joint angles in rad, base first.")]
Waypoint = Annotated[list[float], Field(min_length=JOINTS, max_length=JOINTS)]
Waypoints = Annotated[
    list[Waypoint],
    Field(min_length=1, max_length=WAYPOINTS, description="Waypoints in order, each of six joint angles in rad."),
]
Times = Annotated[
    list[float], Field(min_length=2, max_length=LIST_LENGTH, description="Time of each point in s, rising from 0.")
]
Points = Annotated[
    list[Waypoint],
    Field(
        min_length=2,
        max_length=LIST_LENGTH,
        description="Joint angles in rad at each time; the arm stands at the first.",
    ),
]
PointSpeeds = Annotated[
    list[Waypoint],
    Field(max_length=LIST_LENGTH, description="Six joint speeds in rad/s at each time; none to have them worked out."),
]
JointSpeed = Annotated[float, Field(description="Greatest speed of the leading joint in rad/s.")]
JointAcceleration = Annotated[float, Field(description="Acceleration of the leading joint in rad/s^2.")]
Width = Annotated[float, Field(description="Opening between the fingers in m.")]
FingerSpeed = Annotated[float, Field(description="Speed of the fingers in m/s.")]
Speeds = Annotated[list[float], Field(min_length=6, max_length=6, description="Six joint speeds in rad/s, base first.")]
Duration = Annotated[float, Field(description="How long the arm moves before it stops by itself, in s.")]
Pin = Annotated[int, Field(description="Standard digital output, 0 to 7.")]
Level = Annotated[bool, Field(description="Whether the output is on.")]
Force = Annotated[float, Field(description="Grip force in N.")]


Outcome = Literal["reached", "ended", "stopped", "authority_lost", "world_changed", "robot_failed"]


class SpeedChange(TypedDict):
    """A change of the arm's speed on its way: to how much of what was asked for, when, why, whether it was seen."""

    percent: int
    after_ms: int
    cause: str
    seen: bool


class Moved(TypedDict):
    """How a motion ended, where the arm is now, and where it was slowed down on its way."""

    outcome: Outcome
    q_rad: list[float]
    reason: str
    speed: list[SpeedChange]


class Gripped(TypedDict):
    """How a move of the fingers ended, where they are, whether a thing stopped them, whether it ended by itself."""

    outcome: Outcome
    reason: str
    width_m: float
    object: bool
    arrived: bool


class Activated(TypedDict):
    """Whether the gripper is ready to move now, and where its fingers are."""

    ready: bool
    width_m: float


class Switched(TypedDict):
    """A digital output as the robot has it now."""

    pin: int
    value: bool


class World(TypedDict):
    """What the sensors see: whether it is believed, how old it is, how many people and objects."""

    perception: Literal["fresh", "stale", "missing", "invalid"]
    age_ms: int | None
    people: int | None
    objects: int | None


class State(TypedDict):
    """The robot and its surroundings now."""

    q_rad: list[float]
    qd_rad_s: list[float]
    moving: bool
    robot_mode: int
    safety_mode: int
    world: World


class ArmDriver(Protocol):
    """Port of the robot for the tools."""

    async def act(
        self, operation: Operation, numbers: Sequence[float], permit: Permit
    ) -> MotionEnd | GripResult | None:
        """Carries the operation out to its end.

        Args:
            operation: of the robot.
            numbers: its parameters in order, in SI units.
            permit: of exactly these numbers.

        Returns:
            End of the arm's motion, or of the fingers'; None for what only switches.

        Raises:
            ActuationRefusedError: nothing was sent.
            RobotError: the robot cannot be read, or does not answer.
        """
        ...

    async def stop(self) -> MotionEnd:
        """Stops everything."""
        ...

    async def read_state(self) -> JointState:
        """The robot's state now."""
        ...


def _moved(end: MotionEnd) -> Moved:
    speed = [
        SpeedChange(
            percent=round(100 * change.fraction),
            after_ms=change.after_ms,
            cause=change.cause,
            seen=change.confirmed_ms is not None,
        )
        for change in end.changes
    ]
    return Moved(outcome=end.end.value, q_rad=list(end.q_rad), reason=end.reason, speed=speed)


def arm_server(driver: ArmDriver, world: Callable[[], dict[str, Any]]) -> MCPServer[Any]:
    """An MCP server with the tools of a cell, not yet guarded.

    Args:
        driver: of the robot.
        world: what the sensors see, as in `World`.
    """
    server: MCPServer[Any] = MCPServer(NAME, log_level="ERROR")

    @server.tool()
    async def move_joint(q_rad: Joints, speed_rad_s: JointSpeed, acceleration_rad_s2: JointAcceleration) -> Moved:
        """Move the arm in a straight line of joint space to six joint angles, and tell where it has stopped."""
        end = await _permitted(driver, ops.MOVE_JOINT, (*q_rad, speed_rad_s, acceleration_rad_s2))
        return _moved(end)

    @server.tool()
    async def move_path(
        waypoints_rad: Waypoints, speed_rad_s: JointSpeed, acceleration_rad_s2: JointAcceleration
    ) -> Moved:
        """Move the arm through 1 to 4 waypoints, straight in joint space, resting at each; tell where it stopped."""
        angles = (angle for point in ops.padded(waypoints_rad) for angle in point)
        end = await _permitted(driver, ops.MOVE_PATH, (*angles, speed_rad_s, acceleration_rad_s2))
        return _moved(end)

    @server.tool()
    async def follow_trajectory(
        times_s: Times,
        positions_rad: Points,
        speed_rad_s: JointSpeed,
        acceleration_rad_s2: JointAcceleration,
        velocities_rad_s: PointSpeeds = [],  # noqa: B006 - never changed; no list is the tool's default
    ) -> Moved:
        """Move the arm through joint angles at stated times, without a stop at each; tell where it has stopped."""
        del times_s, positions_rad, velocities_rad_s  # what was decided is sent, and the permit has it
        end = await _permitted(driver, ops.FOLLOW_TRAJECTORY, (speed_rad_s, acceleration_rad_s2))
        return _moved(end)

    @server.tool()
    async def stop() -> Moved:
        """Stop the arm and the gripper now. Always allowed; what was asked for before will not move them any more."""
        end = await driver.stop()
        return _moved(end)

    @server.tool()
    async def gripper_move(width_m: Width, speed_m_s: FingerSpeed, force_n: Force) -> Gripped:
        """Move the gripper's fingers to an opening, and tell where they have stopped."""
        grip = await _permitted(driver, ops.GRIPPER_MOVE, (width_m, speed_m_s, force_n))
        width_m = grip.width_um / 1e6
        return Gripped(
            outcome=grip.end.value, reason=grip.reason, width_m=width_m, object=grip.object, arrived=grip.arrived
        )

    @server.tool()
    async def gripper_activate() -> Activated:
        """Make the gripper ready after power-on: its fingers close and open once, over their whole stroke."""
        grip = await _permitted(driver, ops.GRIPPER_ACTIVATE, ())
        return Activated(ready=grip.arrived, width_m=grip.width_um / 1e6)

    @server.tool()
    async def speed_joint(qd_rad_s: Speeds, acceleration_rad_s2: JointAcceleration, duration_s: Duration) -> Moved:
        """Move the arm at six joint speeds for a time, then stop it. The same call again before the end prolongs it."""
        end = await _permitted(driver, ops.SPEED_JOINT, (*qd_rad_s, acceleration_rad_s2, duration_s))
        return _moved(end)

    @server.tool()
    async def set_digital_output(pin: Pin, value: Level) -> Switched:
        """Switch a standard digital output of the controller, and tell its value once the robot has it."""
        await _permitted(driver, ops.SET_DIGITAL_OUTPUT, (pin, int(value)))
        return Switched(pin=pin, value=value)

    @server.tool()
    async def read_state() -> State:
        """Read joint angles and speeds, the robot's modes, and how much of the surroundings is seen."""
        try:
            state = await driver.read_state()
        except RobotError as error:
            raise ToolError(str(error.code)) from error
        return State(
            q_rad=list(state.q_rad),
            qd_rad_s=list(state.qd_rad_s),
            moving=not state.still,
            robot_mode=state.robot_mode,
            safety_mode=state.safety_mode,
            world=World(**world()),  # type: ignore[typeddict-item]  # the callable gives exactly these keys
        )

    return server


async def _permitted(driver: ArmDriver, operation: Operation, numbers: Sequence[float]) -> Any:
    """The operation under the permit of this gate run; without one nothing moves."""
    permit = current_permit()
    if permit is None:
        raise ToolError(str(Reason.NOT_WHAT_WAS_DECIDED))
    try:
        return await driver.act(operation, numbers, permit)
    except ActuationRefusedError as refused:
        permit.refusal = refused.reason
        raise ToolError(str(refused.reason)) from refused
    except RobotError as error:
        raise ToolError(str(error.code)) from error


class _NoDriver:
    """Absent robot: enough to ask the tools for their definitions."""

    async def act(self, *_: Any) -> None:
        raise ActuationRefusedError(Reason.EFFECT_FAILED)

    async def stop(self) -> MotionEnd:
        raise ActuationRefusedError(Reason.EFFECT_FAILED)

    async def read_state(self) -> JointState:
        raise ActuationRefusedError(Reason.EFFECT_FAILED)


def tool_definitions() -> tuple[ToolPin, ...]:
    """The tools of a cell as they are to be registered. Not to be called inside a running event loop."""
    served = asyncio.run(arm_server(_NoDriver(), dict).list_tools())
    return tuple(
        ToolPin(tool.name, definition_digest(tool), ARM_TOOLS[tool.name].name, ARM_TOOLS[tool.name].base_tier)
        for tool in served
    )
