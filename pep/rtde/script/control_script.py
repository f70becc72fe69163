"""Recognition of ur_rtde's control script on a script port, byte for byte, with its path.

ur_rtde sends one program for each PolyScope version, with the number of its registers in two places and, after a path
was asked for, a block of waypoints in a third. The texts come out of the installed library and are pinned by their
SHA-256, so that a library that was tampered with is no allow-list. The forwarded program is written from our own copy
and from the numbers that were read; not one byte is the client's.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.base.errors import ConfigError, PepFault
from pep.rtde.script.move_path import MAX_LINE, PathBlock, render_path
from pep.rtde.wire.recipes import OFFSETS
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pep.rtde.script.move_path import Waypoint
    from pep.rtde.wire.recipes import Offset

MAX_SCRIPT: Final = 64 * 1024
"""Bytes of a control script without its path; the longest has 50,759."""

_FLOAT_MARK: Final = "# float register offset\n"
_INT_MARK: Final = "# int register offset\n"
_PATH_MARK: Final = "# inject move path\n"

# SHA-256 of the whole upload of ur_rtde 1.6.5 without a path, by the first PolyScope 5 minor version that has it, for
# offsets 0 and 24.
PINS: Final[tuple[tuple[int, str, str], ...]] = (
    (
        0,
        "d62551f4ce9a77100b47d57f354ecbe34efea91d2ac97ffb803a4e70ed3e0c6c",
        "cb8cf81ae62ef8ac243cbd63f2f6751a56db890ecc7b3b5c462fe35c2c3e7896",
    ),
    (
        3,
        "150cebead63d7d2ee8fa88513f7fc29d309919b905dae669b3290ec9dc3fa49a",
        "b806c996eef5b8322adcfeb3fc667f1fd601d083c70983005e75f37fb170a791",
    ),
    (
        4,
        "feab23a7cf91021d324e050bf7fe2c88969aed052da1833f6b389c0f155ad14c",
        "2dc79d9cfa0d7a56a696539a2f6c3cd170975900b61b2162701bf6691c59c5db",
    ),
    (
        9,
        "3f10d40db92081644322ebabd1b1d10d6340f214c13de69b5d9055223ce2ba0a",
        "948ea520b523f93bdb3d954c916b1f71f4defe4838acf0bcc6ae40b2ccf5f6e3",
    ),
    (
        10,
        "596761a93dfb175355b265245f9b94f8807528bf7ff85a654a61448f82ae8bf8",
        "a09be6d4241a8fe761b2e0c5e0e32ad4f1b58b4b866ca69f4072e580d104b1f9",
    ),
    (
        23,
        "5462851f747f0a22a3748c6e4f376cee798f1b14edaa0a12721d4cedc8c715b0",
        "f7fe25a7ba2a2262785509abd4b8161ed7e84b682067ac34c151c1b523155662",
    ),
    (
        26,
        "b2e1dd66fc5f0ba0b9211ab8b71c3ca61651f479caae04142a6ca2d2b89ca539",
        "b98a1195cdb6c1c087a3944414c243e15507a23f9500dc29e0ecc5845ea82b2a",
    ),
)


@dataclass(frozen=True, slots=True)
class ControlScript:
    """One control script as it is sent.

    Attributes:
        since: the first PolyScope 5 minor version that it is for.
        offset: first register of the client.
        head: its bytes before the path.
        tail: its bytes after the path.
    """

    since: int
    offset: Offset
    head: bytes
    tail: bytes


@dataclass(frozen=True, slots=True)
class Upload:
    """A control script that was recognised.

    Attributes:
        script: the recognised script.
        path: the waypoints that it carries.
    """

    script: ControlScript
    path: tuple[Waypoint, ...]

    def render(self) -> bytes:
        """Program to send: our own copy, with the path written anew."""
        return self.script.head + render_path(self.path) + self.script.tail


def installed_body(minor: int) -> str:
    """Script of the installed ur_rtde for PolyScope 5.`minor`, before any insertion; opens nothing."""
    from script_client import ScriptClient

    return str(ScriptClient("127.0.0.1", 5, minor).getScript())


def allow_list(body: Callable[[int], str]) -> tuple[ControlScript, ...]:
    """Every control script, each equal to its pin.

    Args:
        body: text for PolyScope 5.n by the library, as `installed_body` gives it.

    Raises:
        ConfigError: `CONFIG_INVALID` when a script is not what was pinned.
    """
    found = []
    for since, *pins in PINS:
        text = body(since)
        for offset, pin in zip(OFFSETS, pins, strict=True):
            script = _script(since, offset, text)
            whole = script.head + script.tail
            # [RTDE-7] the whole upload, not a part of it.
            if len(whole) > MAX_SCRIPT or hashlib.sha256(whole).hexdigest() != pin:
                raise ConfigError(PepFault.CONFIG_INVALID, f"ur_rtde's control script for 5.{since} is another one")
            found.append(script)
    return tuple(found)


def scripts_for(minor: int, scripts: Sequence[ControlScript]) -> tuple[ControlScript, ...]:
    """Control scripts that ur_rtde sends to PolyScope 5.`minor`, one for each offset."""
    since = max(script.since for script in scripts if script.since <= minor)
    return tuple(script for script in scripts if script.since == since)


def _script(since: int, offset: Offset, body: str) -> ControlScript:
    for mark in (_FLOAT_MARK, _INT_MARK):
        body = body.replace(mark, f"{mark}{offset}", 1)
    head, mark, tail = f"def rtde_control():\n{body}end\n".partition(_PATH_MARK)
    return ControlScript(since, offset, (head + mark).encode(), tail.encode())


_CHANGED: Final = InputRefusal(Reason.TOOL_DEFINITION_CHANGED, "control script")


class _Follower:
    """One script, with its part that has come."""

    def __init__(self, script: ControlScript) -> None:
        self._script = script
        self._head = self._tail = 0  # bytes of each that have come
        self._path = PathBlock()
        self._line = b""  # of the path, not yet complete
        self.depth = 0

    def feed(self, received: bytes) -> Upload | InputRefusal | None:
        agreed = _agreed(self._script.head, self._head, received)
        self._head += agreed
        self.depth += agreed
        received = received[agreed:]
        if self._head < len(self._script.head):
            return _CHANGED if received else None
        # A tab begins a line of the path; the script itself goes on with a blank.
        while received and not self._tail and (self._line or received.startswith(b"\t")):
            line, end, received = (self._line + received).partition(b"\n")
            if len(line) > MAX_LINE:
                return InputRefusal(Reason.BODY_MALFORMED, "path")
            if not end:
                self._line = line
                return None
            self._line = b""
            refused = self._path.line(line)
            if refused is not None:
                return refused
            self.depth += len(line)
        if not received:
            return None
        if not self._path.complete:
            return InputRefusal(Reason.BODY_MALFORMED, "path")
        agreed = _agreed(self._script.tail, self._tail, received)
        self._tail += agreed
        self.depth += agreed
        if agreed < len(received):
            return _CHANGED
        return Upload(self._script, tuple(self._path.waypoints)) if self._tail == len(self._script.tail) else None


def _agreed(expected: bytes, at: int, received: bytes) -> int:
    """Number of bytes of `received` that agree with `expected` from `at` on."""
    part = expected[at : at + len(received)]
    if received.startswith(part):
        return len(part)
    return next(index for index, (a, b) in enumerate(zip(part, received, strict=False)) if a != b)


class Recogniser:
    """Recogniser of one program among allowed scripts, while it arrives.

    It keeps at most one line of a path.

    Args:
        scripts: that may be sent, at least one.
    """

    def __init__(self, scripts: Sequence[ControlScript]) -> None:
        self._followers = [_Follower(script) for script in scripts]
        self._over: InputRefusal | None = None

    def feed(self, received: bytes) -> Upload | InputRefusal | None:
        """Recognised program, as soon as it is known; None while more is needed.

        Returns:
            Refused as soon as no script goes on so (`TOOL_DEFINITION_CHANGED`), a line of the path is none of ur_rtde's
            (`BODY_MALFORMED`, `NOT_FINITE`, `ROBOT_LIMIT`, at the end of that line), there are too many waypoints
            (`BODY_TOO_LARGE`), or anything follows the program in the same piece. After an answer all later
            bytes are refused: another program needs another recogniser.
        """
        if self._over is not None:
            return self._over
        answers = [(follower, follower.feed(received)) for follower in self._followers]
        self._followers = [follower for follower, answer in answers if answer is None]
        for _, answer in answers:
            if isinstance(answer, Upload):
                self._over = _CHANGED
                return answer
        if self._followers:
            return None
        # The script that agreed for longest names the fault.
        _, self._over = max(((f.depth, a) for f, a in answers if isinstance(a, InputRefusal)), key=lambda pair: pair[0])
        return self._over
