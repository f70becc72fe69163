"""Table of every command of ur_rtde's control interface: one declared row for each id, with its registers.

An id that has no row is no command. Among them are 254, which the control script gives to itself, and those that
ur_rtde uses as names for what it does otherwise (13, 14, 22, 23, 48 to 50 in its IO interface, 99 for a clear).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, cast

from pep.rtde.command import command_values as v
from pep.rtde.command.fields import (
    BLEND,
    FORCE_DAMPING,
    FORCE_GAIN,
    GAIN,
    JOINT_ACCELERATION,
    JOINT_SPEED,
    LOOKAHEAD,
    NOT_NEGATIVE,
    POSITIVE,
    TOOL_ACCELERATION,
    TOOL_SPEED,
    Field,
    Fixed,
    Flag,
    Flags,
    FrameNumber,
    Number,
    Numbers,
    Vector,
    Whole,
    WrongParameterError,
)
from pep.rtde.wire.recipes import EXTERNAL_WRENCH, INT, OFFSETS, Offset
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pep.rtde.command.command_values import Command
    from pep.rtde.command.register_image import RegisterImage
    from pep.rtde.wire.codec import Value


class CommandClass(Enum):
    """Kind of authority that a command needs."""

    MOTION = "motion"
    """It moves the arm, or lets it be moved."""
    STOP = "stop"
    """It ends motion. Never subject to a permit."""
    GETTER = "getter"
    """It only asks."""
    CONFIGURATION = "configuration"
    """It changes the meaning of later commands, or the robot's assumptions."""
    CONTROL = "control"
    """It concerns the handshake and the script itself."""


class Wait(Enum):
    """Continuation of ur_rtde after it has sent a command."""

    DONE = "done"
    """It blocks until the script says that it is done, then clears the command."""
    AT_ONCE = "at once"
    """It goes on at once; the command stands."""
    PROGRAM_END = "program end"
    """It waits for the program to end."""


M, S, G, CFG, CTL = (
    CommandClass.MOTION,
    CommandClass.STOP,
    CommandClass.GETTER,
    CommandClass.CONFIGURATION,
    CommandClass.CONTROL,
)
DONE, AT_ONCE, PROGRAM_END = Wait.DONE, Wait.AT_ONCE, Wait.PROGRAM_END
EVERY_CYCLE: Final = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})
"""Ids that the control script carries out anew in each cycle, with the registers of that cycle, while they stand."""
MAX_HISTORY: Final = 2**31 - 1


@dataclass(frozen=True, slots=True)
class CommandRow:
    """One command.

    Attributes:
        id: value of integer register 0.
        name: ur_rtde's method.
        command_class: kind of authority that it needs.
        wait: continuation of the client.
        make: the command's type.
        fields: its parameters in order.
    """

    id: int
    name: str
    command_class: CommandClass
    wait: Wait
    make: Callable[..., Command]
    fields: tuple[Field, ...]

    @property
    def every_cycle(self) -> bool:
        """True where the script reads the parameters again and again while the command stands."""
        return self.id in EVERY_CYCLE


def _row(
    number: int, name: str, kind: CommandClass, wait: Wait, make: Callable[..., Command], *layout: Field
) -> CommandRow:
    return CommandRow(number, name, kind, wait, make, layout)


def _ask(name: str, wait: Wait, what: v.Reading) -> CommandRow:
    return _row(what.value, name, G, wait, v.Read, Fixed(what))


def _end(name: str, what: v.StopKind) -> CommandRow:
    return _row(what.value, name, S, PROGRAM_END if what is v.StopKind.PROGRAM else DONE, v.End, Fixed(what))


FIRST, SECOND, THIRD = Numbers(0, 6), Numbers(6, 6), Numbers(12, 6)
_JOINT_MOVE: Final = (FIRST, Number(6, JOINT_SPEED), Number(7, JOINT_ACCELERATION), Flag(1))
_TOOL_MOVE: Final = (FIRST, Number(6, TOOL_SPEED), Number(7, TOOL_ACCELERATION), Flag(1))
_SERVO: Final = (FIRST, Number(8, POSITIVE), Number(9, LOOKAHEAD), Number(10, GAIN))
_SENSOR: Final = (Flag(1), Number(0, NOT_NEGATIVE), Numbers(1, 3), Numbers(4, 3))
_INVERSE: Final = (FIRST, SECOND, Number(12, NOT_NEGATIVE), Number(13, NOT_NEGATIVE))

