"""`ztpm eval`: the commands that measure the project's claims on this machine.

The entry point `eval` of the group `ztpm.commands` names `app`; `ztpm` itself imports nothing of `evaluation`.
"""

from __future__ import annotations

import json
import os
import secrets
import time
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from evaluation import attacks
from evaluation.saying import AsJson, Plot, place, say, telling
from ztpm.cli.output import FAILURE, console, fail, say_json

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from evaluation.harness.bench import Bench
    from evaluation.harness.campaign import Campaign, Outcome, Skipped

Quick = Annotated[bool, typer.Option("--quick", help="Few calls: shows that it runs, not what is true.")]
Calls = Annotated[int, typer.Option(min=10, help="Timed calls of each way.")]
Turns = Annotated[int, typer.Option(help="Of the order in which the ways take turns.")]
T = TypeVar("T")

app = typer.Typer(help="Measure what is claimed.", no_args_is_help=True)
bench = typer.Typer(help="Measure us beside our peers, in one run.", no_args_is_help=True)
app.add_typer(bench, name="bench")
app.add_typer(attacks.app)


@app.command(epilog="Example: ztpm eval stops --count 20")
def stops(
    *,
    count: Annotated[int, typer.Option(min=0, max=1_000, help="Revocations at random instants of random moves.")] = 100,
    walk_in: Annotated[int, typer.Option(min=0, max=1_000, help="People who walk in at random instants.")] = 0,
    seed: Annotated[int | None, typer.Option(help="Of every draw; a fresh one is drawn and told.")] = None,
    out: Annotated[Path | None, typer.Option(help="Directory for stops.json, and stops.png with matplotlib.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object instead of a table.")] = False,
) -> None:
    """Stop times on an embedded cell.

    The exit status is not 0 when a stop left the model or came too late.
    """
    from evaluation.stops.measure import MeasureError, StageError, measure
    from evaluation.stops.report import plot, rows, table

    if out is not None:
        place(out / "stops.json")
    seed = secrets.randbits(32) if seed is None else seed
    try:
        with telling(f"a cell, seed {seed}") as told:
            progress = lambda kind, n: told(f"{kind}: {n}")  # noqa: E731
            reports = list(measure(count=count, walk_in=walk_in, seed=seed, progress=progress))
    except (MeasureError, StageError) as error:
        fail("NOT_MEASURED", str(error))
    result: dict[str, Any] = {
        "ok": all(report.ok for report in reports),
        "seed": seed,
        "bar_ms": 150,
        "figures": [report.figures() for report in reports],
    }
    if out is not None:
        (out / "stops.json").write_text(json.dumps({**result, "stops": rows(reports)}, indent=1), encoding="utf-8")
        plot(reports, out / "stops.png")
    if as_json:
        say_json(result)
    else:
        console.print(table(reports))
    raise typer.Exit(0 if result["ok"] else FAILURE)


@app.command(epilog="Example: ztpm eval paper --each 1")
def paper(
    *,
    each: Annotated[
        int, typer.Option(min=0, max=10, help="Traces of each model and scene that are replayed; 0 for none.")
    ] = 10,
    out: Annotated[Path | None, typer.Option(help="Directory for paper.json, and paper.png with matplotlib.")] = None,
    as_json: AsJson = False,
) -> None:
    """The paper's 60 traces: statistics, and each once more with no gate and before one (a quarter of an hour).

    The exit status is not 0 when a trace left the bound of its scene before the gate.
    """
    from evaluation.harness.absent import AbsentError
    from evaluation.paper.picture import draw
    from evaluation.paper.replay import ReplayError
    from evaluation.paper.result import last_line, tables
    from evaluation.paper.run import run
    from evaluation.paper.sweep import PhysicsError

    if out is not None:
        place(out / "paper.json")
    try:
        with telling() as told:
            result = run(each=each, told=told)
    except (ReplayError, PhysicsError) as error:
        fail("NOT_MEASURED", str(error))
    if out is not None:
        (out / "paper.json").write_text(json.dumps(result.to_json(), indent=1), encoding="utf-8")
        with suppress(AbsentError):
            draw(result, out / "paper.png")
    say(result, tables, last_line, as_json=as_json)
    raise typer.Exit(0 if result.ok else FAILURE)


