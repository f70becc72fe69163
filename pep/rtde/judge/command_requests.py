"""Requests of a leased program's commands. Pure: one command, one answer.

A command is free (it stops, asks or clears), a request of one of the cell's operations, or refused: no operation stands
for it. Refused by default are all commands whose way does not follow from their parameters: forces, torques, arms that
people push, contact, and those that leave the choice of a pose's joint angles to the controller.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, assert_never

from capabilities.values.errors import QuantityError
from capabilities.values.units import Quantity, Unit, nearest, parse, si
from pep.base.operation_row import Sent
from pep.base.operations import (
    MOVE_JOINT,
    MOVE_LINEAR,
    MOVE_PATH,
    SERVO_JOINT,
    SET_DIGITAL_OUTPUT,
    SET_PAYLOAD,
    SET_SPEED_SLIDER,
    SET_TCP,
    SPEED_JOINT,
    SPEED_LINEAR,
    STREAM_MS,
    WAYPOINTS,
    padded,
)
from pep.rtde.command import command_values as v
from pep.rtde.command import io_commands as io
from pep.rtde.command.limits import OFFSET_M, OFFSET_RAD
from pep.rtde.script.move_path import PathMove
from pep.rtde.wire.refusal import InputRefusal
from policies.evidence.model import Point, Request
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.base.operation_row import Operation
    from pep.rtde.command.command_values import Command
    from pep.rtde.command.io_commands import IoCommand
    from pep.rtde.script.move_path import Waypoint

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
    """

    tcp_m_rad: v.Six
    payload_kg: float
    centre_m: v.Three


@dataclass(frozen=True, slots=True)
class NoDecisionNeeded:
    """Command without a decision: it stops, asks, or clears."""


@dataclass(frozen=True, slots=True)
class CommandedOperation:
    """Operation that a command asks for.

    Attributes:
        operation: of the cell.
        numbers: its parameters in order, in SI units, as the command has them.
    """

    operation: Operation
    numbers: tuple[float, ...]

    @property
    def stream(self) -> bool:
        """True where other values may follow without a request of their own."""
        return self.operation.sent is Sent.STREAM

    @property
    def spelt(self) -> tuple[float, ...]:
        """The numbers as a request spells them.

        A stream's angles and speeds are rounded to their grid: they come out of a calculation, and the exact ones are
        judged as every later value is, before they are sent. All else is on its grid, or refused.
        """
        if not self.stream:
            return self.numbers
        return tuple(
            nearest(number, p.unit) if p.unit in _ROUNDED else number
            for number, p in zip(self.numbers, self.operation.parameters, strict=True)
        )


_ROUNDED: Final = frozenset({Unit.MICRORADIAN, Unit.MICRORADIAN_PER_SECOND, Unit.MICRORADIAN_PER_SECOND2})


def asked_of(
    command: Command | IoCommand, *, path: Sequence[Waypoint], fitted: ToolSetup
) -> CommandedOperation | NoDecisionNeeded | InputRefusal:
    """Operation that a command asks for.

    Args:
        command: of the program.
        path: waypoints that stand in its control script, for a `MovePath`.
        fitted: tool and payload of the arm.

    Returns:
        Refused as `NOT_GRANTED` where no operation stands for it, `FRAMES_MISMATCH` for another tool centre point than
        the model's, `PAYLOAD_MISMATCH` for another mass or centre than the committed one, `PARAMETERS_WRONG` for a path
        that no operation can say.
    """
    if isinstance(command, v.Held):  # first, since it is asked five hundred times a second
        return _streamed(command)
    if isinstance(command, v.Clear | v.Stop | v.Question):
        return NoDecisionNeeded()
    if isinstance(command, v.Move):
        return _moved(command, path)
    if isinstance(command, v.Setting):
        return _set(command, fitted)
    return _switched(command)


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
        case v.MoveUntilContact():
            return InputRefusal(Reason.NOT_GRANTED, _NONE)
        case _:
            assert_never(command)


_NONE: Final = "no operation stands for it"
_UNSAID: Final = "the controller, not the command, says which joint angles its pose has"


