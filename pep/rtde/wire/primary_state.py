"""Parts of the robot state that 30001 and 30002 send ten times a second.

Layouts: the vendor's client interface guide, PolyScope 5.10 and later.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, TypeAlias

from pep.rtde.wire.layouts import Record, Vector
from pep.rtde.wire.messages import WireError, WireFault


@dataclass(frozen=True, slots=True)
class RobotMode(Record):
    """Part 0. Clients know it by its size of 47 bytes, header included."""

    LAYOUT: ClassVar[str] = "Q ? ? ? ? ? ? ? B B d d d B"

    timestamp_us: int
    connected: bool
    enabled: bool
    powered: bool
    emergency_stopped: bool
    protective_stopped: bool
    program_running: bool
    program_paused: bool
    robot_mode: int
    control_mode: int
    target_speed_fraction: float
    speed_scaling: float
    speed_fraction_limit: float
    reserved: int


@dataclass(frozen=True, slots=True)
class Joint(Record):
    """One joint of part 1: rad, rad/s, A, V, degrees Celsius."""

    LAYOUT: ClassVar[str] = "d d d f f f f B"

    q: float
    q_target: float
    qd: float
    current: float
    voltage: float
    motor_temperature: float
    micro_temperature: float
    mode: int


@dataclass(frozen=True, slots=True)
class Joints:
    """Part 1: six of them."""

    joints: tuple[Joint, ...]

    @classmethod
    def unpack(cls, body: bytes) -> Joints:
        """The part of exactly these bytes."""
        size = len(body) // 6
        return cls(tuple(Joint.unpack(body[at * size : (at + 1) * size]) for at in range(6 + bool(len(body) % 6))))

    def pack(self) -> bytes:
        """The bytes of the part."""
        if len(self.joints) != 6:
            raise WireError(WireFault.VALUE, f"{len(self.joints)} joints")
        return b"".join(joint.pack() for joint in self.joints)


@dataclass(frozen=True, slots=True)
class Tool(Record):
    """Part 2."""

    LAYOUT: ClassVar[str] = "b b d d f B f f B"

    analog_range_2: int
    analog_range_3: int
    analog_2: float
    analog_3: float
    voltage: float
    output_voltage: int
    current: float
    temperature: float
    mode: int


@dataclass(frozen=True, slots=True)
class Masterboard(Record):
    """Part 3, of a controller without Euromap."""

    LAYOUT: ClassVar[str] = "i i b b d d b b d d f f f f B B B I B B B"

    digital_in: int
    digital_out: int
    analog_in_range_0: int
    analog_in_range_1: int
    analog_in_0: float
    analog_in_1: float
    analog_out_domain_0: int
    analog_out_domain_1: int
    analog_out_0: float
    analog_out_1: float
    temperature: float
    robot_voltage: float
    robot_current: float
    io_current: float
    safety_mode: int
    reduced: int
    euromap: int
    reserved: int
    operational_mode: int
    enabling_device: int
    reserved_too: int


@dataclass(frozen=True, slots=True)
class Cartesian(Record):
    """Part 4: the tool's pose in the base frame and its offset in the flange frame, m and rotation vector."""

    LAYOUT: ClassVar[str] = "6d 6d"

    pose: Vector
    offset: Vector


@dataclass(frozen=True, slots=True)
class Kinematics(Record):
    """Part 5: Denavit-Hartenberg parameters, rad and m."""

    LAYOUT: ClassVar[str] = "6I 6d 6d 6d 6d I"

    checksum: tuple[int, ...]
    theta: Vector
    a: Vector
    d: Vector
    alpha: Vector
    calibration: int


@dataclass(frozen=True, slots=True)
class Configuration(Record):
    """Part 6: limits (low, high for each joint; speed, acceleration for each), defaults, kinematics and types."""

    LAYOUT: ClassVar[str] = "12d 12d d d d d d 6d 6d 6d 6d i i i i"

    position_limits: Vector
    motion_limits: Vector
    joint_speed: float
    joint_acceleration: float
    tool_speed: float
    tool_acceleration: float
    equivalent_radius: float
    a: Vector
    d: Vector
    alpha: Vector
    theta: Vector
    masterboard_version: int
    controller_box: int
    robot_type: int
    robot_sub_type: int


@dataclass(frozen=True, slots=True)
class Force(Record):
    """Part 7: the wrench of force mode and the dexterity."""

    LAYOUT: ClassVar[str] = "6d d"

    wrench: Vector
    dexterity: float


@dataclass(frozen=True, slots=True)
class Additional(Record):
    """Part 8."""

    LAYOUT: ClassVar[str] = "B B B"

    freedrive_button: int
    freedrive_enabled: int
    io_freedrive_enabled: int


@dataclass(frozen=True, slots=True)
class OtherPart:
    """A part that is not among these."""

    kind: int
    body: bytes


Part: TypeAlias = (
    RobotMode | Joints | Tool | Masterboard | Cartesian | Kinematics | Configuration | Force | Additional | OtherPart
)
PARTS: Final = (RobotMode, Joints, Tool, Masterboard, Cartesian, Kinematics, Configuration, Force, Additional)
