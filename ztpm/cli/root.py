"""The root of the command line: every way in which a command ends, told in one form."""

from __future__ import annotations

import sys
from itertools import takewhile
from typing import TYPE_CHECKING, Any, Final, NoReturn

import typer
from typer import rich_utils
from typer.core import TyperGroup

from ztpm.cli.output import AS_JSON, INTERRUPTED, fail
from ztpm.codes.unavailable import UnavailableError, unavailable

if TYPE_CHECKING:
    from collections.abc import Sequence


START: Final = "Start a cell and its parts"
PEOPLE: Final = "People: lend, answer, revoke"
LOOK: Final = "Look"
PROVE: Final = "Prove"
PANELS: Final = (START, PEOPLE, LOOK, PROVE)
"""Groups of the commands, in the order in which the help shows them."""


class CommandLine(TyperGroup):
    """Group that ends wrong usage, Ctrl-C, and files that cannot be had as every other failure ends."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of the commands, group by group."""
        names = super().list_commands(ctx)
        panels = {name: getattr(self.commands[name], "rich_help_panel", PROVE) for name in names}
        return sorted(names, key=lambda name: PANELS.index(panels[name]))

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
        words = sys.argv[1:] if args is None else list(args)
        # A program's own options follow `--`.
        AS_JSON.set("--json" in takewhile(lambda word: word != "--", words))
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


def _usage(error: typer.TyperException) -> NoReturn:
    """Ends a command that was asked for wrongly; one without any words shows its help."""
    context = getattr(error, "ctx", None)
    if not AS_JSON.get() and type(error).__name__ == "NoArgsIsHelpError":
        rich_utils.rich_format_error(error)  # type: ignore[arg-type]
        raise typer.Exit(error.exit_code)
    path = "ztpm" if context is None else context.command_path
    sentence = " ".join(error.format_message().split()).rstrip(".")
    fail("USAGE", f"{path}: {sentence[:1].lower()}{sentence[1:]}" if sentence else f"{path}: no command is given")
