"""Words of a program to a Robotiq gripper, read into what they mean. Others are refused.

A program sets registers by name and byte, and reads them. Position, speed and force alone move nothing; a position
does where the gripper is to go to it (GTO).
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, TypeAlias

from pep.base.operations import FINGER_SPEED_UM_S, GRIP_MN, STROKE_UM
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from collections.abc import Mapping

REGISTER: Final = 255  # G1: one byte each for speed and force, linear
CLOSED: Final = 228  # G1: position register at which the fingers touch; 255 is never reached
MAX_LINE: Final = 256
"""Bytes of a line without its end; the longest that a client library sends has a fifth."""
WRITABLE: Final[Mapping[str, int]] = MappingProxyType(
    {"ACT": 1, "GTO": 1, "ATR": 1, "ARD": 1, "FOR": REGISTER, "SPE": REGISTER, "POS": REGISTER}
)
"""Registers that a program may name after SET, with the greatest value of each (G1)."""
READABLE: Final = frozenset((*WRITABLE, "PRE", "OBJ", "STA", "FLT", "PCO"))


@dataclass(frozen=True, slots=True)
class MoveFingers:
    """Moves the fingers.

    Attributes:
        position, speed, force: registers, 0 to 255.
    """

    position: int
    speed: int
    force: int

    @property
    def width_um(self) -> int:
        """Opening that the position means."""
        return round((CLOSED - min(self.position, CLOSED)) * STROKE_UM / CLOSED)

    @property
    def speed_um_s(self) -> int:
        """Speed of the fingers."""
        return _value(self.speed, *FINGER_SPEED_UM_S)

    @property
    def force_mn(self) -> int:
        """Force of the grip."""
        return _value(self.force, *GRIP_MN)


@dataclass(frozen=True, slots=True)
class ActivateFingers:
    """Makes the gripper ready: the fingers make a full stroke, unless it is ready already."""


GripperCommand: TypeAlias = MoveFingers | ActivateFingers


@dataclass(frozen=True, slots=True)
class ReadRegister:
    """Reads a register of that name."""

    name: str


@dataclass(frozen=True, slots=True)
class SetRegisters:
    """Sets registers by their names."""

    values: Mapping[str, int]


def parse_gripper_line(line: bytes) -> ReadRegister | SetRegisters | InputRefusal:
    """Content of a line. Never raises.

    Args:
        line: without its line feed; one carriage return before it is taken for part of the end.

    Returns:
        Refused as `BODY_TOO_LARGE` for a line that is too long, `TOOL_UNKNOWN` for other words, `OUT_OF_RANGE` for a
        value that the register cannot have, `PARAMETERS_WRONG` for a register that is named twice.
    """
    if len(line) > MAX_LINE:
        return InputRefusal(Reason.BODY_TOO_LARGE, "gripper line")
    match line.removesuffix(b"\r").decode("latin-1").split(" "):
        case ["GET", name] if name in READABLE:
            return ReadRegister(name)
        case ["SET", *pairs] if pairs and len(pairs) % 2 == 0:
            return _set(pairs[::2], pairs[1::2])
        case _:
            return InputRefusal(Reason.TOOL_UNKNOWN, "gripper line")


def _set(names: list[str], values: list[str]) -> SetRegisters | InputRefusal:
    if not set(names) <= WRITABLE.keys():
        return InputRefusal(Reason.TOOL_UNKNOWN, "gripper register")
    if len(set(names)) < len(names):
        return InputRefusal(Reason.PARAMETERS_WRONG, "a register twice")
    read: dict[str, int] = {}
    for name, value in zip(names, values, strict=True):
        if not (value.isascii() and value.isdigit() and len(value) <= len(str(REGISTER))):
            return InputRefusal(Reason.OUT_OF_RANGE, name)
        read[name] = int(value)
        if read[name] > WRITABLE[name]:
            return InputRefusal(Reason.OUT_OF_RANGE, name)
    return SetRegisters(MappingProxyType(read))


def byte_of(value: int, low: int, high: int) -> int:
    """Byte nearest to a value on the scale from `low` to `high`."""
    return round((value - low) * REGISTER / (high - low))


def _value(byte: int, low: int, high: int) -> int:
    """Value that a byte means on the scale from `low` to `high`."""
    return low + round(byte * (high - low) / REGISTER)
