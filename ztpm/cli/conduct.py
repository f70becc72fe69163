"""`ztpm eval conduct`: trust and behaviour on simulated agents, measured against what is stated."""

from __future__ import annotations

import secrets
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ztpm.cli.output import FAILURE, USAGE, console, fail, say_json


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
    from evaluation.tokens.campaign import Settings
    from evaluation.tokens.report import report, table

    seed = secrets.randbits(32) if seed is None else seed
    known = {campaign.id: campaign for campaign in CAMPAIGNS}
    unknown = sorted(set(only or ()) - known.keys())
    if unknown:
        fail("UNKNOWN_CAMPAIGN", f"{', '.join(unknown)} is none of {', '.join(known)}", as_json=as_json, status=USAGE)
    settings = Settings(quick=quick, seed=seed, vectors=None, clock_ns=time.perf_counter_ns, told=lambda _: None)
    chosen = [campaign for campaign in CAMPAIGNS if not only or campaign.id in only]
    if as_json:
        found = [(campaign, campaign.run(settings)) for campaign in chosen]
    else:
        console.print(f"seed {seed}")
        found = []
        with console.status("") as status:
            for campaign in chosen:
                told = lambda what, of=campaign.id: status.update(f"{of}: {what}")  # noqa: E731
                found.append((campaign, campaign.run(replace(settings, told=told))))
    said = report(found, quick=quick, seed=seed)
    if plot is not None:
        try:
            said["plots"] = [path.name for path in draw(plot, seed=seed)]
        except ModuleNotFoundError as error:
            fail("NOT_PLOTTED", str(error), as_json=as_json)
    if as_json:
        say_json(said)
    else:
        console.print(table(found))
    raise typer.Exit(0 if said["ok"] else FAILURE)
