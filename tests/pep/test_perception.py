"""Frames: only what a registered sensor signed, in order and in time, may say what the world is; and a bad frame is never nothing."""

import asyncio
import json
import os
import subprocess
import sys
from dataclasses import replace

import pytest

import pep.world
from capabilities import keys
from capabilities.caps import DEFAULT as CAPS
from capabilities.statements import observation
from pep.context.frames import FRAME_BYTES, Distrusted, Frame, FrameFault, Frames, Rejected, Seen, Unseen
from pep.context.witness import contradicted
from pep.perception import Receiver
from pep.pit import CellParameters, Robot, observed, standing_adult
from pep.rtde.state import JointState
from pep.sim.seen import SceneCommandError
from pep.sim.sensor import Sensor, obey
from pep.world import CellPhysics
from policies.reasons import Reason
from tests.pep.kit import AUDIENCE, CALIBRATION, MOVE, ManualClock, Registry
from pep.mcp.mapping import ARM_TOOLS, to_request


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
        assert isinstance(verdict, Rejected)
        assert verdict.fault is fault
        assert isinstance(self.frames.view(), Distrusted)
        assert isinstance(self.admit(), Frame)
        assert isinstance(self.frames.view(), Seen)


@pytest.fixture
def world():
    world = World()
    assert isinstance(world.admit(), Frame)
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
    world.registry.known = {"camera-1": replace(world.registry.known["camera-1"], **changed)}
    assert isinstance(world.frames.view(), Unseen)
    assert states(world) == [("camera-1", "missing", "")]


def test_a_frame_under_the_new_registration_is_believed_again(world):
    old = world.registry.known["camera-1"]
    world.registry.known = {"camera-1": replace(old, calibration="cd" * 32)}
    assert world.admit().fault is FrameFault.WRONG_CALIBRATION
    assert isinstance(world.admit(calibration="cd" * 32), Frame)
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
    assert isinstance(world.frames.admit(text), Frame)
    world.distrusted(text, FrameFault.NOT_NEWER)


def test_reordered(world):
    first, second = world.text(), world.text()
    world.frames.admit(second)
    world.distrusted(first, FrameFault.NOT_NEWER)


def test_an_earlier_boot_does_not_come_back(world):
    old = world.text()
    world.clock.advance(10)
    assert isinstance(world.admit(boot_id="1" * 32, sequence=1), Frame)
    verdict = world.frames.admit(old)
    assert verdict.fault is FrameFault.NOT_NEWER
    world.clock.advance(10)
    assert world.admit(boot_id="0" * 32, sequence=99).fault is FrameFault.NOT_NEWER


def test_a_new_boot_continues(world):
    world.clock.advance(10)
    assert isinstance(world.admit(boot_id="1" * 32, sequence=1), Frame)
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

    from capabilities import jws

    claims = world.text().split(b".")[1]
    raw = base64.urlsafe_b64decode(claims + b"=" * (-len(claims) % 4))
    assert b'"sequence":' in raw
    spoilt = raw.replace(b'"sequence":%d' % world.sequence, b'"sequence":' + value)
    signed = jws.sign(
        {"typ": "ztpm-observation+jwt", "kid": keys.thumbprint(keys.public_raw(world.key))}, spoilt, world.key
    )
    verdict = world.frames.admit(signed.encode())
    assert isinstance(verdict, Rejected)
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
        receiver = Receiver(world.frames, clock=world.clock, incident=lambda *what: told.append(what))
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
    """Whether the receiver hangs up on a sender of these chunks."""

    async def scenario():
        receiver = Receiver(world.frames, clock=world.clock, incident=lambda *what: None)
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
    monkeypatch.setattr("pep.perception.FIRST_FRAME_S", 0.2)
    assert ended(world, b"\n")
    assert ended(world, b"x\n")
    assert ended(world, world.text(sensor="camera-9") + b"\n")
    assert ended(world), "who says nothing makes room"
    assert not ended(world, world.text() + b"\n"), "a sensor stays"


def test_invented_names_are_one_incident(world):
    frames = [world.text(sensor=f"camera-{n}") + b"\n" for n in range(7, 12)]
    told = []

    async def scenario():
        receiver = Receiver(world.frames, clock=world.clock, incident=lambda *what: told.append(what))
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
        robot=robot,
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
        self.honest = pep.world.assess
        monkeypatch.setattr(pep.world, "assess", self)

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


