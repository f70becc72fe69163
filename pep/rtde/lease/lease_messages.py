"""Messages of a motion lease: several connections of one program, side by side, and the beat.

    program --TCP--> `ztpm rtde run` == one TCP connection, frames of one session ==> gateway --TCP--> robot

Each message of the session (`capabilities.proof.session_frames`) is one word of this module: a connection is opened to
one of the controller's ports, bytes go both ways, either end closes it, and the gateway tells the reason of a refusal.
Between whiles there are beats. A carriage neither loses nor reorders, so nothing here is numbered or repeated. A
message without meaning ends the lease.

No sockets here: bytes in, bytes out.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import TYPE_CHECKING, Final, TypeAlias, assert_never

from capabilities.proof.session_frames import OVERHEAD_BYTES
from capabilities.values.caps import DEFAULT
from pep.rtde.wire import frame_splitter
from pep.rtde.wire.client_texts import TOLD_BYTES, fits

if TYPE_CHECKING:
    from capabilities.values.caps import Caps

CONNECTIONS: Final = 16
"""Most connections in one lease: ur_rtde's four interfaces have six, and reconnects may overlap."""
REASON_BYTES: Final = 64
_WORD: Final = struct.Struct(">BB")
_PORT_BYTES: Final = 2


class LeaseMessageFault(StrEnum):
    """Fault that ends a lease."""

    MALFORMED = "CARRIAGE_MALFORMED"
    TOO_LONG = "CARRIAGE_TOO_LONG"
    OUT_OF_PLACE = "CARRIAGE_OUT_OF_PLACE"
    TOO_MANY = "CARRIAGE_TOO_MANY"


class LeaseMessageError(ValueError):
    """Bytes that are no word, or a word without meaning here; `code` is the reason."""

    def __init__(self, code: LeaseMessageFault, detail: str) -> None:
        super().__init__(detail)
        self.code = code


@dataclass(frozen=True, slots=True)
class Beat:
    """Program's side and gateway's: still here."""


@dataclass(frozen=True, slots=True)
class Open:
    """Program's side: connect this line to that port of the controller."""

    line: int
    port: int


@dataclass(frozen=True, slots=True)
class Opened:
    """Gateway's: the line is open."""

    line: int


@dataclass(frozen=True, slots=True)
class OpenRefused:
    """Gateway's: the line is not opened, for this reason code."""

    line: int
    reason: str


@dataclass(frozen=True, slots=True)
class Bytes:
    """Either's: these bytes, at least one, on an open line."""

    line: int
    content: bytes


@dataclass(frozen=True, slots=True)
class Closed:
    """Either's: the line is closed in both directions. Its number is free once both have said so."""

    line: int


@dataclass(frozen=True, slots=True)
class RefusalNotice:
    """Gateway's: reason why input on the line was refused, or waits. For people alone."""

    line: int
    text: str


@dataclass(frozen=True, slots=True)
class LeaseOver:
    """Gateway's: the lease ends now, for this reason. Only the end of the session follows."""

    reason: str


Word: TypeAlias = Beat | Open | Opened | OpenRefused | Bytes | Closed | RefusalNotice | LeaseOver


class _Kind(IntEnum):
    BEAT = 0
    OPEN = 1
    OPENED = 2
    REFUSED = 3
    BYTES = 4
    CLOSED = 5
    OVER = 6
    TOLD = 7


_BYTES: Final = int(_Kind.BYTES)
HEAD_BYTES: Final = _WORD.size
"""Bytes of a message that are not content."""


