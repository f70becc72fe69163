"""Mapping from the arguments of a tool call to a Request, each value in its one spelling.

Pure. An argument that does not fit is refused. A number finer than its unit is, too, unless its row rounds it: then it
is rounded once, here, before anything is decided, and the tool gets the rounded one (`decided_arguments`).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, assert_never

import rfc8785

from capabilities.values.arguments import Argument, measured
from capabilities.values.arguments import argument as argument_value
from capabilities.values.bounds import permits
from capabilities.values.errors import QuantityError
from capabilities.values.units import INT_LIMIT, DeclaredUnit, ListOf, Quantity, Sort, Unit, parse, scaled
from capabilities.values.well_formed import LIST_LENGTH
from pep.base.errors import DeclarationError, PepFault
from pep.base.operation_row import ArgumentForm, OperationKind
from pep.base.operations import JOINTS, OPERATIONS, WAYPOINTS, padded
from policies.evidence.model import Point, Request
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from capabilities.values.arguments import Value
    from capabilities.values.units import Kind
    from pep.base.operation_row import BoundedParameter, Operation, ToolArgument

TOOL: Final = frozenset({Point.TOOL})
ROBOT_TOOL: Final = frozenset({Point.TOOL, Point.ACTUATION})
"""Points of one gate run before a robot: the tool call, and its command to the robot."""


@dataclass(frozen=True, slots=True)
class Misfit:
    """Reason why arguments are no request.

    Attributes:
        reason: the code.
        argument: the first that does not fit; "" when it is the whole.
        detail: for the holder.
    """

    reason: Reason
    argument: str
    detail: str


ARM_TOOLS: Final[Mapping[str, Operation]] = {each.name: each for each in OPERATIONS if each.arguments is not None}
"""The tools of a UR3e cell: each operation that has arguments, under its own name."""


def stops(tools: Mapping[str, Operation], name: str | None) -> bool:
    """True where a call of that tool only stops: any caller may, without token, ticket or permit.

    Args:
        tools: that may be called, by name.
        name: of the called tool; None where none is called.
    """
    operation = None if name is None else tools.get(name)
    return operation is not None and operation.kind is OperationKind.STOP


def points_of(operation: Operation) -> frozenset[Point]:
    """Points of one gate run for the operation."""
    return TOOL if operation.robot is None else ROBOT_TOOL


def bare_request(operation: Operation, *, audience: str) -> Request:
    """Request for the operation without its values, enough to know which evidence the policies need.

    Args:
        operation: of the called tool.
        audience: canonical URL of this server.
    """
    return Request("", points_of(operation), audience, operation.object, operation.name, (), 0.0)


def to_request(
    operation: Operation, arguments: Mapping[str, Any], *, request_id: str, audience: str, at: float
) -> Request | Misfit:
    """Canonical request of these arguments.

    Args:
        operation: of the called tool.
        arguments: as the tool will get them.
        request_id: made by the PEP.
        audience: canonical URL of this server.
        at: wall clock of arrival, seconds since the epoch.

    Returns:
        The request, with the default of what is left out; or `PARAMETERS_WRONG` for a missing or extra argument, one of
        another type, or a list of another length; `NOT_CANONICAL` for another spelling of a word than its one; and the
        codes of `capabilities.values.units.parse` for a number that is none, not finite, out of range or off the grid.
    """
    stated = operation.arguments or ()
    if not {each.name for each in stated}.issuperset(arguments):
        return Misfit(Reason.PARAMETERS_WRONG, "", "an argument that the tool does not have")
    values: list[Value] = []
    for argument, limits in operation.stated():
        if argument.name not in arguments and argument.default is None:
            return Misfit(Reason.PARAMETERS_WRONG, argument.name, "the argument is missing")
        read = _read(argument, limits, _given(argument, arguments))
        if isinstance(read, Misfit):
            return read
        values.extend(read)
    return Request(
        request_id=request_id,
        points=points_of(operation),
        audience=audience,
        object=operation.object,
        operation=operation.name,
        values=tuple(values),
        at=at,
    )


def _given(argument: ToolArgument, arguments: Mapping[str, Any]) -> Any:
    """The argument's value in a call, or its default where the call leaves it out."""
    if argument.name in arguments or argument.default is None:
        return arguments[argument.name]
    return json.loads(argument.default)


