"""The `ztpm` command line, `--json` for machines.

Exit status: 0 success, 4 not decided yet (another person must answer), 130 Ctrl-C; any other is that of the code with
which the command fails (ztpm/codes): 1 failure, 2 usage, 3 refused.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points
from typing import Annotated

import typer

from ztpm.cli import cell, demo, doctor, explain, mcp, pit, rtde_run, serve, setup, up
from ztpm.cli.brought import GROUP, add_brought
from ztpm.cli.examples import add_examples
from ztpm.cli.policy import commands
from ztpm.cli.provider import agent, approvals, audit, idp, keys, mandate, people, restore, token
from ztpm.cli.root import LOOK, PEOPLE, PROVE, START, CommandLine

app = typer.Typer(
    name="ztpm",
    cls=CommandLine,
    help="Lend authority to AI agents that move a robot: nothing moves unless authority, physics and policy agree.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def ztpm_(
    *,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=setup.tell_version)
    ] = False,
) -> None:
    """Lend authority to AI agents that move a robot: nothing moves unless authority, physics and policy agree."""


app.command("demo", rich_help_panel=START)(demo.demo)
app.command("up", rich_help_panel=START)(up.up)
app.command("init", rich_help_panel=START)(setup.init)
app.command("doctor", rich_help_panel=START)(doctor.doctor)
app.command("revoke", rich_help_panel=PEOPLE)(token.revoke)
app.command("explain", rich_help_panel=LOOK)(explain.explain)
app.command("version", rich_help_panel=LOOK)(setup.version)
mcp.app.command("serve")(serve.tools)
idp.app.command("recover")(people.recover)
idp.app.command("backup")(restore.backup)
idp.app.command("restore")(restore.restore)
idp.app.command("resume")(restore.resume)
idp.app.command("mark")(restore.mark)
agent.app.command("vouch")(restore.vouch)
serve.rtde.command("run")(rtde_run.run)
serve.rtde.command("connect")(rtde_run.connect)
for name, group, panel in (
    ("approvals", approvals.app, PEOPLE),
    ("agent", agent.app, PEOPLE),
    ("token", token.app, PEOPLE),
    ("mandate", mandate.app, PEOPLE),
    ("person", people.app, PEOPLE),
    ("keys", keys.app, PEOPLE),
    ("cell", cell.app, START),
    ("idp", idp.app, START),
    ("mcp", mcp.app, START),
    ("rtde", serve.rtde, START),
    ("audit", audit.app, LOOK),
    ("pit", pit.app, LOOK),
    ("policy", commands.app, PROVE),
):
    app.add_typer(group, name=name, rich_help_panel=panel)
add_examples(app)


@cache
def command_line() -> typer.Typer:
    """The `app` with the commands that installed packages bring.

    They may import `ztpm`, so not at this module's import.
    """
    add_brought(app, entry_points(group=GROUP))
    return app


def main() -> None:
    """Run the command line."""
    command_line()()
