"""Robot as its controller knows it: every RTDE variable, kept or computed, and the settings of programs."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Final, TypeVar

from pep.rtde.wire.variables import INPUTS, OUTPUTS, WIDTH, VariableType
from ursim.motion.arm import AXES, GRAVITY_M_S2, Body
from ursim.motion.drive import Drive
from ursim.motion.dynamics import acceleration, joint_torques, linear_momentum
from ursim.motion.led import DAMPING, TOUCH_N, Surface, wrench_at
from ursim.motion.motion import ZERO, Brake, MoveJoints, MoveTool
from ursim.motion.spatial import IDENTITY, Frame, Triple, chain, rotate, to_frame, to_pose, transpose

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pep.rtde.wire.codec import Value
    from ursim.motion.arm import Arm, Joints

T = TypeVar("T")

FLANGE: Final[Frame] = ((0.0, 0.0, 0.0), IDENTITY)
TICK_S: Final = 0.002  # e-Series control and RTDE rate, 500 Hz
FIRST_STEP: Final = 50_000  # 100 s of uptime: the vendor's client waits while the timestamp is below 40 s
MAIN_VOLTAGE_V: Final = 48.0  # nominal supply of the arm
TEMPERATURE_C: Final = 25.0
ANALOG_FULL: Final = (0.020, 10.0)  # A and V at full scale of an output, e-Series user manual
JOINT_RUNNING, JOINT_IDLE, JOINT_OFF, JOINT_BOOTING = 253, 255, 239, 247  # RTDE joint_mode


class RobotMode(IntEnum):
    """RTDE robot_mode."""

    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    RUNNING = 7


class SafetyMode(IntEnum):
    """RTDE safety_mode."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9


class OperationalMode(IntEnum):
    """Operational mode of the robot, numbered as in the controller's message C211 and on the primary interface."""

    NONE = 0  # disabled: nobody has set a password for it, or taken control of it
    AUTOMATIC = 1
    MANUAL = 2


class Cause(IntEnum):
    """Cause for which a program is slowed down: RTDE time_scale_source, as far as it is computed here."""

    NO_PROGRAM = 0
    NOT_SLOWED = 1
    MOMENTUM = 5
    TOOL_SPEED = 8
    ELBOW_SPEED = 9


