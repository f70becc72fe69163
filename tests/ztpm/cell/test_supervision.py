"""Supervision: restarts and their number, and the effect of a scene file, with pretended children."""

import collections
import contextlib
import json
import threading

import pytest
from pep.base.errors import PepFault, RobotError
from ztpm.base.event_log import EventLog
from ztpm.base.processes import ChildError
from ztpm.cell.supervision import ChildLostError, SceneFile, Supervision

from ztpm.cell import supervision as module


class Pretended:
    def __init__(self, name):
        self.name, self.dead, self.output, self.told = name, threading.Event(), collections.deque(["last word"]), []
        self.popen = self
        self.returncode, self.pid = None, 1

    @property
    def alive(self):
        return not self.dead.is_set()

    def wait(self, timeout=None):
        self.dead.wait(timeout)
        return self.returncode

    def tell(self, command):
        if not self.alive:
            raise BrokenPipeError
        self.told.append(command)

    def die(self, status=-9):
        self.returncode = status
        self.dead.set()


class PretendedCell:
    """Keeps what was started, in order."""

    class addresses:
        controller_host = "127.77.0.12"

    def __init__(self, *, simulated=True):
        self.simulated = simulated
        self.children, self.did, self.failures = {"idp": Pretended("identity provider")}, [], collections.Counter()

    def start(self, name, options=()):
        self.end(name)
        self.did.append((name, *options))
        if self.failures[name]:
            self.failures[name] -= 1
            raise ChildError(name, "broken", [])
        self.children[name] = Pretended(name)

    def end(self, name):
        child = self.children.pop(name, None)
        if child is not None:
            child.die(0)

    def stop(self):
        for name in list(self.children):
            self.end(name)

    beside = contextlib.nullcontext
    start_idp = lambda self: self.start("idp")
    start_robot = lambda self: self.start("robot")
    start_sensor = lambda self, *options: self.start("sensor", options)
    start_gateway = lambda self, *options: self.start("gateway", options)
    start_tools = lambda self: self.start("tools")
    sensor = property(lambda self: self.children["sensor"])
    gateway = property(lambda self: self.children["gateway"])


class Ended(threading.Event):
    """Never waits; keeps for how long it was asked to."""

    def __init__(self):
        super().__init__()
        self.pauses = []

    def wait(self, timeout=None):
        self.pauses.append(timeout)
        return self.is_set()


@pytest.fixture
def log(tmp_path):
    return EventLog(tmp_path / "up.log", wall_s=lambda: 0.0, say=lambda told: None)


@pytest.fixture
def stops(monkeypatch):
    stopped = []
    monkeypatch.setattr(module, "stop_program", stopped.append)
    return stopped


class Kept:
    def __init__(self, tmp_path, log, **options):
        self.now, self.cell, self.ended = 0.0, PretendedCell(**options), Ended()
        self.path, self.log = tmp_path / "scene.json", tmp_path / "up.log"
        self.supervision = Supervision(
            self.cell, scene=SceneFile(self.path, log), log=log, ended=self.ended, clock=lambda: self.now
        )
        self.supervision.start()
        self.cell.did.clear()

    def events(self, name):
        return [e for e in map(json.loads, self.log.read_text().splitlines()) if e["event"] == name]


@pytest.fixture
def kept(tmp_path, log, stops):
    return Kept(tmp_path, log)


def test_a_sensor_is_started_as_often_as_it_dies(kept):
    for _ in range(50):
        kept.cell.sensor.die()
        kept.supervision.look()
    assert kept.cell.did == [("sensor", "--paused")] * 50
    assert kept.supervision.restarts["sensor"] == 50
    assert kept.ended.pauses[:6] == [0.5, 1, 2, 4, 8, 8] and max(kept.ended.pauses) == 8
    assert len(kept.events("died")) == len(kept.events("restarted")) == 50
    assert kept.events("died")[0]["lines"] == ["last word"]


@pytest.mark.parametrize(
    ("name", "did"),
    [
        ("idp", [("idp",)]),
        ("tools", [("tools",)]),
        ("gateway", [("gateway",)]),
        ("robot", [("robot",), ("gateway",)]),
    ],
)
def test_others_are_started_three_times_in_ten_minutes(kept, name, did):
    for _ in range(3):
        kept.cell.children[name].die()
        kept.supervision.look()
    assert kept.cell.did == did * 3
    kept.cell.children[name].die()
    with pytest.raises(ChildLostError) as raised:
        kept.supervision.look()
    assert (raised.value.name, raised.value.lines) == (name, ["last word"])
    assert kept.cell.did == did * 3


