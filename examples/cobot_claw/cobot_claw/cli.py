"""`ztpm claw`: a person asks four agents in natural language.

The entry point `claw` of the group `ztpm.commands` names `app`; `ztpm` itself imports nothing of this package.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup


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
    approve: Annotated[
        bool, typer.Option("--approve", help="Bob, who is asked about tier 3, says yes to all.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object for each request.")] = False,
) -> None:
    """Ask in natural language, on a fresh cell.

    Scripts play the models unless COBOT_CLAW_MODEL names one: `openai:NAME`, `anthropic:NAME`, `vllm:NAME@URL`. The
    exit status is 3 when something was refused or failed.
    """
    from cobot_claw.errors import ClawError
    from cobot_claw.models import model_for, stated
    from cobot_claw.system import system
    from ztpm.base.layout import LayoutError
    from ztpm.base.processes import ChildError
    from ztpm.stage.stage import StageError

    done = True
    try:
        model_for("orchestrator", stated())  # a wrong choice is told before anything is started
        with system(directory=data, told=_starting, approves=_answer(yes=approve)) as running:
            for text in requests:
                told = running.ask(text)
                done = done and told.done
                if as_json:
                    typer.echo(json.dumps({"request": text, **asdict(told)}))
                else:
                    typer.echo(f"> {text}\n{told.text}")
                    typer.echo(f"  {told.seconds:.1f} s, the arm moved {told.moved_rad:.2f} rad, trace {told.trace}\n")
    except (ClawError, ChildError, LayoutError, StageError) as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(1) from error
    sys.exit(0 if done else 3)


@app.command(epilog="Example: ztpm claw show --svg run.svg")
def show(
    *,
    svg: Annotated[Path | None, typer.Option(help="A file for the recorded run.")] = None,
    picture: Annotated[Path | None, typer.Option(help="A file for the spans of the handover, as bars.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
) -> None:
    """Five requests and one beyond what was lent, with scripts as models: watched in the spans and on the arm.

    The exit status is 1 when one is not as told.
    """
    import os

    from rich.console import Console

    from cobot_claw.models import SCRIPTED, VARIABLE
    from cobot_claw.recording import bars, terminal
    from cobot_claw.shows import SHOWS
    from cobot_claw.shows import show as run
    from cobot_claw.system import system

    os.environ[VARIABLE] = SCRIPTED
    console = Console(record=svg is not None, width=110, quiet=as_json, highlight=False)
    seen = []
    with system(told=_starting, approves=lambda asked: _told_yes(console, asked)) as running:
        for one in SHOWS:
            console.print(f'[bold]$ ztpm claw "{one.request}"[/]')
            shown = run(running, one)
            seen.append((one, shown))
            mark = "[green]as told[/]" if not shown.faults else "[red]NOT as told[/]"
            console.print(shown.told.text, markup=False)
            parts = len({each["service"] for each in shown.spans})
            console.print(
                f"  {mark}: {shown.told.seconds:.1f} s, the arm moved {shown.told.moved_rad:.2f} rad, "
                f"{len(shown.spans)} spans of {parts} processes in trace {shown.told.trace[:16]}",
                style="dim",
            )
            for fault in shown.faults:
                console.print(f"  ! {fault}", markup=False)
            if picture is not None and one.request == "Hand me the part":
                picture.write_text(bars(shown.spans, f'ztpm claw "{one.request}"'), "utf-8")
    good = sum(1 for _, shown in seen if not shown.faults)
    console.print(f"{good} of {len(seen)} requests as told")
    if svg is not None:
        svg.write_text(terminal(console, "ztpm claw show"), "utf-8")
    if as_json:
        rows = [
            {"request": one.request, **asdict(shown.told), "spans": len(shown.spans), "faults": list(shown.faults)}
            for one, shown in seen
        ]
        typer.echo(json.dumps({"ok": good == len(seen), "shows": rows}))
    sys.exit(0 if good == len(seen) else 1)


def _starting(what: str) -> None:
    typer.echo(f"starting {what}", err=True)


def _told_yes(console: Any, asked: Any) -> bool:
    from cobot_claw.approving import in_words

    console.print(f"  bob is asked: {in_words(asked)}: yes", style="yellow", markup=False)
    return True


def _answer(*, yes: bool) -> Any:
    """The answer of the second person: yes, asked at this terminal, or nobody's."""
    from cobot_claw.approving import in_words

    def approves(asked: Any) -> bool:
        typer.echo(f"bob approves: {in_words(asked)}", err=True)
        return True

    if yes:
        return approves
    if not sys.stdin.isatty():
        return None
    return lambda asked: typer.confirm(f"bob, {in_words(asked)}. Approve?", err=True)
