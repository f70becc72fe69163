"""Arena with no enforcement: a simulated controller that an unmodified client drives, and nothing else."""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

from rtde_control import RTDEControlInterface

from evaluation.redteam.admission.outbox import Outbox
from ursim.ports.launch import SimulatedController
from ztpm.stage.samples import StateRecorder

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from evaluation.redteam.acts.act import Act, Came
    from evaluation.redteam.record import HarmSeen
    from evaluation.redteam.scenario import Moment, Scenario

BRING_RAD_S: Final = 1.5
ACCELERATION_RAD_S2: Final = 3.0


@dataclass
class BareArena:
    """Controller and client of it.

    Attributes:
        control: the client's connection.
        eyes: every sample of the controller.
        outbox: notes that were sent.
    """

    control: RTDEControlInterface
    eyes: StateRecorder
    outbox: Outbox
    _prepared_s: float = 0.0

    def prepare(self, scenario: Scenario) -> None:
        """Brings the arm to where the scenario begins."""
        self.control.moveJ(list(scenario.start_rad), BRING_RAD_S, ACCELERATION_RAD_S2)
        self._prepared_s = time.monotonic()

    def show(self, moment: Moment) -> None:
        """Nothing: nobody looks."""

    def perform(self, act: Act) -> Came:
        """Does an act with no enforcement."""
        return act.bare(self)

    def settle(self) -> None:
        """Ends what is still moving."""
        self.control.stopJ(ACCELERATION_RAD_S2)

    def harm(self) -> tuple[HarmSeen, ...]:
        """Harm that is no motion: notes that left."""
        return self.outbox.left(self._prepared_s)

    def primitives(self) -> Mapping[str, float]:
        """None: nothing is decided."""
        return {}

    def digest(self) -> str:
        """Nothing is recorded."""
        return ""


@contextmanager
def bare_arena() -> Iterator[BareArena]:
    """An arena of its own, ended afterwards."""
    with (
        TemporaryDirectory(prefix="ztpm-") as folder,
        SimulatedController.start() as controller,
        StateRecorder(controller.host) as eyes,
    ):
        control = RTDEControlInterface(controller.host)
        try:
            yield BareArena(control, eyes, Outbox(Path(folder) / "outbox.ndjson"))
        finally:
            control.disconnect()
