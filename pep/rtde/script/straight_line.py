"""Programs other than ur_rtde's own: lists of known statements with plain numbers only.

There is no variable, no branch, no loop, no thread and no function in them, so what they do can be read off and judged
statement by statement. What is passed on is written anew from them (`pep.rtde.script.statements`).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, assert_never

from pep.rtde.command.command_values import StopJ, StopL
from pep.rtde.command.fields import (
    ANY,
    BLEND,
    JOINT_ACCELERATION,
    JOINT_SPEED,
    POSITIVE,
    TOOL_ACCELERATION,
    TOOL_SPEED,
    Span,
    WrongParameterError,
    judged,
)
from pep.rtde.command.io_commands import Bank, SetDigitalOutputs
from pep.rtde.script.move_path import PathMove, Waypoint
from pep.rtde.script.statements import Sleep, StraightLine, TextMessage, WriteOutputDouble, WriteOutputInteger
from pep.rtde.script.syntax_tree import (
    Binary,
    Boolean,
    Definition,
    Evaluate,
    FunctionCall,
    Integer,
    ListLiteral,
    PoseLiteral,
    Real,
    Text,
    Unary,
)
from pep.rtde.script.urscript import ScriptError, parse
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pep.rtde.script.statements import Statement
    from pep.rtde.script.syntax_tree import Argument, Expression
    from pep.rtde.script.syntax_tree import Statement as Node

MAX_TEXT: Final = 64 * 1024
"""Characters of a program."""
MAX_STATEMENTS: Final = 100
OUTPUT_REGISTERS: Final = 48


# ---------------------------------------------------------------------------------------------------------- arguments


class _Kind(Enum):
    """Kind of an argument that is no number in a span."""

    TARGET = "joint angles or a pose"
    WHOLE = "a whole number"
    TRUTH = "True or False"
    TEXT = "a text"


@dataclass(frozen=True, slots=True)
class _Parameter:
    """One parameter of a statement; without a default it must be given."""

    name: str
    kind: _Kind | Span
    default: float | None = None


@dataclass(frozen=True, slots=True)
class _Form:
    """Form of one statement: its parameters in order, and the function that makes its value."""

    parameters: tuple[_Parameter, ...]
    make: Callable[..., Statement]


_SAFE_TEXT: Final = re.compile(r"[A-Za-z0-9 .,:_-]{0,200}")
_SLEEP: Final = Span(0.0, 600.0)  # ours
_NO_TIME: Final = Span(0.0, 0.0)  # a time would put speed and acceleration out of force
_INT_32: Final = 2**31


def _wrong(place: str) -> WrongParameterError:
    return WrongParameterError(Reason.PARAMETERS_WRONG, place)


def _number(expression: Expression, place: str) -> float:
    match expression:
        case Integer(value) | Real(value):
            return float(value)
        case Unary("-", Integer(value) | Real(value)):
            return -float(value)
        case Unary("+", Integer(value) | Real(value)):
            return float(value)
        case _:
            raise _wrong(place)


def _whole(expression: Expression, place: str) -> int:
    match expression:
        case Integer(value):
            return value
        case Unary("-", Integer(value)):
            return -value
        case Binary("+", Integer(left), Integer(right)):  # ur_rtde writes a register as its number and the offset
            return left + right
        case _:
            raise _wrong(place)


def _read(expression: Expression, kind: _Kind | Span, place: str) -> object:
    match kind:
        case Span():
            return judged(_number(expression, place), kind, place)
        case _Kind.WHOLE:
            return _whole(expression, place)
        case _Kind.TRUTH:
            if not isinstance(expression, Boolean):
                raise _wrong(place)
            return expression.value
        case _Kind.TEXT:
            if not isinstance(expression, Text) or not _SAFE_TEXT.fullmatch(expression.value):
                raise _wrong(place)
            return expression.value
        case _Kind.TARGET:
            if not isinstance(expression, ListLiteral | PoseLiteral) or len(expression.items) != 6:
                raise _wrong(place)
            numbers = tuple(judged(_number(item, place), ANY, place) for item in expression.items)
            return isinstance(expression, PoseLiteral), numbers
        case _:
            assert_never(kind)


# ---------------------------------------------------------------------------------------------------------- statements


def _move(move: PathMove) -> Callable[..., Statement]:
    def make(target: tuple[bool, Any], acceleration: float, speed: float, time_s: float, blend_m: float) -> Statement:
        del time_s
        is_pose, numbers = target
        return Waypoint(move, is_pose, numbers, speed, acceleration, blend_m)

    return make


def _digital(bank: Bank, count: int) -> Callable[..., Statement]:
    def make(number: int, level: bool) -> Statement:  # noqa: FBT001
        _index(number, count)
        return SetDigitalOutputs(bank, 1 << number, int(level) << number)

    return make


def _index(number: int, count: int) -> None:
    if not 0 <= number < count:
        raise WrongParameterError(Reason.OUT_OF_RANGE, "n")


def _write_integer(register: int, value: int) -> Statement:
    _index(register, OUTPUT_REGISTERS)
    if not -_INT_32 <= value < _INT_32:
        raise WrongParameterError(Reason.OUT_OF_RANGE, "value")
    return WriteOutputInteger(register, value)


def _write_double(register: int, value: float) -> Statement:
    _index(register, OUTPUT_REGISTERS)
    return WriteOutputDouble(register, value)


_LEVEL: Final = (_Parameter("n", _Kind.WHOLE), _Parameter("b", _Kind.TRUTH))
# The defaults are URScript's.
_FORMS: Final[Mapping[str, _Form]] = MappingProxyType(
    {
        "movej": _Form(
            (
                _Parameter("q", _Kind.TARGET),
                _Parameter("a", JOINT_ACCELERATION, 1.4),
                _Parameter("v", JOINT_SPEED, 1.05),
                _Parameter("t", _NO_TIME, 0.0),
                _Parameter("r", BLEND, 0.0),
            ),
            _move(PathMove.MOVEJ),
        ),
        "movel": _Form(
            (
                _Parameter("pose", _Kind.TARGET),
                _Parameter("a", TOOL_ACCELERATION, 1.2),
                _Parameter("v", TOOL_SPEED, 0.25),
                _Parameter("t", _NO_TIME, 0.0),
                _Parameter("r", BLEND, 0.0),
            ),
            _move(PathMove.MOVEL),
        ),
        "stopj": _Form((_Parameter("a", POSITIVE),), lambda a: StopJ(a, asynchronous=False)),
        "stopl": _Form((_Parameter("a", POSITIVE),), lambda a: StopL(a, asynchronous=False)),
        "set_digital_out": _Form(_LEVEL, _digital(Bank.STANDARD, 8)),
        "set_standard_digital_out": _Form(_LEVEL, _digital(Bank.STANDARD, 8)),
        "set_configurable_digital_out": _Form(_LEVEL, _digital(Bank.CONFIGURABLE, 8)),
        "set_tool_digital_out": _Form(_LEVEL, _digital(Bank.TOOL, 2)),
        "write_output_integer_register": _Form(
            (_Parameter("address", _Kind.WHOLE), _Parameter("value", _Kind.WHOLE)), _write_integer
        ),
        "write_output_float_register": _Form(
            (_Parameter("address", _Kind.WHOLE), _Parameter("value", ANY)), _write_double
        ),
        "sleep": _Form((_Parameter("t", _SLEEP),), Sleep),
        "textmsg": _Form((_Parameter("s1", _Kind.TEXT),), TextMessage),
    }
)
STATEMENTS: Final = frozenset(_FORMS)
"""Functions that a program may call."""


def straight_line(text: str) -> StraightLine | InputRefusal:
    """Statements of a program. Never raises.

    Args:
        text: one program, as `pep.rtde.script.urscript.ProgramStream` cuts it out: a definition without parameters, or
            bare
            calls.

    Returns:
        Refused as `BODY_TOO_LARGE` or `BODY_MALFORMED` when it is too long or no URScript, `TOOL_UNKNOWN` for anything
        but a call of one of `STATEMENTS`, and `PARAMETERS_WRONG`, `NOT_FINITE`, `ROBOT_LIMIT` or `OUT_OF_RANGE` for
        what a call is given.
    """
    if len(text) > MAX_TEXT:
        return InputRefusal(Reason.BODY_TOO_LARGE, "program")
    try:
        tree = parse(text)
    except ScriptError as error:
        return InputRefusal(Reason.BODY_MALFORMED, f"line {error.line}")
    nodes: Sequence[Node] = tree.statements
    if len(nodes) == 1 and isinstance(nodes[0], Definition):
        program = nodes[0]
        if program.kind != "def" or program.parameters:
            return InputRefusal(Reason.TOOL_UNKNOWN, f"line {program.line}")
        nodes = program.body
    if not nodes:
        return InputRefusal(Reason.BODY_MALFORMED, "an empty program")
    if len(nodes) > MAX_STATEMENTS:
        return InputRefusal(Reason.BODY_TOO_LARGE, "program")
    found = []
    for node in nodes:
        statement = _statement(node)
        if isinstance(statement, InputRefusal):
            return statement
        found.append(statement)
    return StraightLine(tuple(found))


def _statement(node: Node) -> Statement | InputRefusal:
    place = f"line {node.line}"
    if not isinstance(node, Evaluate) or not isinstance(node.expression, FunctionCall):
        return InputRefusal(Reason.TOOL_UNKNOWN, place)
    form = _FORMS.get(node.expression.function)
    if form is None:
        return InputRefusal(Reason.TOOL_UNKNOWN, place)
    try:
        return form.make(*_bound(form, node.expression.arguments))
    except WrongParameterError as wrong:
        return InputRefusal(wrong.reason, f"{place}: {wrong.place}")


def _bound(form: _Form, arguments: Sequence[Argument]) -> list[object]:
    """Values of a form's parameters, in order."""
    given: dict[str, Expression] = {}
    for at, argument in enumerate(arguments):
        if argument.name is None and at >= len(form.parameters):
            raise _wrong("one too many")
        name = form.parameters[at].name if argument.name is None else argument.name
        if name in given:
            raise _wrong(name)
        given[name] = argument.value
    values: list[object] = []
    for parameter in form.parameters:
        expression = given.pop(parameter.name, None)
        if expression is not None:
            values.append(_read(expression, parameter.kind, parameter.name))
        elif parameter.default is not None:
            values.append(parameter.default)
        else:
            raise _wrong(parameter.name)
    if given:
        raise _wrong("a parameter that does not exist")
    return values
