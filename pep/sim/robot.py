"""What the controller knows about its robot: every RTDE variable, kept or computed, and what programs may set."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Any, Final, TypeVar

from pep.rtde.variables import INPUTS, OUTPUTS, WIDTH, VariableType
from pep.sim.arm import AXES, GRAVITY_M_S2
from pep.sim.drive import Drive
from pep.sim.motion import ZERO
from pep.sim.spatial import IDENTITY, Frame, Triple, chain, rotate, to_frame, to_pose, transpose

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pep.rtde.codec import Value
    from pep.sim.arm import Arm, Joints

T = TypeVar("T")

TICK_S: Final = 0.002  # e-Series control and RTDE rate, 500 Hz
FIRST_STEP: Final = 50_000  # 100 s of uptime: the vendor's client waits while the timestamp is below 40 s
MAIN_VOLTAGE_V: Final = 48.0  # nominal supply of the arm
TEMPERATURE_C: Final = 25.0
JOINT_RUNNING, JOINT_IDLE, JOINT_OFF = 253, 255, 239  # RTDE joint_mode


class RobotMode(IntEnum):
    """RTDE robot_mode."""

    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    RUNNING = 7


class SafetyMode(IntEnum):
    """RTDE safety_mode."""

    NORMAL = 1
    PROTECTIVE_STOP = 3
    ROBOT_EMERGENCY_STOP = 7


class RuntimeState(IntEnum):
    """RTDE runtime_state."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


_SAFETY_BITS: Final = {
    SafetyMode.NORMAL: 1 << 0,
    SafetyMode.PROTECTIVE_STOP: 1 << 2 | 1 << 10,
    SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7 | 1 << 10,
}


