"""Frames: only a registered sensor's, in order and in time, say how the world is.

A bad frame is never nothing.
"""

import asyncio
import dataclasses
from dataclasses import dataclass

import pep.world.world
import pytest
from capabilities.values.caps import DEFAULT as CAPS
from msgspec.structs import replace
from pep.base.errors import PepFault, RobotError
from pep.mcp.mapping import ARM_TOOLS, to_request
from pep.perception.consistency import contradicted
from pep.perception.receiver import FrameReceiver
from pep.perception.sensor_frames import (
    FRAME_BYTES,
    Distrusted,
    FrameFault,
    Frames,
    RejectedFrame,
    Seen,
    SensorFrame,
    Unseen,
)
from pep.rtde.robot.state_receiver import JointState
from pep.world.held_object import CommittedGrip
from pep.world.world import CellPhysics
from policies.evidence.evidence import ImpactReading
from policies.words.reason_table import Reason
from tests.pep.kit import AUDIENCE, CALIBRATION, MOVE, ManualClock, Registry
from ursim.sensor.sensor import Sensor, obey

from capabilities.keys import keys
from capabilities.statements import observation
from capabilities.statements import observation as wire
from capabilities.statements.people import picture
from capabilities.values.errors import StatementError
from pep.pit import CellParameters, Robot, SceneError, observed, standing_adult


class World:
    def __init__(self):
        self.clock, self.registry = ManualClock(), Registry()
        self.key = self.registry.add_sensor()
        self.frames = self.watching("camera-1")
        self.boot, self.sequence = "0" * 32, 0

    def watching(self, *named):
        self.frames = Frames(sensors=self.registry, named=frozenset(named), clock=self.clock, caps=CAPS)
        return self.frames

    def observation(self, **changes):
        self.sequence += 1
        seen = observation.Observation(
            sensor="camera-1",
            boot_id=self.boot,
            sequence=self.sequence,
            captured_ms=int(self.clock.wall_s() * 1000),
            calibration=CALIBRATION,
            complete=True,
            people=(),
            objects=(),
        )
        return replace(seen, **changes)

    def text(self, *, key=None, **changes):
        return observation.sign(self.observation(**changes), key or self.key).encode()

    def admit(self, **changes):
        return self.frames.admit(self.text(**changes))

    def distrusted(self, text, fault):
        verdict = self.frames.admit(text)
        assert isinstance(verdict, RejectedFrame)
        assert verdict.fault is fault
        assert isinstance(self.frames.view(), Distrusted)
        assert isinstance(self.admit(), SensorFrame)
        assert isinstance(self.frames.view(), Seen)


@pytest.fixture
def world():
    world = World()
    assert isinstance(world.admit(), SensorFrame)
    return world


def test_age_counts_from_arrival_and_adds_the_declared_transit(world):
    assert world.frames.view().age_ms == 20
    world.clock.advance(300)
    assert world.frames.view().age_ms == 320
    world.clock.wall += 60
    assert world.frames.view().age_ms == 320


def test_nothing_seen_yet():
    world = World()
    assert isinstance(world.frames.view(), Unseen)


def test_no_registered_sensor_is_no_view(world):
    world.registry.known = {}
    assert isinstance(world.frames.view(), Unseen)


def test_every_sensor_that_the_cell_names_must_be_heard(world):
    second = world.registry.add_sensor("camera-2")
    world.watching("camera-1", "camera-2")
    assert isinstance(world.frames.view(), Unseen)
    world.admit()
    assert (world.frames.view().silent, world.frames.view().complete) == (("camera-2",), False)
    world.clock.advance(100)
    world.admit(sensor="camera-2", key=second)
    assert world.frames.view().age_ms == 120  # the older of the two
    assert (world.frames.view().silent, world.frames.view().complete) == ((), True)


def test_a_named_sensor_that_nobody_registered_is_a_view_that_is_missing(world):
    world.watching("camera-1", "camera-9")
    world.admit()
    assert states(world) == [("camera-1", "fresh", ""), ("camera-9", "missing", "")]
    assert not world.frames.view().complete


def test_a_registered_sensor_that_the_cell_does_not_name_is_a_stranger(world):
    second = world.registry.add_sensor("camera-2")
    world.distrusted(world.text(sensor="camera-2", key=second), FrameFault.UNKNOWN_SENSOR)