# Units stand at the types. Ids, registers and the ways of waiting: ur_rtde 1.6.5, and the control script it uploads.
_ROWS: Final = (
    _row(0, "kickWatchdog", CTL, AT_ONCE, v.Clear),
    _row(1, "moveJ", M, DONE, v.MoveJ, *_JOINT_MOVE),
    _row(2, "moveJ_IK", M, DONE, v.MoveJIk, *_JOINT_MOVE),
    _row(3, "moveL", M, DONE, v.MoveL, *_TOOL_MOVE),
    _row(4, "moveL_FK", M, DONE, v.MoveLFk, *_TOOL_MOVE),
    _row(6, "forceMode", M, AT_ONCE, v.ForceMode, FIRST, Flags(2), SECOND, Whole(1, 1, 3), THIRD),
    _end("forceModeStop", v.StopKind.FORCE_MODE),
    _row(8, "zeroFtSensor", CFG, DONE, v.ZeroForceSensor),
    _row(9, "speedJ", M, AT_ONCE, v.SpeedJ, FIRST, Number(6, JOINT_ACCELERATION), Number(7, NOT_NEGATIVE)),
    _row(10, "speedL", M, AT_ONCE, v.SpeedL, FIRST, Number(6, TOOL_ACCELERATION), Number(7, NOT_NEGATIVE)),
    _row(11, "servoJ", M, AT_ONCE, v.ServoJ, *_SERVO),
    _row(
        *(12, "servoC", M, AT_ONCE, v.ServoC),
        *(FIRST, Number(6, TOOL_SPEED), Number(7, TOOL_ACCELERATION), Number(8, BLEND)),
    ),
    _row(15, "speedStop", S, DONE, v.SpeedStop, Number(0, POSITIVE)),
    _row(16, "servoStop", S, DONE, v.ServoStop, Number(0, POSITIVE)),
    _row(17, "setPayload", CFG, DONE, v.SetPayload, Number(0, NOT_NEGATIVE), Numbers(1, 3)),
    _row(18, "teachMode", M, DONE, v.TeachMode),
    _end("endTeachMode", v.StopKind.TEACH_MODE),
    _row(20, "forceModeSetDamping", CFG, DONE, v.SetForceDamping, Number(0, FORCE_DAMPING)),
    _row(21, "forceModeSetGainScaling", CFG, DONE, v.SetForceGain, Number(0, FORCE_GAIN)),
    _row(24, "servoL", M, AT_ONCE, v.ServoL, *_SERVO),
    _row(25, "toolContact", G, AT_ONCE, v.ToolContact, FIRST),
    _ask("getStepTime", AT_ONCE, v.Reading.STEP_TIME),
    _row(27, "getActualJointPositionsHistory", G, AT_ONCE, v.JointHistory, Whole(1, 0, MAX_HISTORY)),
    _ask("getTargetWaypoint", DONE, v.Reading.TARGET_WAYPOINT),
    _row(29, "setTcp", CFG, DONE, v.SetTcp, FIRST),
    _row(30, "getInverseKinematics", G, DONE, v.InverseKinematics, *_INVERSE),
    _end("triggerProtectiveStop", v.StopKind.PROTECTIVE_STOP),
    _row(33, "stopL", S, DONE, v.StopL, Number(0, POSITIVE), Flag(1)),
    _row(34, "stopJ", S, DONE, v.StopJ, Number(0, POSITIVE), Flag(1)),
    _row(35, "setWatchdog", CTL, DONE, v.SetWatchdog, Number(0, POSITIVE)),
    _row(36, "isPoseWithinSafetyLimits", G, DONE, v.PoseWithinLimits, FIRST),
    _row(37, "isJointsWithinSafetyLimits", G, DONE, v.JointsWithinLimits, FIRST),
    _ask("getJointTorques", AT_ONCE, v.Reading.JOINT_TORQUES),
    _row(39, "poseTrans", G, DONE, v.PoseTrans, FIRST, SECOND),
    _ask("getTCPOffset", DONE, v.Reading.TCP_OFFSET),
    _row(41, "jogStart", M, DONE, v.JogStart, FIRST, FrameNumber(6), Number(7, POSITIVE), Numbers(8, 6)),
    _end("jogStop", v.StopKind.JOG),
    _ask("getForwardKinematics", DONE, v.Reading.FORWARD_KINEMATICS),
    _row(44, "getForwardKinematics", G, DONE, v.ForwardKinematics, FIRST, SECOND),
    _row(45, "movePath", M, DONE, v.MovePath, Flag(1)),
    _row(46, "getInverseKinematics", G, DONE, v.InverseKinematicsNearest, FIRST),
    _ask("isSteady", DONE, v.Reading.STEADY),
    _row(51, "moveUntilContact", M, DONE, v.MoveUntilContact, FIRST, SECOND, Number(12, TOOL_ACCELERATION)),
    _row(52, "freedriveMode", M, DONE, v.FreedriveMode, Flags(1), FIRST),
    _end("endFreedriveMode", v.StopKind.FREEDRIVE_MODE),
    _ask("getFreedriveStatus", DONE, v.Reading.FREEDRIVE_STATUS),
    _row(55, "setExternalForceTorque", CFG, AT_ONCE, v.SetExternalWrench, Vector(EXTERNAL_WRENCH)),
    _row(56, "ftRtdeInputEnable", CFG, DONE, v.ForceInput, *_SENSOR),
    _row(57, "enableExternalFtSensor", CFG, DONE, v.ExternalForceSensor, *_SENSOR),
    _ask("getActualToolFlangePose", AT_ONCE, v.Reading.FLANGE_POSE),
    _row(59, "setGravity", CFG, DONE, v.SetGravity, Numbers(0, 3)),
    _row(60, "getInverseKinematicsHasSolution", G, DONE, v.ReachableNearest, FIRST),
    _row(61, "getInverseKinematicsHasSolution", G, DONE, v.Reachable, *_INVERSE),
    _row(62, "startContactDetection", CTL, DONE, v.StartContactDetection, FIRST),
    _row(63, "stopContactDetection", CTL, DONE, v.StopContactDetection),
    _ask("readContactDetection", DONE, v.Reading.CONTACT),
    _row(
        *(65, "setTargetPayload", CFG, DONE, v.SetTargetPayload),
        *(Number(0, NOT_NEGATIVE), Numbers(1, 3), Numbers(4, 6)),
    ),
    _row(66, "directTorque", M, AT_ONCE, v.DirectTorque, FIRST),
    _ask("getMassMatrix", AT_ONCE, v.Reading.MASS_MATRIX),
    _ask("getCoriolisAndCentrifugalTorques", AT_ONCE, v.Reading.CORIOLIS_TORQUES),
    _ask("getTargetJointAccelerations", AT_ONCE, v.Reading.TARGET_JOINT_ACCELERATIONS),
    _ask("getJacobian", AT_ONCE, v.Reading.JACOBIAN),
    _ask("getJacobianTimeDerivative", AT_ONCE, v.Reading.JACOBIAN_TIME_DERIVATIVE),
    _end("stopScript", v.StopKind.PROGRAM),
)
ROWS: Final[Mapping[int, CommandRow]] = MappingProxyType({row.id: row for row in _ROWS})
"""Every command, by its id."""

