"""Vector parameters: a pose or a set of joints has one limit for each axis, which together are a box.

An axis is a parameter like any other. The box is in the names alone: `q0`, `q1` .. `q5`, adjacent, of one unit.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.values.errors import FaultCode, ScopeError
from capabilities.values.scope import Bound, Grant, Limit, Range
from capabilities.values.units import DeclaredUnit, Measure, Parameter, Unit

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["VectorParameter", "box", "boxes_of"]

_AXIS: Final = re.compile(r"(.*[^0-9])(0|[1-9][0-9]?)", re.ASCII)
"""A name and the number of its axis, without leading zeros."""


@dataclass(frozen=True, slots=True)
class VectorParameter:
    """A vector parameter of a grant: at least two axes, `name` and their number, in one unit.

    Attributes:
        name: without the number.
        unit: of every axis.
        bounds: one for each axis, in their order.
    """

    name: str
    unit: Measure
    bounds: tuple[Bound, ...]


def box(name: str, unit: Measure, lows: Sequence[int], highs: Sequence[int]) -> tuple[Limit, ...]:
    """The limits of a vector parameter: axis i is named `name` and i, and reaches from ``lows[i]`` to ``highs[i]``.

    They stand in a grant in this order: ``Grant("ur3e", "move_joint", (*box("q", urad, lows, highs), speed))``.

    Raises:
        ScopeError: `STATEMENT_MALFORMED` unless there are as many lows as highs, at least one, and the name does not
            end in a digit; `OUT_OF_RANGE` for a low above its high.
    """
    if not lows or len(lows) != len(highs) or not name or name[-1].isdigit():
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "a box has a low and a high for each axis, and a name")
    if any(low > high for low, high in zip(lows, highs, strict=True)):
        raise ScopeError(FaultCode.OUT_OF_RANGE, f"{name}: a low above its high")
    return tuple(
        Limit(Parameter(f"{name}{axis}", unit), Range(low, high))
        for axis, (low, high) in enumerate(zip(lows, highs, strict=True))
    )


def boxes_of(grant: Grant) -> tuple[VectorParameter, ...]:
    """Vector parameters in a grant: each run of adjacent limits of one name, numbered from 0, in one unit.

    A run has two axes or more.
    """
    found: list[VectorParameter] = []
    run: VectorParameter | None = None
    for limit in grant.limits:
        named, unit = _AXIS.fullmatch(limit.parameter.name), limit.parameter.kind
        if named is None or not isinstance(unit, (Unit, DeclaredUnit)):
            run = None
        elif run is not None and (named[1], int(named[2]), unit) == (run.name, len(run.bounds), run.unit):
            run = VectorParameter(run.name, run.unit, (*run.bounds, limit.bound))
            found[-1] = run
        else:
            run = VectorParameter(named[1], unit, (limit.bound,)) if named[2] == "0" else None
            if run is not None:
                found.append(run)
    return tuple(run for run in found if len(run.bounds) > 1)
