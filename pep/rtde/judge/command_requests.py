"""Requests of a leased program's commands. Pure: one command, one answer.

A command is free (it stops, asks or clears), a request of one of the cell's operations, or refused: no operation stands
for it. Refused by default are all commands whose way does not follow from their parameters: torques. A move
that leaves the choice of a pose's joint angles to the controller is asked about as `pep.rtde.judge.pose_targets`
rewrites it. Where a force or a hand leads, the grant says how fast, how far and for how long ([LSD-18]).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, assert_never

from capabilities.values.errors import QuantityError
from capabilities.values.scope import Range
from capabilities.values.units import Unit, nearest, si
from pep.base.operation_row import Sent
from pep.base.operations import (
    CONTACT_WAY_UM,
    FORCE_MODE,
    FREEDRIVE,
    JOINTS,
    MOVE_JOINT,
    MOVE_LINEAR,
    MOVE_PATH,
    MOVE_UNTIL_CONTACT,
    MOVE_WAYPOINTS,
    SERVO_JOINT,
    SERVO_LINEAR,
    SET_FORCE_DAMPING,
    SET_FORCE_GAIN,
    SET_PAYLOAD,
    SET_TCP,
    SPEED_JOINT,
    SPEED_LINEAR,
    STREAM_MS,
    WAYPOINTS,
    WAYPOINTS_MOST,
    ZERO_FORCE_SENSOR,
    padded,
)
from pep.base.request_digest import value_of
from pep.rtde.command import command_values as v
from pep.rtde.command.command_table import row_of
from pep.rtde.command.gripper_commands import ActivateFingers, MoveFingers
from pep.rtde.command.limits import OFFSET_M, OFFSET_RAD
from pep.rtde.judge.device_requests import gripped, switched, without_operation
from pep.rtde.judge.led_requests import forced, handed
from pep.rtde.script.move_path import PathMove
from pep.rtde.wire.refusal import InputRefusal
from policies.evidence.model import Point, Request
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from capabilities.values.arguments import Value
    from capabilities.values.chain import Chain
    from capabilities.values.scope import Grant
    from pep.base.operation_row import Operation
    from pep.base.request_digest import Number
    from pep.rtde.command.command_values import Command
    from pep.rtde.command.gripper_commands import GripperCommand
    from pep.rtde.command.io_commands import IoCommand
    from pep.rtde.script.move_path import Waypoint
    from pep.world.held_object import DeclaredLoad

POINTS: Final = frozenset({Point.ACTUATION})
"""Points of the request: no tool call comes before it, and only the command itself is decided."""
CENTRE_M: Final = 1e-3
"""Ours: distance within which two centres of mass are the same.

