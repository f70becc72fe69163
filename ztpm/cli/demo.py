"""`ztpm demo`: the story, live."""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Final

import typer
from rich.live import Live
from rich.table import Table

from ztpm.cli.output import FAILURE, console, say_json

if TYPE_CHECKING:
    from ztpm.demo.run import StepReport

STARTING: Final = "starting the cell"


def demo(
    *,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object instead of a table.")] = False,
) -> None:
    """Tell the story end to end on an embedded cell.

    The exit status is not 0 when any step is not as told.
    """
    from ztpm.demo.run import play
    from ztpm.demo.story import STORY
    from ztpm.preparing import waiting
    from ztpm.stage.live import stage

    started = time.perf_counter()
    told: list[StepReport] = []
    if as_json:
        with waiting(STARTING, at_once=True) as started_up, stage() as on_stage:
            started_up()
            told.extend(play(on_stage, step) for step in STORY.steps)
    else:
        console.print("Starting identity provider, simulated UR3e, sensor, gateway and tool server ...")
        with waiting(STARTING, at_once=True) as started_up, stage() as on_stage:
            started_up()
            with Live(console=console, auto_refresh=False, vertical_overflow="visible") as live:
                for step in STORY.steps:
                    told.append(play(on_stage, step))
                    live.update(_table(told), refresh=True)
    ok = all(step.ok for step in told)
    figures = {
        "steps": len(told),
        "as_told": sum(step.ok for step in told),
        "seconds": round(time.perf_counter() - started, 1),
        "refusal_ms_median": _median([s.latency_ms for s in told if s.decision == "DENY" and s.latency_ms]),
    }
    if as_json:
        say_json({"ok": ok, "steps": [_rounded(step) for step in told], "figures": figures})
    else:
        console.print(f"{figures['as_told']} of {figures['steps']} steps as told, in {figures['seconds']} s.")
    raise typer.Exit(0 if ok else FAILURE)


def _median(values: list[float]) -> float | None:
    return round(sorted(values)[len(values) // 2], 1) if values else None


def _rounded(step: StepReport) -> dict[str, object]:
    return {**asdict(step), "latency_ms": round(step.latency_ms, 1), "moved_rad": round(step.moved_rad, 4)}


COLOURS = {"PERMIT": "green", "DENY": "red", "DEFER": "yellow", "DONE": "blue"}


def _table(told: list[StepReport]) -> Table:
    table = Table(expand=True, show_lines=False, box=None, pad_edge=False)
    for heading, justify in (
        ("", "left"),
        ("step", "left"),
        ("decision", "left"),
        ("tier", "right"),
        ("moved", "right"),
        ("ms", "right"),
    ):
        table.add_column(heading, justify="right" if justify == "right" else "left", no_wrap=True)
    table.add_column("what was seen", overflow="fold", ratio=1)
    for step in told:
        table.add_row(
            "[green]✓[/]" if step.ok else "[bold red]✗[/]",
            step.id,
            f"[{COLOURS.get(step.decision, 'white')}]{step.decision}[/]",
            "" if step.tier is None else str(step.tier),
            f"{step.moved_rad:.2f}" if step.moved_rad >= 0.005 else "still",  # a display threshold
            f"{step.latency_ms:.0f}",
            f"{step.told} [dim]({step.reason})[/]",
        )
    return table
