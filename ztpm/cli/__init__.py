"""The `ztpm` command line, `--json` for machines.

Exit status: 0 success, 4 not decided yet (another person must answer), 130 Ctrl-C; any other is that of the code with
which the command fails (ztpm/codes): 1 failure, 2 usage, 3 refused.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points

import typer

from ztpm.cli import (
    agent,
    approvals,
    audit,
    cell,
    delegation,
    demo,
    doctor,
    keys,
    mcp,
    people,
    pit,
    revoke,
    rtde_run,
    serve,
    setup,
    token,
    up,
)
from ztpm.cli.brought import GROUP, add_brought
from ztpm.cli.policy import commands
from ztpm.cli.root import CommandLine

app = typer.Typer(
    name="ztpm",
    cls=CommandLine,
    help="Lend authority to AI agents that move a robot: nothing moves unless authority, physics and policy agree.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("demo")(demo.demo)
app.command("doctor")(doctor.doctor)
app.command("up")(up.up)
app.command("init")(setup.init)
app.command("version")(setup.version)
app.command("revoke")(revoke.revoke)
app.add_typer(approvals.app, name="approvals")
app.add_typer(agent.app, name="agent")
app.add_typer(people.app, name="person")
app.add_typer(keys.app, name="keys")
app.add_typer(commands.app, name="policy")
app.add_typer(pit.app, name="pit")
app.add_typer(audit.app, name="audit")
token.app.command("issue")(delegation.issue)
token.app.command("delegate")(delegation.delegate)
app.add_typer(token.app, name="token")
app.add_typer(cell.app, name="cell")
mcp.app.command("serve")(serve.tools)
app.add_typer(mcp.app, name="mcp")
serve.idp.command("recover")(people.recover)
app.add_typer(serve.idp, name="idp")
serve.rtde.command("run")(rtde_run.run)
serve.rtde.command("connect")(rtde_run.connect)
app.add_typer(serve.rtde, name="rtde")


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
