"""The frames of the primary (30001, 30011), secondary (30002, 30012) and real-time (30003, 30013) interfaces.

Strict and without IO, like `pep.rtde.codec`: bytes to typed frames and back. A frame of the first two is `int32 size,
uint8 kind, body`, big-endian, the size counting its own header; a robot state holds parts of the same shape. What is
new in a younger controller (an unknown kind of frame, part or message) is representable and survives; what contradicts
itself raises `WireError`. Layouts: the vendor's client interface guide, PolyScope 5.10 and later.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Self, TypeAlias

from pep.rtde.messages import WireError, WireFault

HEADER: Final = 5
MAX_FRAME: Final = 65_536  # bytes; a robot state has some 1,500, a message a text
ROBOT_STATE, MESSAGE = 16, 20
READ_ONLY: Final = 210  # error code that answers a script where none is taken
REALTIME_SIZE: Final = 1220  # bytes of a real-time frame, e-Series from 5.10

Vector: TypeAlias = tuple[float, ...]


class _Record:
    """Fields in wire order. `LAYOUT` has a word of `struct` for each; one with a count is a tuple."""

    LAYOUT: ClassVar[str]
    _STRUCT: ClassVar[struct.Struct]
    _WIDTHS: ClassVar[tuple[int, ...]]  # 0 for a number alone
    __slots__: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls) -> None:
        words = cls.LAYOUT.split()
        cls._STRUCT = struct.Struct(">" + "".join(words))
        cls._WIDTHS = tuple(int(word[:-1] or 0) for word in words)

    @classmethod
    def unpack(cls, body: bytes) -> Self:
        """The record of exactly these bytes."""
        if len(body) != cls._STRUCT.size:
            raise WireError(WireFault.PAYLOAD, f"{cls.__name__} of {len(body)} bytes")
        flat, at = cls._STRUCT.unpack(body), 0
        values: list[object] = []
        for width in cls._WIDTHS:
            values.append(flat[at : at + width] if width else flat[at])
            at += width or 1
        return cls(*values)

    def pack(self) -> bytes:
        """The bytes of the record."""
        flat: list[Any] = []
        for width, name in zip(self._WIDTHS, self.__slots__, strict=True):
            value = getattr(self, name)
            if width:
                flat += value
            else:
                flat.append(value)
        try:
            return self._STRUCT.pack(*flat)
        except struct.error as error:
            raise WireError(WireFault.VALUE, str(error)) from error


# --------------------------------------------------------------------------------------------- parts of the robot state


@dataclass(frozen=True, slots=True)
class RobotMode(_Record):
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
class Joint(_Record):
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
class Tool(_Record):
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
class Masterboard(_Record):
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
class Cartesian(_Record):
    """Part 4: the tool's pose in the base frame and its offset in the flange frame, m and rotation vector."""

    LAYOUT: ClassVar[str] = "6d 6d"

    pose: Vector
    offset: Vector


@dataclass(frozen=True, slots=True)
class Kinematics(_Record):
    """Part 5: Denavit-Hartenberg parameters, rad and m."""

    LAYOUT: ClassVar[str] = "6I 6d 6d 6d 6d I"

    checksum: tuple[int, ...]
    theta: Vector
    a: Vector
    d: Vector
    alpha: Vector
    calibration: int


@dataclass(frozen=True, slots=True)
class Configuration(_Record):
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
class Force(_Record):
    """Part 7: the wrench of force mode and the dexterity."""

    LAYOUT: ClassVar[str] = "6d d"

    wrench: Vector
    dexterity: float


@dataclass(frozen=True, slots=True)
class Additional(_Record):
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
_PARTS: Final = (RobotMode, Joints, Tool, Masterboard, Cartesian, Kinematics, Configuration, Force, Additional)


@dataclass(frozen=True, slots=True)
class RobotState:
    """What both interfaces send ten times a second."""

    parts: tuple[Part, ...]


# ------------------------------------------------------------------------------------------------------------- messages


@dataclass(frozen=True, slots=True)
class Version:
    """Kind 3, sent first: the controller's software."""

    project: str
    major: int
    minor: int
    bugfix: int
    build: int
    date: str


@dataclass(frozen=True, slots=True)
class ErrorCode:
    """Kind 6: an error by its number; `level` and the rest as the controller means them."""

    code: int
    argument: int
    level: int
    kind: int
    value: int
    text: str