def states(world, *, now_ms=None):
    look = world.frames.look()
    reading = look.reading(now_ms=look.taken_ms if now_ms is None else now_ms, limit_ms=500)
    return [(s.sensor, s.state, s.fault) for s in reading.sensors]


def test_what_the_record_says_of_the_sensors(world):
    second = world.registry.add_sensor("camera-2")
    world.watching("camera-1", "camera-2")
    assert states(world) == [("camera-1", "missing", ""), ("camera-2", "missing", "")]
    world.admit()
    world.admit(sensor="camera-2", key=second)
    assert states(world) == [("camera-1", "fresh", ""), ("camera-2", "fresh", "")]
    world.clock.advance(480)
    assert states(world)[0] == ("camera-1", "fresh", "")
    world.clock.advance(1)
    assert states(world)[0] == ("camera-1", "stale", "")
    world.frames.admit(world.text(key=second))
    world.frames.admit(b"noise")
    assert states(world) == [
        ("", "invalid", "MALFORMED"),
        ("camera-1", "invalid", "UNTRUSTED"),
        ("camera-2", "stale", ""),
    ]
    world.admit()
    assert states(world)[0] == ("camera-1", "fresh", ""), "the next good frame outlives both"


@pytest.mark.parametrize(
    "changed", [{"calibration": "cd" * 32}, {"key": keys.public_raw(keys.generate())}, {"transit_ms": 21}]
)
def test_a_changed_registration_takes_back_what_was_believed_under_the_old_one(world, changed):
    world.registry.known = {"camera-1": dataclasses.replace(world.registry.known["camera-1"], **changed)}
    assert isinstance(world.frames.view(), Unseen)
    assert states(world) == [("camera-1", "missing", "")]


def test_a_frame_under_the_new_registration_is_believed_again(world):
    old = world.registry.known["camera-1"]
    world.registry.known = {"camera-1": dataclasses.replace(old, calibration="cd" * 32)}
    assert world.admit().fault is FrameFault.WRONG_CALIBRATION
    assert isinstance(world.admit(calibration="cd" * 32), SensorFrame)
    assert isinstance(world.frames.view(), Seen)


def test_forged(world):
    world.distrusted(world.text(key=keys.generate()), FrameFault.UNTRUSTED)


def test_signed_by_another_registered_sensor(world):
    second = world.registry.add_sensor("camera-2")
    world.watching("camera-1", "camera-2")
    world.frames.admit(world.text(sensor="camera-2", key=second))
    world.distrusted(world.text(key=second), FrameFault.UNTRUSTED)


def test_replayed(world):
    text = world.text()
    assert isinstance(world.frames.admit(text), SensorFrame)
    world.distrusted(text, FrameFault.NOT_NEWER)


def test_reordered(world):
    first, second = world.text(), world.text()
    world.frames.admit(second)
    world.distrusted(first, FrameFault.NOT_NEWER)


def test_an_earlier_boot_does_not_come_back(world):
    old = world.text()
    world.clock.advance(10)
    assert isinstance(world.admit(boot_id="1" * 32, sequence=1), SensorFrame)
    verdict = world.frames.admit(old)
    assert verdict.fault is FrameFault.NOT_NEWER
    world.clock.advance(10)
    assert world.admit(boot_id="0" * 32, sequence=99).fault is FrameFault.NOT_NEWER


def test_a_new_boot_continues(world):
    world.clock.advance(10)
    assert isinstance(world.admit(boot_id="1" * 32, sequence=1), SensorFrame)
    assert isinstance(world.frames.view(), Seen)


def test_a_recording_from_before_the_start():
    world = World()
    assert world.admit(captured_ms=int((world.clock.wall_s() - 60) * 1000)).fault is FrameFault.OUT_OF_TIME
    assert isinstance(world.frames.view(), Distrusted)


def test_a_frame_that_was_held_up_is_as_old_as_its_sender_says():
    world = World()
    captured_ms = int(world.clock.wall_s() * 1000) - 800
    world.frames.admit(world.text(captured_ms=captured_ms))
    assert world.frames.view().age_ms >= 800
    assert world.admit(captured_ms=captured_ms - 5_000).fault in {FrameFault.OUT_OF_TIME, FrameFault.NOT_NEWER}


