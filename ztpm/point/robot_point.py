"""Enforcement point with a robot: sensors, people, physics and a gate on top of the common parts."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

from capabilities.values.caps import DEFAULT as CAPS
from pep.base.clock import SystemClock
from pep.gate.gate import Gate
from pep.gate.observe_only import Marked
from pep.gate.robot_ports import RobotPorts
from pep.journal.budget_store import BUDGETS, BudgetStore
from pep.journal.task_store import TASKS, TaskStore
from pep.perception.receiver import FrameReceiver
from pep.perception.sensor_frames import Frames
from pep.pit import surveyed
from pep.pit.assessment.readiness import compile_telling
from pep.point.deferrals import Deferrals, recover_gate
from pep.point.motion_pictures import MotionPictures
from pep.point.parts import EnforcementInputs, opened
from pep.rtde.robot.state_receiver import StateReceiver
from pep.world.held_object import CommittedGrip
from pep.world.sequence import Sequence
from pep.world.world import CellPhysics
from ztpm.point.cell_config import read_cell, read_robot
from ztpm.point.enforcement_point import EnforcementPoint
from ztpm.point.robot_report import report_of

if TYPE_CHECKING:
    from collections.abc import Coroutine

    import httpx2

    from capabilities.keys.keys import PrivateKey
    from capabilities.keys.trust import TrustBundle
    from capabilities.statements.cell import Cell
    from pep.base.ports import Journal, MotionSlot
    from pep.gate.observe_only import Simulated
    from pep.people.latches import Latches
    from pep.request.edge import Edge
    from policies.decision.policy import PolicySet
    from ztpm.point.cell_config import CellConfig


def _preparing(progress: object) -> None:
    """Tells the progress to the process that started this one."""
    sys.stdout.write(json.dumps({"preparing": str(progress)}) + "\n")
    sys.stdout.flush()


class OpenedCell(EnforcementInputs):
    """Inputs of an enforcement point with a robot besides its configuration: read, verified and in force."""

    survey: Cell


def opened_cell(config: CellConfig) -> OpenedCell:
    """Inputs that the configuration names.

    Raises:
        PepError: one of them cannot be had, or must not be believed.
    """
    survey = read_cell(config, at=SystemClock().wall_s())
    return OpenedCell(survey=survey, **opened(config))


class RobotPoint(EnforcementPoint):
    """Parts that every enforcement point with a robot has, composed.

    Args:
        config: of it.
        survey: the signed cell file, verified and in force.
        trust: the issuer's public keys.
        key: of this PEP.
        http: client of the identity provider.
        unsafe_observe: the simulated controller, where nothing is to be enforced; None enforces.

    Attributes:
        robot: the arm's model, with its tool and empty fingers.
        gate: made by the subclass.
        kept: deferred calls that their callers look after.
    """

    config: CellConfig
    gate: Gate

    def __init__(
        self,
        config: CellConfig,
        *,
        survey: Cell,
        trust: TrustBundle,
        key: PrivateKey,
        http: httpx2.AsyncClient,
        unsafe_observe: Simulated | None = None,
    ) -> None:
        super().__init__(config, trust=trust, key=key, http=http)
        self._unsafe_observe = unsafe_observe
        self.cell = surveyed(survey, config.cell)
        self.frames = Frames(sensors=self.follower, named=frozenset(survey.sensors), clock=self.clock, caps=CAPS)
        self.receiver = FrameReceiver(self.frames, clock=self.clock, incident=self._frame_incident)
        self.state = StateReceiver(config.robot_host, self.clock)
        compile_telling(_preparing)  # before the first question: a minute the very first time, a second from then on
        self.robot = read_robot(config, tool=survey.tool)
        self.holding = CommittedGrip(self.robot, self.cell)
        self.physics = CellPhysics(
            holding=self.holding,
            cell=self.cell,
            valid_until_s=survey.not_after,
            frames=self.frames,
            state=self.state,
            clock=self.clock,
        )
        people = Deferrals.of(
            self,
            journal=self.marked,
            timeout_ms=config.defer_timeout_s * 1000,
            trust=trust,
            key=key,
            pictures=self.physics.questions,
        )
        self.asks, self.asking = people.asks, people.asking
        self.pictures = MotionPictures(
            self.physics.questions,
            clock=self.clock,
            record=lambda kind, body: self.gate.note(kind, body),  # noqa: PLW0108  the gate is made later
            shipped=lambda: (self.journal.last_seq, self.shipper.accepted_through),
            asking=self.asking,
            incident=self.feed_incident,
        )
        self.kept = TaskStore(config.state_dir / TASKS)

    @property
    def edge(self) -> Edge:
        """The gate."""
        return self.gate

    @property
    def marked(self) -> Journal:
        """Journal; where nothing is enforced, every record says so."""
        return self.journal if self._unsafe_observe is None else Marked(self.journal)

    def gated(self, policies: PolicySet, *, slot: MotionSlot, latches: Latches) -> Gate:
        """Gate over these parts.

        Args:
            policies: the policies of decisions.
            slot: one motion at a time.
            latches: the latch of the robot.
        """
        return Gate(
            clock=self.clock,
            authority=self.authority,
            registry=self.follower,
            robot=RobotPorts(
                slot=slot,
                sequence=Sequence(self.clock),
                physics=self.physics,
                latched=lambda: latches.latch_id,
                pictured=self.pictures,
            ),
            policies=policies,
            journal=self.journal,
            budgets=BudgetStore(self.config.state_dir / BUDGETS),
            asks=self.asks,
            announcer=self.asking,
            unsafe_observe=self._unsafe_observe,
        )

    def recover(self) -> None:
        """Records an end for permits that an earlier process left open, and remembers its accepted proofs."""
        recover_gate(self.journal, gate=self.gate, asks=self.asks, proofs=super().recover)

    def beside(self) -> dict[str, Coroutine[Any, Any, None]]:
        """Tasks that run as long as it serves, by name."""
        return {**super().beside(), "asking": self.asking.run(), "pictures": self.pictures.run()}

    async def report(self) -> dict[str, object]:
        """Report on robot, perception and revocation view."""
        sensors = {**self.physics.summary(), "sensors": sorted(self.follower.sensors())}
        now_ms, view = self.clock.monotonic_ms(), self.frames.view()
        told = await report_of(self.robot, self.cell, self.state, sensors, view, at_ms=now_ms)
        return {**told, **await super().report()}

    async def listen(self) -> None:
        """Listens to the sensors."""
        # Not before: a frame is judged by the registered keys, and without them every sensor is a stranger.
        await self.receiver.listen(self.config.host, self.config.perception_port)

    async def stand(self) -> None:
        """Stops the arm."""
        raise NotImplementedError

    async def close(self) -> None:
        """Ends the parts composed beside these, with the arm standing still."""
        raise NotImplementedError

    async def let_go(self) -> None:
        """Releases sensors and robot, and closes the file of tasks."""
        self.kept.close()
        await self.receiver.close()
        self.state.close()

    def _frame_incident(self, sensor: str, fault: str, detail: str, count: int) -> None:
        self.note({"what": "perception", "sensor": sensor, "fault": fault, "detail": detail, "count": count})