def test_deaths_are_forgotten_after_ten_minutes(kept):
    for _ in range(20):
        kept.cell.children["idp"].die()
        kept.supervision.look()
        kept.now += 201.0
    assert kept.supervision.restarts["idp"] == 20


def test_a_start_that_fails_counts_as_a_death(kept):
    kept.cell.failures["idp"] = 3
    kept.cell.children["idp"].die()
    with pytest.raises(ChildLostError):
        kept.supervision.look()
    assert kept.cell.did == [("idp",)] * 3
    assert len(kept.events("restart-failed")) == 3


def test_nothing_is_started_once_the_end_was_asked_for(kept):
    kept.cell.sensor.die()
    kept.ended.set()
    kept.supervision.look()
    kept.supervision.run()
    assert kept.cell.did == []


def test_the_arm_is_stopped_when_the_gateway_dies_and_not_when_it_ends(kept, stops):
    guard = kept.supervision._guard
    kept.cell.gateway.die(-9)
    guard.join(10)
    assert stops == ["127.77.0.12"]
    assert len(kept.events("arm-stopped")) == 1
    kept.supervision.look()
    kept.supervision.stop()
    kept.supervision._guard.join(10)
    assert stops == ["127.77.0.12"]
    assert kept.cell.children == {}


def test_a_controller_and_sensors_that_are_there_are_no_processes(tmp_path, log, stops):
    kept = Kept(tmp_path, log, simulated=False)
    assert set(kept.cell.children) == {"idp", "gateway", "tools"}
    kept.path.write_text('{"people": []}')
    kept.supervision.look()
    assert kept.cell.did == []
    guard = kept.supervision._guard
    kept.cell.gateway.die(-9)
    guard.join(10)
    assert stops == ["127.77.0.12"]
    kept.supervision.look()
    assert [each[0] for each in kept.cell.did] == ["gateway"]


def test_an_arm_that_cannot_be_stopped_is_on_record(kept, monkeypatch):
    def refuse(host):
        raise RobotError(PepFault.ROBOT_UNREACHABLE, "gone")

    monkeypatch.setattr(module, "stop_program", refuse)
    guard = kept.supervision._guard
    kept.cell.gateway.die(1)
    guard.join(10)
    assert len(kept.events("stop-failed")) == 1


PEOPLE = {"people": [{"id": "p1", "standing_adult": {"x_m": 1.0, "y_m": 0.0}}]}
PERSON = {"form": "ztpm-world/1", "frame": "base", "view": PEOPLE}
OLD_PERSON = {"people": [{"id": "p1", "x_m": 1.0, "y_m": 0.0}]}


@pytest.mark.parametrize("file", [PERSON, OLD_PERSON])
def test_a_sensor_sees_the_scene_before_it_sends_a_frame(kept, file):
    kept.path.write_text(json.dumps(file))
    kept.supervision.look()
    expected = [{**PEOPLE, "objects": []}, {"pause": False}]
    assert kept.cell.sensor.told[-2:] == expected
    kept.cell.sensor.die()
    kept.supervision.look()
    assert kept.cell.did == [("sensor", "--paused")]
    assert kept.cell.sensor.told == expected


def test_a_scene_file_that_goes_away_is_an_empty_scene(kept):
    kept.path.write_text(json.dumps(PERSON))
    kept.supervision.look()
    kept.path.unlink()
    kept.supervision.look()
    assert kept.cell.sensor.told[-2] == {"people": [], "objects": []}


@pytest.mark.parametrize("rubbish", ["", "{", "[]", "null", '{"pause": true}', "[" * 100_000, " " * 1_048_577, "\xff"])
def test_rubbish_leaves_the_scene_as_it_was(kept, rubbish):
    kept.path.write_text(json.dumps(PERSON))
    kept.supervision.look()
    before = list(kept.cell.sensor.told)
    kept.path.write_bytes(rubbish.encode("latin-1"))
    kept.supervision.look()
    kept.supervision.look()
    assert kept.cell.sensor.told == before
    assert len(kept.events("scene-refused")) == 1


def test_the_log_is_put_aside_when_it_is_long(tmp_path):
    path = tmp_path / "up.log"
    path.write_bytes(b"x" * 4_194_305)
    EventLog(path, wall_s=lambda: 0.0, say=print).note("up", "told", pid=1)
    assert json.loads(path.read_text()) == {
        "at": "1970-01-01T00:00:00.000+00:00",
        "event": "up",
        "sentence": "told",
        "pid": 1,
    }
    assert (tmp_path / "up.log.1").stat().st_size == 4_194_305
