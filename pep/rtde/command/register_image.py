"""Merged register image of one client: the controller's registers once every package has arrived.

A package carries a few variables and the controller keeps the rest, so no package alone determines the effect. A value
is judged at its use, not at its writing: ur_rtde leaves rubbish in variables that nothing reads.

An image begins with zeros, as a controller's registers do after it has started. A controller keeps its registers when a
client leaves, so an image for a new client is written out whole before anything else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, assert_never

from pep.rtde.wire.recipes import DOUBLE, INT
from pep.rtde.wire.refusal import InputRefusal
from pep.rtde.wire.variables import INPUTS, WIDTH, VariableType
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pep.rtde.wire.codec import Value
    from pep.rtde.wire.recipes import WritableVariables


@dataclass(frozen=True, slots=True)
class RegisterImage:
    """Values of every input variable of a profile.

    Attributes:
        profile: variables that may be written, and the first register.
        values: of each of its variables.
    """

    profile: WritableVariables
    values: Mapping[str, Value]

    @classmethod
    def blank(cls, profile: WritableVariables) -> RegisterImage:
        """Image of zeros."""
        return cls(profile, {name: _zero(INPUTS[name]) for name in profile.names})

    def merge(self, package: Mapping[str, Value]) -> RegisterImage | InputRefusal:
        """Image after `package`.

        Returns:
            Refused for a variable outside the profile (`TOOL_UNKNOWN`), or a value that is not of its variable's type
            (`OUT_OF_RANGE` for a whole number too large, `PARAMETERS_WRONG` for anything else). NaN is a double.
        """
        for name, value in package.items():
            if name not in self.profile.names:
                return InputRefusal(Reason.TOOL_UNKNOWN, "a variable outside the profile")
            kind = INPUTS[name]
            # Nearly all are doubles, five thousand times a second.
            reason = None if kind is VariableType.DOUBLE and type(value) is float else _misfit(kind, value)
            if reason is not None:
                return InputRefusal(reason, name)
        return RegisterImage(self.profile, {**self.values, **package})

    def whole(self, register: int) -> int:
        """Integer register, counted from the client's first; 0 when the profile does not have it."""
        found = self.values.get(INT[self.profile.offset + register], 0)
        assert isinstance(found, int)
        return found

    def double(self, register: int) -> float:
        """Double register, counted from the client's first; 0 when the profile does not have it."""
        found = self.values.get(DOUBLE[self.profile.offset + register], 0.0)
        assert isinstance(found, float)
        return found

    def doubles(self, first: int, count: int) -> tuple[float, ...]:
        """Several double registers in a row."""
        begin = self.profile.offset + first
        found = tuple(self.values.get(name, 0.0) for name in DOUBLE[begin : begin + count])
        assert all(isinstance(each, float) for each in found)
        return found  # type: ignore[return-value]  # asserted

    def number(self, name: str) -> float:
        """Variable of one number, by its name; 0 when the profile does not have it."""
        found = self.values.get(name, 0)
        assert isinstance(found, int | float)
        return found

    def vector(self, name: str) -> tuple[float, ...]:
        """Variable of several numbers, by its name; zeros when the profile does not have it."""
        found = self.values.get(name, _zero(INPUTS[name]))
        assert isinstance(found, tuple)
        return found


def _zero(kind: VariableType) -> Value:
    if kind in WIDTH:
        return (0.0,) * WIDTH[kind]
    return 0.0 if kind is VariableType.DOUBLE else 0


_WHOLE: Final = {VariableType.UINT8: (0, 2**8), VariableType.UINT32: (0, 2**32), VariableType.INT32: (-(2**31), 2**31)}


def _misfit(kind: VariableType, value: Value) -> Reason | None:
    """Reason why a value does not have this type; None when it does."""
    match kind:
        case VariableType.UINT8 | VariableType.UINT32 | VariableType.INT32:
            if type(value) is not int:
                return Reason.PARAMETERS_WRONG
            low, beyond = _WHOLE[kind]
            return None if low <= value < beyond else Reason.OUT_OF_RANGE
        case VariableType.DOUBLE:
            return None if type(value) is float else Reason.PARAMETERS_WRONG  # NaN too
        case VariableType.VECTOR6D:
            fits = isinstance(value, tuple) and len(value) == WIDTH[kind] and all(type(item) is float for item in value)
            return None if fits else Reason.PARAMETERS_WRONG
        case (
            VariableType.BOOL
            | VariableType.UINT64
            | VariableType.VECTOR3D
            | VariableType.VECTOR6INT32
            | VariableType.VECTOR6UINT32
            | VariableType.NOT_FOUND
            | VariableType.IN_USE
        ):
            raise AssertionError(f"no profile has a variable of type {kind}")
        case _:
            assert_never(kind)
