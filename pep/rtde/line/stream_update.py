"""Fast path of a running stream: each next value is read and written by the six doubles that changed.

A streaming program sends one package five hundred times a second, and nothing in it changes but six doubles in a row.
Every other change, and a package that comes torn or with more, goes the long way through the image
(`pep.rtde.command.image_changes`), as the first value does.
"""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING, Final

from pep.rtde.command import command_values as v
from pep.rtde.command.command_table import encode
from pep.rtde.wire.codec import encode_request
from pep.rtde.wire.recipes import DOUBLE

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pep.rtde.command.command_values import Command
    from pep.rtde.wire.codec import Recipe
    from pep.rtde.wire.messages import Values
    from pep.rtde.wire.recipes import Offset

_SIX: Final = struct.Struct(">6d")
_DOUBLE_BYTES: Final = 8
_PROTOCOL: Final = 2
"""Protocol version of the frames: a client's values are the same in both."""


class Following:
    """Places of the doubles that may change from one value to the next. Use `of`.

    Args:
        said: the client's frame, in which everything else stays.
        first: first byte of the six doubles in it.
        frame: that was written for it.
        places: first bytes of the six doubles in that.
    """

    def __init__(self, said: bytes, first: int, frame: bytes, places: tuple[int, ...]) -> None:
        self._size, self._first, beyond = len(said), first, first + _SIX.size
        self._before, self._after = said[:first], said[beyond:]
        self._frame = bytearray(frame)
        self._runs = _runs(zip(range(first, beyond, _DOUBLE_BYTES), places, strict=True))

    @classmethod
    def of(
        cls, package: Values, recipe: Recipe, *, frame: bytes, own: Recipe, command: Command, offset: Offset
    ) -> Following | None:
        """Follower of a command that came in one package, and was written in one frame.

        Args:
            package: newest of the client, of the form of `recipe`.
            recipe: the client's.
            frame: newest of ours; it ends with values of the form of `own`.
            own: ours.
            command: that was written.
            offset: first register of both.

        Returns:
            None where values of this command do not follow each other in six doubles, or one package does not say it.
        """
        if not isinstance(command, v.ServoJ | v.SpeedJ):
            return None
        there = recipe.unpack(package.packed)
        if any(name not in there or there[name] != value for name, value in encode(command, offset).items()):
            return None
        six = DOUBLE[offset : offset + 6]
        begin, head = recipe.names.index(six[0]), len(frame) - own.size
        if recipe.names[begin : begin + len(six)] != six:
            return None
        said = encode_request(package, _PROTOCOL)
        place, places = recipe.place(six[0]), [own.place(name) for name in six]
        assert place is not None
        first = len(said) - len(package.packed) + place
        return cls(said, first, frame, tuple(head + place for place in places if place is not None))

    def read(self, received: bytes) -> v.Six | None:
        """The six doubles of the next value; None where these bytes are another frame in anything but these."""
        if len(received) != self._size or not received.startswith(self._before) or not received.endswith(self._after):
            return None
        six: v.Six = _SIX.unpack_from(received, self._first)
        return six if all(map(math.isfinite, six)) else None

    def written(self, received: bytes) -> bytes:
        """The frame to write for bytes that `read` has read."""
        frame = self._frame
        for at, place, length in self._runs:
            frame[place : place + length] = received[at : at + length]
        return bytes(frame)


def _runs(places: Iterable[tuple[int, int]]) -> list[tuple[int, int, int]]:
    """Runs of adjacent bytes to copy: source, target and length of each."""
    runs: list[tuple[int, int, int]] = []
    for at, place in places:
        if runs and (at, place) == (runs[-1][0] + runs[-1][2], runs[-1][1] + runs[-1][2]):
            runs[-1] = (*runs[-1][:2], runs[-1][2] + _DOUBLE_BYTES)
        else:
            runs.append((at, place, _DOUBLE_BYTES))
    return runs
