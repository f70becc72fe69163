"""Log of a cell's keeper, as JSON lines.

It is no audit: that is the journal and the ledger.
"""

from __future__ import annotations

import datetime as dt
import json
import threading
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

MOST_BYTES: Final = 4_194_304
"""A longer log is put aside when the next run begins; one earlier log is kept."""


class EventLog:
    """Appends one line for each event. Any thread. A line that cannot be written stops nothing.

    Args:
        path: of the file.
        wall_s: wall clock, seconds since the epoch.
        say: is told each event as a sentence, too.
    """

    def __init__(self, path: Path, *, wall_s: Callable[[], float], say: Callable[[str], None]) -> None:
        self._path = path
        self._wall_s = wall_s
        self._say = say
        self._lock = threading.Lock()
        try:
            if path.stat().st_size > MOST_BYTES:
                path.replace(path.with_name(path.name + ".1"))
        except OSError:
            return

    def note(self, event: str, sentence: str, **facts: object) -> None:
        """Tells the event and writes it to the file.

        Args:
            event: its name, for programs.
            sentence: for people.
            facts: plain JSON.
        """
        at = dt.datetime.fromtimestamp(self._wall_s(), dt.UTC).isoformat(timespec="milliseconds")
        line = json.dumps({"at": at, "event": event, "sentence": sentence, **facts}) + "\n"
        with self._lock:
            self._say(sentence)
            try:
                with self._path.open("a", encoding="utf-8") as file:
                    file.write(line)
            except OSError as error:
                self._say(f"{self._path}: {type(error).__name__}")