def test_seconds_late_is_a_recording():
    world = World()
    assert world.admit(captured_ms=int((world.clock.wall_s() - 4) * 1000)).fault is FrameFault.OUT_OF_TIME


def test_from_the_future(world):
    world.distrusted(world.text(captured_ms=int((world.clock.wall_s() + 60) * 1000)), FrameFault.OUT_OF_TIME)


def test_wrong_calibration(world):
    world.distrusted(world.text(calibration="cd" * 32), FrameFault.WRONG_CALIBRATION)


def test_unknown_sensor(world):
    world.distrusted(world.text(sensor="camera-9", key=keys.generate()), FrameFault.UNKNOWN_SENSOR)


@pytest.mark.parametrize("text", [b"", b"hello", b"a.b.c", b"\xff\xfe", b"e30.e30.e30", b"{}"])
def test_garbage(world, text):
    world.distrusted(text, FrameFault.MALFORMED)


def test_oversized(world):
    world.distrusted(world.text() + b"A" * FRAME_BYTES, FrameFault.TOO_LARGE)


@pytest.mark.parametrize("value", [b"NaN", b"Infinity", b"1e999", b"1.5"])
def test_a_number_that_is_no_integer(world, value):
    import base64

    from capabilities.keys import jws

    claims = world.text().split(b".")[1]
    raw = base64.urlsafe_b64decode(claims + b"=" * (-len(claims) % 4))
    assert b'"sequence":' in raw
    spoilt = raw.replace(b'"sequence":%d' % world.sequence, b'"sequence":' + value)
    signed = jws.sign(
        {"typ": "ztpm-observation+jwt", "kid": keys.thumbprint(keys.public_raw(world.key))}, spoilt, world.key
    )
    verdict = world.frames.admit(signed.encode())
    assert isinstance(verdict, RejectedFrame)
    assert isinstance(world.frames.view(), Distrusted)


def test_one_sensors_good_frame_does_not_excuse_anothers_bad_one(world):
    second = world.registry.add_sensor("camera-2")
    world.watching("camera-1", "camera-2")
    world.admit(sensor="camera-2", key=second)
    world.frames.admit(world.text(key=keys.generate()))
    world.clock.advance(10)
    world.admit(sensor="camera-2", key=second)
    assert isinstance(world.frames.view(), Distrusted)


def test_a_withdrawn_sensor_is_not_believed_any_more(world):
    world.registry.known = {}
    assert world.admit().fault is FrameFault.UNKNOWN_SENSOR


# -- on the wire


def received(world, *chunks, until):
    told = []

    async def scenario():
        receiver = FrameReceiver(world.frames, clock=world.clock, incident=lambda *what: told.append(what))
        port = await receiver.listen("127.0.0.1", 0)
        _, writer = await asyncio.open_connection("127.0.0.1", port)
        for chunk in chunks:
            writer.write(chunk)
        if chunks:
            await writer.drain()
        async with asyncio.timeout(10):
            while not until(told):
                await asyncio.sleep(0.005)
        writer.close()
        await receiver.close()

    asyncio.run(scenario())
    return told


def test_frames_arrive_in_pieces_and_several_at_once(world):
    text = b"\n".join([world.text(), world.text(), world.text()]) + b"\n"
    last = world.sequence
    received(
        world,
        text[:100],
        text[100:],
        until=lambda _: world.frames.view().frames[0].observation.sequence == last,
    )


def test_bad_frames_are_told_without_flooding(world):
    told = received(world, b"x\n" * 50, until=lambda told: told and isinstance(world.frames.view(), Distrusted))
    assert told == [("", "MALFORMED", "", 1)]


def ended(world, *chunks):
    """True where the receiver hangs up on a sender of these chunks."""

    async def scenario():
        receiver = FrameReceiver(world.frames, clock=world.clock, incident=lambda *what: None)
        port = await receiver.listen("127.0.0.1", 0)
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        for chunk in chunks:
            writer.write(chunk)
        await writer.drain()
        try:
            async with asyncio.timeout(3):
                return await reader.read() == b""
        except TimeoutError:
            return False
        finally:
            writer.close()
            await receiver.close()

    return asyncio.run(scenario())


