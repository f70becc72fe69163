"""Commands that installed packages bring: each entry point of the group `ztpm.commands` is a Typer under its name."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable
    from importlib.metadata import EntryPoint


def brought(points: Iterable[EntryPoint], *, taken: Collection[str]) -> dict[str, typer.Typer]:
    """Commands of `points`, by name.

    An entry point is left out, and a line on standard error says why, when its name is taken or it does not load.

    Args:
        points: of the group `ztpm.commands`.
        taken: names of the command line's own commands, which are never replaced.
    """
    found: dict[str, typer.Typer] = {}
    for point in sorted(points, key=lambda point: point.name):
        if point.name in taken or point.name in found:
            _leave_out(point, "the name is taken")
            continue
        try:
            commands = point.load()
        except (ImportError, AttributeError) as error:
            _leave_out(point, str(error))
            continue
        if not isinstance(commands, typer.Typer):
            _leave_out(point, "it is no Typer")
            continue
        found[point.name] = commands
    return found


def _leave_out(point: EntryPoint, why: str) -> None:
    typer.echo(f"COMMAND_LEFT_OUT: {point.name} ({point.value}): {why}", err=True)
