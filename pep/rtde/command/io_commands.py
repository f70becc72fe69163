"""Effects of a package beside its command: outputs, the speed slider, free registers, the external wrench.

The controller takes these from their variables when they are written, under every command register. A mask names the
meant outputs; a level under no mask is only staged, and ur_rtde may send any rubbish there.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Final, TypeAlias, assert_never

from pep.rtde.command.command_values import SetExternalWrench
from pep.rtde.command.fields import ANY, Span, Vector, WrongParameterError, judged
from pep.rtde.wire.recipes import DOUBLE, EXTERNAL_WRENCH, FIRST_FREE, INT, LAST_FREE, OFFSETS
from pep.rtde.wire.refusal import InputRefusal
from pep.rtde.wire.variables import INPUTS
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from pep.rtde.command.register_image import RegisterImage
    from pep.rtde.wire.codec import Value
    from pep.rtde.wire.recipes import Offset


class Bank(Enum):
    """Digital outputs that belong together, by the beginning of their variables' names."""

    STANDARD = "standard_digital_output"
    CONFIGURABLE = "configurable_digital_output"
    TOOL = "tool_digital_output"


@dataclass(frozen=True, slots=True)
class SetDigitalOutputs:
    """Sets digital outputs.

    Attributes:
        bank: of which.
        mask: bit i: output i is meant.
        levels: bit i: output i is to be high; zero outside the mask.
    """

    bank: Bank
    mask: int
    levels: int


class Quantity(Enum):
    """Quantity of an analog output, by its bit."""

    CURRENT = 0
    VOLTAGE = 1


@dataclass(frozen=True, slots=True)
class SetAnalogOutput:
    """Sets an analog output to a part (0 to 1) of its range."""

    channel: int
    quantity: Quantity
    ratio: float


@dataclass(frozen=True, slots=True)
class SetSpeedSlider:
    """Scales every speed by this (0 to 1)."""

    fraction: float


@dataclass(frozen=True, slots=True)
class SetInputInteger:
    """Sets a free integer register of the controller, by its own number."""

    register: int
    value: int


@dataclass(frozen=True, slots=True)
class SetInputDouble:
    """Sets a free double register of the controller, by its own number."""

    register: int
    value: float


IoCommand: TypeAlias = (
    SetDigitalOutputs | SetAnalogOutput | SetSpeedSlider | SetInputInteger | SetInputDouble | SetExternalWrench
)

_WIDTH: Final = {Bank.STANDARD: 8, Bank.CONFIGURABLE: 8, Bank.TOOL: 2}
_CHANNELS: Final = 2
_ANALOG: Final = "standard_analog_output_"
_SLIDER: Final = "speed_slider_"
_PART: Final = Span(0.0, 1.0)
# Registers are all that moves with the offset.
_DIRECT: Final = {
    offset: frozenset(
        [name for name in INPUTS if "_register" not in name]
        + [
            names[register]
            for names in (INT, DOUBLE)
            for register in range(offset + FIRST_FREE, offset + LAST_FREE + 1)
        ]
    )
    for offset in OFFSETS
}


def decode_io(image: RegisterImage, written: Collection[str]) -> tuple[IoCommand, ...] | InputRefusal:
    """Effects of a package by its variables alone; empty when it touches none of them. Never raises.

    Args:
        image: with the package merged.
        written: the package's variables. To write an output again is to set it again, so the image alone is not enough.

    Returns:
        Refused as `OUT_OF_RANGE` for a mask of outputs that do not exist, `NOT_FINITE` or `ROBOT_LIMIT` for a number.
    """
    if _DIRECT[image.profile.offset].isdisjoint(written):
        return ()
    try:
        return tuple(_said(image, written))
    except WrongParameterError as wrong:
        return InputRefusal(wrong.reason, wrong.place)


def method_of(command: IoCommand) -> str:
    """ur_rtde's method for a command, with which a refusal names it to the program's author."""
    match command:
        case SetDigitalOutputs(bank=bank):
            return f"set{bank.name.capitalize()}DigitalOut"
        case SetAnalogOutput(quantity=quantity):
            return f"setAnalogOutput{quantity.name.capitalize()}"
        case SetSpeedSlider():
            return "setSpeedSlider"
        case SetInputInteger():
            return "setInputIntRegister"
        case SetInputDouble():
            return "setInputDoubleRegister"
        case SetExternalWrench():
            return "setExternalForceTorque"
        case _:
            assert_never(command)


