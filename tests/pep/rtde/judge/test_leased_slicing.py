"""Small commands of a leased program are judged as their sum, which begins at the last end (TEA-6)."""

import asyncio
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from pep.watch.watch import Watch, WatchAges
from pep.world.sequence import Sequence
from policies.words.reason_table import Reason
from tests.pep.pit.scenes import FRONT
from tests.pep.rtde.judge.test_leased_physics import Runner
from tests.pep.rtde.leased import played, until
from tests.pep.rtde.world import World
from tests.pep.test_slicing import HASTE, STEPS, base

from pep.pit import CellParameters, adult_at_distance
from pep.rtde.command import command_values as v

pytestmark = [pytest.mark.e2e, pytest.mark.clause("LSD-2")]

FIRST = -0.6
SOMEBODY = adult_at_distance(1.15, bearing_rad=FRONT)
"""Far enough for a step, and not for the sweep."""
FRAMES_S = 0.01
PAST_RAD = 0.03
"""Further than a committed state may be off; as far as nobody would see."""


class Remembering(World):
    """A world that knows what was done in it, and whose arm carries out what is forwarded."""

    cell = CellParameters(time_limit_s=20.0, perception_age_limit_s=10.0)

    def begin(self, *people):
        self.people = people
        self.at(*people)
        self.runner = Runner(self.arm)
        self.runner.q = base(FIRST)
        self.arrived = self.physics.arrived
        self.forget()
        return self

    def played(self, scenario):
        """Result of `scenario(judge)`, while the sensor's frames go on."""

        async def see():
            while True:
                self.show(*self.people)
                await asyncio.sleep(FRAMES_S)

        async def seen(judge):
            seeing = asyncio.get_running_loop().create_task(see())
            try:
                return await scenario(judge)
            finally:
                seeing.cancel()

        return played(self, seen)

    def forget(self):
        """As if nothing had been done for longer than anything counts."""
        self.gate._robot = replace(self.gate._robot, sequence=Sequence(self.clock))

    def pushed(self, by_rad):
        """The arm stands elsewhere, and nothing of ours has moved it."""
        first, *others = self.arm.here().q_rad
        self.runner.motion, self.runner.q = None, (first + by_rad, *others)

    def watching(self, permit, *, remaining):
        return Watch(
            permit,
            remaining=self.physics if remaining is self else remaining,
            views=self.frames,
            limits=WatchAges(20_000, 20_000, 20_000),
            clock=self.clock,
            submit=self.judging.submit,
        )

    async def goes(self, judge, angle):
        """The answer to a move there; what is forwarded has ended."""
        ended = len(self.outcomes())
        held = self.held(v.MoveJ(tuple(round(q, 6) for q in base(angle)), *HASTE.values(), True))
        judge.judge(held)
        await until(lambda: held.answers)
        if held.forwarded:
            await until(lambda: len(self.outcomes()) > ended)
            assert self.outcomes()[-1]["result"]["outcome"] == "reached"
        else:
            judge.withdrawn(held)
            await until(lambda: not judge._cases)
        return held.answers

    def reason(self):
        """Of the newest decision."""
        return self.records("decision")[-1]["body"]["decision"]["reason"]


@pytest.fixture
def world(tmp_path, monkeypatch):
    monkeypatch.setattr("pep.gate.gate.PHYSICS_TIMEOUT_S", 60.0)
    world = Remembering(tmp_path)
    world.judging = ThreadPoolExecutor(1)
    yield world
    world.judging.shutdown()
    world.gate.close()
    world.journal.close()


def test_a_sweep_in_steps_needs_the_person_that_the_sweep_needs(world):
    world.begin(SOMEBODY)

    async def scenario(judge):
        assert await world.goes(judge, -FIRST) == ["defer"]
        assert world.reason() == Reason.TIER_NEEDS_APPROVAL
        steps = []
        for number in range(1, STEPS + 1):
            steps.append(await world.goes(judge, FIRST + 0.1 * number))
            if steps[-1] != ["forward"]:
                break
        assert steps[-1] == ["defer"]
        assert world.reason() == Reason.SEQUENCE_NEEDS_APPROVAL
        assert 2 < len(steps) < STEPS
        world.forget()  # by itself the very step is nothing
        assert await world.goes(judge, FIRST + 0.1 * len(steps)) == ["forward"]

    world.played(scenario)


def test_an_arm_that_was_moved_past_the_gateway_does_not_go_on_as_if_it_were_not(world):
    world.begin()

    async def scenario(judge):
        assert await world.goes(judge, FIRST + 0.1) == ["forward"]
        world.pushed(PAST_RAD)
        assert await world.goes(judge, FIRST + 0.2) == [Reason.SEQUENCE_DRIFT]
        world.pushed(-PAST_RAD)
        assert await world.goes(judge, FIRST + 0.2) == ["forward"]

    world.played(scenario)
