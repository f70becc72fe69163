"""Fields of a command's parameters in the registers, one each, which read, judge and write it.

Registers are counted from the client's first one. A number is judged here and nowhere else: one that is not finite, or
outside of ur_rtde's own range, belongs to no command.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias

from pep.rtde.command.command_values import JogFrame
from pep.rtde.wire.recipes import DOUBLE, INT
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from pep.rtde.command.register_image import RegisterImage
    from pep.rtde.wire.codec import Value
    from pep.rtde.wire.recipes import Offset

Written: TypeAlias = dict[str, "Value"]


class WrongParameterError(Exception):
    """Parameter that a command cannot have; never leaves the reading of a command."""

    def __init__(self, reason: Reason, place: str) -> None:
        super().__init__(place)
        self.reason = reason
        self.place = place


@dataclass(frozen=True, slots=True)
class Span:
    """The numbers from `low` to `high`, both among them."""

    low: float
    high: float


_INF: Final = math.inf
ANY: Final = Span(-_INF, _INF)
NOT_NEGATIVE: Final = Span(0.0, _INF)
POSITIVE: Final = Span(math.ulp(0.0), _INF)
JOINT_SPEED: Final = Span(0.0, 3.14)  # U12 (docs/physics.md), rad/s
JOINT_ACCELERATION: Final = Span(0.0, 40.0)  # U12, rad/s2
TOOL_SPEED: Final = Span(0.0, 3.0)  # U12, m/s
TOOL_ACCELERATION: Final = Span(0.0, 150.0)  # U12, m/s2
LOOKAHEAD: Final = Span(0.03, 0.2)  # U12, s
GAIN: Final = Span(100.0, 2000.0)  # U12
BLEND: Final = Span(0.0, 2.0)  # U12, m
FORCE_DAMPING: Final = Span(0.0, 1.0)  # URScript manual, force_mode_set_damping
FORCE_GAIN: Final = Span(0.0, 2.0)  # URScript manual, force_mode_set_gain_scaling


def judged(value: float, span: Span, place: str, register: int | None = None) -> float:
    """The value, after checks that it is finite and in the span.

    Args:
        value: to judge.
        span: range of the value.
        place: name for the record.
        register: number of the register, if it has one.

    Raises:
        WrongParameterError: `NOT_FINITE`, or `ROBOT_LIMIT` outside the span.
    """
    if math.isfinite(value) and span.low <= value <= span.high:
        return value
    reason = Reason.ROBOT_LIMIT if math.isfinite(value) else Reason.NOT_FINITE
    raise WrongParameterError(reason, place if register is None else f"{place} {register}")


@dataclass(frozen=True, slots=True)
class Number:
    """One double."""

    register: int
    span: Span = ANY

    def names(self, offset: Offset) -> tuple[str, ...]:
        """Variables of the field."""
        return (DOUBLE[offset + self.register],)

    def read(self, image: RegisterImage) -> float:
        """The number."""
        return judged(image.double(self.register), self.span, "double", self.register)

    def write(self, value: object, offset: Offset) -> Written:
        """Variables to write for it."""
        assert isinstance(value, float)
        return {DOUBLE[offset + self.register]: value}


@dataclass(frozen=True, slots=True)
class Numbers:
    """Several doubles in a row."""

    first: int
    count: int

    def names(self, offset: Offset) -> tuple[str, ...]:
        """Variables of the field."""
        return DOUBLE[offset + self.first : offset + self.first + self.count]

    def read(self, image: RegisterImage) -> tuple[float, ...]:
        """The numbers."""
        values = image.doubles(self.first, self.count)
        if not all(map(math.isfinite, values)):
            raise WrongParameterError(Reason.NOT_FINITE, f"doubles from {self.first}")
        return values

    def write(self, value: object, offset: Offset) -> Written:
        """Variables to write for them."""
        assert isinstance(value, tuple)
        return dict(zip(self.names(offset), value, strict=True))


@dataclass(frozen=True, slots=True)
class Whole:
    """One integer."""

    register: int
    low: int
    high: int

    def names(self, offset: Offset) -> tuple[str, ...]:
        """Variables of the field."""
        return (INT[offset + self.register],)

    def read(self, image: RegisterImage) -> int:
        """The integer."""
        value = image.whole(self.register)
        if not self.low <= value <= self.high:
            raise WrongParameterError(Reason.OUT_OF_RANGE, f"integer {self.register}")
        return value

    def write(self, value: object, offset: Offset) -> Written:
        """Variables to write for it."""
        assert isinstance(value, int)
        return {INT[offset + self.register]: value}


@dataclass(frozen=True, slots=True)
class Flag:
    """One integer that is 0 or 1."""

    register: int

    def names(self, offset: Offset) -> tuple[str, ...]:
        """Variables of the field."""
        return (INT[offset + self.register],)

    def read(self, image: RegisterImage) -> bool:
        """True where the integer is 1."""
        value = image.whole(self.register)
        if value not in (0, 1):
            raise WrongParameterError(Reason.PARAMETERS_WRONG, f"integer {self.register}")
        return value == 1

    def write(self, value: object, offset: Offset) -> Written:
        """Variables to write for it."""
        return {INT[offset + self.register]: int(value is True)}


@dataclass(frozen=True, slots=True)
class Flags:
    """Six integers in a row that are 0 or 1 each."""

    first: int

    def names(self, offset: Offset) -> tuple[str, ...]:
        """Variables of the field."""
        return INT[offset + self.first : offset + self.first + 6]

    def read(self, image: RegisterImage) -> tuple[bool, ...]:
        """True for each integer that is 1."""
        return tuple(Flag(self.first + axis).read(image) for axis in range(6))

    def write(self, value: object, offset: Offset) -> Written:
        """Variables to write for them."""
        assert isinstance(value, tuple)
        return {name: int(item is True) for name, item in zip(self.names(offset), value, strict=True)}


@dataclass(frozen=True, slots=True)
class FrameNumber:
    """Frame of a jog: ur_rtde sends its number as a double."""

    register: int

    def names(self, offset: Offset) -> tuple[str, ...]:
        """Variables of the field."""
        return (DOUBLE[offset + self.register],)

    def read(self, image: RegisterImage) -> JogFrame:
        """The frame."""
        value = judged(image.double(self.register), ANY, "double", self.register)
        for frame in JogFrame:
            if value == frame.value:
                return frame
        raise WrongParameterError(Reason.PARAMETERS_WRONG, f"double {self.register}")

    def write(self, value: object, offset: Offset) -> Written:
        """Variables to write for it."""
        assert isinstance(value, JogFrame)
        return {DOUBLE[offset + self.register]: float(value.value)}


@dataclass(frozen=True, slots=True)
class Vector:
    """Six doubles in a variable that is no register."""

    name: str

    def names(self, offset: Offset) -> tuple[str, ...]:
        """Variables of the field."""
        del offset
        return (self.name,)

    def read(self, image: RegisterImage) -> tuple[float, ...]:
        """The numbers."""
        values = image.vector(self.name)
        if not all(map(math.isfinite, values)):
            raise WrongParameterError(Reason.NOT_FINITE, self.name)
        return values

    def write(self, value: object, offset: Offset) -> Written:
        """Variables to write for it, at any offset."""
        del offset
        assert isinstance(value, tuple)
        return {self.name: value}


@dataclass(frozen=True, slots=True)
class Fixed:
    """Parameter that follows from the command's id."""

    value: object

    def names(self, offset: Offset) -> tuple[str, ...]:
        """Variables of the field: none."""
        del offset
        return ()

    def read(self, image: RegisterImage) -> object:
        """The constant value."""
        del image
        return self.value

    def write(self, value: object, offset: Offset) -> Written:
        """Variables to write: none."""
        del value, offset
        return {}


Field: TypeAlias = Number | Numbers | Whole | Flag | Flags | FrameNumber | Vector | Fixed
