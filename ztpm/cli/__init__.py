"""The `ztpm` command line, `--json` for machines.

Exit status: 0 success, 4 not decided yet (another person must answer), 130 Ctrl-C; any other is that of the code with
which the command fails (ztpm/codes): 1 failure, 2 usage, 3 refused.
"""

from __future__ import annotations

from typing import Annotated

import typer

from ztpm.cli.root import HELP, CommandLine, tell_version

app = typer.Typer(
    name="ztpm",
    cls=CommandLine,
    help="Lend authority to AI agents that move a robot: nothing moves unless authority, physics and policy agree.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": sorted(HELP)},
)


@app.callback()
def ztpm_(
    *,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=tell_version)
    ] = False,
) -> None:
    """Lend authority to AI agents that move a robot: nothing moves unless authority, physics and policy agree."""


def main() -> None:
    """Run the command line."""
    app()