MASKS: Final = (*(f"{bank.value}_mask" for bank in Bank), _ANALOG + "mask", _SLIDER + "mask")
"""Variables that make a package set anything; zero where nothing is meant."""


def encode_io(command: IoCommand, offset: Offset) -> dict[str, Value]:
    """Variables to write for a command; with all other `MASKS` zero, they do nothing else."""
    match command:
        case SetDigitalOutputs(bank, mask, levels):
            return {f"{bank.value}_mask": mask, bank.value: levels}
        case SetAnalogOutput(channel, quantity, ratio):
            return {
                _ANALOG + "mask": 1 << channel,
                _ANALOG + "type": quantity.value << channel,
                f"{_ANALOG}{channel}": ratio,
            }
        case SetSpeedSlider(fraction):
            return {_SLIDER + "mask": 1, _SLIDER + "fraction": fraction}
        case SetInputInteger(register, value):
            return {INT[register]: value}
        case SetInputDouble(register, value):
            return {DOUBLE[register]: value}
        case SetExternalWrench(wrench):
            return Vector(EXTERNAL_WRENCH).write(wrench, offset)
        case _:
            assert_never(command)


def sets(command: IoCommand) -> frozenset[tuple[object, int]]:
    """Things that a command sets: two commands with a common one set the same thing."""
    match command:
        case SetDigitalOutputs(bank, mask):
            return frozenset((bank, output) for output in range(_WIDTH[bank]) if mask >> output & 1)
        case SetAnalogOutput(channel):
            return frozenset({(SetAnalogOutput, channel)})
        case SetInputInteger(register) | SetInputDouble(register):
            return frozenset({(type(command), register)})
        case SetSpeedSlider() | SetExternalWrench():
            return frozenset({(type(command), 0)})
        case _:
            assert_never(command)


def _said(image: RegisterImage, written: Collection[str]) -> Iterator[IoCommand]:
    def touched(*names: str) -> bool:
        return not set(names).isdisjoint(written)

    for bank, width in _WIDTH.items():
        if touched(f"{bank.value}_mask", bank.value):
            mask = _bits(image, f"{bank.value}_mask", width)
            if mask:
                yield SetDigitalOutputs(bank, mask, int(image.number(bank.value)) & mask)
    if touched(*(_ANALOG + name for name in ("mask", "type", "0", "1"))):
        mask = _bits(image, _ANALOG + "mask", _CHANNELS)
        kinds = int(image.number(_ANALOG + "type"))
        for channel in range(_CHANNELS):
            if mask >> channel & 1:
                ratio = judged(image.number(f"{_ANALOG}{channel}"), _PART, f"{_ANALOG}{channel}")
                yield SetAnalogOutput(channel, Quantity(kinds >> channel & 1), ratio)
    if touched(_SLIDER + "mask", _SLIDER + "fraction") and _bits(image, _SLIDER + "mask", 1):
        yield SetSpeedSlider(judged(image.number(_SLIDER + "fraction"), _PART, _SLIDER + "fraction"))
    begin = image.profile.offset
    for register in range(begin + FIRST_FREE, begin + LAST_FREE + 1):
        if touched(INT[register]):
            yield SetInputInteger(register, int(image.number(INT[register])))
        if touched(DOUBLE[register]):
            yield SetInputDouble(register, judged(image.number(DOUBLE[register]), ANY, DOUBLE[register]))
    if touched(EXTERNAL_WRENCH):
        x, y, z, rx, ry, rz = Vector(EXTERNAL_WRENCH).read(image)
        yield SetExternalWrench((x, y, z, rx, ry, rz))


def _bits(image: RegisterImage, name: str, width: int) -> int:
    mask = int(image.number(name))
    if mask >> width:
        raise WrongParameterError(Reason.OUT_OF_RANGE, name)
    return mask