class Robot:
    """One arm with its controller's state. Only the tick thread writes it.

    Args:
        arm: kinematics and limits.
        q: joint angles to start at.
        stop_deceleration_rad_s2: of every stop nobody asked to be different.
    """

    def __init__(self, arm: Arm, q: Joints, *, stop_deceleration_rad_s2: float) -> None:
        self.arm = arm
        self.drive = Drive(arm, q, stop_deceleration_rad_s2=stop_deceleration_rad_s2)
        self.step = FIRST_STEP
        self.mode = RobotMode.RUNNING
        self.safety = SafetyMode.NORMAL
        self.runtime = RuntimeState.STOPPED
        self.tcp: Frame = ((0.0, 0.0, 0.0), IDENTITY)
        self.payload_kg = 0.0
        self.payload_cog_m: Triple = (0.0, 0.0, 0.0)
        self.payload_inertia: tuple[float, ...] = ZERO
        self.gravity: Triple = (0.0, 0.0, GRAVITY_M_S2)
        self.digital_out = 0
        self.alarm: str | None = None  # a protective stop that a program or the drive asks for
        self.values: dict[str, Value] = {name: _zero(kind) for name, kind in (OUTPUTS | INPUTS).items()}
        self.written_at: dict[str, int] = {}
        self.computed = self._computed()
        self._derived: dict[Callable[[Robot], Any], Any] = {}
        self._derived_from = self.drive.now

    def once(self, compute: Callable[[Robot], T]) -> T:
        """What `compute` makes of the robot as it is, made again only after the arm or a setting has changed."""
        if self._derived_from is not self.drive.now:
            self._derived.clear()
            self._derived_from = self.drive.now
        if compute not in self._derived:
            self._derived[compute] = compute(self)
        found: T = self._derived[compute]
        return found

    def changed(self) -> None:
        """A setting that poses or torques depend on has changed."""
        self._derived.clear()

    @property
    def frames(self) -> list[Frame]:
        """The link frames now, the flange last."""
        return self.once(_frames)

    @property
    def tool(self) -> Frame:
        """The tool centre point in the base frame."""
        return self.once(_tool)

    @property
    def tool_pose(self) -> tuple[float, ...]:
        """The tool centre point as a pose."""
        return self.once(_tool_pose)

    def read(self, name: str) -> Value:
        """An RTDE output as it is now."""
        computed = self.computed.get(name)
        return self.values[name] if computed is None else computed()

    def write(self, inputs: Mapping[str, Value]) -> None:
        """What one data package sets. Inputs that are no registers act at once; the last value stays."""
        for name, value in inputs.items():
            self.values[name] = value
            self.written_at[name] = self.step
        for prefix, shift in (("standard", 0), ("configurable", 8), ("tool", 16)):
            mask = inputs.get(f"{prefix}_digital_output_mask")
            if isinstance(mask, int):
                self.set_digital_out(mask << shift, int(self._plain(f"{prefix}_digital_output")) << shift)
        if inputs.get("speed_slider_mask"):
            fraction = self._plain("speed_slider_fraction")
            if 0.0 <= fraction <= 1.0:  # anything else, NaN included, is no setting of a slider
                self.drive.slider = fraction
        channels = inputs.get("standard_analog_output_mask")
        for channel in (0, 1):  # an unmasked channel may hold anything: ur_rtde leaves it uninitialised
            level = self._plain(f"standard_analog_output_{channel}")
            if isinstance(channels, int) and channels >> channel & 1 and 0.0 <= level <= 1.0:
                self.values[f"standard_analog_output{channel}"] = level

    def set_digital_out(self, mask: int, bits: int) -> None:
        """The masked outputs take the given levels."""
        self.digital_out = self.digital_out & ~mask | bits & mask

    def _plain(self, name: str) -> float:
        value = self.values[name]
        return 0.0 if isinstance(value, tuple) else value

    def _computed(self) -> dict[str, Callable[[], Value]]:
        drive = self.drive
        return {
            "timestamp": lambda: self.step * TICK_S,
            "control_step": lambda: self.step,
            "actual_q": lambda: drive.now.q,
            "target_q": lambda: drive.now.q,
            "actual_qd": lambda: drive.now.qd,
            "target_qd": lambda: drive.now.qd,
            "target_qdd": lambda: drive.now.qdd,
            "actual_TCP_pose": lambda: self.tool_pose,
            "target_TCP_pose": lambda: self.tool_pose,
            "actual_TCP_speed": self.tool_speed,
            "target_TCP_speed": self.tool_speed,
            "target_moment": self.holding_torques,
            "elbow_position": lambda: self.frames[2][0],
            "actual_tool_accelerometer": self._accelerometer,
            "tcp_offset": lambda: to_pose(self.tcp),
            "payload": lambda: self.payload_kg,
            "payload_cog": lambda: self.payload_cog_m,
            "payload_inertia": lambda: self.payload_inertia,
            "target_gravity": lambda: self.gravity,
            "robot_mode": lambda: self.mode,
            "joint_mode": lambda: (_JOINT_MODES[self.mode],) * AXES,
            "safety_mode": lambda: self.safety,
            "safety_status": lambda: self.safety,
            "safety_status_bits": lambda: _SAFETY_BITS[self.safety],
            "robot_status_bits": lambda: (
                (self.mode >= RobotMode.POWER_ON) | (self.runtime is RuntimeState.PLAYING) << 1
            ),
            "runtime_state": lambda: self.runtime,
            "speed_scaling": lambda: drive.scaling,
            "target_speed_fraction": lambda: drive.slider,
            "actual_digital_output_bits": lambda: self.digital_out,
            "actual_main_voltage": lambda: MAIN_VOLTAGE_V,
            "actual_robot_voltage": lambda: MAIN_VOLTAGE_V,
            "actual_joint_voltage": lambda: (MAIN_VOLTAGE_V,) * AXES,
            "joint_temperatures": lambda: (TEMPERATURE_C,) * AXES,
        }

    def tool_speed(self) -> tuple[float, ...]:
        """Velocity of the tool centre point: m/s, then rad/s."""
        return self.once(_tool_speed)

    def holding_torques(self) -> Joints:
        """Torques [Nm] against gravity; a model without friction, inertia or contact."""
        return self.once(_holding_torques)

    def flange(self) -> Frame:
        """The tool flange in the base frame."""
        return self.frames[-1]

    def _accelerometer(self) -> Triple:
        return self.once(_accelerometer)

    def set_tcp(self, pose: tuple[float, ...]) -> None:
        """The tool centre point from now on, in the flange frame."""
        self.tcp = to_frame(pose)
        self.changed()

    def set_payload(self, mass_kg: float, cog_m: Triple) -> None:
        """What the tool carries from now on; the centre of mass in the flange frame."""
        self.payload_kg, self.payload_cog_m = mass_kg, cog_m
        self.changed()

    def forward(self, q: Joints, tcp: Frame) -> tuple[float, ...]:
        """The tool's pose at joint angles `q`."""
        return to_pose(chain(self.arm.frames(q)[-1], tcp))


_JOINT_MODES: Final = {
    RobotMode.POWER_OFF: JOINT_OFF,
    RobotMode.POWER_ON: JOINT_IDLE,
    RobotMode.IDLE: JOINT_IDLE,
    RobotMode.RUNNING: JOINT_RUNNING,
}


def _frames(robot: Robot) -> list[Frame]:
    return robot.arm.frames(robot.drive.now.q)


def _tool(robot: Robot) -> Frame:
    return chain(robot.frames[-1], robot.tcp)


def _tool_pose(robot: Robot) -> tuple[float, ...]:
    return to_pose(robot.tool)


def _tool_speed(robot: Robot) -> tuple[float, ...]:
    now = robot.drive.now
    return ZERO if now.at_rest else robot.arm.twist(robot.frames, now.qd, robot.tcp)


def _holding_torques(robot: Robot) -> Joints:
    return robot.arm.static_torques(robot.frames, robot.payload_kg, robot.payload_cog_m)


def _accelerometer(robot: Robot) -> Triple:
    return rotate(transpose(robot.frames[-1][1]), (0.0, 0.0, GRAVITY_M_S2))


def _zero(kind: VariableType) -> Value:
    width = WIDTH.get(kind)
    if width is not None:
        return (0,) * width if kind in (VariableType.VECTOR6INT32, VariableType.VECTOR6UINT32) else (0.0,) * width
    return {VariableType.BOOL: False, VariableType.DOUBLE: 0.0}.get(kind, 0)
