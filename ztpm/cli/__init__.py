"""The `ztpm` command line: exit 0 success, 1 failure, 2 usage, 3 a token that is refused; `--json` for machines."""

from __future__ import annotations

import typer

from ztpm.cli import audit, cell, demo, doctor, evaluation, policy, serve, setup, token

app = typer.Typer(
    name="ztpm",
    help="Lend authority to AI agents that move a robot: nothing moves unless authority, physics and policy agree.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("demo")(demo.demo)
app.command("doctor")(doctor.doctor)
app.command("init")(setup.init)
app.command("version")(setup.version)
app.add_typer(policy.app, name="policy")
app.add_typer(audit.app, name="audit")
app.add_typer(token.app, name="token")
app.add_typer(cell.app, name="cell")
app.add_typer(evaluation.app, name="eval")
app.add_typer(serve.idp, name="idp")
app.add_typer(serve.rtde, name="rtde")


def main() -> None:
    """Run the command line."""
    app()
