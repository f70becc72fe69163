"""A simulated controller and everything before it that decides: real state, readiness, physics, gate, watch and journal.

What is made by hand is the identity provider's word (keys, a token, its registry), and what a sensor sees: nobody.
"""

import asyncio
import contextlib
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

from pep.rtde.judge.command_judge import LeasedJudge
from pep.rtde.judge.command_requests import ToolSetup
from pep.rtde.judge.execution import LeasedEffects
from pep.rtde.motion.motions import Motions
from pep.pit.scene.cell import Part
from pep.rtde.robot.dashboard import RemoteControl
from pep.watch.watch import Watch, WatchAges
from pep.world.tool_poses import ToolPoses
from pep.world.held_object import CommittedGrip
from policies.words.parameters import Parameters
from tests.pep import kit
from tests.pep.kit import AUDIENCE
from tests.pep.pit.scenes import HOME, ROBOT
from tests.pep.rtde.world import CELL, World
from ursim.ports.launch import SimulatedController
from ztpm.point.robot import readiness

from pep.pit import surveyed

TOOL = ROBOT.tool
FITTED = ToolSetup((*TOOL.tcp_m, 0.0, 0.0, 0.0), TOOL.mass_kg, TOOL.com_m)
PART = Part("cube", 0.4)
FRAMES_S = 0.05
"""Between two frames of the sensor."""


def controller(*, off_m=0.0):
    """Controller at home with the model's tool, its told values off by so much along the flange."""
    *xy, z = FITTED.centre_m
    payload, (*tcp_xy, tcp_z) = (FITTED.payload_kg, *xy, z - off_m), TOOL.tcp_m
    return SimulatedController.start(joints=HOME, tcp_m=(*tcp_xy, tcp_z - off_m), payload=payload)


class RobotCell(World):
    """A cell at a controller. On the event loop that it is opened on."""

    def open(self, host, *, state, stopper, program, commanding=lambda: True):
        """The judge of it.

        Args:
            host: of the controller.
            state: of the controller; ends with this.
            stopper: of its arm.
            program: what the controller runs, for its readiness.
            commanding: whether the connection that commands stands.
        """
        self.cell = surveyed(kit.survey(self.clock.wall_s()), replace(CELL, parts=(PART,)))
        self.grip = CommittedGrip(ROBOT, self.cell)
        self.at()
        self.state = state
        self.readiness = readiness(state, RemoteControl(host), program, commanding, robot=ROBOT, holding=self.holding())
        self.sighted(self.state)
        self.judging = ThreadPoolExecutor(1, "rest")
        self.begin_stream(frozenset()).see(self.state.read().q_rad)
        self.seeing = asyncio.get_running_loop().create_task(self.see())
        watching = partial(
            Watch, views=self.frames, limits=WatchAges.of(self.cell), clock=self.clock, submit=self.judging.submit
        )
        self.judge_ = LeasedJudge(
            gate=self.gate,
            effects=LeasedEffects(
                motions=Motions(
                    starts=self.physics, hurry=lambda *, moving: None, state=self.state, stopper=stopper, clock=self.clock,
                    pause=time.sleep,
                ),
                acts=self.physics, remaining=self.physics, certifying=self.begin_stream, posing=ToolPoses(self.holding()),
                declared=self.holding().declared, watching=watching, fingers=None,
                record=self.gate.record, parameters=Parameters(), audience=AUDIENCE, clock=self.clock,
            ),
            asks=self.asks, registry=self.registry, readiness=self.readiness, stopper=stopper, fitted=self.fitted, audience=AUDIENCE,
            clock=self.clock,
        )  # fmt: skip
        return self.judge_

    def holding(self):
        """The fingers, with what a program has said is in them."""
        return self.grip

    def fitted(self):
        grip = self.grip
        return ToolSetup((*TOOL.tcp_m, 0.0, 0.0, 0.0), grip.carried_kg, grip.centre_m, grip.loads)

    async def see(self):
        """The sensor's frames."""
        while True:
            self.show()
            await asyncio.sleep(FRAMES_S)

    async def close(self):
        """The arm stands, and nothing is open any more."""
        await self.judge_.close()
        self.seeing.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self.seeing
        self.readiness.close()
        self.state.close()
        self.gate.close()
        self.journal.close()
        self.judging.shutdown()
