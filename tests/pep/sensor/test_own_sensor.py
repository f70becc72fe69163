"""A sensor of one's own over a real socket, from threads and coroutines: each frame whole, or not at all."""

import asyncio
import hashlib
import os
import subprocess
import sys
import time
from contextlib import asynccontextmanager

import pytest
from capabilities.statements.observation import ObservedFact
from capabilities.values.caps import DEFAULT as CAPS
from pep.base.clock import SystemClock
from pep.base.errors import ConfigError
from pep.base.ports import RegisteredSensor
from pep.perception.receiver import FrameReceiver
from pep.perception.sensor_frames import Frames, Seen
from tests.pep.kit import CALIBRATION

from capabilities.keys import keys
from pep.sensor import Sensor, SensorError, PersonSight, ball, box, rod, person_at, thing

KEY = keys.generate()
PASSPHRASE = "a passphrase for tests"


class Hearing:
    """A perception point, as a gateway has it."""

    def __init__(self, calibration=CALIBRATION):
        registered = RegisteredSensor("camera-1", keys.public_raw(KEY), calibration, 20)
        self.incidents = []
        self.frames = Frames(
            sensors=type("Known", (), {"sensors": lambda _: {"camera-1": registered}})(),
            named=frozenset({"camera-1"}),
            clock=SystemClock(),
            caps=CAPS,
        )
        self.receiver = FrameReceiver(
            self.frames, clock=SystemClock(), incident=lambda *what: self.incidents.append(what)
        )

    async def heard(self, sequence):
        """The frame of that number, once it is the newest."""
        async with asyncio.timeout(10):
            while True:
                view = self.frames.view()
                if isinstance(view, Seen) and view.frames[0].observation.sequence >= sequence:
                    return view.frames[0].observation
                assert not self.incidents, self.incidents
                await asyncio.sleep(0.002)


@asynccontextmanager
async def hearing(**options):
    point = Hearing(**options)
    port = await point.receiver.listen("127.0.0.1", 0)
    try:
        yield point, f"127.0.0.1:{port}"
    finally:
        await point.receiver.close()


def made(gateway, **options):
    return Sensor(KEY, gateway, calibration=CALIBRATION, name="camera-1", **options)


def at(x_m, name=""):
    return person_at(x_m, 0.0, floor_z_m=-0.8, name=name)


def test_a_coroutine_sees_and_the_point_believes_it():
    async def scenario():
        async with hearing() as (point, place), made(place) as sensor:
            cup = thing("cup-1", "fragile", rod((0.4, 0, 0), (0.4, 0, 0.1), 0.03))
            shown = sensor.see([at(1.0)], [cup], facts=[ObservedFact("people", "count", 1)])
            frame = await point.heard(shown.sequence)
            assert (
                shown.gateways == 1 and shown.people == ("person-1",) and shown.unseen == {"person-1": ("body parts",)}
            )
            assert [one.id for one in frame.people] == ["person-1"] and frame.complete
            assert frame.objects == (cup,) and frame.facts[0].value == 1
            for _ in range(20):
                shown = sensor.see([at(1.0)])
                await asyncio.sleep(0.01)
            assert shown.rate_hz < 101 and not (await point.heard(shown.sequence)).objects
            # who was there a moment ago is told on, and who comes is another one
            shown = sensor.see([at(3.0)])
            assert shown.people == ("person-2", "person-1")
            later = {one.id: one.age_ms for one in (await point.heard(shown.sequence)).people}
            assert later["person-2"] == 0 < later["person-1"] <= 400

    asyncio.run(scenario())


def test_a_thread_sees_with_or_without_a_with():
    async def scenario():
        async with hearing() as (point, place), hearing() as (other, second):

            def look():
                with made([place, second]) as sensor:
                    return sensor.see([at(1.0)])

            shown = await asyncio.to_thread(look)
            assert shown.gateways == 2
            await point.heard(1)
            await other.heard(1)
        async with hearing() as (point, place):
            sensor = made(place)
            shown = await asyncio.to_thread(sensor.see)
            assert shown.gateways == 1 and (await point.heard(1)).people == ()
            await asyncio.to_thread(sensor.close)
            await asyncio.to_thread(sensor.close)

    asyncio.run(scenario())


