"""`ztpm demo`: the story, live."""

from __future__ import annotations

import time
from contextlib import contextmanager
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

    from ztpm.demo.run import StepReport

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
    started = time.perf_counter()
    told: list[StepReport] = []
    recording = Recording(time.monotonic)
    # Both are told the same: the picture has a width of its own, whatever the reader's terminal is.
    all_lines = [telling.Telling(each, CHAPTERS) for each in (console, recording.console)]
    if as_json:
        with start_failures(), waiting(STARTING, at_once=True) as started_up, stage() as on_stage:
            started_up()
            told.extend(play(on_stage, step) for step in STORY.steps)
    else:
        console.print("A whole cell on this machine: provider, simulated UR3e, sensor, gateway, tools.")
        with (
            start_failures(),
            console.status("They start") as status,
            waiting(STARTING, shown := _Shown(status)) as started_up,
            stage(begin=partial(Child.begin, preparing=shown)) as on_stage,
        ):
            started_up()
            for number, step in enumerate(STORY.steps, 1):
                for lines in all_lines:
                    lines.announce(step.id)
                recording.look()
                shown.begin(f"{step.id} ({number} of {len(STORY.steps)})")
                told.append(play(on_stage, step))
                for lines in all_lines:
                    lines.tell(told[-1])
                recording.look()
            shown.begin("They end")
    sums = telling.figures(told, time.perf_counter() - started, moved_rad=MOVED_RAD)
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