def _path(path: Sequence[Waypoint]) -> CommandedOperation | InputRefusal:
    """Path of joint moves at one speed from rest to rest, as `move_path` has it."""
    first = path[0] if path else None
    even = first is not None and all(
        (each.move, each.is_pose, each.blend_m) == (PathMove.MOVEJ, False, 0.0)
        and (each.speed, each.acceleration) == (first.speed, first.acceleration)
        for each in path
    )
    if first is None or not even or len(path) > WAYPOINTS:
        return InputRefusal(Reason.PARAMETERS_WRONG, f"1 to {WAYPOINTS} joint moves at one speed without blends")
    angles = (angle for point in padded([each.target for each in path]) for angle in point)
    return CommandedOperation(MOVE_PATH, (*angles, first.speed, first.acceleration))


def _streamed(command: v.Held) -> CommandedOperation | InputRefusal:
    match command:
        case v.SpeedJ(qd, acceleration, time_s):
            return CommandedOperation(SPEED_JOINT, (*qd, acceleration, stands_s(time_s)))
        case v.SpeedL(xd, acceleration, time_s):
            return CommandedOperation(SPEED_LINEAR, (*xd, acceleration, stands_s(time_s)))
        case v.ServoJ(q, time_s, lookahead_s, gain):
            return CommandedOperation(SERVO_JOINT, (*q, time_s, lookahead_s, gain))
        case v.ServoL():
            return InputRefusal(Reason.NOT_GRANTED, _UNSAID)
        case v.ServoC() | v.DirectTorque() | v.JogStart() | v.ForceMode() | v.TeachMode() | v.FreedriveMode():
            return InputRefusal(Reason.NOT_GRANTED, _NONE)
        case _:
            assert_never(command)


def _set(command: v.Setting, fitted: ToolSetup) -> CommandedOperation | InputRefusal:
    """Setting of tool or payload, which may be repeated but not changed: the model would be another one."""
    match command:
        case v.SetTcp(pose):
            own = fitted.tcp_m_rad
            if not (math.dist(pose[:3], own[:3]) <= OFFSET_M and math.dist(pose[3:], own[3:]) <= OFFSET_RAD):
                return InputRefusal(Reason.FRAMES_MISMATCH, "another tool centre point than the model's")
            return CommandedOperation(SET_TCP, pose)
        case v.SetPayload(mass_kg, centre_m):
            same = nearest(mass_kg, Unit.GRAM) == nearest(fitted.payload_kg, Unit.GRAM)
            if not (same and (centre_m == _KEPT or math.dist(centre_m, fitted.centre_m) <= CENTRE_M)):
                return InputRefusal(Reason.PAYLOAD_MISMATCH, "another payload than the committed one")
            return CommandedOperation(SET_PAYLOAD, (mass_kg, *centre_m))
        case (
            v.ZeroForceSensor()
            | v.SetTargetPayload()
            | v.SetGravity()
            | v.SetForceDamping()
            | v.SetForceGain()
            | v.ForceInput()
            | v.ExternalForceSensor()
            | v.SetExternalWrench()
            | v.SetWatchdog()
            | v.StartContactDetection()
            | v.StopContactDetection()
        ):
            return InputRefusal(Reason.NOT_GRANTED, _NONE)
        case _:
            assert_never(command)


def _switched(command: IoCommand) -> CommandedOperation | InputRefusal:
    match command:
        case io.SetDigitalOutputs(io.Bank.STANDARD, mask, levels) if mask.bit_count() == 1:
            return CommandedOperation(SET_DIGITAL_OUTPUT, (mask.bit_length() - 1, int(levels != 0)))
        case io.SetSpeedSlider(fraction):
            return CommandedOperation(SET_SPEED_SLIDER, (fraction,))
        case (
            io.SetDigitalOutputs()
            | io.SetAnalogOutput()
            | io.SetInputInteger()
            | io.SetInputDouble()
            | v.SetExternalWrench()
        ):
            return InputRefusal(Reason.NOT_GRANTED, _NONE)
        case _:
            assert_never(command)


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
    values: list[Quantity] = []
    for parameter, number in zip(operation.parameters, asked.spelt, strict=True):
        try:
            values.append(Quantity(parameter.name, parameter.unit, parse(number, parameter.unit)))
        except QuantityError as error:
            return InputRefusal(Reason(error.code), f"{parameter.name}: {error.detail}")
    return Request(request_id, POINTS, audience, operation.object, operation.name, tuple(values), at)
