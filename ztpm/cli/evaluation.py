"""`ztpm eval`: what we claim, measured on this machine."""

from __future__ import annotations

import importlib
import json
import secrets
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from ztpm.cli import campaigns
from ztpm.cli.conduct import conduct
from ztpm.cli.output import FAILURE, console, fail, say_json

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from evaluation.bench.timing import Plan
    from evaluation.stops import Report

app = typer.Typer(help="Measure what is claimed.", no_args_is_help=True)
bench = typer.Typer(help="Measure us beside our peers, in one run.", no_args_is_help=True)
app.add_typer(bench, name="bench")
app.command()(conduct)


@app.command()
def stops(
    *,
    count: Annotated[int, typer.Option(min=0, max=1_000, help="Revocations at random instants of random moves.")] = 100,
    walk_in: Annotated[int, typer.Option(min=0, max=1_000, help="People who walk in at random instants.")] = 0,
    seed: Annotated[int | None, typer.Option(help="Of every draw; a fresh one is drawn and told.")] = None,
    out: Annotated[Path | None, typer.Option(help="Directory for stops.json, and stops.png with matplotlib.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object instead of a table.")] = False,
) -> None:
    """Stop times on an embedded cell; the exit status is not 0 when a stop left the model or came too late."""
    from evaluation.stops import MeasureError, StageError, measure, rows

    seed = secrets.randbits(32) if seed is None else seed
    try:
        if as_json:
            reports = list(measure(count=count, walk_in=walk_in, seed=seed, progress=_nothing))
        else:
            console.print(f"Starting a cell; seed {seed} ...")
            with console.status("") as status:
                told = lambda kind, n: status.update(f"{kind}: {n}")  # noqa: E731
                reports = list(measure(count=count, walk_in=walk_in, seed=seed, progress=told))
    except (MeasureError, StageError) as error:
        fail("NOT_MEASURED", str(error), as_json=as_json)
    result: dict[str, Any] = {
        "ok": all(report.ok for report in reports),
        "seed": seed,
        "bar_ms": 150,
        "figures": [report.figures() for report in reports],
    }
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "stops.json").write_text(json.dumps({**result, "stops": rows(reports)}, indent=1), encoding="utf-8")
        _plot(reports, out / "stops.png")
    if as_json:
        say_json(result)
    else:
        console.print(_table(reports))
    raise typer.Exit(0 if result["ok"] else FAILURE)


@bench.command("capabilities")
def bench_capabilities(
    *,
    quick: Annotated[bool, typer.Option("--quick", help="Few calls: shows that it runs, not what is true.")] = False,
    seed: Annotated[int, typer.Option(help="Of the order in which cells take turns.")] = 1,
    plot: Annotated[Path | None, typer.Option(help="A PNG file for the picture; needs matplotlib.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object instead of tables.")] = False,
) -> None:
    """Capability tokens from the wire to a decision: ours, Tenuo, AIP, bare Biscuit, macaroons, PyJWT."""
    from evaluation.bench import plot as plots
    from evaluation.bench.report import ratios_line
    from evaluation.bench.run import run
    from evaluation.bench.table import tables
    from evaluation.bench.timing import FULL, QUICK

    result = _measured(run, plots.plot, QUICK if quick else FULL, seed=seed, plot=plot, as_json=as_json)
    absent = [f"{row.peer}: {row.why}" for row in result.rows if row.scope is None]
    _tell(result, tables, ratios_line, remarks=absent, as_json=as_json)


@bench.command("decide")
def bench_decide(
    *,
    quick: Annotated[bool, typer.Option("--quick", help="Few calls: shows that it runs, not what is true.")] = False,
    seed: Annotated[int, typer.Option(help="Of the order in which engines take turns.")] = 1,
    plot: Annotated[Path | None, typer.Option(help="A PNG file for the picture; needs matplotlib.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object instead of tables.")] = False,
) -> None:
    """One decision on facts that are there: ours, Cedar, casbin and Rego on equivalent rules."""
    from evaluation.bench.decisions import plot as plots
    from evaluation.bench.decisions.report import ratios_line, tables
    from evaluation.bench.decisions.run import FULL, run
    from evaluation.bench.timing import QUICK

    result = _measured(run, plots.plot, QUICK if quick else FULL, seed=seed, plot=plot, as_json=as_json)
    remarks = [f"{row.peer}: {row.why}" for row in result.rows if row.case is None]
    remarks.append(f"All engines agree in {result.agreed} cases, on {result.rules} rules.")
    _tell(result, tables, ratios_line, remarks=remarks, as_json=as_json)


@bench.command("pit")
def bench_pit(
    *,
    quick: Annotated[bool, typer.Option("--quick", help="Few calls: shows that it runs, not what is true.")] = False,
    seed: Annotated[int, typer.Option(help="Of the questions, and of the order in which engines take turns.")] = 1,
    plot: Annotated[Path | None, typer.Option(help="A PNG file for the picture; needs matplotlib.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object instead of tables.")] = False,
) -> None:
    """The physics of one command: ours, its parts, and distances sampled by pinocchio and MuJoCo."""
    from functools import partial

    from evaluation.bench.pit import plot as plots
    from evaluation.bench.pit.report import ratios_line, tables
    from evaluation.bench.pit.run import FULL, QUICK, run

    few = partial(run, sizes=(5,), questions=2)
    plan = QUICK if quick else FULL
    result = _measured(few if quick else run, plots.plot, plan, seed=seed, plot=plot, as_json=as_json)
    remarks = [f"{row.peer}: {row.why}" for row in result.rows if row.load is None]
    _tell(result, tables, ratios_line, remarks=remarks, as_json=as_json)


