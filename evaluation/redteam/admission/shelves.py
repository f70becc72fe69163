"""Stores that nobody trusts: collections of documents and rows of a memory, as plain files that anyone may change."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Final

from pep.context.collection import StoredContent
from pep.context.memory_rows import MemoryRow

if TYPE_CHECKING:
    from pathlib import Path

MANIFEST: Final = "manifest.jws"
ENDING: Final = ".txt"
_WORD: Final = re.compile(r"\w+")


class Shelf:
    """Collection in a folder: a file for each content, and the signed manifest beside them.

    Args:
        folder: of it.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def keep(self, id_: str, text: str) -> None:
        """Puts a content there, in place of an earlier one of that id."""
        self._folder.mkdir(parents=True, exist_ok=True)
        (self._folder / f"{id_}{ENDING}").write_text(text, "utf-8")

    def sign(self, manifest: str) -> None:
        """Puts a manifest there."""
        (self._folder / MANIFEST).write_text(manifest, "ascii")

    @property
    def manifest(self) -> str:
        """The manifest as it lies there, or nothing."""
        path = self._folder / MANIFEST
        return path.read_text("ascii") if path.exists() else ""

    def nearest(self, query: str, *, most: int) -> list[StoredContent]:
        """Contents that share most words with the query first."""
        wanted = set(_WORD.findall(query.lower()))
        held = [StoredContent(id_, self._path(id_).read_text("utf-8")) for id_ in self.ids(most=1 << 16)]
        held.sort(key=lambda one: -len(wanted & set(_WORD.findall((one.text or "").lower()))))
        return held[:most]

    def ids(self, *, most: int) -> list[str]:
        """Ids of the contents, in order."""
        return sorted(path.name.removesuffix(ENDING) for path in self._folder.glob(f"*{ENDING}"))[:most]

    def _path(self, id_: str) -> Path:
        return self._folder / f"{id_}{ENDING}"


class MemoryFolder:
    """Rows of a memory, a file each.

    Args:
        folder: of them.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def append(self, row: MemoryRow) -> None:
        """Adds a row.

        Raises:
            FileExistsError: its place is taken.
        """
        with self.path(row.sequence).open("x", encoding="utf-8") as file:
            json.dump({"text": row.text, "value": row.value.decode()}, file)

    def replace(self, row: MemoryRow) -> None:
        """Puts a row in the place of another one, as an intruder does."""
        self.path(row.sequence).unlink(missing_ok=True)
        self.append(row)

    def row(self, sequence: int) -> MemoryRow | None:
        """The row at that place."""
        path = self.path(sequence)
        if not path.exists():
            return None
        held = json.loads(path.read_text("utf-8"))
        return MemoryRow(sequence, held["text"], held["value"].encode())

    def rows(self, *, most: int) -> list[MemoryRow]:
        """At most so many rows, in the order of their places."""
        places = sorted(int(path.stem) for path in self._folder.glob("*.json"))[:most]
        return [row for place in places if (row := self.row(place)) is not None]

    def path(self, sequence: int) -> Path:
        """File of a place."""
        return self._folder / f"{sequence}.json"
