"""Commands that installed packages bring: each entry point of the group `ztpm.commands` is a Typer under its name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import typer

from ztpm.cli.root import PROVE

if TYPE_CHECKING:
    from collections.abc import Iterable
    from importlib.metadata import EntryPoint

GROUP: Final = "ztpm.commands"


def add_brought(app: typer.Typer, points: Iterable[EntryPoint]) -> None:
    """Adds the commands of `points` to `app`; a command of `app` itself is never replaced.

    An entry point is left out, and a line on standard error says why, when its name is taken or it does not load.

    Args:
        app: the command line, with all commands of its own.
        points: of the group `ztpm.commands`.
    """
    taken = {group.name for group in app.registered_groups} | {command.name for command in app.registered_commands}
    for point in sorted(points, key=lambda point: point.name):
        if point.name in taken:
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
        taken.add(point.name)
        app.add_typer(commands, name=point.name, rich_help_panel=PROVE)


def _leave_out(point: EntryPoint, why: str) -> None:
    typer.echo(f"COMMAND_LEFT_OUT: {point.name} ({point.value}): {why}", err=True)
