"""Commands of ur_rtde's control interface as values: one type for each, its units in the names.

A pose is x, y, z in metres and a rotation vector in radians, in the robot's base frame. Parameters on the wire that the
control script does not use are left out: a value states the robot's own action.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

Three: TypeAlias = tuple[float, float, float]
Six: TypeAlias = tuple[float, float, float, float, float, float]
Axes: TypeAlias = tuple[bool, bool, bool, bool, bool, bool]


@dataclass(frozen=True, slots=True)
class Clear:
    """No command; it also satisfies the watchdog."""


# ----------------------------------------------------------------------------------------------------- moves to a place


@dataclass(frozen=True, slots=True)
class MoveJ:
    """To joint angles, straight in joint space."""

    q_rad: Six
    speed_rad_s: float
    acceleration_rad_s2: float
    asynchronous: bool


@dataclass(frozen=True, slots=True)
class MoveJIk:
    """To a pose, straight in joint space."""

    pose_m_rad: Six
    speed_rad_s: float
    acceleration_rad_s2: float
    asynchronous: bool


@dataclass(frozen=True, slots=True)
class MoveL:
    """To a pose, straight in tool space."""

    pose_m_rad: Six
    speed_m_s: float
    acceleration_m_s2: float
    asynchronous: bool


@dataclass(frozen=True, slots=True)
class MoveLFk:
    """To joint angles, straight in tool space."""

    q_rad: Six
    speed_m_s: float
    acceleration_m_s2: float
    asynchronous: bool


@dataclass(frozen=True, slots=True)
class MovePath:
    """Along the path in the control script that was uploaded last."""

    asynchronous: bool


@dataclass(frozen=True, slots=True)
class MoveUntilContact:
    """With a tool speed until a contact, then back to the contact's place."""

    xd_m_s_rad_s: Six
    direction: Six
    acceleration_m_s2: float


# ------------------------------------------------------------------------------------------- moves that a client holds


@dataclass(frozen=True, slots=True)
class ServoJ:
    """Towards joint angles, for the next `time_s`."""

    q_rad: Six
    time_s: float
    lookahead_s: float
    gain: float


@dataclass(frozen=True, slots=True)
class ServoL:
    """Towards a pose, for the next `time_s`; the script solves for the joints in each cycle."""

    pose_m_rad: Six
    time_s: float
    lookahead_s: float
    gain: float


@dataclass(frozen=True, slots=True)
class ServoC:
    """Towards a pose on circles. It goes on after the command is cleared."""

    pose_m_rad: Six
    speed_m_s: float
    acceleration_m_s2: float
    blend_m: float


@dataclass(frozen=True, slots=True)
class SpeedJ:
    """With joint speeds. The script repeats them until a stop, for any `time_s`."""

    qd_rad_s: Six
    acceleration_rad_s2: float
    time_s: float


@dataclass(frozen=True, slots=True)
class SpeedL:
    """With a tool speed. The script repeats it until a stop, for any `time_s`."""

    xd_m_s_rad_s: Six
    acceleration_m_s2: float
    time_s: float


@dataclass(frozen=True, slots=True)
class DirectTorque:
    """With joint torques. The friction scales that ur_rtde sends are not used by its script."""

    torque_nm: Six


class JogFrame(Enum):
    """Frame of a jog's speed."""

    BASE = 0
    TOOL = 1
    CUSTOM = 2


@dataclass(frozen=True, slots=True)
class JogStart:
    """With a tool speed in a frame, until `JogStop`."""

    xd_m_s_rad_s: Six
    frame: JogFrame
    acceleration_m_s2: float
    custom_frame_m_rad: Six


@dataclass(frozen=True, slots=True)
class ForceMode:
    """With forces along the selected axes of a frame.

    Attributes:
        type: 1 to 3, as URScript's `force_mode` has it.
        wrench_n_nm: along and about each selected axis.
        limits: of a selected axis its speed [m/s, rad/s], of another its deviation [m, rad].
    """

    task_frame_m_rad: Six
    selection: Axes
    wrench_n_nm: Six
    type: int
    limits: Six


@dataclass(frozen=True, slots=True)
class TeachMode:
    """A person may push the arm."""


@dataclass(frozen=True, slots=True)
class FreedriveMode:
    """A person may push the arm along the free axes of a frame."""

    free_axes: Axes
    feature_m_rad: Six


# ---------------------------------------------------------------------------------------------------------------- stops


@dataclass(frozen=True, slots=True)
class StopJ:
    """Ends a move.

    An earlier stop decides whether the script brakes in joint or in tool space.
    """

    deceleration_rad_s2: float
    asynchronous: bool


@dataclass(frozen=True, slots=True)
class StopL:
    """Ends a move.

    An earlier stop decides whether the script brakes in joint or in tool space.
    """

    deceleration_m_s2: float
    asynchronous: bool


@dataclass(frozen=True, slots=True)
class SpeedStop:
    """Ends `SpeedJ` [rad/s2] or `SpeedL` [m/s2]."""

    deceleration: float


@dataclass(frozen=True, slots=True)
class ServoStop:
    """Ends `ServoJ`, `ServoL` and `ServoC`; brakes in tool space."""

    deceleration_m_s2: float


class StopKind(Enum):
    """Stops without parameters, by command id."""

    FORCE_MODE = 7
    TEACH_MODE = 19
    PROTECTIVE_STOP = 31
    JOG = 42
    FREEDRIVE_MODE = 53
    PROGRAM = 255


@dataclass(frozen=True, slots=True)
class End:
    """Ends the mode of its name; the protective stop ends everything."""

    what: StopKind


# -------------------------------------------------------------------------- what later commands, and the robot, rely on


@dataclass(frozen=True, slots=True)
class ZeroForceSensor:
    """Takes the sensor's present reading as zero."""


