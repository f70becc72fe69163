"""Built-in functions of URScript for sockets that a program opens, as UR's script manual tells them.

Reads wait for at most their time-out, 2 s where none is said, or without end where it is 0 or less. The simulator
resolves no host names.
"""

# ruff: noqa: PLR0917  the signatures are URScript's

from __future__ import annotations

import math
import struct
from collections.abc import Generator
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from ursim.motion.robot import TICK_S
from ursim.motion.values import INT_HIGH, INT_LOW, ScriptRuntimeError, Value, Vector, as_text, number
from ursim.script.builtin import Function, row
from ursim.script.program_sockets import MOST_SOCKETS, ProgramSocket

if TYPE_CHECKING:
    from collections.abc import Callable

    from ursim.script.program import Execution

OPEN_S: Final = 2.0
"""Time in which a peer must take a connection."""
READ_S: Final = 2.0
MOST_NUMBERS: Final = 30
"""Numbers of one read."""

Steps: TypeAlias = Generator[None, None, Any]


def _name(value: Value) -> str:
    if not isinstance(value, str):
        raise ScriptRuntimeError("a socket's name is text")
    return value


def _open(run: Execution, address: Value, port: Value, socket_name: Value = "socket_0") -> Steps:
    name = _name(socket_name)
    if not isinstance(address, str) or isinstance(port, bool) or not isinstance(port, int):
        raise ScriptRuntimeError("socket_open takes an address and a port")
    _close(run, name)
    if len(run.sockets) >= MOST_SOCKETS:
        raise ScriptRuntimeError(f"more than {MOST_SOCKETS} sockets")
    try:
        opened = run.sockets[name] = ProgramSocket(address, port)
    except ValueError as error:
        raise ScriptRuntimeError(f"socket_open: {error}") from error
    for _ in range(round(OPEN_S / TICK_S)):
        if opened.ready():
            return True
        if opened.over:
            break
        yield
    _close(run, name)
    return False


def _close(run: Execution, socket_name: Value = "socket_0") -> None:
    former = run.sockets.pop(_name(socket_name), None)
    if former is not None:
        former.close()


def _read(
    run: Execution, socket_name: Value, timeout: Value, take: Callable[[ProgramSocket], bytes | None]
) -> Generator[None, None, bytes | None]:
    """Bytes of `take`, once it gives some; None when the time is over, or the connection."""
    seconds = number(timeout, "timeout")
    left = round(seconds / TICK_S) if seconds > 0.0 else None
    while (opened := run.sockets.get(_name(socket_name))) is not None:
        taken = take(opened)
        if taken is not None:
            return taken
        if opened.over or left == 0:
            return None
        if left is not None:
            left -= 1
        yield
    return None


def _count(value: Value) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 < value <= MOST_NUMBERS:
        raise ScriptRuntimeError(f"1 to {MOST_NUMBERS} numbers are read at once")
    return value


def _integers(run: Execution, number: Value, socket_name: Value = "socket_0", timeout: Value = READ_S) -> Steps:
    count = _count(number)
    taken = yield from _read(run, socket_name, timeout, lambda opened: opened.take(4 * count))
    return Vector([0, *[-1] * count] if taken is None else [count, *struct.unpack(f">{count}i", taken)])


def _bytes(run: Execution, number: Value, socket_name: Value = "socket_0", timeout: Value = READ_S) -> Steps:
    count = _count(number)
    taken = yield from _read(run, socket_name, timeout, lambda opened: opened.take(count))
    return Vector([0, *[-1] * count] if taken is None else [count, *taken])


def _floats(run: Execution, number: Value, socket_name: Value = "socket_0", timeout: Value = READ_S) -> Steps:
    """Numbers in parentheses, separated by commas."""
    count = _count(number)
    taken = yield from _read(run, socket_name, timeout, lambda opened: opened.take_to(b")"))
    words = [] if taken is None else taken.decode("ascii", "replace").strip(" \r\n\t()").split(",")
    try:
        read = [float(word) for word in words[:count]]
    except ValueError:
        read = []
    return Vector([len(read), *read, *[math.nan] * (count - len(read))])


