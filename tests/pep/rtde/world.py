"""A house whose physics is the real one, computed from what a sensor signs."""

from capabilities.values.caps import DEFAULT as CAPS
from pep.perception.sensor_frames import Frames, SensorFrame
from pep.rtde.robot.state_receiver import JointState
from pep.world.cell_stream import CellStream
from pep.world.held_object import CommittedGrip
from pep.world.world import CellPhysics
from tests.pep.kit import CALIBRATION
from tests.pep.pit.scenes import HOME, ROBOT
from tests.pep.rtde.leased import House, played, until

from capabilities.statements import observation
from pep.pit import CellParameters, observed

CELL = CellParameters(time_limit_s=20.0, watch_time_limit_s=20.0, perception_age_limit_s=30.0, watch_age_limit_s=1.0)
"""A loaded host is slow, and this is not about that."""
STILL = (0.0,) * 6


class World(House):
    """A house whose physics is computed from what a sensor signs; the arm stands at `HOME`."""

    cell = CELL

    def at(self, *people):
        self.frames = Frames(sensors=self.registry, named=frozenset({"camera-1"}), clock=self.clock, caps=CAPS)
        self.key, self.sequence = self.registry.add_sensor(), 0
        self.show(*people)
        self.arm.here = lambda: JointState(HOME, STILL, 7, 1)
        return self.sighted(self.arm)

    def sighted(self, state):
        """Assessed from there."""
        self.physics = CellPhysics(
            holding=self.holding(),
            cell=self.cell,
            valid_until_s=2**40,
            frames=self.frames,
            state=state,
            clock=self.clock,
        )
        self.start_of = self.physics.start_of
        return self.build()

    def holding(self):
        """The empty fingers."""
        return CommittedGrip(ROBOT, self.cell)

    def show(self, *people):
        self.sequence += 1
        seen = observation.Observation(
            sensor="camera-1",
            boot_id="0" * 32,
            sequence=self.sequence,
            captured_ms=int(self.clock.wall_s() * 1000),
            calibration=CALIBRATION,
            complete=True,
            people=tuple(observed(person) for person in people),
            objects=(),
        )
        assert isinstance(self.frames.admit(observation.sign(seen, self.key).encode()), SensorFrame)

    def begin_stream(self, touch, led=None):
        return CellStream(
            holding=self.holding(), cell=self.cell, frames=self.frames, touch=touch, clock=self.clock, led=led
        )

    def decided(self, command):
        """The held command, decided; what was forwarded is stopped at once."""
        held = self.held(command, before=self.arm.halt)

        async def scenario(judge):
            judge.judge(held)
            await until(lambda: held.answers)

        played(self, scenario)
        return held