def encode(word: Word) -> bytes:
    """Message of `word`; `decode` gives the word back.

    Raises:
        CarriageError: a line or port of no number, no content, a reason that is no code, or a text that does not fit.
    """
    match word:
        case Bytes(line, content):  # first, since nearly every word is one
            if not content:
                raise LeaseMessageError(LeaseMessageFault.MALFORMED, "no bytes")
            return _packed(_BYTES, line) + content
        case Beat():
            return _packed(_Kind.BEAT, 0)
        case Open(line, port):
            if not 0 < port <= 0xFFFF:
                raise LeaseMessageError(LeaseMessageFault.MALFORMED, f"port {port}")
            return _packed(_Kind.OPEN, line) + port.to_bytes(_PORT_BYTES, "big")
        case Opened(line):
            return _packed(_Kind.OPENED, line)
        case OpenRefused(line, reason):
            if not _is_code(reason):
                raise LeaseMessageError(LeaseMessageFault.MALFORMED, "no reason code")
            return _packed(_Kind.REFUSED, line) + reason.encode()
        case Closed(line):
            return _packed(_Kind.CLOSED, line)
        case RefusalNotice(line, text):
            if not fits(text):
                raise LeaseMessageError(LeaseMessageFault.MALFORMED, "no text that fits")
            return _packed(_Kind.TOLD, line) + text.encode()
        case LeaseOver(reason):
            if not _is_code(reason):
                raise LeaseMessageError(LeaseMessageFault.MALFORMED, "no reason code")
            return _packed(_Kind.OVER, 0) + reason.encode()
        case _:
            assert_never(word)


def decode(message: bytes) -> Word:
    """Word of `message`, in its one spelling.

    Raises:
        CarriageError: it says none.
    """
    if len(message) < HEAD_BYTES:
        raise LeaseMessageError(LeaseMessageFault.MALFORMED, "cut short")
    kind, line = _WORD.unpack_from(message)
    rest = message[HEAD_BYTES:]
    if kind == _BYTES and rest:
        return Bytes(line, rest)
    match kind, len(rest):
        case _Kind.BEAT, 0 if line == 0:
            return Beat()
        case _Kind.OPEN, length if length == _PORT_BYTES and any(rest):
            return Open(line, int.from_bytes(rest, "big"))
        case _Kind.OPENED, 0:
            return Opened(line)
        case _Kind.REFUSED, _ if rest.isascii() and _is_code(rest.decode()):
            return OpenRefused(line, rest.decode())
        case _Kind.CLOSED, 0:
            return Closed(line)
        case _Kind.TOLD, length if length <= TOLD_BYTES and rest.isascii() and fits(rest.decode()):
            return RefusalNotice(line, rest.decode())
        case _Kind.OVER, _ if line == 0 and rest.isascii() and _is_code(rest.decode()):
            return LeaseOver(rest.decode())
        case _:
            raise LeaseMessageError(LeaseMessageFault.MALFORMED, f"no word of kind {kind} with {len(rest)} bytes")


def _packed(kind: int, line: int) -> bytes:
    if not 0 <= line <= 0xFF:
        raise LeaseMessageError(LeaseMessageFault.MALFORMED, f"line {line}")
    return _WORD.pack(kind, line)


def _is_code(reason: str) -> bool:
    plain = reason.isascii() and reason.replace("_", "").isalnum() and reason == reason.upper()
    return plain and 0 < len(reason) <= REASON_BYTES


