"""Admission point of the arena, in its own process, with the guarded tools beside it.

    python -m evaluation.redteam.admission.point --config point.toml

Its collections and its memory lie in plain files that the attacks of a scenario change.
"""

from __future__ import annotations

import argparse
import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

import uvicorn

from evaluation.harness.announcing import Announcing
from evaluation.redteam.admission.shelves import MemoryFolder, Shelf
from evaluation.redteam.admission.tools import notes_server
from evaluation.redteam.admission.words import FORMS
from pep.context.stores.sqlite import HighWaterMarkFile
from pep.point.admission_server import AdmissionServer, QuestionError
from pep.point.guard_config import GuardConfig

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pep.context.retrieval import Curated

SHELVES: Final = "shelves"
MEMORY: Final = "memory"
CONTENT_OF: Final = {"handbook": "document", "library": "scenario"}
"""Kind of content by the beginning of a collection's name."""
_COLLECTION: Final = re.compile(r"(handbook|library)-[0-9]{1,9}")


class AdmissionPoint(AdmissionServer):
    """The guarded tools, and the gate of admission beside them.

    Args:
        guard: configuration of the guard.
        people, curators: raw public key by id.
    """

    def __init__(self, guard: GuardConfig, *, people: Mapping[str, bytes], curators: Mapping[str, bytes]) -> None:
        self._folder = guard.folder
        self._adopted: dict[str, str] = {}
        super().__init__(
            notes_server(guard.folder),
            guard,
            people=people,
            curators=curators,
            forms=FORMS,
            memory=MemoryFolder(guard.folder / MEMORY),
            marks=HighWaterMarkFile(guard.folder / "marks.json"),
        )

    def collection(self, name: str) -> Curated:
        """The collection, with its manifest as it lies there now adopted or refused."""
        found = _COLLECTION.fullmatch(name)
        if found is None:
            raise QuestionError("collection: there is none of that name")
        shelf = Shelf(self._folder / SHELVES / name)
        signed = shelf.manifest
        if self._adopted.get(name) != signed:
            self._adopted[name] = signed
            self.curate(name, CONTENT_OF[found[1]], shelf, signed)
        return super().collection(name)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m evaluation.redteam.admission.point", description=__doc__)
    parser.add_argument("--config", required=True, type=Path)
    path = parser.parse_args().config
    given = tomllib.loads(path.read_text("utf-8"))
    known = {name: {id_: bytes.fromhex(raw) for id_, raw in given[name].items()} for name in ("people", "curators")}
    point = AdmissionPoint(GuardConfig.read(path.parent / given["guard"]), **known)

    parts = urlsplit(point.config.audience)
    settings = uvicorn.Config(
        point,
        host=parts.hostname or "127.0.0.1",
        port=parts.port or 80,
        loop="asyncio",
        ws="none",
        log_level="warning",
        access_log=False,
        server_header=False,
    )
    Announcing(settings).run()


if __name__ == "__main__":
    main()
