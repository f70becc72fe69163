"""Commands by name, each loaded when it is called: a command costs its own libraries, and those of no other."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

import typer.main

from ztpm.cli.brought import brought
from ztpm.cli.command_rows import PROVE, CommandRow
from ztpm.cli.examples import add_examples, example

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from importlib.metadata import EntryPoint

    from typer import Typer

GROUP: Final = "ztpm.commands"
"""Entry points by which installed packages bring commands."""


class LaterCommands(Mapping[str, Any]):
    """Commands of the command line library, under their names.

    Those that installed packages bring come after those of `ztpm`, which they never replace. They are looked for when a
    name is none of `ztpm`'s own, or when all names are asked for.
    """

    def __init__(self, rows: Iterable[CommandRow], points: Callable[[], Iterable[EntryPoint]]) -> None:
        """A mapping that has loaded nothing.

        Args:
            rows: commands of `ztpm` itself, in their order.
            points: entry points that bring others.
        """
        self._rows = {row.name: row for row in rows}
        self._points = points

    def __getitem__(self, name: str) -> Any:
        row = self._rows.get(name)
        return self._brought[name] if row is None else loaded(row)

    def __iter__(self) -> Iterator[str]:
        yield from self._rows
        yield from self._brought

    def __len__(self) -> int:
        return len(self._rows) + len(self._brought)

    def shown(self) -> dict[str, Any]:
        """Commands as the help lists them: name, panel and first paragraph, without being loaded."""
        own = {
            name: typer.core.TyperCommand(name, help=row.help, rich_help_panel=row.panel)
            for name, row in self._rows.items()
        }
        return {**own, **self._brought}

    @cached_property
    def _brought(self) -> dict[str, Any]:
        found = brought(self._points(), taken=self._rows)
        return {name: _named(typer.main.get_group(app), name, PROVE) for name, app in found.items()}


def installed() -> Iterable[EntryPoint]:
    """Entry points of the installed packages that bring commands."""
    from importlib.metadata import entry_points

    return entry_points(group=GROUP)


@cache
def loaded(row: CommandRow) -> Any:
    """The command of `row`, its modules loaded."""
    home = _at(row.home)
    if not isinstance(home, typer.Typer):
        alone = typer.Typer(add_completion=False)
        alone.command(row.name, epilog=example(row.name))(home)
        return _named(typer.main.get_command(alone), row.name, row.panel)
    for name, joined in row.joined:
        home.command(name)(_at(joined))
    add_examples(home, row.name)
    return _named(typer.main.get_group(home), row.name, row.panel)


def _at(home: str) -> Callable[..., Any] | Typer:
    module, _, name = home.partition(":")
    found: Callable[..., Any] | Typer = getattr(import_module(module), name)
    return found


def _named(command: Any, name: str, panel: str) -> Any:
    command.name, command.rich_help_panel = name, panel
    return command
