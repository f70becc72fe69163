"""The frames of the primary (30001, 30011) and secondary (30002, 30012) interfaces.

Strict and without IO, like `pep.rtde.wire.codec`: typed frames to bytes, and messages back. A frame is `int32 size,
uint8 kind, body`, big-endian, the size counting its own header; a robot state holds parts of the same shape. A message
of a kind that only a younger controller knows is representable and survives; one that contradicts itself raises
`WireError`.
Layouts: the vendor's client interface guide, PolyScope 5.10 and later.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final, TypeAlias

from pep.rtde.wire.frame_splitter import LENGTH, FrameSplitter, LengthError
from pep.rtde.wire.messages import WireError, WireFault
from pep.rtde.wire.primary_state import PARTS, OtherPart, Part

HEADER: Final = 5
MAX_FRAME: Final = 65_536  # bytes; a robot state has some 1,500, a message a text
ROBOT_STATE, MESSAGE = 16, 20
READ_ONLY: Final = 210  # error code that answers a script where none is taken


@dataclass(frozen=True, slots=True)
class PrimaryState:
    """State that both interfaces send ten times a second."""

    parts: tuple[Part, ...]


# ------------------------------------------------------------------------------------------------------------- messages


@dataclass(frozen=True, slots=True)
class Version:
    """Kind 3, sent first: the controller's software."""

    project: str
    major: int
    minor: int
    bugfix: int
    build: int
    date: str


@dataclass(frozen=True, slots=True)
class ErrorCode:
    """Kind 6: an error by its number; `level` and the rest as the controller means them."""

    code: int
    argument: int
    level: int
    kind: int
    value: int
    text: str


@dataclass(frozen=True, slots=True)
class Key:
    """Kind 7: a program started or stopped, by its title; the text is the program's name."""

    code: int
    argument: int
    title: str
    text: str


@dataclass(frozen=True, slots=True)
class RuntimeException:
    """Kind 10: a program failed there."""

    line: int
    column: int
    text: str


@dataclass(frozen=True, slots=True)
class OtherMessage:
    """A message that is not among these."""

    kind: int
    body: bytes


Content: TypeAlias = Version | ErrorCode | Key | RuntimeException | OtherMessage


@dataclass(frozen=True, slots=True)
class PrimaryMessage:
    """Message of the controller, at its own microseconds."""

    timestamp_us: int
    source: int
    content: Content


@dataclass(frozen=True, slots=True)
class OtherFrame:
    """A frame that is neither state nor message."""

    kind: int
    body: bytes


PrimaryFrame: TypeAlias = PrimaryState | PrimaryMessage | OtherFrame


class PrimaryFrameSplitter:
    """Splitter of the bytes of 30001 or 30002, in pieces of any size, into kinds and unread bodies."""

    def __init__(self) -> None:
        self._cutter = FrameSplitter(HEADER, MAX_FRAME, itself=True)

    def feed(self, received: bytes) -> list[tuple[int, bytes]]:
        """Frames completed by `received`, in order.

        Raises:
            WireError: a size below the header or above `MAX_FRAME`, seen as soon as it is there.
        """
        try:
            pieces = self._cutter.feed(received)
        except LengthError as error:
            check_size(error.length, MAX_FRAME)
            raise
        return [(piece[LENGTH], piece[HEADER:]) for piece in pieces]


def encode_primary(frame: PrimaryFrame) -> bytes:
    """The bytes of a frame.

    Raises:
        WireError: a value that does not fit its field.
    """
    match frame:
        case PrimaryState(parts):
            return _framed(ROBOT_STATE, b"".join(_encode_part(part) for part in parts))
        case PrimaryMessage(timestamp, source, content):
            kind, body = _encode_content(content)
            return _framed(MESSAGE, _pack(">Qbb", timestamp, source, kind) + body)
        case OtherFrame(kind, body):
            return _framed(kind, body)


def decode_message(body: bytes) -> PrimaryMessage:
    """Message in a frame of kind `MESSAGE`.

    Raises:
        WireError: it contradicts itself.
    """
    if len(body) < 10:
        raise WireError(WireFault.PAYLOAD, "a message without its kind")
    timestamp, source, sort = struct.unpack_from(">Qbb", body)
    return PrimaryMessage(timestamp, source, _decode_content(sort, body[10:]))


def _encode_part(part: Part) -> bytes:
    if isinstance(part, OtherPart):
        return _framed(part.kind, part.body)
    return _framed(PARTS.index(type(part)), part.pack())


def _decode_content(kind: int, body: bytes) -> Content:
    try:
        match kind:
            case 3:
                end = 1 + body[0]
                major, minor, bugfix, build = struct.unpack_from(">BBii", body, end)
                return Version(_text(body[1:end]), major, minor, bugfix, build, _text(body[end + 10 :]))
            case 6:
                code, argument, level, sort, value = struct.unpack_from(">iiiII", body)
                return ErrorCode(code, argument, level, sort, value, _text(body[20:]))
            case 7:
                code, argument, length = struct.unpack_from(">iiB", body)
                if len(body) < 9 + length:
                    raise WireError(WireFault.PAYLOAD, "a title shorter than it says")
                return Key(code, argument, _text(body[9 : 9 + length]), _text(body[9 + length :]))
            case 10:
                line, column = struct.unpack_from(">ii", body)
                return RuntimeException(line, column, _text(body[8:]))
            case _:
                return OtherMessage(kind, body)
    except (struct.error, IndexError) as error:
        raise WireError(WireFault.PAYLOAD, f"a message of kind {kind} of {len(body)} bytes") from error


def _encode_content(content: Content) -> tuple[int, bytes]:
    match content:
        case Version(project, major, minor, bugfix, build, date):
            return 3, _counted(project) + _pack(">BBii", major, minor, bugfix, build) + _bytes(date)
        case ErrorCode(code, argument, level, kind, value, text):
            return 6, _pack(">iiiII", code, argument, level, kind, value) + _bytes(text)
        case Key(code, argument, title, text):
            return 7, _pack(">ii", code, argument) + _counted(title) + _bytes(text)
        case RuntimeException(line, column, text):
            return 10, _pack(">ii", line, column) + _bytes(text)
        case OtherMessage(kind, body):
            return kind, body


# ------------------------------------------------------------------------------------------------------------ the bytes


def check_size(size: int, limit: int) -> None:
    """Checks that the size of a frame, or of a part of a state, is possible.

    Raises:
        WireError: it is below the header or above `limit`.
    """
    if size < HEADER:
        raise WireError(WireFault.SIZE, f"a frame that says it has {size} bytes")
    if size > limit:
        raise WireError(WireFault.TOO_LONG, f"a frame of {size} bytes, limit {limit}")


def _framed(kind: int, body: bytes) -> bytes:
    check_size(HEADER + len(body), MAX_FRAME)
    return _pack(">iB", HEADER + len(body), kind) + body


def _pack(layout: str, *values: object) -> bytes:
    try:
        return struct.pack(layout, *values)
    except struct.error as error:
        raise WireError(WireFault.VALUE, str(error)) from error


def _text(held: bytes) -> str:
    return held.decode("utf-8", "surrogateescape")


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")


def _counted(text: str) -> bytes:
    held = _bytes(text)
    return _pack(">B", len(held)) + held