@app.command(epilog="Example: ztpm eval programs pick_and_place policy_rollout")
def programs(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]...", help="Of programs (default: all thirty).")
    ] = None,
    *,
    out: Annotated[Path | None, typer.Option(help="File for the JSON object.", dir_okay=False)] = None,
    as_json: AsJson = False,
) -> None:
    """Thirty small programs in plain ur_rtde, each under a lease as it is (ten minutes).

    Questions to people are answered by a person in the run, and counted. The exit status is not 0 when a program
    failed.
    """
    from evaluation.programs.catalog import CatalogError
    from evaluation.programs.result import last_line, tables
    from evaluation.programs.run import run
    from ztpm.base.processes import ChildError
    from ztpm.stage.stage import StageError

    if out is not None:
        place(out)
    try:
        with telling() as told:
            result = run(names or (), told=told)
    except (CatalogError, ChildError, StageError) as error:
        fail("NOT_MEASURED", str(error))
    if out is not None:
        out.write_text(json.dumps(result.to_json(), indent=1), encoding="utf-8")
    say(result, tables, last_line, as_json=as_json)
    raise typer.Exit(0 if result.ok else FAILURE)


@app.command(epilog="Example: ztpm eval dojo --tasks 1")
def dojo(
    *,
    tasks: Annotated[int, typer.Option(min=0, help="First user tasks of each suite that are replayed; 0 for all.")] = 0,
    suite: Annotated[list[str] | None, typer.Option(help="This suite alone; may be repeated.")] = None,
    environment: Annotated[
        Path | None, typer.Option(help="Folder of AgentDojo's own environment; in the user's cache by default.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="File for the JSON object.", dir_okay=False)] = None,
    as_json: AsJson = False,
) -> None:
    """AgentDojo's attackers, their calls forced under scopes of the user tasks (a quarter of an hour; no model).

    The environment is made where it is missing. The exit status is not 0 when a bar is missed.
    """
    from evaluation.dojo.place import NoEnvironmentError, prepared, usual_folder
    from evaluation.dojo.result import last_line, tables
    from evaluation.dojo.run import run
    from evaluation.dojo.scopes import ScopeFileError
    from evaluation.dojo.suites import SuiteError
    from ztpm.base.processes import ChildError
    from ztpm_idp.client import ClientError

    if out is not None:
        place(out)
    try:
        with telling() as told:
            python = prepared(environment or usual_folder(os.environ), told)
            result = run(python, tasks=tasks, only=suite or (), told=told)
    except (NoEnvironmentError, SuiteError, ScopeFileError, ChildError, ClientError) as error:
        fail("NOT_MEASURED", str(error))
    if out is not None:
        out.write_text(json.dumps(result.to_json(), indent=1), encoding="utf-8")
    say(result, tables, last_line, as_json=as_json)
    raise typer.Exit(0 if result.ok else FAILURE)


@app.command(epilog="Example: ztpm eval law --benign 100")
def law(
    *,
    benign: Annotated[int, typer.Option(min=1, max=100_000, help="Benign motions that are drawn.")] = 1_000,
    seed: Annotated[int | None, typer.Option(min=0, help="Of every draw; a fresh one is drawn and told.")] = None,
    out: Annotated[Path | None, typer.Option(help="File for the JSON object.", dir_okay=False)] = None,
    as_json: AsJson = False,
) -> None:
    """The law of the impact index beside one by the speed of approach: whom each asks, and what each misses."""
    from evaluation.pit.law import last_line, study, tables
    from evaluation.redteam.laws import laws_table, tally, violations
    from evaluation.redteam.scenario import ScenarioError, scenarios

    if out is not None:
        place(out)
    try:
        with telling() as told:
            result = study(benign, seed=secrets.randbits(32) if seed is None else seed, told=told)
            told("joint moves of the red team")
            tallied, violated = tally(scenarios()), violations(scenarios())
    except ScenarioError as error:
        fail("NOT_MEASURED", str(error))
    redteam = {law: asdict(one) for law, one in tallied.items()}
    report = {**result.to_json(), "redteam": redteam, "violations": asdict(violated)}
    if out is not None:
        out.write_text(json.dumps(report, indent=1), encoding="utf-8")
    if as_json:
        say_json(report)
        return
    console.print(f"seed {result.seed}")
    console.print(laws_table(tallied))
    console.print(violated.told())
    console.print()
    say(result, tables, last_line, as_json=False)


@bench.command("capabilities", epilog="Example: ztpm eval bench capabilities --quick")
def bench_capabilities(
    *,
    quick: Quick = False,
    seed: Annotated[int, typer.Option(help="Of the order in which cells take turns.")] = 1,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Capability tokens from the wire to a decision: ours, Tenuo, AIP, bare Biscuit, macaroons, PyJWT."""
    from evaluation.tokens.bench import BENCH

    _run(BENCH, quick=quick, seed=seed, plot=plot, as_json=as_json)


@bench.command("decide", epilog="Example: ztpm eval bench decide --quick")
def bench_decide(
    *,
    quick: Quick = False,
    seed: Annotated[int, typer.Option(help="Of the order in which engines take turns.")] = 1,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """One decision on facts that are there: ours, Cedar, casbin and Rego on equivalent rules."""
    from evaluation.decisions.bench import BENCH

    _run(BENCH, quick=quick, seed=seed, plot=plot, as_json=as_json)


@bench.command("idp", epilog="Example: ztpm eval bench idp --quick")
def bench_idp(
    *,
    quick: Quick = False,
    database: Annotated[
        list[str] | None, typer.Option(help="sqlite, postgresql, or the URL of an empty one; may be repeated.")
    ] = None,
    agents: Annotated[int, typer.Option(min=100, max=100_000, help="Registered agents.")] = 10_000,
    as_json: AsJson = False,
) -> None:
    """The identity provider's operations beside a bare endpoint that proves, signs and commits one row."""
    from evaluation.harness.timing import WrongAnswerError
    from evaluation.idp.bench import last_line, tables
    from evaluation.idp.databases import KINDS
    from evaluation.idp.run import run
    from ztpm.base.processes import ChildError

    sizes: dict[str, Any] = {"batch": 20, "rounds": 1, "workers": (1,)} if quick else {}
    try:
        with telling() as told:
            result = run(database or KINDS, agents=agents, told=told, **sizes)
    except (WrongAnswerError, ChildError) as error:
        fail("NOT_MEASURED", str(error))
    say(result, tables, last_line, as_json=as_json)


@bench.command("mcp", epilog="Example: ztpm eval bench mcp --calls 200")
def bench_mcp(*, calls: Calls = 1_000, seed: Turns = 1, as_json: AsJson = False) -> None:
    """A gateway beside FastMCP's proxy of the same server, and a guard over stdio; records on."""
    from evaluation.tools.mcp_bench import last_line, tables
    from evaluation.tools.mcp_run import run

    say(_acts(run, calls, seed), tables, last_line, as_json=as_json)


@bench.command("pit", epilog="Example: ztpm eval bench pit --quick")
def bench_pit(
    *,
    quick: Quick = False,
    seed: Annotated[int, typer.Option(help="Of the questions, and of the order in which engines take turns.")] = 1,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """The physics of one command: ours, its parts, and distances sampled by pinocchio and MuJoCo."""
    from evaluation.pit.bench import BENCH

    _run(BENCH, quick=quick, seed=seed, plot=plot, as_json=as_json)


@bench.command("rtde", epilog="Example: ztpm eval bench rtde --seconds 5")
def bench_rtde(
    *,
    seconds: Annotated[float, typer.Option(min=1, help="How long each stream lasts.")] = 60.0,
    as_json: AsJson = False,
) -> None:
    """A 500 Hz stream of an unmodified ur_rtde program: through the gateway, and directly to the controller."""
    from evaluation.rtde.bench import StreamBrokenError, summary, tables
    from evaluation.rtde.run import run

    try:
        with telling() as told:
            result = run(seconds, told=told)
    except StreamBrokenError as error:
        fail("NOT_MEASURED", str(error))
    if as_json:
        say_json(result.to_json())
        return
    for table in tables(result):
        console.print(table)
    console.print(summary(result))


@bench.command("tools", epilog="Example: ztpm eval bench tools --calls 200")
def bench_tools(*, calls: Calls = 1_000, seed: Turns = 1, as_json: AsJson = False) -> None:
    """A guarded act beside the unguarded one, over HTTP and as a function; records on."""
    from evaluation.tools.bench import last_line, tables
    from evaluation.tools.run import run

    say(_acts(run, calls, seed), tables, last_line, as_json=as_json)


def _acts(run: Callable[..., T], calls: int, seed: int) -> T:
    """Result of a run of an act."""
    from evaluation.harness.absent import AbsentError
    from evaluation.tools.bench import NotMeasuredError
    from pep.base.errors import PepError
    from ztpm.base.processes import ChildError
    from ztpm_idp.client import ClientError

    try:
        with telling() as told:
            return run(calls, seed=seed, told=told)
    except (NotMeasuredError, AbsentError, ClientError, ChildError, PepError) as error:
        fail("NOT_MEASURED", str(error))


def _run(bench: Bench[Any], *, quick: bool, seed: int, plot: Path | None, as_json: bool) -> None:
    """Runs a benchmark; prints its tables, its remarks beside them, and the ratios last."""
    from evaluation.decisions.rules import NoPlainFormError
    from evaluation.harness.absent import AbsentError
    from evaluation.harness.timing import WrongAnswerError

    plan, few = (bench.quick, bench.few) if quick else (bench.full, {})
    try:
        with telling() as told:
            result = bench.run(plan, seed=seed, told=told, **few)
        if plot is not None:
            bench.picture(result, plot)
    except (WrongAnswerError, NoPlainFormError, AbsentError) as error:
        fail("NOT_MEASURED", str(error))
    if as_json:
        say_json(result.to_json())
        return
    for table in bench.tables(result):
        console.print(table)
        console.print()
    for remark in bench.remarks(result):
        console.print(remark)
    console.print(", ".join(f"{name} {version}" for name, version in result.versions.items()))
    console.print(f"{result.seconds:.0f} s on {result.machine['processor']}; load {result.machine['load'][0]}")
    console.print(bench.last_line(result.ratios))


@app.command(epilog="Example: ztpm eval tokens --quick")
def tokens(
    *,
    quick: Annotated[
        bool, typer.Option("--quick", help="Few trials: shows that it runs, not that a bar holds.")
    ] = False,
    only: Annotated[list[str] | None, typer.Option(help="Run this one, by its id; may be repeated.")] = None,
    seed: Annotated[int | None, typer.Option(help="Of every draw; a fresh one is drawn and told.")] = None,
    vectors: Annotated[
        Path | None,
        typer.Option(help="Vectors made by others: `biscuit` and `wycheproof` in it.", exists=True, file_okay=False),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object instead of a table.")] = False,
) -> None:
    """The claims about tokens, each tried so many times; the exit status is not 0 when one is missed."""
    from evaluation.harness.campaign_report import line, table
    from evaluation.tokens.campaigns.registry import CAMPAIGNS

    found, report = _campaigns(CAMPAIGNS, only, quick=quick, seed=seed, vectors=vectors, as_json=as_json)
    if as_json:
        say_json(report)
    else:
        console.print(table(found))
        console.print(line(found))
    raise typer.Exit(0 if report["ok"] else FAILURE)


@app.command(epilog="Example: ztpm eval conduct --quick")
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
    from evaluation.harness.campaign_report import table

    found, report = _campaigns(CAMPAIGNS, only, quick=quick, seed=seed, vectors=None, as_json=as_json)
    if plot is not None:
        try:
            report["plots"] = [path.name for path in draw(plot, seed=report["seed"])]
        except ModuleNotFoundError as error:
            fail("NOT_PLOTTED", str(error))
    if as_json:
        say_json(report)
    else:
        console.print(table(found))
    raise typer.Exit(0 if report["ok"] else FAILURE)


def _campaigns(
    campaigns: Sequence[Campaign],
    only: Collection[str] | None,
    *,
    quick: bool,
    seed: int | None,
    vectors: Path | None,
    as_json: bool,
) -> tuple[list[tuple[Campaign, Outcome | Skipped]], dict[str, Any]]:
    """Outcome of each campaign, in their order, and the report of all of them.

    Ends the command with `UNKNOWN_CAMPAIGN` when `only` names none of them.
    """
    from evaluation.harness.campaign import Settings
    from evaluation.harness.campaign_report import report

    seed = secrets.randbits(32) if seed is None else seed
    known = {campaign.id: campaign for campaign in campaigns}
    unknown = sorted(set(only or ()) - known.keys())
    if unknown:
        fail("UNKNOWN_CAMPAIGN", f"{', '.join(unknown)} is none of {', '.join(known)}")
    chosen = [campaign for campaign in campaigns if not only or campaign.id in only]
    if not as_json:
        console.print(f"seed {seed}")
    found: list[tuple[Campaign, Outcome | Skipped]] = []
    with telling() as told:
        for campaign in chosen:
            tell = lambda what, of=campaign.id: told(f"{of}: {what}")  # noqa: E731
            settings = Settings(quick=quick, seed=seed, vectors=vectors, clock_ns=time.perf_counter_ns, told=tell)
            found.append((campaign, campaign.run(settings)))
    return found, report(found, quick=quick, seed=seed)
