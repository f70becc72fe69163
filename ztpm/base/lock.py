"""One cell at a time in a directory: a lock that ends with its holder, and holds the holder's pid."""

from __future__ import annotations

import fcntl
import os
from typing import TYPE_CHECKING, Final, Self

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

PID_BYTES: Final = 32
UNKNOWN: Final = 0
"""Stands for the pid of a holder that has not written it yet."""


class LockedError(RuntimeError):
    """The lock is held by another process.

    Attributes:
        pid: of the holder, or `UNKNOWN`.
    """

    def __init__(self, path: Path, pid: int) -> None:
        super().__init__(f"{path} is held by process {pid}")
        self.pid = pid


class DirectoryLock:
    """A held lock; leaving the `with` block gives it back.

    Attributes:
        stale_pid: of an earlier holder that ended without giving it back (kill -9, a power cut), or None.
    """

    def __init__(self, descriptor: int, stale_pid: int | None) -> None:
        self._fd = descriptor
        self.stale_pid = stale_pid

    @classmethod
    def take(cls, path: Path) -> DirectoryLock:
        """Takes the lock for this process. Children do not inherit it.

        Args:
            path: of the lock file; made when missing, never removed, so that two processes never lock two files.

        Raises:
            LockedError: when another process holds it.
            OSError: when the file cannot be made.
        """
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise LockedError(path, _pid_in(descriptor) or UNKNOWN) from None
            stale_pid = _pid_in(descriptor)
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, b"%d\n" % os.getpid(), 0)
        except BaseException:
            os.close(descriptor)
            raise
        return cls(descriptor, stale_pid)

    def give_back(self) -> None:
        """Frees the lock, and empties the file."""
        os.ftruncate(self._fd, 0)
        # A child that was just started has the file open until the kernel closes it: the lock is ended, not left.
        fcntl.flock(self._fd, fcntl.LOCK_UN)
        os.close(self._fd)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.give_back()


def _pid_in(descriptor: int) -> int | None:
    text = os.pread(descriptor, PID_BYTES, 0).strip()
    return int(text) if text.isdigit() else None
