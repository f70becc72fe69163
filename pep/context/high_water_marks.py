"""High-water marks: the newest version ever seen of a thing, kept out of reach of the thing's keeper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol


@dataclass(frozen=True, slots=True)
class HighWaterMark:
    """Newest version or number seen, with the SHA-256 (hex) of its text; 0 and "" for nothing yet."""

    version: int
    digest: str


UNSEEN: Final = HighWaterMark(0, "")


class HighWaterMarks(Protocol):
    """Marks by name, over restarts. One process at a time; any thread."""

    def read(self, name: str) -> HighWaterMark:
        """The mark, `UNSEEN` when there never was one.

        Raises:
            PepError: `STATE_UNREADABLE`; to start from nothing would accept what was rolled back.
        """
        ...

    def write(self, name: str, mark: HighWaterMark) -> None:
        """Writes the mark so that it survives a power cut.

        Raises:
            PepError: `STATE_UNREADABLE` when it could not be made durable.
        """
        ...
