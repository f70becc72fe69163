"""Commands that try the paper's attacks on running cells."""

from __future__ import annotations

import json
import secrets
from pathlib import Path
from typing import Annotated

import typer

from evaluation.saying import AsJson, Plot, place, say, telling
from ztpm.cli.output import FAILURE, console, fail

app = typer.Typer()


@app.command(epilog="Example: ztpm eval redteam --sample 5 --seed 1")
def redteam(
    *,
    sample: Annotated[
        int, typer.Option(min=0, help="Scenarios of each class, hazardous and benign, that are drawn; 0 for all.")
    ] = 0,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the sample; a fresh one is drawn and told.")] = None,
    only: Annotated[list[str] | None, typer.Option(help="This scenario alone, by its id; may be repeated.")] = None,
    mode: Annotated[
        list[str] | None, typer.Option(help="This mode alone: none, tokens, policy or all; may be repeated.")
    ] = None,
    cells: Annotated[int, typer.Option(min=1, max=8, help="Cells beside each other; each wants a core.")] = 2,
    meshes: Annotated[Path | None, typer.Option(help="Folder of the vendor's UR3e description.")] = None,
    ledger: Annotated[
        Path | None, typer.Option(help="File that keeps each run, to go on where this was ended.", dir_okay=False)
    ] = None,
    out: Annotated[Path | None, typer.Option(help="File for the JSON object.", dir_okay=False)] = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Attacks of all five classes, forced on running cells, with and without enforcement (hours; see --sample).

    The exit status is not 0 when a bar is missed.
    """
    from evaluation.harness.absent import AbsentError
    from evaluation.redteam.campaign import RedRequest, RequestError, campaign
    from evaluation.redteam.ledger import LedgerError
    from evaluation.redteam.picture import draw
    from evaluation.redteam.result import last_line, tables
    from evaluation.redteam.scenario import ScenarioError

    for file in (out, ledger):
        if file is not None:
            place(file)
    seed = secrets.randbits(32) if seed is None else seed
    try:
        with telling() as told:
            result = campaign(
                RedRequest(sample, seed, tuple(only or ()), tuple(mode or ()), cells, meshes, ledger), told
            )
    except (RequestError, LedgerError, ScenarioError, AbsentError) as error:
        fail("NOT_MEASURED", str(error))
    if out is not None:
        out.write_text(json.dumps(result.to_json(), indent=1), encoding="utf-8")
    if plot is not None:
        try:
            draw(result, plot)
        except AbsentError as error:
            fail("NOT_PLOTTED", str(error))
    if not as_json and sample:
        console.print(f"seed {seed}")
    say(result, tables, last_line, as_json=as_json)
    raise typer.Exit(0 if result.ok else FAILURE)


@app.command(epilog="Example: ztpm eval coverage --sample 1 --seed 1")
def coverage(
    *,
    sample: Annotated[
        int, typer.Option(min=0, help="Cells of each attack class that are drawn, with one scenario each; 0 for all.")
    ] = 0,
    seed: Annotated[int | None, typer.Option(min=0, help="Of every draw; a fresh one is drawn and told.")] = None,
    only: Annotated[list[str] | None, typer.Option(help="This primitive alone, by its id; may be repeated.")] = None,
    meshes: Annotated[Path | None, typer.Option(help="Folder of the vendor's UR3e description.")] = None,
    ledger: Annotated[
        Path | None, typer.Option(help="File that keeps each run, to go on where this was ended.", dir_okay=False)
    ] = None,
    out: Annotated[Path | None, typer.Option(help="File for the JSON object.", dir_okay=False)] = None,
    as_json: AsJson = False,
) -> None:
    """The paper's coverage table, each cell by taking primitives out of a running cell (long; see --sample).

    A cell that is not shown says so. The exit status is not 0 when a run did not come about.
    """
    from evaluation.coverage.result import last_line, tables
    from evaluation.coverage.run import CoverageRequest, coverage
    from evaluation.harness.absent import AbsentError
    from evaluation.redteam.campaign import MESHES
    from evaluation.redteam.judging import judge_of
    from evaluation.redteam.ledger import LedgerError
    from evaluation.redteam.referee import RefereeError
    from evaluation.redteam.scenario import ScenarioError

    for file in (out, ledger):
        if file is not None:
            place(file)
    seed = secrets.randbits(32) if seed is None else seed
    try:
        judge = judge_of(meshes or MESHES)
        with telling() as told:
            result = coverage(CoverageRequest(sample, seed, tuple(only or ()), ledger), judge, told)
    except (RefereeError, LedgerError, ScenarioError, AbsentError) as error:
        fail("NOT_MEASURED", str(error))
    if out is not None:
        out.write_text(json.dumps(result.to_json(), indent=1), encoding="utf-8")
    if not as_json:
        console.print(f"seed {seed}")
    say(result, tables, last_line, as_json=as_json)
    raise typer.Exit(0 if result.ok else FAILURE)