@dataclass(frozen=True, slots=True)
class Key:
    """Kind 7: a program started or stopped, by its title; the text is the program's name."""

    code: int
    argument: int
    title: str
    text: str


@dataclass(frozen=True, slots=True)
class RuntimeException:
    """Kind 10: a program failed there."""

    line: int
    column: int
    text: str


@dataclass(frozen=True, slots=True)
class OtherMessage:
    """A message that is not among these."""

    kind: int
    body: bytes


Content: TypeAlias = Version | ErrorCode | Key | RuntimeException | OtherMessage


@dataclass(frozen=True, slots=True)
class Message:
    """What the controller tells, at its own microseconds."""

    timestamp_us: int
    source: int
    content: Content


@dataclass(frozen=True, slots=True)
class OtherFrame:
    """A frame that is neither state nor message."""

    kind: int
    body: bytes


PrimaryFrame: TypeAlias = RobotState | Message | OtherFrame


class PrimaryFramer:
    """Cuts the bytes of 30001 or 30002 into frames, however they were torn."""

    def __init__(self) -> None:
        self._held = bytearray()

    def feed(self, received: bytes) -> list[PrimaryFrame]:
        """The frames completed by `received`, in order.

        Raises:
            WireError: a size below the header or above `MAX_FRAME`, seen as soon as it is there, or a frame that
                contradicts itself.
        """
        self._held += received
        found: list[PrimaryFrame] = []
        while len(self._held) >= HEADER:
            size, kind = struct.unpack_from(">iB", self._held)
            _check_size(size, MAX_FRAME)
            if len(self._held) < size:
                break
            found.append(_decode(kind, bytes(self._held[HEADER:size])))
            del self._held[:size]
        return found


def encode_primary(frame: PrimaryFrame) -> bytes:
    """The bytes of a frame.

    Raises:
        WireError: a value that does not fit its field.
    """
    match frame:
        case RobotState(parts):
            return _framed(ROBOT_STATE, b"".join(_encode_part(part) for part in parts))
        case Message(timestamp, source, content):
            kind, body = _encode_content(content)
            return _framed(MESSAGE, _pack(">Qbb", timestamp, source, kind) + body)
        case OtherFrame(kind, body):
            return _framed(kind, body)


def _decode(kind: int, body: bytes) -> PrimaryFrame:
    if kind == ROBOT_STATE:
        return RobotState(tuple(_decode_parts(body)))
    if kind == MESSAGE:
        if len(body) < 10:
            raise WireError(WireFault.PAYLOAD, "a message without its kind")
        timestamp, source, sort = struct.unpack_from(">Qbb", body)
        return Message(timestamp, source, _decode_content(sort, body[10:]))
    return OtherFrame(kind, body)


def _decode_parts(body: bytes) -> list[Part]:
    parts: list[Part] = []
    at = 0
    while at < len(body):
        if len(body) - at < HEADER:
            raise WireError(WireFault.PAYLOAD, "a part without its header")
        size, kind = struct.unpack_from(">iB", body, at)
        _check_size(size, len(body) - at)
        held = body[at + HEADER : at + size]
        parts.append(_PARTS[kind].unpack(held) if kind < len(_PARTS) else OtherPart(kind, held))
        at += size
    return parts


def _encode_part(part: Part) -> bytes:
    if isinstance(part, OtherPart):
        return _framed(part.kind, part.body)
    return _framed(_PARTS.index(type(part)), part.pack())


def _decode_content(kind: int, body: bytes) -> Content:
    try:
        match kind:
            case 3:
                end = 1 + body[0]
                major, minor, bugfix, build = struct.unpack_from(">BBii", body, end)
                return Version(_text(body[1:end]), major, minor, bugfix, build, _text(body[end + 10 :]))
            case 6:
                code, argument, level, sort, value = struct.unpack_from(">iiiII", body)
                return ErrorCode(code, argument, level, sort, value, _text(body[20:]))
            case 7:
                code, argument, length = struct.unpack_from(">iiB", body)
                if len(body) < 9 + length:
                    raise WireError(WireFault.PAYLOAD, "a title shorter than it says")
                return Key(code, argument, _text(body[9 : 9 + length]), _text(body[9 + length :]))
            case 10:
                line, column = struct.unpack_from(">ii", body)
                return RuntimeException(line, column, _text(body[8:]))
            case _:
                return OtherMessage(kind, body)
    except (struct.error, IndexError) as error:
        raise WireError(WireFault.PAYLOAD, f"a message of kind {kind} of {len(body)} bytes") from error