def test_without_a_gateway_nothing_is_sent_and_it_is_connected_to_when_it_comes():
    async def scenario():
        async with hearing() as (_, place):
            pass
        async with made(place) as sensor:
            assert sensor.see().gateways == 0
            late = made(place)
            assert (await asyncio.to_thread(late.see)).age_ms < 1000, "the wait for a connection is no age"
            await asyncio.to_thread(late.close)
            point = Hearing()
            await point.receiver.listen(*place.rpartition(":")[::2])
            async with asyncio.timeout(10):
                while not (shown := sensor.see()).gateways:
                    await asyncio.sleep(0.02)
            await point.heard(shown.sequence)
            await point.receiver.close()

    asyncio.run(scenario())


def test_a_program_with_nothing_but_the_core_sees(tmp_path):
    """The key's file names the sensor, and neither gateway, physics nor a robot's interface is loaded."""
    document = tmp_path / "camera-1.pdf"
    document.write_bytes(b"measured on Monday")
    (tmp_path / "camera-1.key").write_bytes(keys.to_pem(KEY, PASSPHRASE.encode()))
    (tmp_path / "camera-1.key").chmod(0o600)
    program = (
        "import sys\nfrom ztpm import Sensor\nfrom pep.sensor import person_at\n"
        "with Sensor('camera-1.key', sys.argv[1], calibration='camera-1.pdf') as sensor:\n"
        "    print(sensor.see(people=[person_at(0.7, 0.0, floor_z_m=-0.8)]).gateways)\n"
        "print(sorted({'numpy', 'coal', 'pinocchio', 'numba', 'mcp', 'rtde_receive'} & set(sys.modules)))\n"
        "print([name for name in sys.modules if name.startswith(('pep.gate', 'pep.pit', 'pep.perception', 'ztpm_idp'))])\n"
    )

    async def scenario():
        async with hearing(calibration=hashlib.sha256(document.read_bytes()).hexdigest()) as (point, place):
            ran = await asyncio.to_thread(
                subprocess.run, [sys.executable, "-c", program, place], cwd=tmp_path, capture_output=True, text=True,
                timeout=60, env={**os.environ, "ZTPM_PASSPHRASE": PASSPHRASE, "PYTHONPATH": os.getcwd()},
            )  # fmt: skip
            assert ran.stdout.split("\n") == ["1", "[]", "[]", ""], ran.stderr
            assert (await point.heard(1)).people[0].regions[0][0] == "head"

    asyncio.run(scenario())


# --- people over time ------------------------------------------------------------------------------------------------


def people_of(*frames, keep_s=0.4):
    """(id, age in ms) of everybody in the last of these frames of (people, seconds since the first)."""
    sensor = made("127.0.0.1:1", keep_s=keep_s)
    began = time.time() - 0.9
    followed = sensor._people
    for sights, after_s in frames:
        followed = followed.after(sights, at_s=began + after_s)
    return [(one.id, one.age_ms) for one in followed.told(at_s=began + frames[-1][1])]


def test_people_keep_their_ids_as_they_walk_past_each_other():
    # two walk apart by 2 m in y, towards each other in x at 1.5 m/s, and change their order in the list
    def two(step):
        one = PersonSight((("head", ball((1.0 + 0.05 * step, 1.0, 0.7), 0.2)),))
        other = PersonSight((("head", ball((2.0 - 0.05 * step, -1.0, 0.7), 0.2)),))
        return [one, other] if step % 2 else [other, one]

    sensor = made("127.0.0.1:1")
    followed, places = sensor._people, {}
    for step in range(20):
        followed = followed.after(two(step), at_s=step / 30)
        for one in followed.told(at_s=step / 30):
            places.setdefault(one.id, []).append(one.regions[0][1].center_um[1])
    assert {name: set(found) for name, found in places.items()} == {
        "person-1": {-1_000_000},
        "person-2": {1_000_000},
    }


def test_somebody_whom_a_frame_loses_is_told_on_with_their_age_for_a_while():
    assert people_of(([at(1.0)], 0.0), ([], 0.2)) == [("person-1", 200)]
    assert people_of(([at(1.0)], 0.0), ([], 0.2), ([at(1.2)], 0.3)) == [("person-1", 0)]
    assert people_of(([at(1.0)], 0.0), ([], 0.2), ([], 0.41)) == []
    assert people_of(([at(1.0)], 0.0), ([], 0.2), keep_s=0) == []
    assert people_of(([at(1.0, "bob")], 0.0), ([at(1.0, "carol")], 0.1)) == [("carol", 0), ("bob", 100)]


