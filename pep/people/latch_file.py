"""File of a robot's latch: it survives every restart, and one that cannot be read is no missing one ([LSD-21])."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.statements.people import latch as statement
from capabilities.values import strict_json
from pep.base.files import replace_file

if TYPE_CHECKING:
    from pathlib import Path

    from capabilities.statements.people.latch import Latch

LATCH_FILE: Final = "latch.json"
"""Name of the file, in the state directory."""
FORM: Final = 1
FILE_BYTES: Final = 16_384
"""Longest file that is read; one has some 1500 bytes."""


@dataclass(frozen=True, slots=True)
class InForce:
    """A latch, and its signed text: empty until the way out is worked out."""

    latch: Latch
    text: str = ""


class LatchFile:
    """The latch on disk, replaced atomically and synced."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def read(self) -> InForce | None:
        """The latch; None where there is no file.

        Raises:
            ValueError: there is one, and it does not say which latch.
            OSError: it cannot be read.
        """
        try:
            with self._path.open("rb") as opened:
                raw = opened.read(FILE_BYTES + 1)
        except FileNotFoundError:
            return None
        stored = strict_json.parse_object(raw)
        text = stored.get("text")
        if stored.keys() != {"form", "latch", "text"} or stored["form"] != FORM or not isinstance(text, str):
            raise ValueError("not the members of a latch's file")
        if not isinstance(stored["latch"], dict) or len(raw) > FILE_BYTES:
            raise ValueError("no latch")
        return InForce(statement.read_claims(stored["latch"]), text)

    def write(self, found: InForce) -> None:
        """The latch is on disk.

        Raises:
            OSError: when it could not be made durable.
        """
        replace_file(
            self._path,
            strict_json.canonical({"form": FORM, "latch": statement.claims(found.latch), "text": found.text}),
        )

    def set_aside(self) -> None:
        """Keeps a copy of an unreadable file for people; the file itself says that there was one."""
        with contextlib.suppress(OSError), self._path.open("rb") as opened:
            self._path.with_suffix(".unreadable").write_bytes(opened.read(FILE_BYTES + 1))

    def remove(self) -> None:
        """There is no latch on disk.

        Raises:
            OSError: when that could not be made so.
        """
        self._path.unlink(missing_ok=True)