class OpenLines:
    """Lines that are open at either end of a lease, with the words that may follow.

    A number is used again only after both ends have closed its line, so that bytes under way never reach the next
    connection of that number.

    Args:
        asking: whether this is the program's end, which asks for lines; the other one opens or refuses them.

    Attributes:
        open: lines on which bytes may come: neither end has closed them.
        leaving: lines that the other end has closed, and this one has not yet.
    """

    def __init__(self, *, asking: bool) -> None:
        self._asking = asking
        self._state: dict[int, _Line] = {}
        self.open: frozenset[int] = frozenset()
        self.leaving: frozenset[int] = frozenset()

    def _becomes(self, line: int, state: _Line | None) -> None:
        """Puts that line into this state; without one, its number is free."""
        if state is None:
            del self._state[line]
        else:
            self._state[line] = state
        # Asked for with every word, and changed with few.
        self.open, self.leaving = self._in(_Line.OPEN), self._in(_Line.LEAVING)

    def _in(self, wanted: _Line) -> frozenset[int]:
        return frozenset(line for line, state in self._state.items() if state is wanted)

    def free(self) -> int:
        """Lowest number that is not in use.

        Raises:
            CarriageError: `TOO_MANY`.
        """
        for line in range(CONNECTIONS):
            if line not in self._state:
                return line
        raise LeaseMessageError(LeaseMessageFault.TOO_MANY, f"{CONNECTIONS} lines are in use")

    def said(self, word: Word) -> bool:
        """Notes that this end says `word`; true where it is still worth saying.

        The other end may have closed the line just now.

        Raises:
            CarriageError: it has no meaning here.
        """
        return self._next(word, own=True)

    def heard(self, word: Word) -> bool:
        """Notes that the other end said `word`; true where it is to be acted on.

        This end may have closed the line just before.

        Raises:
            CarriageError: it has no meaning here.
        """
        return self._next(word, own=False)

    def _next(self, word: Word, *, own: bool) -> bool:
        if isinstance(word, Bytes) and word.line in self.open:
            return True
        if isinstance(word, Beat):
            return True
        if isinstance(word, LeaseOver):
            if own is self._asking:
                raise LeaseMessageError(LeaseMessageFault.OUT_OF_PLACE, "the program's side ends it without a word")
            return True
        state, asks = self._state.get(word.line), own is self._asking
        closing, other = (_Line.CLOSING, _Line.LEAVING) if own else (_Line.LEAVING, _Line.CLOSING)
        match word:
            case Open() if asks and state is None:
                if len(self._state) >= CONNECTIONS:
                    raise LeaseMessageError(LeaseMessageFault.TOO_MANY, f"more than {CONNECTIONS} lines")
                self._becomes(word.line, _Line.ASKED)
                return True
            case Opened() if not asks and state is _Line.ASKED:
                self._becomes(word.line, _Line.OPEN)
                return True
            case OpenRefused() if not asks and state is _Line.ASKED:
                self._becomes(word.line, None)
                return True
            # Also about input from before either end closed the line.
            case RefusalNotice() if not asks and state in (_Line.OPEN, other):
                return True
            case Bytes() if state is other:  # they crossed the closing of the end that no longer wants them
                return False
            case Closed() if state is _Line.OPEN:
                self._becomes(word.line, closing)
                return True
            case Closed() if state is other:
                self._becomes(word.line, None)
                return True
            case _:
                raise LeaseMessageError(LeaseMessageFault.OUT_OF_PLACE, f"{type(word).__name__} on line {word.line}")


class _Line(StrEnum):
    ASKED = "asked"
    OPEN = "open"
    CLOSING = "closing"
    """State of a line that this end has closed."""
    LEAVING = "leaving"
    """State of a line that the other end has closed."""


class SessionFrameSplitter:
    """Splitter of a byte stream into the session's frames, in pieces of any size.

    Each follows its length in four bytes.

    Args:
        caps: the largest message.
    """

    def __init__(self, caps: Caps = DEFAULT) -> None:
        self._cutter = frame_splitter.FrameSplitter(OVERHEAD_BYTES, caps.frame_bytes + OVERHEAD_BYTES, itself=False)

    def feed(self, received: bytes) -> list[bytes]:
        """Frames completed by `received`, in order.

        Raises:
            CarriageError: a length that no frame has, as soon as it is there.
        """
        try:
            return [piece[frame_splitter.LENGTH :] for piece in self._cutter.feed(received)]
        except frame_splitter.LengthError as error:
            raise LeaseMessageError(LeaseMessageFault.TOO_LONG, f"a frame of {error.length} bytes") from error


def delimited(frame: bytes) -> bytes:
    """Frame as it goes over the connection."""
    return len(frame).to_bytes(frame_splitter.LENGTH, "big") + frame
