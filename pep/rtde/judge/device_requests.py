"""Operations of a program's commands to fingers, outputs and the speed slider. Pure: one command, one answer."""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

from capabilities.values.units import Unit, si
from pep.base.operations import GRIPPER_ACTIVATE, GRIPPER_MOVE, SET_DIGITAL_OUTPUT, SET_SPEED_SLIDER
from pep.rtde.command import command_values as v
from pep.rtde.command import io_commands as io
from pep.rtde.command.gripper_commands import ActivateFingers, MoveFingers
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from pep.base.operation_row import Operation
    from pep.rtde.command.gripper_commands import GripperCommand
    from pep.rtde.command.io_commands import IoCommand


def gripped(command: GripperCommand) -> tuple[Operation, tuple[float, ...]]:
    """Operation of the fingers and its parameters, in SI units."""
    match command:
        case MoveFingers(width_um=width, speed_um_s=speed, force_mn=force):
            numbers = (
                si(width, Unit.MICROMETRE),
                si(speed, Unit.MICROMETRE_PER_SECOND),
                si(force, Unit.MILLINEWTON),
            )
            return GRIPPER_MOVE, numbers
        case ActivateFingers():
            return GRIPPER_ACTIVATE, ()
        case _:
            assert_never(command)


def switched(command: IoCommand) -> tuple[Operation, tuple[float, ...]] | InputRefusal:
    """Operation that sets an output or the speed slider; refused as `NOT_GRANTED` where none stands for it."""
    match command:
        case io.SetDigitalOutputs(io.Bank.STANDARD, mask, levels) if mask.bit_count() == 1:
            return SET_DIGITAL_OUTPUT, (mask.bit_length() - 1, int(levels != 0))
        case io.SetSpeedSlider(fraction):
            return SET_SPEED_SLIDER, (fraction,)
        case (
            io.SetDigitalOutputs()
            | io.SetAnalogOutput()
            | io.SetInputInteger()
            | io.SetInputDouble()
            | v.SetExternalWrench()
        ):
            return without_operation(io.method_of(command))
        case _:
            assert_never(command)


def without_operation(method: str) -> InputRefusal:
    """Refusal of a method of ur_rtde for which no operation stands, by its name."""
    return InputRefusal(Reason.NOT_GRANTED, f"{method}: no operation stands for it")
