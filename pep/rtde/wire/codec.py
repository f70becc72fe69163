"""RTDE wire, strict and without IO: bytes to typed messages and back, for controller, client and gateway alike.

Every frame is `uint16 size, uint8 kind, payload`, big-endian, the size counting its own header. What is outside the
protocol raises `WireError` with a code and the stream is of no use afterwards; what is only surprising (a data package
whose length does not fit its recipe, which ur_rtde sends) is representable, so that each consumer decides for itself.

Protocol version 1 differs in three payloads: set-up of outputs has no frequency and no recipe id in its answer, and
data packages from the controller have no recipe id.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias, assert_never

from pep.rtde.wire.messages import (
    AskControlVersion,
    ControlVersion,
    FrameKind,
    InputsAnswer,
    OutputsAnswer,
    Pause,
    PauseAnswer,
    ProtocolAnswer,
    RequestProtocol,
    RtdeMessage,
    SetupInputs,
    SetupOutputs,
    Start,
    StartAnswer,
    Values,
    WireError,
    WireFault,
)
from pep.rtde.wire.variables import LAYOUT, WIDTH, VariableType

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pep.rtde.wire.messages import Answer, Request

HEADER: Final = 3
MAX_FRAME: Final = 0xFFFF  # the size field
MAX_REQUEST: Final = 4096  # longest frame a client has reason to send: a field list of 2048 bytes, or 255 values of 8
MAX_FIELD_LIST: Final = 2048  # bytes; the vendor's documented limit
MAX_FIELDS: Final = 256
MAX_TEXT: Final = 255  # a length byte

Value: TypeAlias = int | float | bool | tuple[float, ...] | tuple[int, ...]


@dataclass(frozen=True, slots=True)
class RtdeFrame:
    """One frame, its payload not yet read."""

    kind: FrameKind
    payload: bytes

    def encode(self) -> bytes:
        """Bytes of the frame."""
        size = HEADER + len(self.payload)
        if size > MAX_FRAME:
            raise WireError(WireFault.TOO_LONG, f"a frame of {size} bytes")
        return struct.pack(">HB", size, self.kind) + self.payload


class Framer:
    """Cutter of a byte stream into frames, in pieces of any size.

    Args:
        limit: longest frame accepted, header included.
    """

    def __init__(self, limit: int = MAX_REQUEST) -> None:
        self._limit = limit
        self._held = bytearray()

    def feed(self, received: bytes) -> list[RtdeFrame]:
        """Frames completed by `received`, in order.

        Raises:
            WireError: a size below the header or above the limit, or an unknown kind; both are seen as soon as the
                three bytes of a header are there, never after waiting for a payload.
        """
        held = self._held
        held += received
        found: list[RtdeFrame] = []
        at = 0
        while len(held) - at >= HEADER:
            size, number = struct.unpack_from(">HB", held, at)
            if size < HEADER:
                raise WireError(WireFault.SIZE, f"a frame that says it has {size} bytes")
            if size > self._limit:
                raise WireError(WireFault.TOO_LONG, f"a frame of {size} bytes, limit {self._limit}")
            kind = _KINDS.get(number)
            if kind is None:
                raise WireError(WireFault.KIND, f"a frame of kind {number}")
            if len(held) - at < size:
                break
            found.append(RtdeFrame(kind, bytes(held[at + HEADER : at + size])))
            at += size
        del held[:at]
        return found

    @property
    def pending(self) -> int:
        """Bytes of the incomplete frame being held."""
        return len(self._held)


_KINDS: Final = {int(kind): kind for kind in FrameKind}


# ------------------------------------------------------------------------------------------------------------- messages


def decode_request(frame: RtdeFrame, protocol: int) -> Request:
    """Message of a client in `frame` under protocol version 1 or 2.

    Raises:
        WireError: a payload of the wrong length, a field list that is empty, not printable ASCII, longer than
            `MAX_FIELD_LIST`, of more than `MAX_FIELDS` names or with an empty name (one trailing comma is allowed,
            ur_rtde sends it), or a frequency that is not a finite number.
    """
    payload = frame.payload
    match frame.kind:
        case FrameKind.VALUES:  # first, since nearly every frame is one
            return _decode_values(payload, numbered=True)
        case FrameKind.PROTOCOL_VERSION:
            return RequestProtocol(_unpack(">H", payload)[0])
        case FrameKind.CONTROL_VERSION:
            _unpack(">", payload)
            return AskControlVersion()
        case FrameKind.TEXT:
            return _decode_text(payload, protocol)
        case FrameKind.SETUP_OUTPUTS:
            if protocol == 1:
                return SetupOutputs(_decode_names(payload), None)
            if len(payload) < 8:
                raise WireError(WireFault.PAYLOAD, "set-up of outputs without a frequency")
            (frequency,) = struct.unpack_from(">d", payload)
            if not math.isfinite(frequency):
                raise WireError(WireFault.FREQUENCY, "a frequency that is no number")
            return SetupOutputs(_decode_names(payload[8:]), frequency)
        case FrameKind.SETUP_INPUTS:
            return SetupInputs(_decode_names(payload))
        case FrameKind.START:
            _unpack(">", payload)
            return Start()
        case FrameKind.PAUSE:
            _unpack(">", payload)
            return Pause()
        case _:
            assert_never(frame.kind)


def encode_request(request: Request, protocol: int) -> bytes:
    """Frame of `request`; field lists are written without a trailing comma."""
    match request:
        case RequestProtocol(version):
            frame = RtdeFrame(FrameKind.PROTOCOL_VERSION, _pack(">H", version))
        case AskControlVersion():
            frame = RtdeFrame(FrameKind.CONTROL_VERSION, b"")
        case RtdeMessage():
            frame = RtdeFrame(FrameKind.TEXT, _encode_text(request, protocol))
        case Values():
            frame = RtdeFrame(FrameKind.VALUES, _encode_values(request))
        case SetupOutputs(names, frequency):
            lead = b"" if protocol == 1 else _pack(">d", frequency)
            frame = RtdeFrame(FrameKind.SETUP_OUTPUTS, lead + _encode_names(names))
        case SetupInputs(names):
            frame = RtdeFrame(FrameKind.SETUP_INPUTS, _encode_names(names))
        case Start():
            frame = RtdeFrame(FrameKind.START, b"")
        case Pause():
            frame = RtdeFrame(FrameKind.PAUSE, b"")
        case _:
            assert_never(request)
    return frame.encode()


def decode_answer(frame: RtdeFrame, protocol: int) -> Answer:
    """Message of a controller in `frame` under protocol version 1 or 2.

    Raises:
        WireError: a payload of the wrong length, or a type name that does not exist.
    """
    payload = frame.payload
    match frame.kind:
        case FrameKind.VALUES:
            return _decode_values(payload, numbered=protocol != 1)
        case FrameKind.PROTOCOL_VERSION:
            return ProtocolAnswer(_decode_flag(payload))
        case FrameKind.CONTROL_VERSION:
            return ControlVersion(*_unpack(">4I", payload))
        case FrameKind.TEXT:
            return _decode_text(payload, protocol)
        case FrameKind.SETUP_OUTPUTS if protocol == 1:
            return OutputsAnswer(_decode_types(payload), None)
        case FrameKind.SETUP_OUTPUTS | FrameKind.SETUP_INPUTS:
            if not payload:
                raise WireError(WireFault.PAYLOAD, "an answer without a recipe id")
            types = _decode_types(payload[1:])
            if frame.kind is FrameKind.SETUP_OUTPUTS:
                return OutputsAnswer(types, payload[0])
            return InputsAnswer(types, payload[0])
        case FrameKind.START:
            return StartAnswer(_decode_flag(payload))
        case FrameKind.PAUSE:
            return PauseAnswer(_decode_flag(payload))
        case _:
            assert_never(frame.kind)


def encode_answer(answer: Answer, protocol: int) -> bytes:
    """Frame of `answer`."""
    match answer:
        case ProtocolAnswer(accepted):
            frame = RtdeFrame(FrameKind.PROTOCOL_VERSION, bytes([accepted]))
        case ControlVersion(major, minor, bugfix, build):
            frame = RtdeFrame(FrameKind.CONTROL_VERSION, _pack(">4I", major, minor, bugfix, build))
        case RtdeMessage():
            frame = RtdeFrame(FrameKind.TEXT, _encode_text(answer, protocol))
        case Values():
            frame = RtdeFrame(FrameKind.VALUES, _encode_values(answer))
        case OutputsAnswer(types, recipe):
            frame = RtdeFrame(
                FrameKind.SETUP_OUTPUTS, (b"" if recipe is None else _pack(">B", recipe)) + _encode_names(types)
            )
        case InputsAnswer(types, recipe):
            frame = RtdeFrame(FrameKind.SETUP_INPUTS, _pack(">B", recipe) + _encode_names(types))
        case StartAnswer(accepted):
            frame = RtdeFrame(FrameKind.START, bytes([accepted]))
        case PauseAnswer(accepted):
            frame = RtdeFrame(FrameKind.PAUSE, bytes([accepted]))
        case _:
            assert_never(answer)
    return frame.encode()


# ---------------------------------------------------------------------------------------------------------- recipes


class Recipe:
    """A list of variables as one packed record.

    Args:
        names: the variables in wire order.
        types: their types; `NOT_FOUND` and `IN_USE` make no recipe.

    Raises:
        WireError: the lengths differ, or a type has no layout.
    """

    __slots__ = ("_plain", "_struct", "names", "types")

    def __init__(self, names: Sequence[str], types: Sequence[VariableType]) -> None:
        if len(names) != len(types):
            raise WireError(WireFault.FIELD_LIST, f"{len(names)} names with {len(types)} types")
        if any(kind not in LAYOUT for kind in types):
            raise WireError(WireFault.TYPE_NAME, "a refused variable has no layout")
        self.names = tuple(names)
        self.types = tuple(types)
        self._plain = WIDTH.keys().isdisjoint(types)  # a number for each name: nearly every record there is
        self._struct = struct.Struct(">" + "".join(LAYOUT[kind] for kind in types))

    @property
    def size(self) -> int:
        """Bytes of the record, without the recipe id."""
        return self._struct.size

    def place(self, name: str) -> int | None:
        """First byte of that variable in the record; None when it is not in it."""
        if name not in self.names:
            return None
        return struct.calcsize(">" + "".join(LAYOUT[kind] for kind in self.types[: self.names.index(name)]))

    def unpack(self, packed: bytes) -> dict[str, Value]:
        """Values by name; a vector is a tuple.

        Doubles may be NaN or infinite: the code that acts on them judges that.

        Raises:
            WireError: not exactly `size` bytes.
        """
        if len(packed) != self._struct.size:
            raise WireError(WireFault.PAYLOAD, f"{len(packed)} bytes for a record of {self._struct.size}")
        flat = self._struct.unpack(packed)
        if self._plain:
            return dict(zip(self.names, flat, strict=True))
        values: dict[str, Value] = {}
        at = 0
        for name, kind in zip(self.names, self.types, strict=True):
            width = WIDTH.get(kind)
            if width is None:
                values[name] = flat[at]
                at += 1
            else:
                values[name] = flat[at : at + width]
                at += width
        return values

    def pack(self, values: Mapping[str, Value]) -> bytes:
        """Record of `values`, which holds at least the recipe's names.

        Raises:
            WireError: a value that does not fit its type.
        """
        if self._plain:
            return self.pack_flat([values[name] for name in self.names])
        flat: list[object] = []
        for name, kind in zip(self.names, self.types, strict=True):
            value = values[name]
            if kind in WIDTH:
                flat.extend(value)  # type: ignore[arg-type]  # struct refuses a vector of another width
            else:
                flat.append(value)
        return self.pack_flat(flat)

    def pack_flat(self, flat: Sequence[object]) -> bytes:
        """Record of already flattened values: the hot path of a controller."""
        try:
            return self._struct.pack(*flat)
        except (struct.error, TypeError) as error:
            raise WireError(WireFault.VALUE, str(error)) from error


# --------------------------------------------------------------------------------------------------------- payloads


def _unpack(layout: str, payload: bytes) -> tuple[int, ...]:
    if len(payload) != struct.calcsize(layout):
        raise WireError(WireFault.PAYLOAD, f"a payload of {len(payload)} bytes, expected {struct.calcsize(layout)}")
    return struct.unpack(layout, payload)


def _pack(layout: str, *values: object) -> bytes:
    try:
        return struct.pack(layout, *values)
    except struct.error as error:
        raise WireError(WireFault.VALUE, str(error)) from error


def _decode_flag(payload: bytes) -> bool:
    (flag,) = _unpack(">B", payload)
    if flag > 1:
        raise WireError(WireFault.PAYLOAD, f"a flag of {flag}")
    return flag == 1


def _decode_names(field_list: bytes) -> tuple[str, ...]:
    if len(field_list) > MAX_FIELD_LIST:
        raise WireError(WireFault.FIELD_LIST, f"a field list of {len(field_list)} bytes")
    if not all(0x21 <= byte <= 0x7E for byte in field_list):
        raise WireError(WireFault.FIELD_LIST, "a field list that is not printable ASCII")
    names = field_list.decode("ascii").split(",")
    if names[-1] == "":
        names.pop()
    if not 1 <= len(names) <= MAX_FIELDS or "" in names:
        raise WireError(WireFault.FIELD_LIST, "a field list without names, with too many, or with an empty one")
    return tuple(names)


def _encode_names(names: Sequence[str]) -> bytes:
    field_list = ",".join(names).encode("ascii", "replace")
    if _decode_names(field_list) != tuple(names):
        raise WireError(WireFault.FIELD_LIST, "names that do not survive the wire")
    return field_list


def _decode_types(field_list: bytes) -> tuple[VariableType, ...]:
    try:
        return tuple(VariableType(name) for name in _decode_names(field_list))
    except ValueError as error:
        if isinstance(error, WireError):
            raise
        raise WireError(WireFault.TYPE_NAME, str(error)) from error


def _decode_values(payload: bytes, *, numbered: bool) -> Values:
    if not numbered:
        return Values(None, payload)
    if not payload:
        raise WireError(WireFault.PAYLOAD, "a data package without a recipe id")
    return Values(payload[0], payload[1:])


def _encode_values(values: Values) -> bytes:
    return values.packed if values.recipe is None else _pack(">B", values.recipe) + values.packed


def _decode_text(payload: bytes, protocol: int) -> RtdeMessage:
    if protocol == 1:
        if not payload:
            raise WireError(WireFault.PAYLOAD, "a text message without a level")
        return RtdeMessage(payload[1:].decode("utf-8", "replace"), "", payload[0])
    parts: list[str] = []
    at = 0
    for _ in range(2):
        if at >= len(payload) or at + 1 + payload[at] > len(payload):
            raise WireError(WireFault.PAYLOAD, "a text message shorter than it says")
        parts.append(payload[at + 1 : at + 1 + payload[at]].decode("utf-8", "replace"))
        at += 1 + payload[at]
    if at + 1 != len(payload):
        raise WireError(WireFault.PAYLOAD, "a text message that does not end with its level")
    return RtdeMessage(parts[0], parts[1], payload[at])


def _encode_text(message: RtdeMessage, protocol: int) -> bytes:
    if protocol == 1:
        return _pack(">B", message.level) + message.text.encode()
    text, source = message.text.encode(), message.source.encode()
    if len(text) > MAX_TEXT or len(source) > MAX_TEXT:
        raise WireError(WireFault.TOO_LONG, f"a text of more than {MAX_TEXT} bytes")
    return bytes([len(text)]) + text + bytes([len(source)]) + source + _pack(">B", message.level)
