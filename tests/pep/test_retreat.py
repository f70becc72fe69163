"""Arm that stands where it should not: it may only get out, and only when a person says so.

Gate, signed frames and physics are real.
"""

import asyncio

import pytest
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.scope import Tier
from pep.perception.sensor_frames import Frames, SensorFrame
from pep.pit.assessment.readiness import compile_all
from pep.rtde.robot.state_receiver import JointState
from pep.world.held_object import CommittedGrip
from pep.world.world import CellPhysics
from policies.evidence.model import Effect
from policies.words.reason_table import Reason
from tests.pep.kit import CALIBRATION, Rig
from tests.pep.pit.scenes import HOME, tcp

from capabilities.statements import observation
from pep.pit import CellParameters, Person, Region, Robot, Sphere, observed

ROBOT = Robot.load("ur3e")
SLOW = {"speed_rad_s": 0.2, "acceleration_rad_s2": 1.0}
STREAM = {"acceleration_rad_s2": 1.0, "duration_s": 0.2}
compile_all()  # compiled before a gate waits for it, as in a tool server: the first time takes longer than any gate waits


class Standing:
    """An arm that stands."""

    def __init__(self, q):
        self.q = q

    def read(self):
        return JointState(self.q, (0.0,) * 6, 7, 1)


class Cell(Rig):
    """A rig that computes its physics from what a sensor signs."""

    def at(self, q, *people):
        frames = Frames(sensors=self.registry, named=frozenset({"camera-1"}), clock=self.clock, caps=CAPS)
        key = self.registry.add_sensor()
        seen = observation.Observation(
            sensor="camera-1",
            boot_id="0" * 32,
            sequence=1,
            captured_ms=int(self.clock.wall_s() * 1000),
            calibration=CALIBRATION,
            complete=True,
            people=tuple(observed(person) for person in people),
            objects=(),
        )
        assert isinstance(frames.admit(observation.sign(seen, key).encode()), SensorFrame)
        cell = CellParameters(time_limit_s=20.0)  # a loaded host is slow, and this is not about that
        self.physics = CellPhysics(
            holding=CommittedGrip(ROBOT, cell),
            cell=cell,
            valid_until_s=2**40,
            frames=frames,
            state=Standing(q),
            clock=self.clock,
        )
        return self.build()

    def asked(self, tool, **arguments):
        decision = asyncio.run(self.gate.run(self.call(self.agent(), tool, arguments), self.effect)).decision
        kinds = {c["kind"] for c in (decision.findings[0].detail if decision.findings else {}).get("contributions", ())}
        return decision, kinds

    def move(self, q, **changes):
        return self.asked("move_joint", q_rad=[round(angle, 6) for angle in q], **{**SLOW, **changes})


@pytest.fixture
def cell(tmp_path, monkeypatch):
    monkeypatch.setattr("pep.gate.gate.PHYSICS_TIMEOUT_S", 60.0)
    cell = Cell(tmp_path)
    yield cell
    cell.gate.close()
    cell.journal.close()
    assert cell.sent == []


def hand_at_the_fingers(depth):
    """A fist that the resting gripper's tip overlaps by `depth`."""
    x, y, z = tcp()
    return Person("bob", ((Region.HAND, Sphere((x, y, z - 0.0345 + 0.0328 - 0.05 + depth), 0.05)),))


def lift(change):
    return (HOME[0], HOME[1] + change, *HOME[2:])


def test_out_of_a_person_needs_a_person_and_deeper_is_denied_whatever_is_authorised(cell):
    cell.at(HOME, hand_at_the_fingers(0.01))
    away, kinds = cell.move(lift(-0.1))
    assert (away.effect, away.reason, away.tier) == (
        Effect.DEFER,
        Reason.TIER_NEEDS_APPROVAL,
        Tier.HIGH_CONSEQUENCE,
    )
    assert "retreat" in kinds
    deeper, _ = cell.move(lift(0.1))
    assert (deeper.effect, deeper.reason) == (Effect.DENY, Reason.PHYSICS_VIOLATION)
    hasty, _ = cell.move(lift(-0.3), speed_rad_s=1.0, acceleration_rad_s2=2.0)
    assert (hasty.effect, hasty.reason) == (Effect.DENY, Reason.PHYSICS_VIOLATION)


def test_a_stream_may_retreat_likewise(cell):
    cell.at(HOME, hand_at_the_fingers(0.01))
    away, kinds = cell.asked("speed_joint", qd_rad_s=[0.0, -0.1, 0.0, 0.0, 0.0, 0.0], **STREAM)
    assert (away.effect, away.tier) == (Effect.DEFER, Tier.HIGH_CONSEQUENCE)
    assert "retreat" in kinds
    deeper, _ = cell.asked("speed_joint", qd_rad_s=[0.0, 0.1, 0.0, 0.0, 0.0, 0.0], **STREAM)
    assert (deeper.effect, deeper.reason) == (Effect.DENY, Reason.PHYSICS_VIOLATION)


def test_back_from_beyond_a_joint_limit_needs_a_person_and_further_is_denied(cell):
    limit = ROBOT.model.joints[0].position_limit_rad
    beyond = (limit + 0.02, *HOME[1:])
    cell.at(beyond)
    inwards, _ = cell.move((limit - 0.1, *HOME[1:]))
    assert (inwards.effect, inwards.tier) == (Effect.DEFER, Tier.HIGH_CONSEQUENCE)
    deeper, _ = cell.asked("speed_joint", qd_rad_s=[0.1, 0.0, 0.0, 0.0, 0.0, 0.0], **STREAM)
    assert (deeper.effect, deeper.reason) == (Effect.DENY, Reason.PHYSICS_VIOLATION)


def test_a_stream_that_would_run_into_a_joint_limit_within_its_stop_is_denied(cell):
    limit = ROBOT.model.joints[0].position_limit_rad
    cell.at((limit - 0.05, *HOME[1:]))
    into, _ = cell.asked("speed_joint", qd_rad_s=[0.2, 0.0, 0.0, 0.0, 0.0, 0.0], **STREAM)  # 0.04 rad by itself
    assert (into.effect, into.reason) == (Effect.DENY, Reason.PHYSICS_VIOLATION)
