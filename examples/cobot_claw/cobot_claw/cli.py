"""`ztpm claw`: a person asks four agents in natural language.

The entry point `claw` of the group `ztpm.commands` names `app`; `ztpm` itself imports nothing of this package.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

if TYPE_CHECKING:
    from pathlib import Path


class Requests(TyperGroup):
    """Group whose first word is a request, unless it is a command's name."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """The words, with `ask` before a request."""
        if args and args[0] not in self.commands and args[0] not in {"-h", "--help"}:
            args = ["ask", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=Requests, help="Ask four agents, each with a capability of its own, to work with the arm.", no_args_is_help=True
)


@app.callback()
def claw() -> None:
    """Ask four agents, each with a capability of its own, to work with the arm."""


@app.command(epilog='Example: ztpm claw "hand me the part"')
def ask(
    requests: Annotated[
        list[str], typer.Argument(help='What is wanted, such as "hand me the part"; one after another.')
    ],
    *,
    data: Annotated[Path | None, typer.Option(help="An empty directory, in which everything is kept.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object for each request.")] = False,
) -> None:
    """Ask in natural language, on a fresh cell.

    Scripts play the models unless COBOT_CLAW_MODEL names one: `openai:NAME`, `anthropic:NAME`, `vllm:NAME@URL`. The
    exit status is 3 when something was refused or failed.
    """
    from cobot_claw.errors import ClawError
    from cobot_claw.models import model_for, stated
    from cobot_claw.system import system
    from ztpm.base.processes import ChildError

    done = True
    try:
        model_for("orchestrator", stated())  # a wrong choice is told before anything is started
        with system(directory=data, told=lambda what: typer.echo(f"starting {what}", err=True)) as running:
            for text in requests:
                told = running.ask(text)
                done = done and told.done
                if as_json:
                    typer.echo(json.dumps({"request": text, **asdict(told)}))
                else:
                    typer.echo(f"> {text}\n{told.text}")
                    typer.echo(f"  {told.seconds:.1f} s, the arm moved {told.moved_rad:.2f} rad, trace {told.trace}\n")
    except (ClawError, ChildError) as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(1) from error
    sys.exit(0 if done else 3)
