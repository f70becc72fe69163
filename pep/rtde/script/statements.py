"""Statements of a straight-line program as values, with their one text.

It has a name of ours, so that no such program passes for ur_rtde's control script.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeAlias, assert_never

from pep.rtde.command.command_values import StopJ, StopL
from pep.rtde.command.io_commands import Bank, SetDigitalOutputs
from pep.rtde.script.move_path import Waypoint
from pep.rtde.script.script_text import render
from pep.rtde.script.syntax_tree import (
    Argument,
    Boolean,
    Definition,
    Evaluate,
    Expression,
    FunctionCall,
    Integer,
    ListLiteral,
    PoseLiteral,
    Program,
    Real,
    Text,
    Unary,
)

NAME: Final = "ztpm_straight_line"
"""Name of the forwarded program."""


@dataclass(frozen=True, slots=True)
class WriteOutputInteger:
    """Sets an integer register that the controller shows."""

    register: int
    value: int


@dataclass(frozen=True, slots=True)
class WriteOutputDouble:
    """Sets a double register that the controller shows."""

    register: int
    value: float


@dataclass(frozen=True, slots=True)
class Sleep:
    """Waits for so long."""

    time_s: float


@dataclass(frozen=True, slots=True)
class TextMessage:
    """Writes a line to the controller's log, of letters, digits, spaces and . , : _ - alone."""

    text: str


Statement: TypeAlias = (
    Waypoint | StopJ | StopL | SetDigitalOutputs | WriteOutputInteger | WriteOutputDouble | Sleep | TextMessage
)


@dataclass(frozen=True, slots=True)
class StraightLine:
    """A program that is a list of statements; a `Waypoint` in it is a move of its own."""

    statements: tuple[Statement, ...]

    def render(self) -> str:
        """The program to send."""
        body = tuple(Evaluate(_call(statement)) for statement in self.statements)
        return render(Program((Definition("def", NAME, (), body),)))


def _call(statement: Statement) -> FunctionCall:
    match statement:
        case Waypoint(move, is_pose, target, speed, acceleration, blend_m):
            items = tuple(map(_literal, target))
            named = (("a", acceleration), ("v", speed), ("r", blend_m))
            return FunctionCall(
                move.value,
                (
                    Argument(None, PoseLiteral(items) if is_pose else ListLiteral(items)),
                    *(Argument(name, _literal(value)) for name, value in named),
                ),
            )
        case StopJ(deceleration):
            return _plain("stopj", _literal(deceleration))
        case StopL(deceleration):
            return _plain("stopl", _literal(deceleration))
        case SetDigitalOutputs(bank, mask, levels):
            return _plain(f"set_{_DIGITAL[bank]}", Integer(mask.bit_length() - 1), Boolean(levels != 0))
        case WriteOutputInteger(register, value):
            return _plain("write_output_integer_register", Integer(register), _literal(value))
        case WriteOutputDouble(register, value):
            return _plain("write_output_float_register", Integer(register), _literal(value))
        case Sleep(time_s):
            return _plain("sleep", _literal(time_s))
        case TextMessage(text):
            return _plain("textmsg", Text(text))
        case _:
            assert_never(statement)


_DIGITAL: Final = {
    Bank.STANDARD: "standard_digital_out",
    Bank.CONFIGURABLE: "configurable_digital_out",
    Bank.TOOL: "tool_digital_out",
}


def _plain(function: str, *values: Expression) -> FunctionCall:
    return FunctionCall(function, tuple(Argument(None, value) for value in values))


def _literal(value: float) -> Expression:
    bare = Integer(abs(value)) if isinstance(value, int) else Real(abs(value))
    return Unary("-", bare) if str(value).startswith("-") else bare