def test_summary_counts(world):
    sensor = Sensor(world.key, name="camera-1", calibration=CALIBRATION)
    tell(
        sensor,
        '{"people": [{"id": "bob", "x_m": 1.0, "y_m": 0.0}], "objects": [{"id": "glass", "kind": "fragile",'
        ' "shape": {"type": "sphere", "center_m": [0.4, 0.0, 0.1], "radius_m": 0.03}}]}',
    )
    world.clock.advance(10)
    assert isinstance(world.frames.admit(sensor.frame(captured_s=world.clock.wall_s()).encode()), Frame)
    summary = physics(world).summary()
    assert (summary["perception"], summary["people"], summary["objects"]) == ("fresh", 1, 1)


def tell(*sensors_and_line, at_s=0.0):
    *sensors, line = sensors_and_line
    obey(sensors, line if isinstance(line, str) else json.dumps(line), at_s=at_s)


def sees(sensor, at_s=0.0):
    """What the sensor's next frame shows: places of people, places of objects, complete."""
    seen = observation.open(sensor.frame(captured_s=at_s), frozenset({sensor.raw}), CAPS)
    torsos = {p.id: dict(p.regions)["torso"].a_um[:2] for p in seen.people}
    things = {o.id: getattr(o.shape, "center_um", None) or o.shape.a_um for o in seen.objects}
    return torsos, things, seen.complete


@pytest.fixture
def sensor():
    key = keys.generate()
    made = Sensor(key, name="camera-1", calibration=CALIBRATION)
    made.raw = keys.public_raw(key)
    tell(made, {"people": [{"id": "bob", "x_m": 1.0, "y_m": 0.0}], "objects": [GLASS, BOX]})
    return made


GLASS = {
    "id": "glass",
    "kind": "fragile",
    "shape": {"type": "capsule", "a_m": [0.4, 0, 0], "b_m": [0.4, 0, 0.1], "radius_m": 0.03},
}
BOX = {
    "id": "part",
    "kind": "rigid",
    "shape": {"type": "box", "center_m": [0.3, 0.1, 0.02], "half_m": [0.02, 0.02, 0.02]},
}
BEFORE = ({"bob": (1_000_000, 0)}, {"glass": (400_000, 0, 0), "part": (300_000, 100_000, 20_000)}, True)


@pytest.mark.parametrize(
    "line",
    [
        "",
        "[]",
        "{}",
        "{",
        "1",
        "[" * 100_000,
        '{"people": [{}]}',
        '{"people": [{"x_m": NaN, "y_m": 0}]}',
        '{"people": [{"x_m": 1e999, "y_m": 0}]}',
        '{"people": [{"x_m": true, "y_m": 0}]}',
        '{"people": [{"x_m": 1, "y_m": 0}, {"x_m": 2, "y_m": 0}]}',
        '{"people": [{"x_m": 1, "y_m": 0, "z_m": 0}]}',
        '{"objects": [{"kind": "fragile"}]}',
        '{"objects": [{"kind": "soft", "shape": {"type": "sphere", "center_m": [0, 0, 0], "radius_m": 1}}]}',
        '{"objects": [{"kind": "rigid", "shape": {"type": "sphere", "center_m": [0, 0], "radius_m": 1}}]}',
        '{"objects": [{"kind": "rigid", "shape": {"type": "sphere", "center_m": [0, 0, 0], "radius_m": 0}}]}',
        '{"people": 1}',
        '{"people": [], "pause": true}',
        '{"pause": 1}',
        '{"complete": null}',
        '{"dance": {"id": "bob"}}',
        '{"walk": {"id": "bob", "to": [1, 1], "speed_m_s": 0}}',
        '{"walk": {"id": "bob", "to": [1, 1], "speed_m_s": -1}}',
        '{"walk": {"id": "bob", "to": [1, 1, 1], "speed_m_s": 1}}',
        '{"walk": {"id": "bob", "to": [1, 1]}}',
        '{"walk": {"id": "carol", "to": [1, 1], "speed_m_s": 1}}',
        '{"walk": {"id": "bob", "to": [1, 1], "speed_m_s": 1, "how": "fast"}}',
        '{"move": {"id": "vase", "to_m": [1, 1, 1], "speed_m_s": 1}}',
        '{"move": {"id": "glass", "to_m": [1, 1], "speed_m_s": 1}}',
        '{"hold": {"id": "vase"}}',
        '{"hold": "glass"}',
        '{"place": {"id": "glass"}}',
        '{"sensor": "camera-9", "people": []}',
        '{"sensor": ["camera-1"], "people": []}',
        '{"sensor": "camera-1"}',
    ],
)
def test_the_simulated_sensor_keeps_its_scene_when_a_command_is_none(sensor, line):
    with pytest.raises(SceneCommandError):
        tell(sensor, line)
    assert sees(sensor) == BEFORE


