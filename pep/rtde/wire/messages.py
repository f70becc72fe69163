"""Messages of RTDE: the kinds of frame, the typed messages of both sides, and the error outside the protocol.

`pep.rtde.wire.codec` turns them into bytes and back; nothing here knows a layout. A difference of protocol version 1 is
stated at its message.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from pep.rtde.wire.variables import VariableType


class WireFault(StrEnum):
    """Fault outside the protocol."""

    SIZE = "WIRE_SIZE"
    TOO_LONG = "WIRE_TOO_LONG"
    KIND = "WIRE_KIND"
    PAYLOAD = "WIRE_PAYLOAD"
    FIELD_LIST = "WIRE_FIELD_LIST"
    FREQUENCY = "WIRE_FREQUENCY"
    TYPE_NAME = "WIRE_TYPE_NAME"
    VALUE = "WIRE_VALUE"


class WireError(ValueError):
    """Bytes or values without a place in the protocol; `code` is the reason."""

    def __init__(self, code: WireFault, detail: str) -> None:
        super().__init__(detail)
        self.code = code


class FrameKind(IntEnum):
    """The type byte of a frame."""

    PROTOCOL_VERSION = ord("V")
    CONTROL_VERSION = ord("v")
    TEXT = ord("M")
    VALUES = ord("U")
    SETUP_OUTPUTS = ord("O")
    SETUP_INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


@dataclass(frozen=True, slots=True)
class RequestProtocol:
    """Client: use this protocol version from the next frame on."""

    version: int


@dataclass(frozen=True, slots=True)
class ProtocolAnswer:
    """Controller: acceptance or refusal of that."""

    accepted: bool


@dataclass(frozen=True, slots=True)
class AskControlVersion:
    """Client: question for the software."""


@dataclass(frozen=True, slots=True)
class ControlVersion:
    """Controller: its software."""

    major: int
    minor: int
    bugfix: int
    build: int


@dataclass(frozen=True, slots=True)
class RtdeMessage:
    """Either side: a text for people.

    Level 0 exception, 1 error, 2 warning, 3 information; version 1 has no source.
    """

    text: str
    source: str
    level: int


@dataclass(frozen=True, slots=True)
class SetupOutputs:
    """Client: the outputs wanted; `frequency_hz` is None in version 1."""

    names: tuple[str, ...]
    frequency_hz: float | None


@dataclass(frozen=True, slots=True)
class OutputsAnswer:
    """Controller: their types in order; `recipe` is None in version 1."""

    types: tuple[VariableType, ...]
    recipe: int | None


@dataclass(frozen=True, slots=True)
class SetupInputs:
    """Client: the inputs it will write, and wants to own."""

    names: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class InputsAnswer:
    """Controller: their types in order; recipe 0 when any was refused."""

    types: tuple[VariableType, ...]
    recipe: int


@dataclass(frozen=True, slots=True)
class Start:
    """Client: stream outputs."""


@dataclass(frozen=True, slots=True)
class StartAnswer:
    """Controller: acceptance or refusal of that."""

    accepted: bool


@dataclass(frozen=True, slots=True)
class Pause:
    """Client: stop streaming."""


@dataclass(frozen=True, slots=True)
class PauseAnswer:
    """Controller: acceptance or refusal of that."""

    accepted: bool


@dataclass(frozen=True, slots=True)
class Values:
    """Either side: the packed values of a recipe; `recipe` is None from a version 1 controller."""

    recipe: int | None
    packed: bytes


Request: TypeAlias = (
    RequestProtocol | AskControlVersion | RtdeMessage | SetupOutputs | SetupInputs | Start | Pause | Values
)
Answer: TypeAlias = (
    ProtocolAnswer | ControlVersion | RtdeMessage | OutputsAnswer | InputsAnswer | StartAnswer | PauseAnswer | Values
)