def checked_defaults(operation: Operation) -> Operation:
    """The operation, each of whose defaults is a value that its row permits.

    Raises:
        DeclarationError: `DECLARATION_MALFORMED`, naming tool and argument.
    """
    for argument, limits in operation.stated():
        read = () if argument.default is None else _read(argument, limits, _given(argument, {}))
        wrong = isinstance(read, Misfit) or not all(
            permits(limit.bound, measured(value)) for limit, value in zip(limits, read, strict=False)
        )
        if wrong:
            where = f"{operation.name}.{argument.name}: its default is none of its values"
            raise DeclarationError(PepFault.DECLARATION_MALFORMED, where)
    return operation


def _read(argument: ToolArgument, limits: Sequence[BoundedParameter], given: Any) -> Sequence[Value] | Misfit:
    """The argument's parameters with the given value."""
    match argument.form:
        case ArgumentForm.VALUE | ArgumentForm.NUMBERS | ArgumentForm.INTEGERS | ArgumentForm.TEXT:
            (limit,) = limits
            if limit.parameter.kind is Sort.FREE and isinstance(given, str) != (argument.form is ArgumentForm.TEXT):
                # A server of tools may read JSON in a text that it takes for something else.
                return Misfit(Reason.PARAMETERS_WRONG, argument.name, _wanted(argument))
            if isinstance(limit.parameter.kind, ListOf):
                return _list(argument.name, limit, limit.parameter.kind.element, given)
            parts: Sequence[Any] | None = (given,)
        case ArgumentForm.POINTS:
            return _points(argument, limits, given)
        case _:
            parts = _numbers(argument, given)
    if parts is None:
        return Misfit(Reason.PARAMETERS_WRONG, argument.name, _wanted(argument))
    values: list[Value] = []
    for place, (limit, part) in enumerate(zip(limits, parts, strict=True)):
        try:
            values.append(_value(limit, limit.parameter.kind, part))
        except QuantityError as error:
            element = f"{argument.name}[{place}]" if argument.form is ArgumentForm.VECTOR else argument.name
            return Misfit(Reason(error.code), element, error.detail)
    return values


def _points(argument: ToolArgument, limits: Sequence[BoundedParameter], given: Any) -> Sequence[Value] | Misfit:
    """The list parameters of a list of points, one for each of a point's numbers."""
    wide = argument.parameters
    if not isinstance(given, list) or not all(isinstance(point, list) and len(point) == wide for point in given):
        return Misfit(Reason.PARAMETERS_WRONG, argument.name, _wanted(argument))
    values: list[Value] = []
    for limit, column in zip(limits, zip(*given, strict=True) if given else ((),) * wide, strict=True):
        assert isinstance(limit.parameter.kind, ListOf)
        read = _list(argument.name, limit, limit.parameter.kind.element, list(column))
        if isinstance(read, Misfit):
            return read
        values.extend(read)
    return values


def _list(name: str, limit: BoundedParameter, element: Kind, given: Any) -> Sequence[Value] | Misfit:
    """The one parameter of a list, each of its members read like a value of its own."""
    if not isinstance(given, list):
        return Misfit(Reason.PARAMETERS_WRONG, name, "a list is wanted")
    if len(given) > LIST_LENGTH:
        return Misfit(Reason.OUT_OF_RANGE, name, f"a list of more than {LIST_LENGTH}")
    members: list[Any] = []
    for place, member in enumerate(given):
        try:
            members.append(_value(limit, element, member).value)
        except QuantityError as error:
            return Misfit(Reason(error.code), f"{name}[{place}]", error.detail)
    return (Argument(limit.parameter.name, limit.parameter.kind, tuple(members)),)  # type: ignore[arg-type]  # the kind of a list


