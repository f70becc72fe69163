"""Splitter of a byte stream into pieces that begin with their own length in four bytes."""

from __future__ import annotations

from typing import Final

LENGTH: Final = 4
"""Bytes of a length; big-endian."""


class LengthError(ValueError):
    """Length that no piece has; `length` is the stated one."""

    def __init__(self, length: int) -> None:
        super().__init__(f"a piece of {length} bytes")
        self.length = length


class FrameSplitter:
    """Splitter of one stream.

    Args:
        least, most: range of a length.
        itself: whether a length counts its own four bytes.
    """

    def __init__(self, least: int, most: int, *, itself: bool) -> None:
        self._least, self._most = least, most
        self._uncounted = 0 if itself else LENGTH
        self._held = bytearray()

    def feed(self, received: bytes) -> list[bytes]:
        """Pieces completed by `received`, in order, each with its length.

        Raises:
            LengthError: a length outside the bounds, as soon as it is there.
        """
        held = self._held
        if not held and self._is_one(received):  # as nearly always
            return [received]
        held += received
        found: list[bytes] = []
        at = 0
        while len(held) - at >= LENGTH:
            length = int.from_bytes(held[at : at + LENGTH], "big", signed=True)
            if not self._least <= length <= self._most:
                raise LengthError(length)
            end = at + self._uncounted + length
            if len(held) < end:
                break
            found.append(bytes(held[at:end]))
            at = end
        del held[:at]
        return found

    def _is_one(self, received: bytes) -> bool:
        """True where that is one whole piece."""
        length = len(received) - self._uncounted
        return self._least <= length <= self._most and received.startswith(length.to_bytes(LENGTH, "big", signed=True))