Three kilograms there turn a joint by 0.03 Nm more.
"""
_KEPT: Final = (0.0, 0.0, 0.0)
"""Centre of mass by which ur_rtde keeps the present one."""


@dataclass(frozen=True, slots=True)
class ToolSetup:
    """Tool and load on which arm and controller have to agree, so that poses and weights mean the same.

    Attributes:
        tcp_m_rad: tool centre point of the cell's model on the flange.
        payload_kg: tool and all that is held, by the committed state.
        centre_m: of that mass, in the flange frame.
        loads: what a program may say that it holds instead.
    """

    tcp_m_rad: v.Six
    payload_kg: float
    centre_m: v.Three
    loads: tuple[DeclaredLoad, ...] = ()


@dataclass(frozen=True, slots=True)
class NoDecisionNeeded:
    """Command without a decision: it stops, asks, or clears."""


@dataclass(frozen=True, slots=True)
class CommandedOperation:
    """Operation that a command asks for.

    Attributes:
        operation: of the cell.
        numbers: its parameters in order, in SI units, as the command has them; a list has one for each waypoint.
    """

    operation: Operation
    numbers: tuple[Number, ...]

    @property
    def stream(self) -> bool:
        """True where other values may follow without a request of their own."""
        return self.operation.sent is Sent.STREAM

    @property
    def spelt(self) -> tuple[Number, ...]:
        """The numbers as a request spells them.

        A stream's angles and speeds are rounded to their grid: they come out of a calculation, and the exact ones are
        judged as every later value is, before they are sent. All else is on its grid, or refused.
        """
        if not self.stream:
            return self.numbers
        return tuple(
            nearest(number, p.unit) if isinstance(number, float) and p.unit in _ROUNDED else number
            for number, p in zip(self.numbers, self.operation.parameters, strict=True)
        )


_ROUNDED: Final = frozenset(
    {
        Unit.MICRORADIAN,
        Unit.MICRORADIAN_PER_SECOND,
        Unit.MICRORADIAN_PER_SECOND2,
        Unit.MICROMETRE,
        Unit.MICROMETRE_PER_SECOND,
        Unit.MICROMETRE_PER_SECOND2,
    }
)


def asked_of(
    command: Command | IoCommand | GripperCommand,
    *,
    path: Sequence[Waypoint],
    fitted: ToolSetup,
    granted: Callable[[Operation], Grant | None] = lambda _: None,
) -> CommandedOperation | NoDecisionNeeded | InputRefusal:
    """Operation that a command asks for.

    Args:
        command: of the program.
        path: waypoints that stand in its control script, for a `MovePath`.
        fitted: tool and payload of the arm.
        granted: grant of an operation, which says what a command leaves open; None where there is none.

    Returns:
        Refused as `NOT_GRANTED` where no operation stands for it, `FRAMES_MISMATCH` for another tool centre point than
        the model's, `PAYLOAD_MISMATCH` for another mass or centre than the committed one, `PARAMETERS_WRONG` for a path
        that no operation can say.
    """
    if isinstance(command, v.Held):  # first, since it is asked five hundred times a second
        return _streamed(command, granted)
    if isinstance(command, v.Clear | v.Stop | v.Question):
        return NoDecisionNeeded()
    if isinstance(command, v.Move):
        return _moved(command, path)
    if isinstance(command, v.Setting):
        return _set(command, fitted)
    if isinstance(command, MoveFingers | ActivateFingers):
        return CommandedOperation(*gripped(command))
    asked = switched(command)
    return asked if isinstance(asked, InputRefusal) else CommandedOperation(*asked)


def as_granted(asked: CommandedOperation, chain: Chain) -> CommandedOperation:
    """The same, with the way of a motion until a contact as long as the chain grants: [LSD-17]."""
    if asked.operation is not MOVE_UNTIL_CONTACT:
        return asked
    grant = chain.scope.find(asked.operation.object, asked.operation.name)
    last = None if grant is None else grant.limits[-1].bound
    if not isinstance(last, Range):
        return asked
    *rest, own = asked.numbers
    assert isinstance(own, float)
    return CommandedOperation(asked.operation, (*rest, min(own, si(last.high, Unit.MICROMETRE))))


def stands_s(time_s: float) -> float:
    """Time for which a speed stands that a program gives for `time_s`, s.

    To ur_rtde's script no time is for ever; here it is the longest there is. A stream's own rhythm is the shortest that
    a host can keep.
    """
    least, most = (si(end, Unit.MILLISECOND) for end in STREAM_MS)
    return max(time_s, least) if time_s > 0 else most


def _moved(command: v.Move, path: Sequence[Waypoint]) -> CommandedOperation | InputRefusal:
    match command:
        case v.MoveJ(q, speed, acceleration, _):
            return CommandedOperation(MOVE_JOINT, (*q, speed, acceleration))
        case v.MoveL(pose, speed, acceleration, _):
            return CommandedOperation(MOVE_LINEAR, (*pose, speed, acceleration))
        case v.MovePath():
            return _path(path)
        case v.MoveJIk() | v.MoveLFk():
            return InputRefusal(Reason.NOT_GRANTED, _UNSAID)
        case v.MoveUntilContact(xd, _, acceleration):
            return CommandedOperation(MOVE_UNTIL_CONTACT, (*xd, acceleration, si(CONTACT_WAY_UM[1], Unit.MICROMETRE)))
        case _:
            assert_never(command)


_ROUND: Final = "servoC: only the controller knows how it rounds its corners; use servoJ"
_TORQUE: Final = "directTorque: no torque says where the arm goes"
_JOG: Final = "jogStart: it goes on when its program is gone; use speedL"
_UNSAID: Final = "the controller, not the command, says which joint angles its pose has"


def _path(path: Sequence[Waypoint]) -> CommandedOperation | InputRefusal:
    """Path of a few joint moves at one speed as `move_path` has it; any other as waypoints."""
    first = path[0] if path else None
    even = first is not None and all(
        (each.move, each.is_pose, each.blend_m) == (PathMove.MOVEJ, False, 0.0)
        and (each.speed, each.acceleration) == (first.speed, first.acceleration)
        for each in path
    )
    if first is None:
        return InputRefusal(Reason.PARAMETERS_WRONG, "a path without waypoints")
    if not even or len(path) > WAYPOINTS:
        return _waypoints(path)
    angles = (angle for point in padded([each.target for each in path]) for angle in point)
    return CommandedOperation(MOVE_PATH, (*angles, first.speed, first.acceleration))


def _waypoints(path: Sequence[Waypoint]) -> CommandedOperation | InputRefusal:
    """Path of joint moves and lines, each with its own speed and blend: [LSD-16]."""
    joints = [each for each in path if each.move is PathMove.MOVEJ]
    lines = [each for each in path if each.move is not PathMove.MOVEJ]
    if len(path) > WAYPOINTS_MOST:
        return InputRefusal(Reason.PARAMETERS_WRONG, f"more than {WAYPOINTS_MOST} waypoints")
    if any(each.is_pose for each in joints) or not all(each.is_pose for each in lines):
        return InputRefusal(Reason.PARAMETERS_WRONG, "a joint move to a pose, or a line to joint angles")
    if path[-1].blend_m > 0:
        return InputRefusal(Reason.PARAMETERS_WRONG, "a blend at the last waypoint, where nothing follows")
    return CommandedOperation(
        MOVE_WAYPOINTS,
        (
            *(tuple(each.target[axis] for each in joints) for axis in range(JOINTS)),
            tuple(each.speed for each in joints),
            tuple(each.acceleration for each in joints),
            *(tuple(each.target[axis] for each in lines) for axis in range(JOINTS)),
            tuple(each.speed for each in lines),
            tuple(each.acceleration for each in lines),
            tuple(each.blend_m for each in path),
            tuple(float(each.move is not PathMove.MOVEJ) for each in path),
        ),
    )


def _streamed(command: v.Held, granted: Callable[[Operation], Grant | None]) -> CommandedOperation | InputRefusal:
    match command:
        case v.SpeedJ(qd, acceleration, time_s):
            return CommandedOperation(SPEED_JOINT, (*qd, acceleration, stands_s(time_s)))
        case v.SpeedL(xd, acceleration, time_s):
            return CommandedOperation(SPEED_LINEAR, (*xd, acceleration, stands_s(time_s)))
        case v.ServoJ(q, time_s, lookahead_s, gain):
            return CommandedOperation(SERVO_JOINT, (*q, time_s, lookahead_s, gain))
        case v.ServoL(pose, time_s, lookahead_s, gain):
            return CommandedOperation(SERVO_LINEAR, (*pose, time_s, lookahead_s, gain))
        case v.ForceMode():
            return _led(FORCE_MODE, forced(command, granted(FORCE_MODE)))
        case v.TeachMode() | v.FreedriveMode():
            return _led(FREEDRIVE, handed(command, granted(FREEDRIVE)))
        case v.ServoC():
            return InputRefusal(Reason.NOT_GRANTED, _ROUND)
        case v.DirectTorque():
            return InputRefusal(Reason.NOT_GRANTED, _TORQUE)
        case v.JogStart():
            return InputRefusal(Reason.NOT_GRANTED, _JOG)
        case _:
            assert_never(command)


def _led(operation: Operation, numbers: tuple[float, ...] | InputRefusal) -> CommandedOperation | InputRefusal:
    return numbers if isinstance(numbers, InputRefusal) else CommandedOperation(operation, numbers)


def _set(command: v.Setting, fitted: ToolSetup) -> CommandedOperation | InputRefusal:
    """Setting of tool or payload, which may be repeated but not changed: the model would be another one."""
    match command:
        case v.SetTcp(pose):
            own = fitted.tcp_m_rad
            if not (math.dist(pose[:3], own[:3]) <= OFFSET_M and math.dist(pose[3:], own[3:]) <= OFFSET_RAD):
                return InputRefusal(Reason.FRAMES_MISMATCH, "another tool centre point than the model's")
            return CommandedOperation(SET_TCP, pose)
        case v.SetPayload(mass_kg, centre_m):
            same = _weighs(command, fitted.payload_kg, fitted.centre_m) or load_of(command, fitted) is not None
            if not same:
                return InputRefusal(Reason.PAYLOAD_MISMATCH, _undeclared(fitted))
            return CommandedOperation(SET_PAYLOAD, (mass_kg, *centre_m))
        case v.ZeroForceSensor():
            return CommandedOperation(ZERO_FORCE_SENSOR, ())
        case v.SetForceDamping(damping):
            return CommandedOperation(SET_FORCE_DAMPING, (damping,))
        case v.SetForceGain(gain):
            return CommandedOperation(SET_FORCE_GAIN, (gain,))
        case (
            v.SetTargetPayload()
            | v.SetGravity()
            | v.ForceInput()
            | v.ExternalForceSensor()
            | v.SetExternalWrench()
            | v.SetWatchdog()
            | v.StartContactDetection()
            | v.StopContactDetection()
        ):
            return without_operation(row_of(command).name)
        case _:
            assert_never(command)


def load_of(command: Command | IoCommand | GripperCommand, fitted: ToolSetup) -> DeclaredLoad | None:
    """Load of the cell that a program declares by this command.

    None for another command, for what is so already, and for a load that the cell does not know.
    """
    if not isinstance(command, v.SetPayload) or _weighs(command, fitted.payload_kg, fitted.centre_m):
        return None
    return next((load for load in fitted.loads if _weighs(command, load.mass_kg, load.centre_m)), None)


def _weighs(command: v.SetPayload, mass_kg: float, centre_m: v.Three) -> bool:
    same = nearest(command.mass_kg, Unit.GRAM) == nearest(mass_kg, Unit.GRAM)
    return same and (command.centre_m == _KEPT or math.dist(command.centre_m, centre_m) <= CENTRE_M)


def _undeclared(fitted: ToolSetup) -> str:
    """Place of a refusal: the masses that the cell knows."""
    known = {f"{fitted.payload_kg:.3f} kg": None, **{f"{load.mass_kg:.3f} kg": None for load in fitted.loads}}
    return f"neither the present payload nor a declared part's: {', '.join(known)}"


def request_of(asked: CommandedOperation, *, request_id: str, audience: str, at: float) -> Request | InputRefusal:
    """The request, in integers.

    Args:
        asked: the operation that the command asks for.
        request_id: made by the enforcement point.
        audience: canonical URL of the robot.
        at: wall clock of arrival, seconds since the epoch.

    Returns:
        Refused with the codes of `capabilities.values.units.parse`, and the parameter.
    """
    operation = asked.operation
    values: list[Value] = []
    for parameter, number in zip(operation.parameters, asked.spelt, strict=True):
        try:
            values.append(value_of(parameter, number))
        except QuantityError as error:
            return InputRefusal(Reason(error.code), f"{parameter.name}: {error.detail}")
    return Request(request_id, POINTS, audience, operation.object, operation.name, tuple(values), at)