def test_a_stranger_is_hung_up_on(world, monkeypatch):
    monkeypatch.setattr("pep.perception.receiver.FIRST_FRAME_S", 0.2)
    assert ended(world, b"\n")
    assert ended(world, b"x\n")
    assert ended(world, world.text(sensor="camera-9") + b"\n")
    assert ended(world), "who says nothing makes room"
    assert not ended(world, world.text() + b"\n"), "a sensor stays"


def test_invented_names_are_one_incident(world):
    frames = [world.text(sensor=f"camera-{n}") + b"\n" for n in range(7, 12)]
    told = []

    async def scenario():
        receiver = FrameReceiver(world.frames, clock=world.clock, incident=lambda *what: told.append(what))
        port = await receiver.listen("127.0.0.1", 0)
        for frame in frames:
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(frame)
            await reader.read()
            writer.close()
        await receiver.close()

    asyncio.run(scenario())
    assert [(sensor, fault) for sensor, fault, *_ in told] == [("", "UNKNOWN_SENSOR")]


def test_an_endless_line_ends_the_connection(world):
    told = received(world, b"A" * (2 * FRAME_BYTES), until=bool)
    assert told[0][1] == "TOO_LARGE"
    assert isinstance(world.frames.view(), Distrusted)


# -- what physics makes of it


class Still:
    def read(self):
        return JointState((0.0,) * 6, (0.0,) * 6, 7, 1)


def physics(world, *, robot=None, valid_until_s=2**40):
    return CellPhysics(
        holding=CommittedGrip(robot, CellParameters()),
        cell=CellParameters(),
        valid_until_s=valid_until_s,
        frames=world.frames,
        state=Still(),
        clock=world.clock,
    )


def impact(world, **options):
    return physics(world, **options).assess(request(), touch=frozenset()).impact


def request():
    return to_request(ARM_TOOLS["move_joint"], MOVE, request_id="r", audience=AUDIENCE, at=0.0)


def test_distrusted_perception_is_a_fault_not_a_tier(world):
    world.frames.admit(world.text(key=keys.generate()))
    assessed = physics(world).assess(request(), touch=frozenset())
    assert assessed.impact.reason == Reason.PERCEPTION_INVALID
    assert [(s.sensor, s.state, s.fault) for s in assessed.perception.sensors] == [("camera-1", "invalid", "UNTRUSTED")]
    assert physics(world).summary()["perception"] == "invalid"


def test_what_breaks_in_physics_is_a_fault(world):
    assert impact(world).reason == Reason.PHYSICS_FAULT


@pytest.mark.clause("STM-25")
def test_what_was_assessed_can_be_shown(world):
    room = physics(world, robot=ARM)
    reading = room.assess(request(), touch=frozenset()).impact
    shown = picture.read(room.questions.shown("r"))
    assert len(shown.postures) > 1
    assert [place.kind for place in shown.places] == [
        each.kind for each in reading.contributions if each.link and each.kind != "perception"
    ]
    with pytest.raises(StatementError):
        room.questions.shown("another")


@pytest.mark.clause("CON-9")
def test_a_fault_leaves_no_picture_of_an_earlier_try(world):
    """The gate may assess a request again; what it decides on then is not what was assessed before."""
    room = physics(world, robot=ARM)
    room.assess(request(), touch=frozenset())
    assert room.questions.question("r") is not None
    world.frames.admit(world.text(key=keys.generate()))
    assert room.assess(request(), touch=frozenset()).impact.reason == Reason.PERCEPTION_INVALID
    assert room.questions.question("r") is None


def test_nothing_is_assessed_after_the_cell_file_has_ended(world):
    end = int(world.clock.wall_s()) + 1
    assert impact(world, robot=ARM, valid_until_s=end).perception == "fresh"
    world.clock.wall = float(end)
    assert impact(world, robot=ARM, valid_until_s=end).reason == Reason.PHYSICS_FAULT


ARM = Robot.load("ur3e")
BOB = observed(standing_adult(1.2, 0.0, name="bob"))


class Slow:
    """An assessment that takes its time, and remembers which age it was asked with."""

    def __init__(self, world, monkeypatch, *takes_ms):
        self.world, self.takes_ms, self.ages, self.scenes, self.touch = world, list(takes_ms), [], [], []
        self.honest = pep.world.world.assess
        monkeypatch.setattr(pep.world.world, "assess", self)

    def __call__(self, robot, scene, *rest, perception_age_s, touch, **named):
        self.ages.append(perception_age_s)
        self.scenes.append(scene)
        self.touch.append(touch)
        answer = self.honest(robot, scene, *rest, perception_age_s=perception_age_s, touch=touch, **named)
        self.world.clock.advance(self.takes_ms.pop(0))
        return answer