def _value(limit: BoundedParameter, kind: Kind, given: Any) -> Value:
    """The parameter with this value, or the member of its list.

    Raises:
        QuantityError: the value is none for it.
    """
    name = limit.parameter.name
    if not isinstance(kind, (Unit, DeclaredUnit)):
        return argument_value(name, kind, given)
    if limit.scale is None:
        return Quantity(name, kind, parse(given, kind))
    return Quantity(name, kind, scaled(given, limit.scale, exact=limit.exact))


def decided_arguments(operation: Operation, request: Request, given: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a declared tool that the request holds: what was decided, and nothing else.

    Args:
        operation: of a tool without a robot.
        request: made of its arguments.
        given: those arguments; only free values are taken from there, as their canonical JSON says them.
    """
    decided: dict[str, Any] = {}
    left = request.values
    for argument, limits in operation.stated():
        mine, left = left[: len(limits)], left[len(limits) :]
        if limits[0].parameter.kind is Sort.FREE:
            decided[argument.name] = _as_decided(_given(argument, given))
        else:
            decided[argument.name] = _argument(argument.form, limits[0].scale or 1, [each.value for each in mine])
    return decided


def _as_decided(value: Any) -> Any:
    """The free value that its canonical JSON states, of which the digest is."""

    def number(figures: str) -> int | float:
        whole = int(figures)
        return whole if -INT_LIMIT <= whole <= INT_LIMIT else float(figures)  # a double without a fraction

    return json.loads(rfc8785.dumps(value), parse_int=number)


def _argument(form: ArgumentForm, scale: int, values: Sequence[Any]) -> Any:
    """An argument of its parameters' values.

    Args:
        form: of the argument.
        scale: of all its numbers.
        values: of its parameters.
    """
    match form:
        case ArgumentForm.NUMBER:
            return values[0] / scale
        case ArgumentForm.INTEGER:
            return values[0] // scale
        case ArgumentForm.FLAG:
            return values[0] == 1
        case ArgumentForm.VALUE | ArgumentForm.TEXT:
            return list(values[0]) if isinstance(values[0], tuple) else values[0]
        case ArgumentForm.VECTOR:
            return [value / scale for value in values]
        case ArgumentForm.NUMBERS:
            return [value / scale for value in values[0]]
        case ArgumentForm.INTEGERS:
            return [value // scale for value in values[0]]
        case ArgumentForm.WAYPOINTS | ArgumentForm.POINTS:
            raise ValueError("a path or a trajectory is a robot's")
        case _:
            assert_never(form)


def rounded(given: Mapping[str, Any], decided: Mapping[str, Any]) -> dict[str, Any]:
    """The decided arguments that are other numbers than the given ones."""
    return {name: value for name, value in decided.items() if name in given and given[name] != value}


def _numbers(argument: ToolArgument, given: Any) -> Sequence[Any] | None:
    """Values of the argument's parameters, each still unread; None for another form."""
    match argument.form:
        case ArgumentForm.NUMBER | ArgumentForm.INTEGER:
            return (given,)
        case ArgumentForm.FLAG:
            return (int(given),) if isinstance(given, bool) else None
        case ArgumentForm.VECTOR:
            return given if isinstance(given, list) and len(given) == argument.parameters else None
        case ArgumentForm.WAYPOINTS:
            points = given if isinstance(given, list) and 1 <= len(given) <= WAYPOINTS else []
            if not points or not all(isinstance(point, list) and len(point) == JOINTS for point in points):
                return None
            return tuple(q for point in padded(points) for q in point)
        case _:
            raise ValueError("a value, or a list of any length")


def _wanted(argument: ToolArgument) -> str:
    match argument.form:
        case ArgumentForm.FLAG:
            return "true or false is wanted"
        case ArgumentForm.WAYPOINTS:
            return f"a list of 1 to {WAYPOINTS} lists of {JOINTS} numbers is wanted"
        case ArgumentForm.POINTS:
            return f"a list of lists of {argument.parameters} numbers is wanted"
        case ArgumentForm.TEXT:
            return "a text is wanted"
        case ArgumentForm.VALUE:
            return "a text is no free value"
        case _:
            return f"a list of {argument.parameters} numbers is wanted"
