"""The simulated sensors do what they are told, by their own clock, and nothing else."""

import asyncio
import json
import os
import subprocess
import sys

import pytest
from capabilities.statements.observation import Convex
from capabilities.values.caps import DEFAULT as CAPS
from pep.perception.receiver import FrameReceiver
from pep.perception.sensor_frames import Frames, Seen
from tests.pep.kit import CALIBRATION, Registry
from ursim.sensor.sensor import Sensor, obey
from ursim.sensor.sensor_scene import SceneCommandError

from capabilities.keys import keys
from capabilities.statements import observation
from pep.pit import observed, standing_adult

pytestmark = pytest.mark.long


def tell(*sensors_and_line, at_s=0.0):
    *sensors, line = sensors_and_line
    obey(sensors, line if isinstance(line, str) else json.dumps(line), at_s=at_s)


def sees(sensor, at_s=0.0):
    """Places of people, places of objects, and completeness in the sensor's next frame."""
    seen = observation.open(sensor.frame(captured_s=at_s), frozenset({sensor.raw}), CAPS)
    torsos = {p.id: dict(p.regions)["torso"].a_um[:2] for p in seen.people}
    things = {o.id: getattr(o.shape, "center_um", None) or o.shape.a_um for o in seen.objects}
    return torsos, things, seen.complete


def shape_of(sensor, name, at_s=0.0):
    seen = observation.open(sensor.frame(captured_s=at_s), frozenset({sensor.raw}), CAPS)
    return next(each.shape for each in seen.objects if each.id == name)


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


def test_a_convex_object_is_seen_where_it_moves(sensor):
    corners = [[0.4, 0, 0], [0.5, 0, 0], [0.4, 0.1, 0], [0.4, 0, 0.1]]
    shape = {"type": "convex", "vertices_m": corners, "radius_m": 0.01}
    tell(sensor, {"objects": [{"id": "wedge", "kind": "rigid", "shape": shape}]})
    seen = shape_of(sensor, "wedge")
    assert seen == Convex(((400_000, 0, 0), (500_000, 0, 0), (400_000, 100_000, 0), (400_000, 0, 100_000)), 10_000)
    tell(sensor, {"move": {"id": "wedge", "to_m": [0.425, 0.025, 1.025], "speed_m_s": 100}}, at_s=100.0)
    shape_of(sensor, "wedge", 100.0)
    assert shape_of(sensor, "wedge", 200.0).vertices_um == tuple((x, y, z + 1_000_000) for x, y, z in seen.vertices_um)
    for wrong in ({"vertices_m": [[0, 0]]}, {"vertices_m": []}, {"vertices_m": corners, "radius_m": -1}):
        line = json.dumps({"objects": [{"kind": "rigid", "shape": {"type": "convex", **wrong}}]})
        with pytest.raises(SceneCommandError):
            tell(sensor, line)


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
    """A real process with two keys and two connections shows a walk, and falls silent on command."""
    from pep.base.clock import SystemClock

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
        receiver = FrameReceiver(frames, clock=clock, incident=lambda *what: told.append(what))
        port = await receiver.listen("127.0.0.1", 0)
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "ursim.sensor.sensor", *arguments, "--to", f"127.0.0.1:{port}",
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
        [sys.executable, "-m", "ursim.sensor.sensor", *given], input="", capture_output=True, text=True, timeout=60
    )
    assert (ended.returncode, ended.stdout) == (2, "")


def test_the_simulated_sensor_refuses_a_key_that_others_can_read(tmp_path):
    path = tmp_path / "sensor.key"
    path.write_bytes(keys.to_pem(keys.generate(), b"secret words"))
    path.chmod(0o644)
    ended = subprocess.run(
        [sys.executable, "-m", "ursim.sensor.sensor", "--key-file", str(path), "--sensor", "s", "--calibration", "ab" * 32,
         "--to", "127.0.0.1:9"],
        env={**os.environ, "ZTPM_PASSPHRASE": "secret words"}, input="", capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert (ended.returncode, ended.stdout) == (2, "")
    assert "CONFIG_INVALID" in ended.stderr