def test_the_age_is_that_at_the_end_of_the_assessment(world, monkeypatch):
    slow = Slow(world, monkeypatch, 70)
    assessed = physics(world, robot=ARM).assess(request(), touch=frozenset())
    assert slow.ages == [0.020]
    assert assessed.impact.perception_age_ms == assessed.perception.sensors[0].age_ms == 90
    assert (assessed.impact.perception, assessed.perception.sensors[0].state) == ("fresh", "fresh")


def test_people_who_walked_on_meanwhile_are_assessed_again(world, monkeypatch):
    world.admit(people=(BOB,))
    slow = Slow(world, monkeypatch, 131, 131)
    assessed = physics(world, robot=ARM).assess(request(), touch=frozenset())
    assert slow.ages == [0.020, pytest.approx(0.020 + 0.131 + 0.197)], "with the age that the answer will have"
    assert assessed.impact.perception_age_ms == 20 + 131 + 131


def test_up_to_the_reaction_that_physics_reckons_with_once_is_enough(world, monkeypatch):
    world.admit(people=(BOB,))
    slow = Slow(world, monkeypatch, 130)
    assert physics(world, robot=ARM).assess(request(), touch=frozenset()).impact.perception_age_ms == 150
    assert slow.ages == [0.020]


@pytest.mark.parametrize("people", [(), (BOB,)])
def test_a_view_that_became_stale_meanwhile_is_stale(world, monkeypatch, people):
    world.admit(people=people)
    Slow(world, monkeypatch, 600, 600)
    assessed = physics(world, robot=ARM).assess(request(), touch=frozenset())
    assert assessed.impact.perception == "stale"
    assert assessed.impact.index_milli >= 3_000
    assert assessed.perception.sensors[0].state == "stale"
    assert assessed.impact.perception_age_ms == 1_220


LATE = replace(BOB, age_ms=400)
SHELF = wire.ObservedObject("shelf", "rigid", wire.Sphere((1_500_000, 0, 0), 100_000), 400)


@pytest.mark.parametrize("late", [{"people": (LATE,)}, {"objects": (SHELF,)}])
def test_a_sighting_that_became_stale_meanwhile_is_stale(world, monkeypatch, late):
    """A sighting that is fresh at the look and too old 100 ms later is asked again.

    It is 20 ms and 400 ms old at the look.
    """
    world.admit(**late)
    slow = Slow(world, monkeypatch, 100, 100)
    assessed = physics(world, robot=ARM).assess(request(), touch=frozenset())
    assert len(slow.ages) == 2
    assert assessed.impact.perception == "stale"
    assert assessed.impact.index_milli >= 3_000
    assert ("perception", "camera-1") in [(each.kind, each.source) for each in assessed.impact.contributions]
    assert assessed.perception.sensors[0].state == "fresh"
    assert physics(world).summary()["perception"] == "stale"


def test_a_sighting_within_the_limit_is_fresh_and_its_person_has_walked_on(world, monkeypatch):
    world.admit(people=(LATE,))
    slow = Slow(world, monkeypatch, 79)
    assessed = physics(world, robot=ARM).assess(request(), touch=frozenset())
    assert [(each.source, each.age_s) for each in slow.scenes[0].people] == [("camera-1", 0.4)]
    assert assessed.impact.perception == "fresh"
    assert physics(world).summary()["perception"] == "fresh"
    seen = {each.source for each in assessed.impact.contributions if each.object.startswith("bob")}
    assert seen == {"camera-1"}


def test_equal_frames_with_another_age_are_not_the_same_scene(world):
    world.admit(people=(LATE,))
    before = world.frames.view().content
    world.admit(people=(replace(LATE, age_ms=401),))
    assert world.frames.view().content != before


def test_an_assessment_that_gets_slower_and_slower_is_a_fault(world, monkeypatch):
    world.admit(people=(BOB,))
    Slow(world, monkeypatch, 200, 900)
    assert impact(world, robot=ARM).reason == Reason.PHYSICS_FAULT