@bench.command("rtde")
def bench_rtde(
    *,
    seconds: Annotated[float, typer.Option(min=1, help="How long each stream lasts.")] = 60.0,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object instead of tables.")] = False,
) -> None:
    """A 500 Hz stream of an unmodified ur_rtde program: through the gateway, and directly to the controller."""
    from evaluation.bench.rtde.report import StreamBrokenError, summary, tables
    from evaluation.bench.rtde.run import run

    try:
        if as_json:
            result = run(seconds, told=_nothing)
        else:
            with console.status("") as status:
                result = run(seconds, told=status.update)
    except StreamBrokenError as error:
        fail("NOT_MEASURED", str(error), as_json=as_json)
    if as_json:
        say_json(result.as_json())
        return
    for table in tables(result):
        console.print(table)
    console.print(summary(result))


def _measured(
    run: Callable[..., Any],
    draw: Callable[[Any, Path], None],
    plan: Plan,
    *,
    seed: int,
    plot: Path | None,
    as_json: bool,
) -> Any:
    """What a benchmark found, its progress shown and its picture drawn; ends the command where it found nothing."""
    from evaluation.bench.absent import AbsentError
    from evaluation.bench.decisions.rules import NoPlainFormError
    from evaluation.bench.timing import WrongAnswerError

    try:
        if as_json:
            result = run(plan, seed=seed, told=_nothing)
        else:
            with console.status("") as status:
                result = run(plan, seed=seed, told=status.update)
        if plot is not None:
            draw(result, plot)
    except (WrongAnswerError, NoPlainFormError, AbsentError) as error:
        fail("NOT_MEASURED", str(error), as_json=as_json)
    return result


def _tell(
    result: Any,
    tables: Callable[[Any], Iterable[Table]],
    ratios_line: Callable[[dict[str, Any]], str],
    *,
    remarks: Iterable[str],
    as_json: bool,
) -> None:
    """The tables of a benchmark, what is to be said beside them, and the ratios last."""
    found = result.to_json()
    if as_json:
        say_json(found)
        return
    for table in tables(result):
        console.print(table)
        console.print()
    for remark in remarks:
        console.print(remark)
    console.print(", ".join(f"{name} {version}" for name, version in result.versions.items()))
    console.print(f"{result.seconds:.0f} s on {result.machine['processor']}; load {result.machine['load'][0]}")
    console.print(ratios_line(found["ratios"]))


VECTORS = Path(__file__).parents[3] / "shared" / "data" / "vectors"
"""Where vectors made by others lie: beside the checkout."""


@app.command("tokens")
def campaigns_of_tokens(
    *,
    quick: Annotated[
        bool, typer.Option("--quick", help="Few trials: shows that it runs, not that a bar holds.")
    ] = False,
    only: Annotated[list[str] | None, typer.Option(help="Run this one, by its id; may be repeated.")] = None,
    seed: Annotated[int | None, typer.Option(help="Of every draw; a fresh one is drawn and told.")] = None,
    vectors: Annotated[Path, typer.Option(help="Vectors made by others: `biscuit` and `wycheproof` in it.")] = VECTORS,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object instead of a table.")] = False,
) -> None:
    """The claims about tokens, each tried so many times; the exit status is not 0 when one is missed."""
    from evaluation.tokens.registry import CAMPAIGNS
    from evaluation.tokens.report import line, table

    there = vectors if vectors.is_dir() else None
    found, said = campaigns.run(CAMPAIGNS, only, quick=quick, seed=seed, vectors=there, as_json=as_json)
    if as_json:
        say_json(said)
    else:
        console.print(table(found))
        console.print(line(found))
    raise typer.Exit(0 if said["ok"] else FAILURE)


def _nothing(*_: object) -> None:
    """No progress is told."""


def _table(reports: list[Report]) -> Table:
    table = Table(box=None, pad_edge=False)
    for heading in ("", "stops", "what", "p50", "p90", "p99", "max", "beyond the model", "bar"):
        table.add_column(heading, justify="right" if heading[:1] == "p" or heading == "max" else "left")
    for report in reports:
        figures = report.figures()
        for n, (key, what) in enumerate(
            (("reaction_ms", "t1 - t0, ms"), ("braking_ms", "t2 - t1, ms"), ("travel_mrad", "travel from t0, mrad"))
        ):
            spread = figures[key]
            first = (report.kind, str(figures["count"])) if n == 0 else ("", "")
            last = (str(figures["beyond_model"]), "met" if report.ok else "missed") if n == 0 else ("", "")
            table.add_row(*first, what, *(f"{spread[p]:.1f}" for p in ("p50", "p90", "p99", "max")), *last)
    return table


def _plot(reports: list[Report], file: Path) -> None:
    """Travel against speed, with the model's curve; nothing without matplotlib."""
    try:
        matplotlib = importlib.import_module("matplotlib")
    except ModuleNotFoundError:
        return
    from ztpm.demo.stopping import model_rad

    matplotlib.use("Agg")
    plots = importlib.import_module("matplotlib.pyplot")
    figure, (travel, reaction) = plots.subplots(1, 2, figsize=(10, 4))
    speeds = [n / 100 for n in range(101)]
    travel.plot(speeds, [model_rad(speed) for speed in speeds], color="black", label="model")
    for report in reports:
        travel.scatter(
            [s.speed_rad_s for s in report.stops], [s.braking_rad for s in report.stops], s=8, label=report.kind
        )
        reaction.hist([s.reaction_s * 1000 for s in report.stops], bins=30, alpha=0.6, label=report.kind)
    travel.set(xlabel="speed of the leading axis, rad/s", ylabel="travel from t1, rad")
    reaction.set(xlabel="t1 - t0, ms", ylabel="stops")
    travel.legend()
    reaction.legend()
    figure.savefig(file, dpi=150)
