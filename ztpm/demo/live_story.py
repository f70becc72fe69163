"""Story on the page of its cell: each step as it is played, beside the arm."""

from __future__ import annotations

import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

from ztpm.status.camera import SnapshotCollector
from ztpm.status.picture import Told
from ztpm.status.server import StatusServer

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ztpm.demo.run import StepReport
    from ztpm.stage.stage import Stage


class LiveStory:
    """Steps so far, newest last; one that is being played has no outcome yet."""

    def __init__(self) -> None:
        self.steps: tuple[Told, ...] = ()

    def begin(self, step: str) -> None:
        """Adds a step that is played from now on."""
        self.steps = (*self.steps, Told(step))

    def end(self, report: StepReport) -> None:
        """Tells the last step's outcome."""
        told = Told(report.id, report.told, report.decision, report.reason, report.tier, report.ok)
        self.steps = (*self.steps[:-1], told)


@contextmanager
def served(on_stage: Stage, story: LiveStory) -> Iterator[str]:
    """URL of the page of that stage's cell, served meanwhile.

    Args:
        on_stage: running.
        story: what is told on it.

    Raises:
        ztpm.status.server.StatusError: it cannot be served.
    """
    camera = SnapshotCollector(on_stage.cell, {}, wall_s=time.time, clock=time.monotonic, story=lambda: story.steps)
    server = StatusServer.of(on_stage.cell, camera, note=lambda _event, _sentence: None)
    try:
        server.start()
        yield server.url
    finally:
        server.stop()
        camera.close()
