"""The root of the command line: every way in which a command ends, told in one form."""

from __future__ import annotations

import re
import sys
from copy import copy
from itertools import takewhile
from typing import TYPE_CHECKING, Any, Final, NoReturn

import typer
from typer.core import TyperGroup

from ztpm.cli.command_rows import ROWS
from ztpm.cli.later_commands import LaterCommands, installed
from ztpm.cli.light_help import load_help
from ztpm.cli.output import AS_JSON, DONE, INTERRUPTED, fail
from ztpm.cli.plain_values import read_plainly
from ztpm.codes.unavailable import UnavailableError, unavailable

if TYPE_CHECKING:
    from collections.abc import Sequence


HELP: Final = frozenset({"-h", "--help"})
_DASHED_ID: Final = re.compile(r"-(?!-)[A-Za-z0-9_-]{21}(?:[A-Za-z0-9_-]{21})?")
"""Id of a token, 22 characters, or name of a key, 43, that begins with a dash."""


class CommandLine(TyperGroup):
    """Group that loads a command when it is called, and ends every failure in one form.

    So end wrong usage, Ctrl-C, and files that cannot be had.
    """

    def __init__(self, **settings: Any) -> None:
        """The group of all commands of `ztpm`, and of those that installed packages bring."""
        super().__init__(**settings)
        self.commands = LaterCommands(ROWS, installed)  # type: ignore[assignment]

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002 - of the library
        """Names of the commands, group by group."""
        return list(self.commands)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Writes the help, in which each command is one line, without loading them."""
        load_help()
        listed = copy(self)
        listed.commands = self.commands.shown()  # type: ignore[attr-defined]
        TyperGroup.format_help(listed, ctx, formatter)

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,  # noqa: ARG002, FBT001, FBT002 - of the library; it is never more than a command
        windows_expand_args: bool = True,  # noqa: ARG002, FBT001, FBT002 - likewise
        **extra: Any,
    ) -> NoReturn:
        """Runs one command, and ends the process with its exit status."""
        words = with_ids_last(sys.argv[1:] if args is None else list(args))
        # A program's own options follow `--`.
        own = set(takewhile(lambda word: word != "--", words))
        AS_JSON.set("--json" in own)
        DONE.set(None)
        if own & HELP:
            load_help()
        read_plainly()
        try:
            status = self._end(words, prog_name, complete_var, **extra)
        except typer.Exit as end:
            status = end.exit_code
        sys.exit(status)

    def _end(self, words: Sequence[str], prog_name: str | None, complete_var: str | None, **extra: Any) -> int:
        try:
            status = super().main(words, prog_name, complete_var, standalone_mode=False, **extra)
        except typer.Abort as error:
            if isinstance(error.__context__, EOFError):
                fail("NOT_CONFIRMED", "the input ended before an answer")
            return INTERRUPTED
        except typer.TyperException as error:
            _usage(error)
        except UnavailableError as error:
            fail(error.code, error.sentence)
        except OSError as error:
            told = unavailable(error)
            fail(told.code, told.sentence)
        return status if type(status) is int else 0


def with_ids_last(words: list[str]) -> list[str]:
    """The words, with the id that `ztpm revoke` takes behind `--`, where it looks like an option."""
    place = next((at for at in range(2, len(words)) if _DASHED_ID.fullmatch(words[at])), 0)
    if words[:1] != ["revoke"] or not place or "--" in words or words[place - 1].startswith("--"):
        return words
    return [*words[:place], *words[place + 1 :], "--", words[place]]


def tell_version(wanted: bool) -> None:  # noqa: FBT001 - as Typer calls it
    """Prints the version and ends the command, where `--version` is given."""
    if wanted:
        from ztpm.cli.setup import version

        version(as_json=AS_JSON.get())
        raise typer.Exit


def _usage(error: typer.TyperException) -> NoReturn:
    """Ends a command that was asked for wrongly; one without any words shows its help."""
    context = getattr(error, "ctx", None)
    if not AS_JSON.get() and type(error).__name__ == "NoArgsIsHelpError":
        from typer import rich_utils

        rich_utils.rich_format_error(error)  # type: ignore[arg-type]
        raise typer.Exit(error.exit_code)
    path = "ztpm" if context is None else context.command_path
    sentence = " ".join(error.format_message().split()).rstrip(".")
    fail("USAGE", f"{path}: {sentence[:1].lower()}{sentence[1:]}" if sentence else f"{path}: no command is given")