def test_people_walk_by_the_sensors_own_clock_and_stand_at_the_end(sensor):
    tell(sensor, {"walk": {"id": "bob", "from": [2, 0], "to": [1, 0], "speed_m_s": 0.5}}, at_s=90.0)
    assert [sees(sensor, t)[0]["bob"][0] for t in (100.0, 100.5, 101.0, 102.0, 200.0)] == [
        2_000_000, 1_750_000, 1_500_000, 1_000_000, 1_000_000,
    ]  # fmt: skip


def test_somebody_who_is_there_walks_on_from_where_they_are(sensor):
    tell(sensor, {"walk": {"id": "bob", "to": [3, 0], "speed_m_s": 1}})
    assert sees(sensor, 10.0)[0] == {"bob": (1_000_000, 0)}
    assert sees(sensor, 11.0)[0] == {"bob": (2_000_000, 0)}
    tell(sensor, {"walk": {"id": "bob", "to": [2, 4], "speed_m_s": 2}}, at_s=11.0)
    assert sees(sensor, 11.0)[0] == {"bob": (2_000_000, 0)}
    assert sees(sensor, 12.0)[0] == {"bob": (2_000_000, 2_000_000)}


def test_two_people_walk_at_once_and_nobody_else_is_touched(sensor):
    tell(sensor, {"walk": {"id": "carol", "from": [0, 2], "to": [0, 1], "speed_m_s": 1}})
    tell(sensor, {"walk": {"id": "dan", "from": [0, 4], "to": [0, 1], "speed_m_s": 1}})
    sees(sensor, 10.0)
    assert sees(sensor, 10.5)[0] == {"bob": (1_000_000, 0), "carol": (0, 1_500_000), "dan": (0, 3_500_000)}


def test_objects_move_are_held_and_are_placed(sensor):
    tell(sensor, {"move": {"id": "part", "to_m": [0.3, 0.1, 0.22], "speed_m_s": 0.1}})
    sees(sensor, 10.0)
    assert sees(sensor, 11.0)[1]["part"] == (300_000, 100_000, 120_000)
    tell(sensor, {"hold": {"id": "part"}}, at_s=11.0)
    assert sees(sensor, 11.0)[1] == {"glass": (400_000, 0, 0)}
    tell(sensor, {"place": {"id": "part", "at_m": [0.0, 0.4, 0.02]}}, at_s=12.0)
    assert sees(sensor, 12.0)[1] == {"glass": (400_000, 0, 0), "part": (0, 400_000, 20_000)}
    tell(sensor, {"place": {"id": "glass", "at_m": [0.5, 0, 0.05]}}, at_s=12.0)
    assert sees(sensor, 99.0)[1]["glass"] == (500_000, 0, 0), "its middle is where it was told, its lower end below"


def test_a_sensor_may_say_that_it_does_not_see_everything(sensor):
    tell(sensor, {"complete": False})
    assert sees(sensor)[2] is False


def test_a_command_is_for_every_sensor_or_for_the_one_that_it_names(sensor):
    other = Sensor(keys.generate(), name="camera-2", calibration=CALIBRATION)
    tell(sensor, other, {"people": []})
    tell(sensor, other, {"sensor": "camera-2", "walk": {"id": "x", "from": [1, 0], "to": [1, 0], "speed_m_s": 1}})
    assert (set(sensor.seen.people), set(other.seen.people)) == (set(), {"x"})
    with pytest.raises(SceneCommandError):
        tell(sensor, other, {"walk": {"id": "x", "to": [0, 0], "speed_m_s": 1}})
    assert sensor.seen.people == {}, "one of them could not, so none did"


