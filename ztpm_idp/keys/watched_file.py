"""Files that are read again when they change, while the provider serves. What cannot be read changes nothing."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Final, Generic, Protocol, TypeVar

from ztpm_idp.keys.key_files import SettingsError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

POLL_S: Final = 0.5
"""Time between two looks at a file: well below the seconds in which a withdrawal has to be everywhere."""
_LOG: Final = logging.getLogger(__name__)

_T = TypeVar("_T")
_Stamp = tuple[int, int, int] | None


class Beside(Protocol):
    """Task beside a provider, for as long as it serves."""

    async def run(self) -> None:
        """Goes on for ever."""
        ...


class WatchedFile(Generic[_T]):
    """A file, what is read of it, and who takes that.

    Args:
        setting: that names the file.
        path: of it; a file that is replaced whole is best, one that is written in place is read again when it is done.
        read: its content, in a thread; raises `SettingsError`.
        take: acts on it, in the event loop, at once or not at all; raises `SettingsError`.
        faults: has the reason, by setting, for which it is not acted on now.
    """

    def __init__(
        self,
        setting: str,
        path: Path,
        *,
        read: Callable[[], _T],
        take: Callable[[_T], None],
        faults: dict[str, str],
    ) -> None:
        self._setting, self._path = setting, path
        self._read, self._take, self._faults = read, take, faults
        self._seen = self._stamp()

    async def look(self) -> None:
        """Looks once; a file that changed since it was last taken is read, and taken."""
        stamp = self._stamp()
        if stamp == self._seen:
            if self._faults.pop(self._setting, None) is not None:
                _LOG.warning("%s: as it was, and acted on", self._setting)
            return
        try:
            self._take(await asyncio.to_thread(self._read))
        except SettingsError as error:
            why = f"{error.setting}: {error.why}"
            if self._faults.get(self._setting) != why:
                _LOG.error("not acted on, the one before is still in force: %s", why)
            self._faults[self._setting] = why
            return
        self._seen = stamp  # of before it was read: what came meanwhile is read next time
        self._faults.pop(self._setting, None)
        _LOG.warning("%s: changed, and acted on", self._setting)

    async def run(self) -> None:
        """Looks for ever."""
        while True:
            await asyncio.sleep(POLL_S)
            await self.look()

    def _stamp(self) -> _Stamp:
        try:
            found = self._path.stat()
        except OSError:
            return None
        return found.st_ino, found.st_mtime_ns, found.st_size
