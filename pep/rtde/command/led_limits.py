"""Limits of motions that a force or a hand leads, taken from the grant.

ur_rtde's force mode and freedrive name no end, and freedrive no speed. To a controller that is for ever and at any
speed; here it is the most that the grant has ([LSD-18]). Public programs give force mode limits that nothing ever
reaches, metres and radians per second; these are lowered to the grant's, and the program is told ([LSD-19]). Pure.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from capabilities.values.chain import Chain
from capabilities.values.scope import OneOf, Range
from capabilities.values.units import si
from pep.base.operations import FORCE_MODE
from pep.rtde.command import command_values as v
from pep.rtde.command.rounding import on_grid

if TYPE_CHECKING:
    from capabilities.values.scope import Grant
    from pep.base.operation_row import BoundedParameter, Operation

HELD: Final = (0.01, 0.01, 0.01, 0.1, 0.1, 0.1)
"""Ours: largest deviation of an axis that is held, m and rad.

A controller that is pushed farther stops by itself.
"""
AXES: Final = ("x", "y", "z")
SPEEDS: Final = FORCE_MODE.limits[12:18]
"""Limits of the speed along and about each axis."""
NO_AXES: Final = (0.0,) * 6


def granted(chain: object, operation: Operation) -> Grant | None:
    """Grant of a token for an operation; None where it has none, or is none."""
    return chain.scope.find(operation.object, operation.name) if isinstance(chain, Chain) else None


def most_of(limit: BoundedParameter, grant: Grant | None) -> float:
    """Most that a parameter may be, in SI units, by its grant and the robot.

    Without a grant it is the robot's.
    """
    own, unit = limit.range, limit.parameter.unit
    for granted in () if grant is None else grant.limits:
        if granted.parameter.name == limit.parameter.name:
            match granted.bound:
                case Range(high=high):
                    return si(min(high, own.high), unit)
                case OneOf(values):
                    inside = [value for value in values if own.low <= value <= own.high]
                    return si(max(inside, default=own.low), unit)
                case _:
                    return si(own.low, unit)
    return si(own.high, unit)


def ends_of(operation: Operation, grant: Grant | None, *, count: int) -> tuple[float, ...]:
    """The last `count` parameters of an operation, which no command says: the most that the grant has."""
    return tuple(most_of(limit, grant) for limit in operation.limits[-count:])


def lowered(command: v.ForceMode, grant: Grant | None) -> tuple[v.ForceMode, str]:
    """Force mode with limits no higher than granted, and what was lowered, as words; "" where nothing was.

    A force along an axis that is held does nothing, and becomes 0.
    """
    asked = on_grid(command)
    assert isinstance(asked, v.ForceMode)
    limits, wrench = list(asked.limits), list(asked.wrench_n_nm)
    changed: list[str] = []  # of compliant axes first: the text has little room
    for axis, (compliant, speed) in enumerate(zip(asked.selection, SPEEDS, strict=True)):
        most = most_of(speed, grant) if compliant else HELD[axis]
        if limits[axis] > most:
            unit = speed.parameter.unit
            limits[axis] = most
            if compliant:
                changed.insert(0, f"{speed.parameter.name}={round(most * unit.per_si)} {unit}")
            else:
                changed.append(f"{_name(axis)} held to {most:g}")
        if not compliant and wrench[axis]:
            wrench[axis] = 0.0
            changed.append(f"{_name(axis)} without force")
    if not changed:
        return asked, ""
    return replace(asked, limits=tuple(limits), wrench_n_nm=tuple(wrench)), ", ".join(changed)  # type: ignore[arg-type]


def _name(axis: int) -> str:
    return ("" if axis < len(AXES) else "r") + AXES[axis % len(AXES)]
