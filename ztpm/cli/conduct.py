"""`ztpm eval conduct`: trust and behaviour on simulated agents, measured against what is stated."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ztpm.cli import campaigns
from ztpm.cli.output import FAILURE, console, fail, say_json


def conduct(
    *,
    quick: Annotated[bool, typer.Option("--quick", help="Few runs: shows that it runs, not that a bar holds.")] = False,
    only: Annotated[list[str] | None, typer.Option(help="Run this one, by its id; may be repeated.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of every draw; a fresh one is drawn and told.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Directory for the pictures; needs matplotlib.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object instead of a table.")] = False,
) -> None:
    """False alarms, detection delays and trust under attack; the exit status is not 0 when a bar is missed."""
    from evaluation.conduct.plots import plot as draw
    from evaluation.conduct.registry import CAMPAIGNS
    from evaluation.tokens.report import table

    found, said = campaigns.run(CAMPAIGNS, only, quick=quick, seed=seed, as_json=as_json)
    if plot is not None:
        try:
            said["plots"] = [path.name for path in draw(plot, seed=said["seed"])]
        except ModuleNotFoundError as error:
            fail("NOT_PLOTTED", str(error), as_json=as_json)
    if as_json:
        say_json(said)
    else:
        console.print(table(found))
    raise typer.Exit(0 if said["ok"] else FAILURE)