class RuntimeState(IntEnum):
    """RTDE runtime_state."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


_SAFETY_BITS: Final = {  # RTDE guide, safety_status_bits; bit 10: stopped due to safety
    SafetyMode.NORMAL: 1 << 0,
    SafetyMode.REDUCED: 1 << 1,
    SafetyMode.PROTECTIVE_STOP: 1 << 2 | 1 << 10,
    SafetyMode.SAFEGUARD_STOP: 1 << 4 | 1 << 10,
    SafetyMode.SYSTEM_EMERGENCY_STOP: 1 << 5 | 1 << 7 | 1 << 10,
    SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7 | 1 << 10,
    SafetyMode.VIOLATION: 1 << 8 | 1 << 10,
    SafetyMode.FAULT: 1 << 9 | 1 << 10,
}
POWERED: Final = frozenset([RobotMode.POWER_ON, RobotMode.IDLE, RobotMode.RUNNING])
UNSTOPPED: Final = frozenset([SafetyMode.NORMAL, SafetyMode.REDUCED])  # programs run in these


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
        self.operational = OperationalMode.NONE
        self.tcp = FLANGE
        self.payload_kg = 0.0
        self.payload_cog_m: Triple = (0.0, 0.0, 0.0)
        self.payload_inertia: tuple[float, ...] = ZERO
        self.gravity: Triple = (0.0, 0.0, GRAVITY_M_S2)
        self.digital_out = 0
        self.analog_domain = 3  # a bit for each analog output: 1 volts, 0 amperes
        self.input_domain = 0  # of the analog inputs, likewise
        self.tool_input_domain = 0
        self._analog_level = [0.0, 0.0]  # of full scale
        self.slowed_for = Cause.NOT_SLOWED
        self.alarm: str | None = None  # a protective stop that a program or the drive asks for
        self.touched_at: int | None = None  # step since which the tool touches something
        self.surfaces: list[Surface] = []  # that the tool may press on
        self._pressing_since: int | None = None  # step since which the tool presses on one
        self.hand: Joints = ZERO  # joint speeds at which a person pushes an arm that may be led
        self.force_damping, self.force_gain = DAMPING, 1.0
        self.force_from_client = False  # the wrench at the tool is external_force_torque
        self.values: dict[str, Value] = {name: _zero(kind) for name, kind in (OUTPUTS | INPUTS).items()}
        self.written_at: dict[str, int] = {}
        self.computed = self._computed()
        self._derived: dict[Callable[[Robot], Any], Any] = {}
        self._derived_from = self.drive.now

    def once(self, compute: Callable[[Robot], T]) -> T:
        """Value that `compute` derives from the robot.

        It is computed again only after the arm or a setting has changed.
        """
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
        """Takes the inputs of one data package.

        Inputs that are no registers act at once; the last value stays.
        """
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
                self.set_analog_domain(channel, int(self._plain("standard_analog_output_type")) >> channel & 1)
                self.set_analog_out(channel, level)

    def set_analog_domain(self, channel: int, voltage: int) -> None:
        """The output gives volts (1) or amperes (0) from now on."""
        self.analog_domain = self.analog_domain & ~(1 << channel) | voltage << channel

    def set_analog_out(self, channel: int, level: float) -> None:
        """The output takes a level, as a part of full scale."""
        self._analog_level[channel] = level

    def analog_level(self, channel: int) -> float:
        """Level of an analog output, as a part of full scale."""
        return self._analog_level[channel]

    def analog_out(self, channel: int) -> float:
        """Level of an analog output: V, or A."""
        return self._analog_level[channel] * ANALOG_FULL[self.analog_domain >> channel & 1]

    @property
    def tool_voltage_v(self) -> int:
        """Supply voltage of the tool's connector."""
        return int(self._plain("tool_output_voltage"))

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
            "actual_q": lambda: drive.now.q,
            "target_q": lambda: drive.now.q,
            "actual_qd": lambda: drive.now.qd,
            "target_qd": lambda: drive.now.qd,
            "target_qdd": lambda: drive.now.qdd,
            "actual_TCP_pose": lambda: self.tool_pose,
            "target_TCP_pose": lambda: self.tool_pose,
            "actual_TCP_speed": self.tool_speed,
            "target_TCP_speed": self.tool_speed,
            "actual_TCP_acceleration": self.tool_acceleration,
            "target_TCP_acceleration": self.tool_acceleration,
            "target_moment": self.torques,
            "actual_TCP_force": self.tool_force,
            "ft_raw_wrench": self.tool_force,
            "tcp_force_scalar": lambda: math.hypot(*self.tool_force()[:3]),
            "actual_momentum": self.momentum,
            "elbow_position": lambda: self.elbow()[0],
            "elbow_velocity": lambda: self.elbow()[1],
            "actual_tool_accelerometer": self.accelerometer,
            "tcp_offset": lambda: to_pose(self.tcp),
            "payload": lambda: self.payload_kg,
            "payload_cog": lambda: self.payload_cog_m,
            "payload_inertia": lambda: self.payload_inertia,
            "robot_mode": lambda: self.mode,
            "joint_mode": lambda: (self.joint_mode,) * AXES,
            "safety_mode": lambda: self.safety,
            "safety_status": lambda: self.safety,
            "safety_status_bits": lambda: _SAFETY_BITS[self.safety],
            "robot_status_bits": lambda: (self.mode in POWERED) | (self.runtime is RuntimeState.PLAYING) << 1,
            "runtime_state": lambda: self.runtime,
            "speed_scaling": lambda: drive.scaling,
            "time_scale_source": lambda: self.slowed_for if self.runtime is RuntimeState.PLAYING else Cause.NO_PROGRAM,
            "target_speed_fraction": lambda: drive.slider,
            "actual_digital_output_bits": lambda: self.digital_out,
            "actual_configurable_digital_output_bits": lambda: self.digital_out >> 8 & 0xFF,
            "standard_analog_output0": lambda: self.analog_out(0),
            "standard_analog_output1": lambda: self.analog_out(1),
            "analog_io_types": lambda: self.analog_domain << 2 | self.input_domain,
            "tool_analog_input_types": lambda: self.tool_input_domain,
            "actual_main_voltage": lambda: MAIN_VOLTAGE_V,
            "actual_robot_voltage": lambda: MAIN_VOLTAGE_V,
            "actual_joint_voltage": lambda: (MAIN_VOLTAGE_V,) * AXES,
            "joint_temperatures": lambda: (TEMPERATURE_C,) * AXES,
        }

    def tool_speed(self) -> tuple[float, ...]:
        """Velocity of the tool centre point: m/s, then rad/s."""
        return self.once(_tool_speed)

    def tool_acceleration(self) -> tuple[float, ...]:
        """Acceleration of the tool centre point: m/s2, then rad/s2."""
        return self.once(_tool_acceleration)

    def flange_speed(self) -> tuple[float, ...]:
        """Velocity of the tool flange: m/s, then rad/s."""
        return self.once(_flange_speed)

    def torques(self) -> Joints:
        """Torques [Nm] that the motion takes; a model without friction or contact."""
        return self.once(_torques)

    @property
    def overloaded(self) -> bool:
        """True where a motion, other than a stop, asks a joint for more torque than it has."""
        if self.drive.motion is None or isinstance(self.drive.motion, Brake):
            return False
        return any(
            abs(torque) > joint.torque_limit_nm for torque, joint in zip(self.torques(), self.arm.joints, strict=True)
        )

    def tool_force(self) -> tuple[float, ...]:
        """Wrench on the tool in the base frame: of what it presses on, or as a client feeds it in."""
        fed = self.values["external_force_torque"]
        if self.force_from_client:
            return fed if isinstance(fed, tuple) else ZERO
        return (*self.felt(self.tool[0]), 0.0, 0.0, 0.0) if self.surfaces else ZERO

    def felt(self, point_m: Triple) -> Triple:
        """Force of all surfaces on a tool at that point, N."""
        return wrench_at(self.surfaces, point_m)

    def feel(self) -> None:
        """Notes, once a step, whether the tool presses on a surface."""
        pressing = bool(self.surfaces) and math.hypot(*self.felt(self.tool[0])) >= TOUCH_N
        if not pressing:
            self._pressing_since = None
        elif self._pressing_since is None:
            self._pressing_since = self.step

    def touching_since(self, direction: Sequence[float]) -> int | None:
        """Step since which the tool touches something that is in its way there; None where it touches nothing.

        Args:
            direction: in the base frame; three zeros for any.
        """
        against = -sum(f * d for f, d in zip(self.felt(self.tool[0]), direction, strict=True))
        pressing = self._pressing_since if against > 0 or not any(direction) else None
        return min((since for since in (self.touched_at, pressing) if since is not None), default=None)

    @property
    def waypoint(self) -> tuple[float, ...]:
        """Target of the move under way, as a pose; without one the tool's pose."""
        match self.drive.motion:
            case MoveJoints(target=target):
                return self.forward(target, self.tcp)
            case MoveTool(target=target):
                return to_pose(target)
            case _:
                return self.tool_pose

    def flange(self) -> Frame:
        """The tool flange in the base frame."""
        return self.frames[-1]

    def accelerometer(self) -> Triple:
        """Reading of the tool's accelerometer, at rest or not [m/s2]."""
        return self.once(_accelerometer)

    def momentum(self) -> float:
        """The norm of the linear momentum [kg m/s]."""
        return self.once(_momentum)

    def elbow(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Position and velocity of the elbow."""
        return self.once(_elbow)

    @property
    def joint_mode(self) -> int:
        """RTDE joint_mode, the same for every joint."""
        return _JOINT_MODES[self.mode]

    def set_tcp(self, pose: tuple[float, ...]) -> None:
        """The tool centre point from now on, in the flange frame."""
        self.tcp = to_frame(pose)
        self.changed()

    def set_payload(self, mass_kg: float, cog_m: Triple, inertia_kg_m2: tuple[float, ...] = ZERO) -> None:
        """Sets the load of the tool: mass, centre of mass, and inertia about it, in the flange frame."""
        self.payload_kg, self.payload_cog_m, self.payload_inertia = mass_kg, cog_m, inertia_kg_m2
        self.changed()

    def set_gravity(self, lift_m_s2: Triple) -> None:
        """The acceleration that holds against gravity, in the base frame."""
        self.gravity = lift_m_s2
        self.changed()

    def forward(self, q: Joints, tcp: Frame) -> tuple[float, ...]:
        """The tool's pose at joint angles `q`."""
        return to_pose(chain(self.arm.frames(q)[-1], tcp))


_JOINT_MODES: Final = {
    RobotMode.BOOTING: JOINT_BOOTING,
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


def _tool_acceleration(robot: Robot) -> tuple[float, ...]:
    return acceleration(robot.frames, robot.drive.now, robot.tcp)


def _flange_speed(robot: Robot) -> tuple[float, ...]:
    return robot.arm.twist(robot.frames, robot.drive.now.qd, FLANGE)


def _torques(robot: Robot) -> Joints:
    load = Body(robot.payload_kg, robot.payload_cog_m, robot.payload_inertia)
    return joint_torques(robot.arm, robot.frames, robot.drive.now, load, robot.gravity)


def _momentum(robot: Robot) -> float:
    return linear_momentum(robot.arm, robot.frames, robot.drive.now.qd, robot.payload_kg, robot.payload_cog_m)


def _elbow(robot: Robot) -> tuple[tuple[float, ...], tuple[float, ...]]:
    frames = robot.frames[:3]
    return frames[2][0], robot.arm.twist(frames, robot.drive.now.qd[:3], FLANGE)[:3]


def _accelerometer(robot: Robot) -> Triple:
    return rotate(transpose(robot.frames[-1][1]), robot.gravity)


def _zero(kind: VariableType) -> Value:
    width = WIDTH.get(kind)
    if width is not None:
        return (0,) * width if kind in (VariableType.VECTOR6INT32, VariableType.VECTOR6UINT32) else (0.0,) * width
    return {VariableType.BOOL: False, VariableType.DOUBLE: 0.0}.get(kind, 0)
