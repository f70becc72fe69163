"""Bounds of a stream's later values: those of the grant and those of the robot."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, assert_never

from capabilities.values.scope import Each, Flags, OneOf, Range, Stems, Words
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capabilities.values.scope import Bound, Grant
    from pep.base.operation_row import Operation


class StreamBounds:
    """Bounds of one stream, looked up once: values come 500 times a second.

    Args:
        operation: that the stream is of.
        grant: of the chain, for that operation.

    Attributes:
        operation: the same.
    """

    def __init__(self, operation: Operation, grant: Grant) -> None:
        self.operation = operation
        granted = {limit.parameter.name: limit.bound for limit in grant.limits}
        self._bounds: tuple[tuple[int, Bound, Range], ...] = tuple(
            (each.parameter.unit.per_si, granted[each.parameter.name], each.range) for each in operation.limits
        )
        self._inside = tuple((per_si, *_both(bound, robot)) for per_si, bound, robot in self._bounds)

    def outside(self, numbers: Sequence[float]) -> Reason | None:
        """Reason why a value is outside; None when it is inside.

        Args:
            numbers: of the operation's parameters in order, in SI units, as they would be sent, before rounding.
        """
        for number, (per_si, low, high) in zip(numbers, self._inside, strict=True):
            if not low <= number * per_si <= high:
                return self._why_not(numbers)
        return None

    def _why_not(self, numbers: Sequence[float]) -> Reason | None:
        for number, (per_si, granted, own) in zip(numbers, self._bounds, strict=True):
            if not math.isfinite(number):
                return Reason.NOT_FINITE
            scaled = number * per_si
            match granted:
                case Range():
                    inside = granted.low <= scaled <= granted.high
                case OneOf():
                    inside = scaled in granted.values
                case Flags() | Words() | Stems() | Each():
                    inside = False  # no bound of a number
                case _:
                    assert_never(granted)
            if not inside:
                return Reason.LIMIT_EXCEEDED_BY_REQUEST
            if not own.low <= scaled <= own.high:
                return Reason.ROBOT_LIMIT
        return None


def _both(granted: Bound, own: Range) -> tuple[int, int]:
    """Range of a number inside both bounds without another look; empty where the bound is a set."""
    return (max(granted.low, own.low), min(granted.high, own.high)) if isinstance(granted, Range) else (1, 0)
