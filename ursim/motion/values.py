"""URScript values: numbers, strings and booleans are Python's own; lists and poses are here, with value semantics."""

from __future__ import annotations

import math
from typing import Any, Final, TypeAlias

from ursim.motion.spatial import (
    add,
    chain,
    compose,
    from_rpy,
    from_vector,
    inverse,
    to_frame,
    to_pose,
    to_vector,
    transpose,
)

INT_LOW: Final = -(2**31)
INT_HIGH: Final = 2**31 - 1
MAX_TEXT: Final = 32_768  # characters of a string; keeps a doubling loop from eating the host
MAX_ITEMS: Final = 4_096  # items of a list

Value: TypeAlias = Any  # a number, a boolean, a string, a Vector or a Pose, a thread handle


class ScriptRuntimeError(Exception):
    """Runtime exception of a controller: the program ends."""


class Vector(list[Value]):
    """A list of fixed length. Reading or writing outside it is an error, negative indices included."""

    def __getitem__(self, index: Any) -> Any:
        """The item at `index`; a pair reads an element of a list of lists."""
        if type(index) is tuple:
            return self[index[0]][index[1]]
        return list.__getitem__(self, self._checked(index))

    def __setitem__(self, index: Any, value: Any) -> None:
        """Replaces one item."""
        if type(index) is tuple:
            self[index[0]][index[1]] = value
        else:
            list.__setitem__(self, self._checked(index), value)

    def _checked(self, index: Any) -> int:
        if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < len(self):
            raise ScriptRuntimeError(f"index {index!r} is outside a list of {len(self)}")
        return index

    def _each(self, other: Any, sign: float) -> Vector:
        if not isinstance(other, list) or len(other) != len(self):
            raise ScriptRuntimeError("lists of different length cannot be added")
        return type(self)(a + sign * b for a, b in zip(self, other, strict=True))

    def __add__(self, other: Any) -> Any:
        """Item by item, as URScript adds lists."""
        return self._each(other, 1)

    def __sub__(self, other: Any) -> Any:
        """Item by item."""
        return self._each(other, -1)

    def __mul__(self, factor: Any) -> Any:
        """Product with a number."""
        if isinstance(factor, list):
            raise ScriptRuntimeError("lists cannot be multiplied")
        return type(self)(item * factor for item in self)

    __rmul__ = __mul__

    def __truediv__(self, divisor: Any) -> Any:
        """Quotient by a number."""
        return type(self)(item / divisor for item in self)


class Pose(Vector):
    """Six numbers that mean a pose: metres and a rotation vector."""


def copied(value: Value) -> Value:
    """Value that an assignment, a return or a parameter keeps.

    A list is copied, and an integer must be inside 32 bits.
    """
    kind = type(value)
    if kind is int:
        if not INT_LOW <= value <= INT_HIGH:
            raise ScriptRuntimeError("an integer outside 32 bits")
    elif kind is Vector or kind is Pose:
        if len(value) > MAX_ITEMS or any(
            isinstance(item, list) and any(isinstance(x, list) for x in item) for item in value
        ):
            raise ScriptRuntimeError("a list too long or nested too deep")
        return kind(copied(item) if isinstance(item, list) else item for item in value)
    elif kind is str and len(value) > MAX_TEXT:
        raise ScriptRuntimeError("a string that is too long")
    return value


def power(base: float, exponent: float) -> float:
    """`base ^ exponent`, always as a float, so that no integer grows without end."""
    return math.pow(base, exponent)


def number(value: Value, name: str) -> float:
    """`value` as a finite float.

    Raises:
        ScriptRuntimeError: it is no number, NaN or infinite.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ScriptRuntimeError(f"{name} must be a finite number")
    return float(value)


def positive(value: Value, name: str) -> float:
    """`value` as a finite float above zero."""
    found = number(value, name)
    if not found > 0.0:
        raise ScriptRuntimeError(f"{name} must be above zero")
    return found


def six(value: Value, name: str) -> tuple[float, ...]:
    """`value` as six finite floats."""
    if not isinstance(value, list) or len(value) != 6:
        raise ScriptRuntimeError(f"{name} must have six numbers")
    return tuple(number(item, name) for item in value)


def three(value: Value, name: str) -> tuple[float, float, float]:
    """`value` as three finite floats."""
    if not isinstance(value, list) or len(value) != 3:
        raise ScriptRuntimeError(f"{name} must have three numbers")
    x, y, z = (number(item, name) for item in value)
    return x, y, z


def pose_trans(start: Value, step: Value) -> Pose:
    """The pose `step`, given in `start`, as seen from where `start` is given."""
    return Pose(to_pose(chain(to_frame(six(start, "p_from")), to_frame(six(step, "p_from_to")))))


def pose_inv(pose: Value) -> Pose:
    """The pose that undoes `pose`."""
    return Pose(to_pose(inverse(to_frame(six(pose, "p_from")))))


def pose_add(first: Value, second: Value) -> Pose:
    """Positions added, rotations composed."""
    (p1, r1), (p2, r2) = to_frame(six(first, "p_1")), to_frame(six(second, "p_2"))
    return Pose((*add(p1, p2), *to_vector(compose(r1, r2))))


def pose_sub(to: Value, start: Value) -> Pose:
    """Positions subtracted, the rotation from `start` to `to`."""
    (p1, r1), ((x, y, z), r2) = to_frame(six(to, "p_to")), to_frame(six(start, "p_from"))
    return Pose((*add(p1, (-x, -y, -z)), *to_vector(compose(r1, transpose(r2)))))


def point_dist(start: Value, to: Value) -> float:
    """The distance [m] between the positions of two poses."""
    return math.dist(six(start, "p_from")[:3], six(to, "p_to")[:3])


def interpolate_pose(start: Value, to: Value, alpha: Value) -> Pose:
    """The pose at `alpha` of the straight way: 0 is `start`, 1 is `to`."""
    (p1, r1), (p2, r2) = to_frame(six(start, "p_from")), to_frame(six(to, "p_to"))
    part = number(alpha, "alpha")
    x, y, z = (a + part * (b - a) for a, b in zip(p1, p2, strict=True))
    rx, ry, rz = (part * each for each in to_vector(compose(r2, transpose(r1))))
    return Pose((x, y, z, *to_vector(compose(from_vector((rx, ry, rz)), r1))))


def rotvec2rpy(vector: Value) -> Vector:
    """Roll, pitch and yaw of a rotation vector: Rz(yaw) Ry(pitch) Rx(roll)."""
    r = from_vector(three(vector, "rotation_vector"))
    return Vector((math.atan2(r[7], r[8]), math.atan2(-r[6], math.hypot(r[0], r[3])), math.atan2(r[3], r[0])))


def rpy2rotvec(vector: Value) -> Vector:
    """The rotation vector of roll, pitch and yaw."""
    return Vector(to_vector(from_rpy(*three(vector, "rpy_vector"))))


def logarithm(base: Value, value: Value) -> float:
    """The logarithm of `value` to `base`."""
    return math.log(number(value, "f"), number(base, "b"))


def norm(value: Value) -> float:
    """Length of a vector, or of a number."""
    if isinstance(value, list):
        return math.hypot(*value)
    return abs(number(value, "norm"))


def as_text(value: Value) -> str:
    """The text of a value, as the controller writes it to its log."""
    if isinstance(value, list):
        return ("p" if type(value) is Pose else "") + "[" + ", ".join(map(as_text, value)) + "]"
    return str(value)
