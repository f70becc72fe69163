"""Grants as wide as the robot's own limits, and the least differences that count."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.values.scope import Grant, Limit

if TYPE_CHECKING:
    from pep.base.operation_row import Operation

OFFSET_M: Final = 1e-4  # ours: a tool centre point that differs by less is the same, but for the wire's rounding
OFFSET_RAD: Final = 1e-3  # ours: likewise, of its turn


def widest(operation: Operation) -> Grant:
    """Grant of an operation with the robot's own limits: no useful token has a wider one."""
    return Grant(
        operation.object, operation.name, tuple(Limit(each.parameter, each.bound) for each in operation.limits)
    )
