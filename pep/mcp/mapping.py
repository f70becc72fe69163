"""Mapping from the arguments of a tool call to a Request in integers.

Pure. An argument that does not fit is refused. A number finer than its unit is, too, unless its row rounds it: then it
is rounded once, here, before anything is decided, and the tool gets the rounded one (`decided_arguments`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, assert_never

from capabilities.values.errors import QuantityError
from capabilities.values.units import Quantity, parse, scaled
from pep.base.operation_row import ArgumentForm, OperationKind
from pep.base.operations import JOINTS, OPERATIONS, WAYPOINTS, padded
from policies.evidence.model import Point, Request
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

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
        The request; or `PARAMETERS_WRONG` for a missing or extra argument or a list of another length, and the codes of
        `capabilities.values.units.parse` for a number that is none, not finite, out of range or off the grid.
    """
    wanted = operation.arguments or ()
    if not {each.name for each in wanted}.issuperset(arguments):
        return Misfit(Reason.PARAMETERS_WRONG, "", "an argument that the tool does not have")
    values: list[Quantity] = []
    for argument in wanted:
        if argument.name not in arguments:
            return Misfit(Reason.PARAMETERS_WRONG, argument.name, "the argument is missing")
        numbers = _numbers(argument, arguments[argument.name])
        if numbers is None:
            return Misfit(Reason.PARAMETERS_WRONG, argument.name, _wanted(argument))
        limits = operation.limits[len(values) : len(values) + argument.parameters]
        for place, (limit, number) in enumerate(zip(limits, numbers, strict=True)):
            try:
                values.append(_quantity(limit, number))
            except QuantityError as error:
                element = f"{argument.name}[{place}]" if argument.form is ArgumentForm.VECTOR else argument.name
                return Misfit(Reason(error.code), element, error.detail)
    return Request(
        request_id=request_id,
        points=points_of(operation),
        audience=audience,
        object=operation.object,
        operation=operation.name,
        values=tuple(values),
        at=at,
    )


def _quantity(limit: BoundedParameter, number: Any) -> Quantity:
    """The parameter with this number.

    Raises:
        QuantityError: the number is none for it.
    """
    name, unit, scale = limit.parameter.name, limit.parameter.unit, limit.scale
    if scale is None:
        return Quantity(name, unit, parse(number, unit))
    return Quantity(name, unit, scaled(number, scale, exact=limit.exact))


def decided_arguments(operation: Operation, request: Request) -> dict[str, Any]:
    """The arguments of a declared tool that the request holds: what was decided, and nothing else.

    Args:
        operation: of a tool without a robot.
        request: made of its arguments.
    """
    decided: dict[str, Any] = {}
    left = list(zip(operation.limits, request.values, strict=True))
    for argument in operation.arguments or ():
        mine, left = left[: argument.parameters], left[argument.parameters :]
        decided[argument.name] = _argument(argument.form, [(limit.scale or 1, value.value) for limit, value in mine])
    return decided


def _argument(form: ArgumentForm, integers: Sequence[tuple[int, int]]) -> Any:
    """An argument of (scale, integer) pairs."""
    match form:
        case ArgumentForm.NUMBER | ArgumentForm.INTEGER | ArgumentForm.FLAG:
            ((scale, value),) = integers
            if form is ArgumentForm.NUMBER:
                return value / scale
            return value // scale if form is ArgumentForm.INTEGER else value == 1
        case ArgumentForm.VECTOR:
            return [value / scale for scale, value in integers]
        case ArgumentForm.WAYPOINTS:
            raise ValueError("a path is a robot's")
        case _:
            assert_never(form)


def rounded(given: Mapping[str, Any], decided: Mapping[str, Any]) -> dict[str, Any]:
    """The decided arguments that are other numbers than the given ones."""
    return {name: value for name, value in decided.items() if given[name] != value}


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
            assert_never(argument.form)


def _wanted(argument: ToolArgument) -> str:
    match argument.form:
        case ArgumentForm.FLAG:
            return "true or false is wanted"
        case ArgumentForm.WAYPOINTS:
            return f"a list of 1 to {WAYPOINTS} lists of {JOINTS} numbers is wanted"
        case _:
            return f"a list of {argument.parameters} numbers is wanted"
