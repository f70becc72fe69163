"""`ztpm demo`: the story, live."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager, suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ztpm.cli.output import FAILURE, console, fail, fail_at, say_json
from ztpm.preparing import Preparing, waiting

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.status import Status

    from ztpm.demo.live_story import LiveStory
    from ztpm.demo.run import StepReport
    from ztpm.stage.stage import Stage

STARTING: Final = "starting the cell"


@contextmanager
def start_failures() -> Iterator[None]:
    """Ends the command with the reason of a process that does not start."""
    from ztpm.base.processes import ChildError
    from ztpm.up import start_failure

    try:
        yield
    except ChildError as error:
        failed = start_failure(error)
        fail(failed.code, str(failed))


@contextmanager
def live_page(on_stage: Stage, *, wanted: bool) -> Iterator[LiveStory]:
    """Steps as a page of the stage's cell shows them; the page is served meanwhile, where one is wanted."""
    from ztpm.demo.live_story import LiveStory, served
    from ztpm.status.server import StatusError

    story = LiveStory()
    if not wanted:
        yield story
        return
    try:
        with served(on_stage, story) as url:
            console.print(f"Look: {url}", markup=False)
            yield story
    except StatusError as error:
        fail("PORT_UNUSABLE", f"page: {error}")


class _Shown(Preparing):
    """Shows the running step, and what a child prepares meanwhile, on one line."""

    def __init__(self, status: Status) -> None:
        super().__init__()
        self._status, self._step = status, "They start"

    def begin(self, step: str) -> None:
        """Shows this step from now on."""
        self._step = step
        self._status.update(step)

    def over(self) -> None:
        """Shows the step alone again."""
        super().over()
        self._status.update(self._step)

    @property
    def _changes(self) -> bool:
        return self._status.console.is_terminal

    def _change(self, text: str) -> None:
        self._status.update(f"{self._step}: {text}")


def demo(
    *,
    record: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also write the story as a moving picture, 60 s of SVG.")
    ] = None,
    web: Annotated[bool, typer.Option("--web", help="Show it on the live page of the cell, too.")] = False,
    seconds: Annotated[
        float | None, typer.Option(min=0.0, help="With --web: time for which the page stays (else until Ctrl-C).")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object instead of the story.")] = False,
) -> None:
    """Tell the story end to end on an embedded cell.

    The exit status is not 0 when any step is not as told.
    """
    from ztpm.base.processes import Child
    from ztpm.demo import telling
    from ztpm.demo.recording import Recording
    from ztpm.demo.run import MOVED_RAD, play
    from ztpm.demo.story import CHAPTERS, STORY
    from ztpm.stage.live import stage

    if record is not None and as_json:
        fail("USAGE", "--record is of the story; with --json none is told")
    if web and as_json:
        fail("USAGE", "--web is of the story; with --json none is told")
    if seconds is not None and not web:
        fail("USAGE", "--seconds is of the page: give --web")
    started = time.perf_counter()
    told: list[StepReport] = []
    recording = Recording(time.monotonic)
    # Both are told the same: the picture has a width of its own, whatever the reader's terminal is.
    all_lines = [telling.Telling(each, CHAPTERS) for each in (console, recording.console)]
    if as_json:
        with start_failures(), waiting(STARTING, at_once=True) as started_up, stage() as on_stage:
            started_up()
            told.extend(play(on_stage, step) for step in STORY.steps)
            ended = time.perf_counter()
    else:
        console.print("A whole cell on this machine: provider, simulated UR3e, sensor, gateway, tools.")
        with (
            start_failures(),
            console.status("They start") as status,
            waiting(STARTING, shown := _Shown(status)) as started_up,
            stage(begin=partial(Child.begin, preparing=shown)) as on_stage,
            live_page(on_stage, wanted=web) as page,
        ):
            started_up()
            for number, step in enumerate(STORY.steps, 1):
                for lines in all_lines:
                    lines.announce(step.id)
                recording.look()
                shown.begin(f"{step.id} ({number} of {len(STORY.steps)})")
                page.begin(step.id)
                told.append(play(on_stage, step))
                page.end(told[-1])
                for lines in all_lines:
                    lines.tell(told[-1])
                recording.look()
            ended = time.perf_counter()
            if web:
                shown.begin("The page stays, until Ctrl-C" if seconds is None else f"The page stays for {seconds:g} s")
                with suppress(KeyboardInterrupt):
                    threading.Event().wait(seconds)
            shown.begin("They end")
    sums = telling.figures(told, ended - started, moved_rad=MOVED_RAD)
    if as_json:
        say_json({"ok": sums.ok, "steps": [telling.as_json(step) for step in told], "figures": asdict(sums)})
    else:
        for lines in all_lines:
            lines.end(sums)
        if record is not None:
            try:
                record.write_text(recording.svg(), encoding="utf-8")
            except OSError as error:
                fail_at(record, error, "UNWRITABLE")
    raise typer.Exit(0 if sums.ok else FAILURE)