READS: Final[Mapping[tuple[int, Offset], frozenset[str]]] = MappingProxyType(
    {
        (row.id, offset): frozenset(name for field in row.fields for name in field.names(offset))
        for row in _ROWS
        for offset in OFFSETS
    }
)
"""Variables of a command's parameters, by its id and the client's offset."""

_MEMBERS: Final = {row.make: tuple(each.name for each in fields(cast("Any", row.make))) for row in _ROWS}
"""Parameters of a command's type, in order."""
_BY_TYPE: Final = {row.make: row for row in _ROWS if row.make not in (v.Read, v.End)}


def row_of(command: Command) -> CommandRow:
    """Row of a command."""
    if isinstance(command, v.Read | v.End):
        return ROWS[command.what.value]
    return _BY_TYPE[type(command)]


def decode(image: RegisterImage) -> Command | InputRefusal:
    """Command that stands in an image; `Clear` when none does. Never raises.

    Returns:
        Refused as `TOOL_UNKNOWN` for an id without a row; as `NOT_FINITE`, `ROBOT_LIMIT` (outside of what ur_rtde would
        send), `OUT_OF_RANGE` (an integer) or `PARAMETERS_WRONG` (neither 0 nor 1) for a parameter. Registers that the
        command does not use are not looked at.
    """
    row = ROWS.get(image.whole(0))
    if row is None:
        return InputRefusal(Reason.TOOL_UNKNOWN, "command id")
    try:
        return row.make(*(field.read(image) for field in row.fields))
    except WrongParameterError as wrong:
        return InputRefusal(wrong.reason, f"{row.name}: {wrong.place}", row.id)


def encode(command: Command, offset: Offset) -> dict[str, Value]:
    """Variables to write for a command: its id and all that the control script reads for it.

    Forwarding these in place of the client's package sends the judged values, and none that was staged before.
    """
    row = row_of(command)
    written: dict[str, Value] = {INT[offset]: row.id}
    for field, member in zip(row.fields, _MEMBERS[row.make], strict=True):
        written |= field.write(getattr(command, member), offset)
    return written
