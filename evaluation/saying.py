"""Ends of a command that measures: the file of its result, its progress, and its words."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ztpm.cli.output import console, fail_at, say_json
from ztpm.preparing import SHOWN, waiting

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from rich.table import Table

Plot = Annotated[Path | None, typer.Option(help="A PNG file for the picture; needs matplotlib.")]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON object instead of tables.")]


def place(file: Path) -> None:
    """Makes the file of a result, empty, before what takes long is begun.

    Ends the command with `UNWRITABLE` where that cannot be.
    """
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    except OSError as error:
        fail_at(file, error, "UNWRITABLE")


def say(
    result: Any, tables: Callable[[Any], Sequence[Table]], last_line: Callable[[Any], str], *, as_json: bool
) -> None:
    """Prints a result: one JSON object, or its tables, the machine, and the figures that count last."""
    if as_json:
        say_json(result.to_json())
        return
    for table in tables(result):
        console.print(table)
        console.print()
    console.print(f"{result.seconds:.0f} s on {result.machine['processor']}; load {result.machine['load'][0]}")
    console.print(last_line(result))


@contextmanager
def telling(what: str = "measuring") -> Iterator[Callable[[str], None]]:
    """Shows on standard error what is told, and how long it takes where nothing is."""
    with waiting(what):
        yield SHOWN.tell