def test_a_frame_that_comes_meanwhile_is_seen_by_the_second_look(world, monkeypatch):
    world.admit(people=(BOB,))
    slow = Slow(world, monkeypatch, 200, 10)
    honest, frames = slow.honest, world.frames

    def interrupted(*rest, **named):
        if len(slow.ages) == 1:
            frames.admit(world.text(key=keys.generate()))
        return honest(*rest, **named)

    slow.honest = interrupted
    assessed = physics(world, robot=ARM).assess(request(), touch=frozenset())
    assert assessed.impact.reason == Reason.PERCEPTION_INVALID
    assert assessed.perception.sensors[0].state == "invalid"


def test_nobody_is_lost_when_another_sensor_falls_silent(world, monkeypatch):
    world.registry.add_sensor("camera-2")
    world.watching("camera-1", "camera-2")
    world.admit(people=(BOB,))
    slow = Slow(world, monkeypatch, 0)
    assessed = physics(world, robot=ARM).assess(request(), touch=frozenset())
    assert [person.id for person in slow.scenes[0].people] == ["bob"]
    assert assessed.impact.perception == "missing"
    assert [s.state for s in assessed.perception.sensors] == ["fresh", "missing"]
    assert physics(world).summary()["perception"] == "missing"


def test_everybody_whom_any_sensor_sees_counts(world, monkeypatch):
    second = world.registry.add_sensor("camera-2")
    world.watching("camera-1", "camera-2")
    world.admit(people=(BOB,))
    world.admit(sensor="camera-2", key=second)
    slow = Slow(world, monkeypatch, 0)
    physics(world, robot=ARM).assess(request(), touch=frozenset({"table"}))
    assert [person.id for person in slow.scenes[0].people] == ["bob"]
    assert slow.touch == [frozenset({"table"})]


@pytest.mark.parametrize(
    ("seen", "told"),
    [
        ({}, True),
        ({"people": (BOB,)}, False),
        ({"people": (observed(standing_adult(1.2, 0.45, name="x")),)}, False),
        ({"people": (observed(standing_adult(1.2, 0.55, name="x")),)}, True),
        ({"complete": False}, False),
    ],
)
def test_sensors_that_contradict_each_other_are_an_incident_and_no_refusal(world, seen, told):
    second = world.registry.add_sensor("camera-2")
    world.watching("camera-1", "camera-2")
    world.admit(people=(BOB,))
    frame = world.admit(sensor="camera-2", key=second, **seen)
    found = world.frames.contradiction(frame)
    assert (found is not None) is told
    if told:
        assert (found.fault, found.sensor) == (FrameFault.CONTRADICTED, "camera-2")
    assert isinstance(world.frames.view(), Seen)


@pytest.mark.parametrize("where", [{"apart_ms": 501}, {"people": (observed(standing_adult(1.6, 0.0)),)}])
def test_what_cannot_be_compared_contradicts_nothing(world, where):
    people = where.get("people", (BOB,))
    seen = world.observation(people=people)
    blind = world.observation(people=())
    assert contradicted(seen, blind, apart_ms=where.get("apart_ms", 0)) == ""
    assert contradicted(world.observation(people=(BOB,)), blind, apart_ms=500)


@dataclass
class Standing:
    q_rad: tuple

    def read(self):
        return JointState(self.q_rad, (0.0,) * 6, 7, 1)


def left(world, q_rad=(0.0,) * 6, authorised_milli=1_000, oldest_ms=None):
    patient = CellParameters(time_limit_s=60.0)  # a machine that does much else
    seen = CellPhysics(
        holding=CommittedGrip(ARM, patient),
        cell=patient,
        valid_until_s=2**40,
        frames=world.frames,
        state=Standing(q_rad),
        clock=world.clock,
    )
    seen.assess(request(), touch=frozenset())
    return seen.left(
        request(), q_rad, authorised_milli=authorised_milli, touch=frozenset(), running=None, oldest_ms=oldest_ms
    )


