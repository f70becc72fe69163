"""Limits of the robot itself on parameters.

They hold beside every token, and no delegation can widen them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.values.chain import Refusal
from capabilities.values.errors import FaultCode
from capabilities.values.scope import Grant, Limit
from pep.base.operations import operation_of

if TYPE_CHECKING:
    from pep.base.operations import Operation
    from policies.evidence.model import Request

OFFSET_M: Final = 1e-4  # ours: a tool centre point that differs by less is the same, but for the wire's rounding
OFFSET_RAD: Final = 1e-3  # ours: likewise, of its turn


def widest(operation: Operation) -> Grant:
    """Grant of an operation with the robot's own limits: no useful token has a wider one."""
    return Grant(
        operation.object, operation.name, tuple(Limit(each.parameter, each.bound) for each in operation.limits)
    )


class Ur3eLimits:
    """The `RobotLimits` port of a UR3e with a Robotiq 2F-85."""

    def refuse(self, request: Request) -> Refusal | None:
        """First parameter outside of the robot's limits, or None.

        An operation that the robot does not have is refused.
        """
        operation = operation_of(request.object, request.operation)
        if operation is None:
            return Refusal(FaultCode.NOT_GRANTED, detail="the robot has no such operation")
        if tuple(value.name for value in request.values) != tuple(each.name for each in operation.parameters):
            return Refusal(FaultCode.PARAMETERS_WRONG, detail="not the operation's parameters")
        for value, limit in zip(request.values, operation.limits, strict=True):
            bound = limit.bound
            if not bound.low <= value.value <= bound.high:
                return Refusal(
                    FaultCode.LIMIT_EXCEEDED_BY_REQUEST,
                    parameter=value.name,
                    value=value.value,
                    unit=value.unit,
                    bound=bound,
                    nearest=min(max(value.value, bound.low), bound.high),
                    detail="the robot's own limit",
                )
        return None
