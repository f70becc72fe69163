"""Physical quantities as integers: one table of units and the only conversions of the project.

A token, a request and a policy hold whole numbers, each with its unit. Floats live at the edges alone: `parse` turns
one into an integer or says exactly why it will not, and `si` turns an integer back for a library that wants SI floats.
A float is accepted only when it lies on the unit's grid, that is when the integer found for it converts back to the
very same float: the decided value is then the sent one, to the last bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from typing import Final

from capabilities.values.errors import FaultCode, QuantityError

INT_LIMIT: Final = 2**53 - 1
"""Largest magnitude of any integer in a request: every JSON reader keeps it exactly (RFC 8259 section 6)."""


class Unit(StrEnum):
    """Units of the profile `ztpm/1`; the value is the suffix that names it in parameters and facts."""

    MICRORADIAN = "urad"
    MICRORADIAN_PER_SECOND = "urad_s"
    MICRORADIAN_PER_SECOND2 = "urad_s2"
    MICROMETRE = "um"
    MICROMETRE_PER_SECOND = "um_s"
    MICROMETRE_PER_SECOND2 = "um_s2"
    MILLINEWTON = "mN"
    MILLINEWTON_METRE = "mNm"
    GRAM = "g"
    MILLISECOND = "ms"
    PERMILLE = "permille"
    COUNT = "count"

    @property
    def per_si(self) -> int:
        """Number of this unit that makes one of the SI unit (rad, m, N, N·m, kg, s, or 1)."""
        return _PER_SI[self]


_PER_SI: Final[dict[Unit, int]] = {
    Unit.MICRORADIAN: 1_000_000,
    Unit.MICRORADIAN_PER_SECOND: 1_000_000,
    Unit.MICRORADIAN_PER_SECOND2: 1_000_000,
    Unit.MICROMETRE: 1_000_000,
    Unit.MICROMETRE_PER_SECOND: 1_000_000,
    Unit.MICROMETRE_PER_SECOND2: 1_000_000,
    Unit.MILLINEWTON: 1_000,
    Unit.MILLINEWTON_METRE: 1_000,
    Unit.GRAM: 1_000,
    Unit.MILLISECOND: 1_000,
    Unit.PERMILLE: 1_000,
    Unit.COUNT: 1,
}


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of an operation: its name as tools spell it and the unit of its integer."""

    name: str
    unit: Unit


@dataclass(frozen=True, slots=True)
class Quantity:
    """One parameter of a request: its name, unit and integer."""

    name: str
    unit: Unit
    value: int


def parse(value: object, unit: Unit) -> int:
    """The integer for an SI number.

    Args:
        value: an int or float in the SI unit that `unit` divides (rad, m/s, N, kg, s ...); anything else is refused,
            bool included.
        unit: the unit wanted.

    Raises:
        QuantityError: `NOT_A_NUMBER` for another type, `NOT_FINITE` for NaN and infinities, `OUT_OF_RANGE` beyond 2^53
            - 1 units, `NOT_ON_GRID` when the nearest integer does not convert back to the same number (the error names
            the nearest one).
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise QuantityError(FaultCode.NOT_A_NUMBER, f"{type(value).__name__} is not a number")
    if isinstance(value, int):
        if not -INT_LIMIT <= value * unit.per_si <= INT_LIMIT:
            raise QuantityError(FaultCode.OUT_OF_RANGE, f"beyond {INT_LIMIT} {unit}")
        return value * unit.per_si
    if not math.isfinite(value):
        raise QuantityError(FaultCode.NOT_FINITE, "not a finite number")
    scaled = value * unit.per_si
    if not -INT_LIMIT <= scaled <= INT_LIMIT:
        raise QuantityError(FaultCode.OUT_OF_RANGE, f"beyond {INT_LIMIT} {unit}")
    whole = round(scaled)
    if si(whole, unit) != value:
        raise QuantityError(FaultCode.NOT_ON_GRID, f"finer than one {unit}; the nearest is {si(whole, unit)!r}")
    return whole


def scaled(value: object, scale: int, *, exact: bool) -> int:
    """The integer for a number of which one makes `scale` integers: the nearest one, of two the even one.

    The number is what its shortest decimal says, as JSON has it; -0.0 is 0.

    Args:
        value: an int or float; anything else is refused, bool included.
        scale: above 0.
        exact: a number between two integers is refused.

    Raises:
        QuantityError: as `parse`; `NOT_ON_GRID` only where `exact`.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise QuantityError(FaultCode.NOT_A_NUMBER, f"{type(value).__name__} is not a number")
    if isinstance(value, float) and not math.isfinite(value):
        raise QuantityError(FaultCode.NOT_FINITE, "not a finite number")
    if not -INT_LIMIT <= value * scale <= INT_LIMIT:
        raise QuantityError(FaultCode.OUT_OF_RANGE, f"beyond {INT_LIMIT}")
    whole = round(precise := Fraction(repr(value)) * scale)
    if exact and precise != whole:
        raise QuantityError(FaultCode.NOT_ON_GRID, f"finer than 1/{scale}; the nearest is {whole / scale!r}")
    return whole


def nearest(value: float, unit: Unit) -> float:
    """SI float on the grid of `unit` that is nearest to `value`.

    A value that is not finite, or too large for the grid, stays as it is.
    """
    scaled = value * unit.per_si
    return si(round(scaled), unit) if math.isfinite(scaled) else value


def si(value: int, unit: Unit) -> float:
    """The SI float of an integer quantity, correctly rounded (one division of exact integers)."""
    return value / unit.per_si
