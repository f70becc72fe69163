"""Parts that a process needs and cannot have, told in one line: code, place, cause, next step."""

from __future__ import annotations

import errno
from typing import Final

from ztpm.codes.code_table import step_of

OWN_CODES: Final = {
    errno.ENOSPC: "DISK_FULL",
    errno.EDQUOT: "DISK_FULL",
    errno.EADDRINUSE: "PORT_UNUSABLE",
    errno.EADDRNOTAVAIL: "PORT_UNUSABLE",
}
"""Errors that are one cause wherever they occur."""


class UnavailableError(Exception):
    """A store, port, disk, certificate or file that cannot be had.

    Attributes:
        code: its cause.
        sentence: place and cause, for a person.
    """

    def __init__(self, code: str, sentence: str) -> None:
        super().__init__(f"{code}: {sentence}")
        self.code = code
        self.sentence = sentence


def unavailable(error: OSError | UnicodeDecodeError, place: object = "", *, code: str = "UNUSABLE") -> UnavailableError:
    """The error as a person is told of it.

    Args:
        error: of the system, or of a text that is none.
        place: its file or address, where the error itself does not name it.
        code: its cause, unless it is one of `OWN_CODES`.
    """
    if isinstance(error, UnicodeDecodeError):
        return UnavailableError(code, f"{place}: not UTF-8 text")
    code = OWN_CODES.get(error.errno or 0, code)
    where = place or error.filename or ""
    cause = error.strerror or str(error) or type(error).__name__
    return UnavailableError(code, f"{where}: {cause}" if where else cause)


def line_of(code: str, sentence: str) -> str:
    """One line for a person: code, place and cause, next step."""
    return f"{code}: {' '.join(sentence.split()).rstrip('.')}. {step_of(code)}"