def test_what_is_left_is_judged_on_what_is_seen(world):
    sensor = Sensor(world.key, name="camera-1", calibration=CALIBRATION)
    world.clock.advance(50)
    world.frames.admit(sensor.frame(captured_s=world.clock.wall_s()).encode())
    here = (0.3, *MOVE["q_rad"][1:])
    empty = left(world, here)
    assert (empty.holds, empty.index_milli, empty.fault) == (True, 1_000, ""), empty
    assert empty.age_ms == 20, "the transit of the only frame"
    assert not left(world, here, authorised_milli=999).holds
    obey([sensor], '{"people": [{"id": "bob", "x_m": -0.5, "y_m": -0.1}]}', at_s=0.0)
    world.frames.admit(sensor.frame(captured_s=world.clock.wall_s()).encode())
    rest = left(world, here)
    assert (rest.holds, rest.fault) == (False, "")
    assert rest.index_milli > 2_000
    assert rest.cause == "person"


def test_what_is_left_can_be_judged_by_the_sensors_that_still_send(world):
    second = world.registry.add_sensor("camera-2")
    world.watching("camera-1", "camera-2")
    world.admit()
    world.clock.advance(30_000)  # an approver has seen since that nobody is there
    here, limit_ms = (0.3, *MOVE["q_rad"][1:]), 150
    assert isinstance(world.frames.view(oldest_ms=limit_ms), Unseen)
    world.admit(sensor="camera-2", key=second)
    assert (world.frames.view().age_ms, world.frames.view(oldest_ms=limit_ms).age_ms) == (30_020, 20)
    assert world.frames.view(oldest_ms=limit_ms).silent == ("camera-1",)
    empty = left(world, here, authorised_milli=3_000, oldest_ms=limit_ms)
    assert (empty.holds, empty.fault, empty.age_ms) == (True, "", 20), empty
    near = observed(standing_adult(-0.5, -0.1, name="bob"))
    world.admit(sensor="camera-2", key=second, people=(near,))
    rest = left(world, here, authorised_milli=3_000, oldest_ms=limit_ms)
    assert (rest.holds, rest.fault, rest.cause) == (False, "", "person"), rest


def test_what_is_left_of_a_distrusted_view_is_a_fault(world):
    world.frames.admit(world.text(key=keys.generate()))
    assert (left(world).holds, left(world).fault) == (False, Reason.PERCEPTION_INVALID)


def test_what_breaks_while_judging_what_is_left_is_a_fault(world):
    rest = physics(world).left(
        request(), (0.0,) * 6, authorised_milli=4_000, touch=frozenset(), running=None, oldest_ms=None
    )
    assert (rest.holds, rest.fault) == (False, Reason.PHYSICS_FAULT)


@pytest.mark.parametrize(
    ("broken", "reason"),
    [
        (SceneError("PERCEPTION_INVALID", "of no kind"), Reason.PERCEPTION_INVALID),
        (RobotError(PepFault.ROBOT_STALLED), Reason.PHYSICS_FAULT),
        (ZeroDivisionError(), Reason.PHYSICS_FAULT),
    ],
    ids=lambda each: type(each).__name__,
)
def test_what_breaks_in_any_question_is_a_fault_of_its_own_reason(world, monkeypatch, broken, reason):
    def breaks(*_):
        raise broken

    asked = physics(world, robot=ARM)
    # Its motion is known from here on.
    assert isinstance(asked.assess(request(), touch=frozenset()).impact, ImpactReading)
    monkeypatch.setattr("pep.world.world.scene_of", breaks)
    assert asked.assess(request(), touch=frozenset()).impact.reason == reason
    assert asked.together(request(), start_urad=(0,) * 6, touch=frozenset()).reason == reason
    rest = asked.left(request(), (0.0,) * 6, authorised_milli=4_000, touch=frozenset(), running=None, oldest_ms=None)
    assert (rest.holds, rest.fault) == (False, reason)


def test_summary_counts(world):
    sensor = Sensor(world.key, name="camera-1", calibration=CALIBRATION)
    obey(
        [sensor],
        '{"people": [{"id": "bob", "x_m": 1.0, "y_m": 0.0}], "objects": [{"id": "glass", "kind": "fragile",'
        ' "shape": {"type": "sphere", "center_m": [0.4, 0.0, 0.1], "radius_m": 0.03}}]}',
        at_s=0.0,
    )
    world.clock.advance(10)
    assert isinstance(world.frames.admit(sensor.frame(captured_s=world.clock.wall_s()).encode()), SensorFrame)
    summary = physics(world).summary()
    assert (summary["perception"], summary["people"], summary["objects"]) == ("fresh", 1, 1)
