"""From the arguments of a tool call to a Request in integers. Pure; what does not fit exactly is refused."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from capabilities.values.errors import QuantityError
from capabilities.values.scope import Tier
from capabilities.values.units import Parameter, Quantity, parse
from pep.base.operations import (
    GRIPPER_ACTIVATE,
    GRIPPER_MOVE,
    JOINTS,
    MOVE_JOINT,
    MOVE_PATH,
    READ_STATE,
    SET_DIGITAL_OUTPUT,
    SPEED_JOINT,
    STOP,
    WAYPOINTS,
    Operation,
    padded,
)
from policies.evidence.model import Point, Request
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Mapping

POINTS: Final = frozenset({Point.TOOL, Point.ACTUATION})
"""One gate run stands for the tool call and for what it sends to the robot."""


@dataclass(frozen=True, slots=True)
class Scalar:
    """An argument that is one number in SI units."""

    argument: str
    parameter: Parameter


@dataclass(frozen=True, slots=True)
class Vector:
    """An argument that is a list of exactly as many numbers as there are parameters."""

    argument: str
    parameters: tuple[Parameter, ...]


@dataclass(frozen=True, slots=True)
class Waypoints:
    """An argument that is a list of 1 to `WAYPOINTS` lists of six numbers; the last stands for those that miss."""

    argument: str
    parameters: tuple[Parameter, ...]


@dataclass(frozen=True, slots=True)
class Flag:
    """An argument that is true or false, 1 or 0 in the request. A number is none."""

    argument: str
    parameter: Parameter


@dataclass(frozen=True, slots=True)
class ToolBinding:
    """How a tool's arguments become an operation's parameters, in the operation's order.

    Attributes:
        tool: its name.
        operation: what it does.
        base_tier: the tier that its author proposes for the registry; the registry's own counts.
        fields: one for each argument.
    """

    tool: str
    operation: Operation
    base_tier: Tier
    fields: tuple[Scalar | Vector | Waypoints | Flag, ...] = ()


@dataclass(frozen=True, slots=True)
class Misfit:
    """Why arguments are no request.

    Attributes:
        reason: the code.
        argument: the first that does not fit; "" when it is the whole.
        detail: for the holder.
    """

    reason: Reason
    argument: str
    detail: str


_MOVE: Final = MOVE_JOINT.parameters
_PATH: Final = MOVE_PATH.parameters
_GRIP: Final = GRIPPER_MOVE.parameters
_SPEED: Final = SPEED_JOINT.parameters
_OUTPUT: Final = SET_DIGITAL_OUTPUT.parameters
ARM_TOOLS: Final[Mapping[str, ToolBinding]] = {
    binding.tool: binding
    for binding in (
        ToolBinding(
            "move_joint",
            MOVE_JOINT,
            Tier.REVERSIBLE,
            (Vector("q_rad", _MOVE[:6]), Scalar("speed_rad_s", _MOVE[6]), Scalar("acceleration_rad_s2", _MOVE[7])),
        ),
        ToolBinding(
            "move_path",
            MOVE_PATH,
            Tier.REVERSIBLE,
            (
                Waypoints("waypoints_rad", _PATH[:-2]),
                Scalar("speed_rad_s", _PATH[-2]),
                Scalar("acceleration_rad_s2", _PATH[-1]),
            ),
        ),
        ToolBinding("stop", STOP, Tier.NO_EFFECT),
        ToolBinding(
            "gripper_move",
            GRIPPER_MOVE,
            Tier.REVERSIBLE,
            (Scalar("width_m", _GRIP[0]), Scalar("speed_m_s", _GRIP[1]), Scalar("force_n", _GRIP[2])),
        ),
        # The fingers make a full stroke, whatever lies between them.
        ToolBinding("gripper_activate", GRIPPER_ACTIVATE, Tier.CONSEQUENTIAL),
        ToolBinding(
            "speed_joint",
            SPEED_JOINT,
            Tier.REVERSIBLE,
            (
                Vector("qd_rad_s", _SPEED[:6]),
                Scalar("acceleration_rad_s2", _SPEED[6]),
                Scalar("duration_s", _SPEED[7]),
            ),
        ),
        ToolBinding(
            "set_digital_output",
            SET_DIGITAL_OUTPUT,
            Tier.REVERSIBLE,
            (Scalar("pin", _OUTPUT[0]), Flag("value", _OUTPUT[1])),
        ),
        ToolBinding("read_state", READ_STATE, Tier.NO_EFFECT),
    )
}
"""The tools of a UR3e cell."""


def bare_request(binding: ToolBinding, *, audience: str) -> Request:
    """A request for the tool's operation without its values: enough to know what the policies want to see of it.

    Args:
        binding: of the called tool.
        audience: canonical URL of this server.
    """
    return Request("", POINTS, audience, binding.operation.object, binding.operation.name, (), 0.0)


def to_request(
    binding: ToolBinding, arguments: Mapping[str, Any], *, request_id: str, audience: str, at: float
) -> Request | Misfit:
    """The canonical request that these arguments mean.

    Args:
        binding: of the called tool.
        arguments: as the tool will get them.
        request_id: made by the PEP.
        audience: canonical URL of this server.
        at: wall clock of arrival, seconds since the epoch.

    Returns:
        The request; or `PARAMETERS_WRONG` for a missing or extra argument or a list of another length, and the codes of
        `capabilities.values.units.parse` for a number that is none, not finite, out of range or off the grid.
    """
    wanted = [field.argument for field in binding.fields]
    for argument in arguments:
        if argument not in wanted:
            return Misfit(Reason.PARAMETERS_WRONG, "", "an argument that the tool does not have")
    values: list[Quantity] = []
    for field in binding.fields:
        if field.argument not in arguments:
            return Misfit(Reason.PARAMETERS_WRONG, field.argument, "the argument is missing")
        given = arguments[field.argument]
        if isinstance(field, Scalar):
            pairs = [(field.parameter, given)]
        elif isinstance(field, Flag):
            if not isinstance(given, bool):
                return Misfit(Reason.PARAMETERS_WRONG, field.argument, "true or false is wanted")
            pairs = [(field.parameter, int(given))]
        elif isinstance(field, Waypoints):
            points = given if isinstance(given, list) and 1 <= len(given) <= WAYPOINTS else []
            if not points or not all(isinstance(point, list) and len(point) == JOINTS for point in points):
                wanted_form = f"a list of 1 to {WAYPOINTS} lists of {JOINTS} numbers is wanted"
                return Misfit(Reason.PARAMETERS_WRONG, field.argument, wanted_form)
            pairs = list(zip(field.parameters, (q for point in padded(points) for q in point), strict=True))
        elif isinstance(given, list) and len(given) == len(field.parameters):
            pairs = list(zip(field.parameters, given, strict=True))
        else:
            return Misfit(
                Reason.PARAMETERS_WRONG, field.argument, f"a list of {len(field.parameters)} numbers is wanted"
            )
        for parameter, number in pairs:
            try:
                values.append(Quantity(parameter.name, parameter.unit, parse(number, parameter.unit)))
            except QuantityError as error:
                return Misfit(Reason(error.code), field.argument, error.detail)
    return Request(
        request_id=request_id,
        points=POINTS,
        audience=audience,
        object=binding.operation.object,
        operation=binding.operation.name,
        values=tuple(values),
        at=at,
    )
