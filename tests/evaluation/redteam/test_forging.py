"""Each forged frame is right in all but one thing, by the recipe that refuses it."""

import pytest
from capabilities.values.caps import DEFAULT as CAPS
from evaluation.redteam.acts.forging import Forgery, Wrong
from pep.perception.sensor_frames import FrameFault, Frames, SensorFrame
from tests.pep.kit import ManualClock, Registry
from ursim.sensor.sensor import Sensor
from ursim.sensor.sensor_scene import Seen
from ztpm.cell.setup import SENSOR_CALIBRATION, SENSOR_ID

from capabilities.keys import keys

FAULTS = {
    Wrong.KEY: FrameFault.UNTRUSTED,
    Wrong.AGENT: FrameFault.UNTRUSTED,
    Wrong.ENFORCEMENT: FrameFault.UNTRUSTED,
    Wrong.UNSIGNED: FrameFault.UNTRUSTED,
    Wrong.ALGORITHM: FrameFault.UNTRUSTED,
    Wrong.BODY: FrameFault.UNTRUSTED,
    Wrong.SENSOR: FrameFault.UNKNOWN_SENSOR,
    Wrong.CALIBRATION: FrameFault.WRONG_CALIBRATION,
    Wrong.STALE: FrameFault.OUT_OF_TIME,
    Wrong.AHEAD: FrameFault.OUT_OF_TIME,
    Wrong.SEQUENCE: FrameFault.NOT_NEWER,
}
OTHER_KEY = {Wrong.KEY, Wrong.AGENT, Wrong.ENFORCEMENT}
"""All others are signed by the sensor here, so that nothing but the one thing is wrong."""
PERSON = {"id": "person-1", "x_m": -0.5, "y_m": 0.2}


class Place:
    def __init__(self):
        registry, self.clock = Registry(), ManualClock()
        self.key = registry.add_sensor(SENSOR_ID, calibration=SENSOR_CALIBRATION)
        self.frames = Frames(sensors=registry, named=frozenset({SENSOR_ID}), clock=self.clock, caps=CAPS)
        self.sensor = Sensor(self.key, name=SENSOR_ID, calibration=SENSOR_CALIBRATION)
        self.sensor.seen = self.sensor.seen.told({"people": [PERSON]}, now_s=self.clock.wall_s())

    def true(self):
        frame = self.sensor.frame(captured_s=self.clock.wall_s())
        assert isinstance(self.frames.admit(frame.encode()), SensorFrame)
        return frame

    def forged(self, wrong, true):
        forgery = Forgery(wrong, keys.generate() if wrong in OTHER_KEY else self.key, Seen.nothing(), boot_id="f" * 32)
        self.clock.wall += 0.01
        return forgery.frame(captured_s=self.clock.wall_s(), complete=True, true=true)


@pytest.mark.parametrize("wrong", FAULTS)
def test_forged_frame_is_refused_for_the_one_thing_that_is_wrong(wrong):
    place = Place()
    # After a true frame an old one would be wrong in two things: it is not newer either.
    before = None if wrong is Wrong.STALE else place.true()
    verdict = place.frames.admit(place.forged(wrong, before).encode())
    assert verdict.fault is FAULTS[wrong]


def test_frame_of_a_stolen_key_is_believed_so_that_only_the_one_thing_tells_the_others():
    place = Place()
    verdict = place.frames.admit(place.forged(Wrong.NOTHING, place.true()).encode())
    assert isinstance(verdict, SensorFrame)
    assert verdict.observation.people == ()


def test_every_wrong_is_tried():
    assert {*FAULTS, Wrong.NOTHING, Wrong.REPLAYED} == set(Wrong)


@pytest.mark.parametrize("wrong", [Wrong.BODY, Wrong.SEQUENCE])
def test_what_needs_a_true_frame_waits_for_one(wrong):
    assert Place().forged(wrong, None) is None