@dataclass(frozen=True, slots=True)
class SetPayload:
    """Mass and its centre; a centre of zeros keeps the one there is."""

    mass_kg: float
    centre_m: Three


@dataclass(frozen=True, slots=True)
class SetTargetPayload:
    """Mass, its centre (zeros keep the one there is) and its inertia Ixx, Iyy, Izz, Ixy, Ixz, Iyz."""

    mass_kg: float
    centre_m: Three
    inertia_kg_m2: Six


@dataclass(frozen=True, slots=True)
class SetTcp:
    """Pose of the tool centre on the flange."""

    pose_m_rad: Six


@dataclass(frozen=True, slots=True)
class SetGravity:
    """Direction and size of gravity."""

    acceleration_m_s2: Three


@dataclass(frozen=True, slots=True)
class SetForceDamping:
    """Damping of force mode, 0 to 1."""

    damping: float


@dataclass(frozen=True, slots=True)
class SetForceGain:
    """Gain of force mode, 0 to 2."""

    scaling: float


@dataclass(frozen=True, slots=True)
class ForceInput:
    """Use of a client's own values by the force mode, and the load on that sensor."""

    enable: bool
    mass_kg: float
    offset_m: Three
    centre_m: Three


@dataclass(frozen=True, slots=True)
class ExternalForceSensor:
    """Use of a sensor that is not the robot's own, and its load."""

    enable: bool
    mass_kg: float
    offset_m: Three
    centre_m: Three


@dataclass(frozen=True, slots=True)
class SetExternalWrench:
    """Reading of such a sensor. The controller takes it from its variable beside every command."""

    wrench_n_nm: Six


@dataclass(frozen=True, slots=True)
class SetWatchdog:
    """Ends the program when the command register is written less often than this."""

    least_hz: float


@dataclass(frozen=True, slots=True)
class StartContactDetection:
    """Lets the arm go back to a contact by itself from now on; zeros are the direction of its motion."""

    direction: Six


@dataclass(frozen=True, slots=True)
class StopContactDetection:
    """Ends the detection; answers whether there was a contact."""


# -------------------------------------------------------------------------------------------------------------- getters


class Reading(Enum):
    """Questions without parameters, by command id."""

    STEP_TIME = 26
    TARGET_WAYPOINT = 28
    JOINT_TORQUES = 38
    TCP_OFFSET = 40
    FORWARD_KINEMATICS = 43
    STEADY = 47
    FREEDRIVE_STATUS = 54
    FLANGE_POSE = 58
    CONTACT = 64
    MASS_MATRIX = 67
    CORIOLIS_TORQUES = 68
    TARGET_JOINT_ACCELERATIONS = 69
    JACOBIAN = 70
    JACOBIAN_TIME_DERIVATIVE = 71


@dataclass(frozen=True, slots=True)
class Read:
    """One of these questions.

    Its script does not use the parameters that ur_rtde sends along with those about the dynamics.
    """

    what: Reading


@dataclass(frozen=True, slots=True)
class ToolContact:
    """Number of cycles of a contact from this direction."""

    direction: Six


@dataclass(frozen=True, slots=True)
class JointHistory:
    """Joint angles of some cycles ago."""

    steps: int


@dataclass(frozen=True, slots=True)
class InverseKinematics:
    """Joint angles of a pose near to others."""

    pose_m_rad: Six
    near_rad: Six
    position_error_m: float
    orientation_error_rad: float


@dataclass(frozen=True, slots=True)
class InverseKinematicsNearest:
    """Joint angles of a pose near to those now."""

    pose_m_rad: Six


@dataclass(frozen=True, slots=True)
class Reachable:
    """Existence of joint angles of a pose near to others."""

    pose_m_rad: Six
    near_rad: Six
    position_error_m: float
    orientation_error_rad: float


@dataclass(frozen=True, slots=True)
class ReachableNearest:
    """Existence of joint angles of a pose near to those now."""

    pose_m_rad: Six


@dataclass(frozen=True, slots=True)
class PoseWithinLimits:
    """Test of a pose against the safety limits."""

    pose_m_rad: Six


@dataclass(frozen=True, slots=True)
class JointsWithinLimits:
    """Test of joint angles against the safety limits."""

    q_rad: Six


@dataclass(frozen=True, slots=True)
class PoseTrans:
    """One pose after another."""

    from_m_rad: Six
    from_to_m_rad: Six


@dataclass(frozen=True, slots=True)
class ForwardKinematics:
    """The pose of joint angles and a tool centre."""

    q_rad: Six
    tcp_m_rad: Six


Move: TypeAlias = MoveJ | MoveJIk | MoveL | MoveLFk | MovePath | MoveUntilContact
Held: TypeAlias = (
    ServoJ | ServoL | ServoC | SpeedJ | SpeedL | DirectTorque | JogStart | ForceMode | TeachMode | FreedriveMode
)
Stop: TypeAlias = StopJ | StopL | SpeedStop | ServoStop | End
Setting: TypeAlias = (
    ZeroForceSensor
    | SetPayload
    | SetTargetPayload
    | SetTcp
    | SetGravity
    | SetForceDamping
    | SetForceGain
    | ForceInput
    | ExternalForceSensor
    | SetExternalWrench
    | SetWatchdog
    | StartContactDetection
    | StopContactDetection
)
Question: TypeAlias = (
    Read
    | ToolContact
    | JointHistory
    | InverseKinematics
    | InverseKinematicsNearest
    | Reachable
    | ReachableNearest
    | PoseWithinLimits
    | JointsWithinLimits
    | PoseTrans
    | ForwardKinematics
)
Command: TypeAlias = Clear | Move | Held | Stop | Setting | Question