def _string(
    run: Execution,
    socket_name: Value = "socket_0",
    prefix: Value = "",
    suffix: Value = "",
    interpret_escape: Value = False,  # noqa: FBT002
    timeout: Value = READ_S,
) -> Steps:
    before, after = (_escaped(text, interpret=bool(interpret_escape)) for text in (prefix, suffix))
    taken = yield from _read(run, socket_name, timeout, lambda opened: opened.take_to(after))
    if taken is None:
        return ""
    text = taken[: len(taken) - len(after)]
    return text[text.find(before) + len(before) :].decode("utf-8", "replace") if before in text else ""


def _escaped(value: Value, *, interpret: bool) -> bytes:
    text = as_text(value)
    if interpret:
        for escape, meant in (("\\n", "\n"), ("\\t", "\t"), ("\\r", "\r"), ("\\\\", "\\")):
            text = text.replace(escape, meant)
    return text.encode()


def _line(run: Execution, socket_name: Value = "socket_0", timeout: Value = READ_S) -> Steps:
    taken = yield from _read(run, socket_name, timeout, lambda opened: opened.take_to(b"\n"))
    return "" if taken is None else taken.decode("utf-8", "replace").rstrip("\r\n")


def _get(run: Execution, name: Value, socket_name: Value = "socket_0") -> Steps:
    """Asks the peer for a variable: `GET name`, and `name value` back."""
    _send(run, f"GET {as_text(name)}\n".encode(), socket_name)
    taken = yield from _read(run, socket_name, READ_S, lambda opened: opened.take_to(b"\n"))
    told, _, value = (b"" if taken is None else taken).decode("ascii", "replace").strip().partition(" ")
    return int(value) if told == name and value.strip().lstrip("-").isdecimal() else 0


def _send(run: Execution, message: bytes, socket_name: Value) -> bool:
    opened = run.sockets.get(_name(socket_name))
    return opened is not None and opened.send(message)


def _send_int(run: Execution, value: Value, socket_name: Value = "socket_0") -> bool:
    whole = number(value, "value")
    if whole != int(whole) or not INT_LOW <= whole <= INT_HIGH:
        raise ScriptRuntimeError("socket_send_int takes a 32-bit integer")
    return _send(run, struct.pack(">i", int(whole)), socket_name)


def _send_byte(run: Execution, value: Value, socket_name: Value = "socket_0") -> bool:
    whole = number(value, "value")
    if whole != int(whole) or not 0 <= whole <= 255:
        raise ScriptRuntimeError("socket_send_byte takes 0 to 255")
    return _send(run, bytes([int(whole)]), socket_name)


ROWS: Final[tuple[Function, ...]] = (
    row("socket_open", "address port [socket_name]", _open),
    row("socket_close", "[socket_name]", _close),
    row("socket_read_binary_integer", "number [socket_name] [timeout]", _integers),
    row("socket_read_byte_list", "number [socket_name] [timeout]", _bytes),
    row("socket_read_ascii_float", "number [socket_name] [timeout]", _floats),
    row("socket_read_string", "[socket_name] [prefix] [suffix] [interpret_escape] [timeout]", _string),
    row("socket_read_line", "[socket_name] [timeout]", _line),
    row("socket_get_var", "name [socket_name]", _get),
    row(
        *("socket_set_var", "name value [socket_name]"),
        lambda run, name, value, socket_name="socket_0": _send(
            run, f"SET {as_text(name)} {as_text(value)}\n".encode(), socket_name
        ),
    ),
    row("socket_send_int", "value [socket_name]", _send_int),
    row("socket_send_byte", "value [socket_name]", _send_byte),
    row(
        *("socket_send_string", "str [socket_name]"),
        lambda run, text, socket_name="socket_0": _send(run, as_text(text).encode(), socket_name),
    ),
    row(
        *("socket_send_line", "str [socket_name]"),
        lambda run, text, socket_name="socket_0": _send(run, as_text(text).encode() + b"\n", socket_name),
    ),
)