def test_a_stranger_gets_another_id():
    assert people_of(([at(1.0)], 0.0), ([at(1.0), at(3.0)], 0.03)) == [("person-1", 0), ("person-2", 0)]
    assert people_of(([at(1.0, "person-1")], 0.0), ([at(3.0)], 0.03))[0] == ("person-2", 0)


# --- what is refused -------------------------------------------------------------------------------------------------

MANY = [at(0.9 * number, f"p{number}") for number in range(33)]
LARGE = [PersonSight((("head", ball((1, 0, 0), 0.1)),) * 64, f"p{number}") for number in range(20)]


@pytest.mark.parametrize(
    ("seen", "code"),
    [
        ({"people": [at(1.0, "bob"), at(2.0, "bob")]}, "SIGHT_MALFORMED"),
        ({"people": [at(1.0, "not a name")]}, "SIGHT_MALFORMED"),
        ({"people": MANY}, "TOO_LARGE"),
        ({"people": LARGE}, "TOO_LARGE"),
        ({"objects": [thing(f"o{n}", "rigid", box((1, 0, 0), (0.1,) * 3)) for n in range(129)]}, "SIGHT_MALFORMED"),
        ({"objects": [thing("o", "rigid", box((1, 0, 0), (0.1,) * 3))] * 2}, "SIGHT_MALFORMED"),
        ({"captured_s": 1_700_000_000}, "OUT_OF_TIME"),
        ({"captured_s": time.time() + 3600}, "OUT_OF_TIME"),
        ({"captured_s": time.time() * 1000}, "OUT_OF_TIME"),
        ({"captured_s": float("nan")}, "NOT_FINITE"),
    ],
)
def test_a_refused_frame_is_not_sent_and_leaves_everything_as_it_was(seen, code):
    async def scenario():
        async with hearing() as (point, place), made(place) as sensor:
            first = sensor.see([at(1.0)])
            with pytest.raises(SensorError) as refused:
                sensor.see(**seen)
            assert refused.value.code == code and refused.value.step
            assert sensor.see([at(1.0)]).sequence == first.sequence + 1
            assert [one.id for one in (await point.heard(2)).people] == ["person-1"]

    asyncio.run(scenario())


def test_frames_out_of_order_are_refused():
    sensor = made("127.0.0.1:1")
    sensor._lines = type("Nowhere", (), {"send": lambda *_: 0})()
    now = time.time()
    sensor.see(captured_s=now)
    with pytest.raises(SensorError) as refused:
        sensor.see(captured_s=now - 0.1)
    assert refused.value.code == "NOT_NEWER"


@pytest.mark.parametrize(
    "build",
    [
        lambda: ball((0, 0, 0), 0),
        lambda: ball((0, 0), 0.1),
        lambda: rod((0, 0, 0), (0, 0, True), 0.1),
        lambda: thing("cup", "soft", ball((0, 0, 0), 0.1)),
        lambda: PersonSight((("nose", ball((0, 0, 0), 0.1)),)),
        lambda: PersonSight((("head", box((0, 0, 0), (1, 1, 1))),)),
        lambda: PersonSight(()),
        lambda: PersonSight((("head", ball((0, 0, 0), 0.1)),), age_s=-1),
    ],
)
def test_a_sight_that_is_none_is_refused(build):
    with pytest.raises(SensorError) as refused:
        build()
    assert refused.value.code == "SIGHT_MALFORMED"


@pytest.mark.parametrize(
    "options",
    [
        {"gateway": "10.0.5.20"},
        {"gateway": "10.0.5.20:70000"},
        {"gateway": []},
        {"name": ""},
        {"calibration": "nowhere.pdf"},
        {"key": "nowhere.key"},
    ],
)
def test_a_sensor_that_cannot_be_set_up_says_which_argument(options):
    given = {"key": KEY, "gateway": "127.0.0.1:1", "calibration": CALIBRATION, "name": "camera-1", **options}
    with pytest.raises(ConfigError) as refused:
        Sensor(given.pop("key"), given.pop("gateway"), **given)
    assert (
        refused.value.code == "CONFIG_INVALID"
        and next(iter(options)) in refused.value.detail
        or "ZTPM_PASSPHRASE" in refused.value.detail
    )
