"""Kinds of parameters, and physical quantities as integers: one table of units and the project's only conversions.

A parameter is a quantity, whose kind is its unit, or of a `Sort`, or a list. A token, a request and a policy hold
quantities as whole numbers, each with its unit. Floats live at the edges alone: `parse` turns one into an integer or
says exactly why it will not, and `si` turns an integer back for a library that wants SI floats.
A float is accepted only when it lies on the unit's grid, that is when the integer found for it converts back to the
very same float: the decided value is then the sent one, to the last bit.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from decimal import Context, Decimal, Inexact
from enum import StrEnum
from typing import Final, TypeAlias

from capabilities.values.errors import FaultCode, QuantityError, ScopeError

INT_LIMIT: Final = 2**53 - 1
"""Largest magnitude of any integer in a request: every JSON reader keeps it exactly (RFC 8259 section 6)."""
_EXACTLY: Final = Context(prec=64, traps=[Inexact])
"""Arithmetic for the shortest decimal of a float, at most 17 digits, and a scale: a rounded product raises."""


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
    MILLIDEGREE_CELSIUS = "mdegC"
    MILLIKELVIN = "mK"
    MILLIVOLT = "mV"
    MILLIAMPERE = "mA"
    MILLIWATT = "mW"
    MILLILITRE = "mL"
    PASCAL = "Pa"
    HERTZ = "Hz"

    @property
    def per_si(self) -> int:
        """Number of this unit that makes one of its SI unit.

        rad, m, N, N·m, kg, s, °C, K, V, A, W, m³, Pa, Hz, or 1.
        """
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
    Unit.MILLIDEGREE_CELSIUS: 1_000,
    Unit.MILLIKELVIN: 1_000,
    Unit.MILLIVOLT: 1_000,
    Unit.MILLIAMPERE: 1_000,
    Unit.MILLIWATT: 1_000,
    Unit.MILLILITRE: 1_000_000,
    Unit.PASCAL: 1,
    Unit.HERTZ: 1,
}


@dataclass(frozen=True, slots=True)
class DeclaredUnit:
    """Unit that a tool declares, or the minor unit of a currency: part of something of which `scale` make one.

    Its scale stands wherever its name does, so that no declaration elsewhere can change a limit's meaning.

    Attributes:
        name: ``x-`` and a name of the tool's own, or ``cur-`` and a code of ISO 4217.
        scale: how many of this unit make one of what the name says: 1 to 10^9.
    """

    name: str
    scale: int

    def __str__(self) -> str:
        return f"{self.name}/{self.scale}"

    @property
    def per_si(self) -> int:
        """Number of this unit that makes one of what its name says."""
        return self.scale


class Sort(StrEnum):
    """Kind of a parameter that is no number, as tokens spell it."""

    FLAG = "flag"
    TEXT = "text"
    PATH = "path"
    URL = "url"
    FREE = "free"
    """Any JSON value: its size is limited, and its digest is decided on and recorded."""


Measure: TypeAlias = Unit | DeclaredUnit
"""Unit of a quantity."""
Scalar: TypeAlias = Unit | DeclaredUnit | Sort
"""Kind of one value."""


@dataclass(frozen=True, slots=True)
class ListOf:
    """Kind of a list of any length, whose members are of one kind, which is not `Sort.FREE`."""

    element: Scalar

    def __str__(self) -> str:
        return f"[{self.element}]"


Kind: TypeAlias = Unit | DeclaredUnit | Sort | ListOf
"""Kind of a parameter."""
DECLARED: Final = re.compile(r"(x-[a-z][a-z0-9_]{0,30}|cur-[A-Z]{3})/([1-9][0-9]{0,8}|1000000000)", re.ASCII)
"""Spelling of a declared unit with its scale."""
_KINDS: Final[dict[str, Unit | Sort]] = {**{str(each): each for each in Unit}, **{str(each): each for each in Sort}}


def kind_of(spelled: str) -> Kind:
    """The kind that a token spells so; ``str`` of it gives the same text.

    Raises:
        ScopeError: `STATEMENT_MALFORMED` when there is none.
    """
    if spelled.startswith("[") and spelled.endswith("]"):
        element = kind_of(spelled[1:-1])
        if isinstance(element, ListOf) or element is Sort.FREE:
            raise ScopeError(FaultCode.STATEMENT_MALFORMED, "a list of lists, or of free values")
        return ListOf(element)
    found = _KINDS.get(spelled)
    if found is not None:
        return found
    declared = DECLARED.fullmatch(spelled)
    if declared is None:
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "no such kind of parameter")
    return DeclaredUnit(declared[1], int(declared[2]))


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of an operation: its name as tools spell it and its kind, which is a quantity's unit."""

    name: str
    kind: Kind

    @property
    def unit(self) -> Unit:
        """Unit of a quantity in one of the profile's own units.

        Raises:
            TypeError: when it is none.
        """
        if isinstance(self.kind, Unit):
            return self.kind
        raise TypeError("not a quantity in a unit of the profile")


@dataclass(frozen=True, slots=True)
class Quantity:
    """One parameter of a request: its name, unit and integer."""

    name: str
    unit: Measure
    value: int


def parse(value: object, unit: Measure) -> int:
    """The integer for an SI number.

    Args:
        value: an int or float in the SI unit that `unit` divides (rad, m/s, N, kg, s ...), or in what a declared one
            divides; anything else is refused, bool included.
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
    whole = round(precise := _EXACTLY.multiply(Decimal(repr(value)), scale))
    if exact and precise != whole:
        raise QuantityError(FaultCode.NOT_ON_GRID, f"finer than 1/{scale}; the nearest is {whole / scale!r}")
    return whole


def nearest(value: float, unit: Measure) -> float:
    """SI float on the grid of `unit` that is nearest to `value`.

    A value that is not finite, or too large for the grid, stays as it is.
    """
    scaled = value * unit.per_si
    return si(round(scaled), unit) if math.isfinite(scaled) else value


def si(value: int, unit: Measure) -> float:
    """The SI float of an integer quantity, correctly rounded (one division of exact integers)."""
    return value / unit.per_si
