"""Records of fixed layout, the parts of frames of the primary and real-time interfaces."""

from __future__ import annotations

import struct
from typing import Any, ClassVar, Self, TypeAlias

from pep.rtde.wire.messages import WireError, WireFault

Vector: TypeAlias = tuple[float, ...]


class Record:
    """Fields in wire order. `LAYOUT` has a word of `struct` for each; one with a count is a tuple."""

    LAYOUT: ClassVar[str]
    _STRUCT: ClassVar[struct.Struct]
    _WIDTHS: ClassVar[tuple[int, ...]]  # 0 for a number alone
    __slots__: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls) -> None:
        words = cls.LAYOUT.split()
        cls._STRUCT = struct.Struct(">" + "".join(words))
        cls._WIDTHS = tuple(int(word[:-1] or 0) for word in words)

    @classmethod
    def size(cls) -> int:
        """Bytes of the record."""
        return cls._STRUCT.size

    @classmethod
    def unpack(cls, body: bytes) -> Self:
        """The record of exactly these bytes."""
        if len(body) != cls._STRUCT.size:
            raise WireError(WireFault.PAYLOAD, f"{cls.__name__} of {len(body)} bytes")
        flat, at = cls._STRUCT.unpack(body), 0
        values: list[object] = []
        for width in cls._WIDTHS:
            values.append(flat[at : at + width] if width else flat[at])
            at += width or 1
        return cls(*values)

    def pack(self) -> bytes:
        """The bytes of the record."""
        flat: list[Any] = []
        for width, name in zip(self._WIDTHS, self.__slots__, strict=True):
            value = getattr(self, name)
            if width:
                flat += value
            else:
                flat.append(value)
        try:
            return self._STRUCT.pack(*flat)
        except struct.error as error:
            raise WireError(WireFault.VALUE, str(error)) from error
