"""Output of commands: one JSON object with `--json`, a table or a sentence without; and their end at a failure."""

from __future__ import annotations

import datetime as dt
import json
import os
import sys
from collections.abc import Mapping
from contextvars import ContextVar
from typing import Final, NoReturn

import typer
from rich.console import Console

from capabilities.values.characters import shown
from ztpm.codes.code_table import DENY, FAILURE, USAGE, status_of, step_of
from ztpm.codes.unavailable import unavailable

__all__ = ["DEFER", "DENY", "FAILURE", "USAGE", "beside", "console", "fail", "fail_at", "instant", "plain", "say_json"]
DEFER: Final = 4
"""Exit status of an open decision: another person must answer."""
INTERRUPTED: Final = 130
"""Exit status after Ctrl-C, as shells have it."""
AS_JSON: Final = ContextVar("AS_JSON", default=False)
"""True where the command line asks for JSON; read from its words, so that it holds for wrong ones, too."""
DONE: Final[ContextVar[Mapping[str, object] | None]] = ContextVar("DONE", default=None)
"""Acts before a failure, told to machines beside it: an arm that was stopped stays stopped."""

WIDE: Final = 160
"""Columns where the output's width is unknown: piped text must not be cut to fit a screen."""
console = Console(
    highlight=False, soft_wrap=True, width=None if sys.stdout.isatty() or "COLUMNS" in os.environ else WIDE
)


def beside() -> Console:
    """Console of standard error, for what is told beside a document on standard output."""
    shown_in_full = None if sys.stderr.isatty() or "COLUMNS" in os.environ else WIDE
    return Console(highlight=False, soft_wrap=True, width=shown_in_full, stderr=True)


def say_json(value: object) -> None:
    """Prints the value as one line of JSON on standard output."""
    typer.echo(json.dumps(value, ensure_ascii=False, allow_nan=False))


def plain(text: str) -> str:
    """Foreign text, made safe for a terminal and its reader: nothing controls the one or deceives the other."""
    return shown(text)


def instant(at: int) -> str:
    """A moment in seconds since the epoch, as people read it and programs sort it (UTC)."""
    return dt.datetime.fromtimestamp(at, dt.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def fail(code: str, sentence: str, *, status: int | None = None, more: Mapping[str, object] | None = None) -> NoReturn:
    """Ends the command with a code, a sentence, and the next step that belongs to the code.

    Args:
        code: of a table of codes; it decides the exit status.
        sentence: place and cause.
        status: in place of the code's own.
        more: told to machines alone.
    """
    step = step_of(code)
    if AS_JSON.get():
        told = {"ok": False, "code": code, "detail": sentence, **({"next": step} if step else {})}
        say_json({**told, **(DONE.get() or {}), **(more or {})})
    else:
        end = "\n" if "\n" in sentence else " " if sentence.endswith((".", "?", "!")) else ". "
        typer.echo(f"{code}: {sentence}{end}{step}" if step else f"{code}: {sentence}", err=True)
    raise typer.Exit(status_of(code) if status is None else status)


def fail_at(place: object, error: OSError | UnicodeDecodeError, code: str) -> NoReturn:
    """Ends the command at a file or address that cannot be had.

    Args:
        place: of it.
        error: of the system.
        code: `UNREADABLE`, `UNWRITABLE` or the like; a full disk is told as one in any case.
    """
    told = unavailable(error, place, code=code)
    fail(told.code, told.sentence)