def test_the_simulated_sensor_makes_nobody_thinner(sensor):
    tell(sensor, {"people": [{"id": "bob", "x_m": 1.0000004, "y_m": 0.3, "facing_rad": 0.5}]})
    text = sensor.frame(captured_s=1.0)
    seen = observation.open(text, frozenset({sensor.raw}), CAPS)
    assert seen.people == (observed(standing_adult(1.0000004, 0.3, facing_rad=0.5, name="bob")),)


@pytest.mark.e2e
def test_two_simulated_sensors_in_one_process_push_what_they_see(tmp_path):
    """A real process, two keys, two connections; a walk that the frames show, one sensor that is told to be silent."""
    from pep.clock import SystemClock

    registry, clock, arguments = Registry(), SystemClock(), []
    for name in ("camera-1", "camera-2"):
        key = registry.add_sensor(name)
        path = tmp_path / f"{name}.key"
        path.write_bytes(keys.to_pem(key, b"secret words"))
        path.chmod(0o600)
        arguments += ["--sensor", name, "--key-file", str(path), "--calibration", CALIBRATION]
    frames = Frames(sensors=registry, named=frozenset(registry.known), clock=clock, caps=CAPS)
    told = []

    async def scenario():
        receiver = Receiver(frames, clock=clock, incident=lambda *what: told.append(what))
        port = await receiver.listen("127.0.0.1", 0)
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "pep.sim.sensor", *arguments, "--to", f"127.0.0.1:{port}",
            env={**os.environ, "ZTPM_PASSPHRASE": "secret words"}, stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
        )  # fmt: skip

        async def until(what):
            async with asyncio.timeout(30):
                while not what():
                    await asyncio.sleep(0.01)

        def y(name):
            view = frames.view()
            shown = [f for f in getattr(view, "frames", ()) if f.observation.sensor == name and f.observation.people]
            return dict(shown[0].observation.people[0].regions)["torso"].a_um[1] if shown else None

        async def say(command):
            process.stdin.write(json.dumps(command).encode() + b"\n")
            await process.stdin.drain()

        try:
            await until(lambda: isinstance(frames.view(), Seen) and frames.view().complete)
            await say({"walk": {"id": "bob", "from": [1, 1], "to": [1, 0], "speed_m_s": 1.0}})
            await until(lambda: y("camera-1") and 0 < y("camera-1") < 900_000)
            await until(lambda: (y("camera-1"), y("camera-2")) == (0, 0))
            await say({"sensor": "camera-2", "pause": True})
            await until(lambda: states_of(frames) == {"camera-1": "fresh", "camera-2": "stale"})
            assert process.returncode is None
        finally:
            process.terminate()
            await process.wait()
            await receiver.close()

    asyncio.run(scenario())
    assert [what for what in told if what[1] != "CONTRADICTED"] == []


def states_of(frames):
    look = frames.look()
    return {s.sensor: s.state for s in look.reading(now_ms=look.taken_ms, limit_ms=500).sensors}


@pytest.mark.parametrize("options", [["--hz", "0"], ["--hz", "nan"], ["--to", "nowhere"], ["--sensor", "two"]])
def test_the_simulated_sensor_refuses_options_that_make_no_sense(tmp_path, options):
    given = ["--sensor", "s", "--calibration", "ab" * 32, "--key-file", "k", "--to", "127.0.0.1:9", *options]
    ended = subprocess.run(
        [sys.executable, "-m", "pep.sim.sensor", *given], input="", capture_output=True, text=True, timeout=60
    )
    assert (ended.returncode, ended.stdout) == (2, "")


def test_the_simulated_sensor_refuses_a_key_that_others_can_read(tmp_path):
    path = tmp_path / "sensor.key"
    path.write_bytes(keys.to_pem(keys.generate(), b"secret words"))
    path.chmod(0o644)
    ended = subprocess.run(
        [sys.executable, "-m", "pep.sim.sensor", "--key-file", str(path), "--sensor", "s", "--calibration", "ab" * 32,
         "--to", "127.0.0.1:9"],
        env={**os.environ, "ZTPM_PASSPHRASE": "secret words"}, input="", capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert (ended.returncode, ended.stdout) == (1, "")
    assert "CONFIG_INVALID" in ended.stderr
