"""Output of commands: one JSON object with `--json`, a table or a sentence without."""

from __future__ import annotations

import datetime as dt
import json
import os
import sys
from collections.abc import Mapping
from typing import Final, NoReturn

import typer
from rich.console import Console

from capabilities.values.characters import shown

FAILURE: Final = 1
USAGE: Final = 2
DENY: Final = 3
"""Exit status of a refusal: a token that does not verify, a request that the identity provider turns down."""
DEFER: Final = 4
"""Exit status of an open decision: another person must answer."""

WIDE: Final = 160
"""Columns where the output's width is unknown: piped text must not be cut to fit a screen."""
console = Console(
    highlight=False, soft_wrap=True, width=None if sys.stdout.isatty() or "COLUMNS" in os.environ else WIDE
)


def say_json(value: object) -> None:
    """Prints the value as one line of JSON on standard output."""
    typer.echo(json.dumps(value, ensure_ascii=False, allow_nan=False))


def plain(text: str) -> str:
    """Foreign text, made safe for a terminal and its reader: nothing controls the one or deceives the other."""
    return shown(text)


def instant(at: int) -> str:
    """A moment in seconds since the epoch, as people read it and programs sort it (UTC)."""
    return dt.datetime.fromtimestamp(at, dt.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def fail(
    code: str, sentence: str, *, as_json: bool, status: int = FAILURE, more: Mapping[str, object] | None = None
) -> NoReturn:
    """Ends the command with a reason code and a sentence; `more` is told by machine alone."""
    if as_json:
        say_json({"ok": False, "code": code, "detail": sentence, **(more or {})})
    else:
        typer.echo(f"{code}: {sentence}", err=True)
    raise typer.Exit(status)
