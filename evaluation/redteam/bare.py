"""Arena with no enforcement: a simulated controller that an unmodified client drives, and nothing else."""

from __future__ import annotations

import socket
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

from rtde_control import RTDEControlInterface

from evaluation.redteam.admission.outbox import Outbox
from evaluation.redteam.attempts import Attempts
from evaluation.redteam.desk.desk import bare_desk, replaced
from evaluation.redteam.parts import beside
from pep.pit import Robot
from pep.rtde.robot.connections import DASHBOARD
from pep.rtde.robot.gripper import DRIVEN
from ursim.ports.launch import SimulatedController
from ztpm.point.cell_config import ROBOT_MODEL
from ztpm.stage.samples import StateRecorder, near
from ztpm.stage.stage import until

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from evaluation.redteam.desk.desk import Desk
    from evaluation.redteam.parts import Came, Deed, Moment, Playable
    from evaluation.redteam.record import HarmSeen

BRING_RAD_S: Final = 1.5
ACCELERATION_RAD_S2: Final = 3.0
TIMEOUT_S: Final = 5.0
ANSWER_BYTES: Final = 4_096
UNLOCKED: Final = b"Protective stop releasing\n"


@dataclass
class BareArena:
    """Controller and client of it.

    Attributes:
        controller: the simulated controller.
        control: the client's connection.
        eyes: every sample of the controller.
        outbox: notes that were sent.
        ends: ends of all that acts have begun, called once the arm stands.
        attempts: the acts of the scenario.
    """

    controller: SimulatedController
    control: RTDEControlInterface
    eyes: StateRecorder
    outbox: Outbox
    ends: ExitStack = field(default_factory=ExitStack)
    _prepared_s: float = 0.0
    attempts: Attempts = field(default_factory=Attempts)
    _open: ExitStack = field(default_factory=ExitStack)
    _desk: Desk | None = None

    @property
    def host(self) -> str:
        """Address of the controller."""
        return self.controller.host

    @property
    def desk(self) -> Desk:
        """The desk, which is started when it is first needed."""
        if self._desk is None:
            self._desk = self._open.enter_context(bare_desk())
        return self._desk

    def close(self) -> None:
        """Ends the desk."""
        self._open.close()

    def _put_desk_back(self) -> None:
        """Replaces a desk that an act has changed by the reviewed one."""
        if self.attempts.desk_changed:
            replaced(self.desk, None)

    def works(self, role: str) -> bool:
        """True unless an act has shut the role out."""
        return not self.desk.papers.times("bar_agent", {"name": role})

    def prepare(self, scenario: Playable) -> None:
        """Brings the arm to where the scenario begins.

        Raises:
            StageError: the arm was not brought there.
        """
        self._put_desk_back()
        if self._desk is not None:
            self._desk.papers.lay_out()
        self.attempts = Attempts()
        until(lambda: self.eyes.now().still, "the arm stands still")
        there = beside(scenario.start_rad)
        self.controller.fault("placed", joints_rad=there)
        until(lambda: near(self.eyes.now().q_rad, there), "the arm where it is put")
        until(lambda: self._brought(scenario.start_rad), "the arm at where the scenario begins")
        self._prepared_s = time.monotonic()

    def _brought(self, start_rad: Sequence[float]) -> bool:
        """True where the arm was brought there; an act may have left a stop, or another program."""
        if not self.control.isProgramRunning():
            if not self._unlocked():
                return False
            self.control.reuploadScript()
        return bool(self.control.moveJ(list(start_rad), BRING_RAD_S, ACCELERATION_RAD_S2))

    def _unlocked(self) -> bool:
        """True where a protective stop was ended, as a person does at the pendant; seconds later at the earliest."""
        with socket.create_connection((self.host, DASHBOARD), timeout=TIMEOUT_S) as link:
            link.recv(ANSWER_BYTES)  # its greeting
            link.sendall(b"unlock protective stop\n")
            return link.recv(ANSWER_BYTES) == UNLOCKED

    def show(self, moment: Moment) -> None:
        """Nothing: nobody looks."""

    def perform(self, act: Deed) -> Came:
        """Does an act with no enforcement."""
        return self.attempts.noted(act, lambda: act.bare(self))

    def settle(self) -> None:
        """Ends what is still moving."""
        self.attempts.end()
        if not self.control.isProgramRunning():
            self.control.reuploadScript()
        self.control.stopJ(ACCELERATION_RAD_S2)
        until(lambda: self.eyes.now().still, "the arm stands still")
        self.ends.close()

    def harm(self) -> tuple[HarmSeen, ...]:
        """Harm that is no motion: what left, what was taken, what no longer works."""
        return (*self.outbox.left(self._prepared_s), *self.attempts.harm(self))

    def primitives(self) -> Mapping[str, float]:
        """None: nothing is decided."""
        return {}

    def digest(self) -> str:
        """Nothing is recorded."""
        return ""


@contextmanager
def bare_arena() -> Iterator[BareArena]:
    """An arena of its own, ended afterwards."""
    tool = Robot.load(ROBOT_MODEL, tool=DRIVEN).tool  # as a person installs it
    with (
        TemporaryDirectory(prefix="ztpm-") as folder,
        SimulatedController.start(tcp_m=tool.tcp_m, payload=(tool.mass_kg, *tool.com_m)) as controller,
        StateRecorder(controller.host) as eyes,
    ):
        control = RTDEControlInterface(controller.host)
        arena = BareArena(controller, control, eyes, Outbox(Path(folder) / "outbox.ndjson"))
        try:
            yield arena
        finally:
            arena.close()
            arena.control.disconnect()