def _encode_content(content: Content) -> tuple[int, bytes]:
    match content:
        case Version(project, major, minor, bugfix, build, date):
            return 3, _counted(project) + _pack(">BBii", major, minor, bugfix, build) + _bytes(date)
        case ErrorCode(code, argument, level, kind, value, text):
            return 6, _pack(">iiiII", code, argument, level, kind, value) + _bytes(text)
        case Key(code, argument, title, text):
            return 7, _pack(">ii", code, argument) + _counted(title) + _bytes(text)
        case RuntimeException(line, column, text):
            return 10, _pack(">ii", line, column) + _bytes(text)
        case OtherMessage(kind, body):
            return kind, body


# ------------------------------------------------------------------------------------------------------------ real time


@dataclass(frozen=True, slots=True)
class RealtimeState(_Record):
    """What 30003 and 30013 send every two milliseconds: doubles alone, the bits among them as numbers."""

    LAYOUT: ClassVar[str] = (
        "d 6d 6d 6d 6d 6d 6d 6d 6d 6d 6d 6d 6d 6d 6d d 6d d d d 6d d 6d 3d 6d d d d d d d d 6d d d 3d 3d d 3d d 3d 6d"
    )

    time_s: float
    q_target: Vector
    qd_target: Vector
    qdd_target: Vector
    current_target: Vector
    moment_target: Vector
    q: Vector
    qd: Vector
    current: Vector
    current_control: Vector
    tool_pose: Vector
    tool_speed: Vector
    tool_force: Vector
    tool_pose_target: Vector
    tool_speed_target: Vector
    digital_in: float
    motor_temperatures: Vector
    controller_time: float
    test_value: float
    robot_mode: float
    joint_modes: Vector
    safety_mode: float
    reserved: Vector
    tool_acceleration: Vector
    reserved_2: Vector
    speed_scaling: float
    momentum: float
    reserved_3: float
    reserved_4: float
    main_voltage: float
    robot_voltage: float
    robot_current: float
    joint_voltages: Vector
    digital_out: float
    program_state: float
    elbow_position: Vector
    elbow_velocity: Vector
    safety_status: float
    reserved_5: Vector
    payload_mass: float
    payload_cog: Vector
    payload_inertia: Vector


class RealtimeFramer:
    """Cuts the bytes of 30003 into states, however they were torn."""

    def __init__(self) -> None:
        self._held = bytearray()

    def feed(self, received: bytes) -> list[RealtimeState]:
        """The states completed by `received`, in order.

        Raises:
            WireError: a length that is not `REALTIME_SIZE`.
        """
        self._held += received
        found: list[RealtimeState] = []
        while len(self._held) >= 4:
            (size,) = struct.unpack_from(">i", self._held)
            if size != REALTIME_SIZE:
                raise WireError(WireFault.SIZE, f"a real-time state of {size} bytes")
            if len(self._held) < size:
                break
            found.append(RealtimeState.unpack(bytes(self._held[4:size])))
            del self._held[:size]
        return found


def encode_realtime(state: RealtimeState) -> bytes:
    """The bytes of a state, its length first."""
    return struct.pack(">i", REALTIME_SIZE) + state.pack()


# ------------------------------------------------------------------------------------------------------------ the bytes


def _check_size(size: int, limit: int) -> None:
    if size < HEADER:
        raise WireError(WireFault.SIZE, f"a frame that says it has {size} bytes")
    if size > limit:
        raise WireError(WireFault.TOO_LONG, f"a frame of {size} bytes, limit {limit}")


def _framed(kind: int, body: bytes) -> bytes:
    _check_size(HEADER + len(body), MAX_FRAME)
    return _pack(">iB", HEADER + len(body), kind) + body


def _pack(layout: str, *values: object) -> bytes:
    try:
        return struct.pack(layout, *values)
    except struct.error as error:
        raise WireError(WireFault.VALUE, str(error)) from error


def _text(held: bytes) -> str:
    return held.decode("utf-8", "surrogateescape")


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")


def _counted(text: str) -> bytes:
    held = _bytes(text)
    return _pack(">B", len(held)) + held
