"""Two sensors of the arena's cell: acts attack the first alone, the second one shows the rest."""

import socket
import time
from contextlib import ExitStack, contextmanager
from types import SimpleNamespace

import pytest
from evaluation.redteam import run
from evaluation.redteam.acts.frame_tap import FrameTap
from evaluation.redteam.acts.perception import NOT_BELIEVED, Blinker, Frames, Silence, _believed
from evaluation.redteam.guarded import GuardedArena
from evaluation.redteam.parts import Came, Effect, Moment
from evaluation.redteam.playing import Setting
from ursim.sensor.sensor import Sensor
from ztpm.base.layout import Layout
from ztpm.cell.setup import SECOND_SENSOR_ID, SENSOR_CALIBRATION, SENSOR_ID
from ztpm.stage.stage import Stage, until

from capabilities.keys import keys

PERSON = {"id": "person-1", "x_m": 0.4, "y_m": 0.0}


class Told:
    """A cell whose sensors only note what they are told, and whose enforcement point counts their sights."""

    def __init__(self, tmp_path, *, second: bool) -> None:
        self.told: list[dict] = []
        self.seen: dict[str, tuple[int, int]] = {}
        layout = Layout(tmp_path)
        if second:
            layout.second_sensor_key.parent.mkdir()
            layout.second_sensor_key.touch()
        self.names = [SENSOR_ID, SECOND_SENSOR_ID][: 1 + second]
        self.layout, self.sensor = layout, SimpleNamespace(tell=self.tell)
        self.arena = GuardedArena(Stage(cell=self, people={}), eyes=None, tap=None)
        self.arena.stage.ask = lambda *_: SimpleNamespace(content={"world": self.world()})
        self.perception = "fresh"
        self.arena.stage.perception = lambda: self.perception

    def tell(self, command: dict) -> None:
        self.told.append(command)
        if "people" in command:
            for name in [command["sensor"]] if "sensor" in command else self.names:
                self.seen[name] = len(command["people"]), len(command["objects"])

    def world(self) -> dict:
        people, objects = (sum(counts) for counts in zip(*self.seen.values(), strict=True))
        return {"perception": self.perception, "people": people, "objects": objects}


def test_what_the_first_sensor_does_not_see_the_second_one_shows(tmp_path) -> None:
    two = Told(tmp_path, second=True)
    two.arena.stage.scene()
    two.arena.show(Moment(people=[PERSON]))
    assert two.seen == {SENSOR_ID: (1, 0), SECOND_SENSOR_ID: (1, 0)}
    two.arena.show(Moment(seen=False, people=[PERSON, PERSON], objects=[]))
    assert two.seen == {SENSOR_ID: (1, 0), SECOND_SENSOR_ID: (2, 0)}
    walk = {"id": "person-1", "to": [0.0, 0.0], "speed_m_s": 1.0}
    two.arena.show(Moment(at_s=0.3, seen=False, walk=walk))
    two.arena.show(Moment(at_s=0.3, walk=walk))
    assert two.told[-2:] == [{"walk": walk, "sensor": SECOND_SENSOR_ID}, {"walk": walk}]


def test_a_sole_sensor_that_is_deceived_shows_nothing(tmp_path) -> None:
    one = Told(tmp_path, second=False)
    one.arena.show(Moment(seen=False, people=[PERSON]))
    one.arena.show(Moment(at_s=0.3, seen=False, people=[PERSON]))
    assert one.told == []
    one.arena.show(Moment(people=[PERSON]))
    assert one.seen == {SENSOR_ID: (1, 0)}


@pytest.mark.parametrize(
    ("act", "done", "undone"),
    [
        (Silence(by="stranger"), {"pause": True}, {"pause": False}),
        (Silence(by="stranger", for_s=0.01), {"pause": True}, {"pause": False}),
        (Blinker(by="stranger"), {"complete": False}, {"complete": True}),
    ],
)
def test_acts_attack_the_first_sensor_alone(tmp_path, act, done: dict, undone: dict) -> None:
    two = Told(tmp_path, second=True)
    two.perception = "fresh" if isinstance(act, Silence) else "missing"
    assert act.guarded(two.arena) == Came(Effect.DONE)
    two.perception = "fresh"
    two.arena.ends.close()
    assert two.told[0] == {**done, "sensor": SENSOR_ID}
    assert two.told[-1] == {**undone, "sensor": SENSOR_ID}
    assert {command.get("sensor") for command in two.told} == {SENSOR_ID}


def test_frames_are_done_only_where_no_other_sensor_says_more(tmp_path) -> None:
    two, empty = Told(tmp_path, second=True), Frames(by="stranger", wrong="nothing")
    odd = {"body": {"what": "perception", "fault": "CONTRADICTED"}}
    two.arena.stage.journal = lambda **_: [odd]
    two.seen = {SENSOR_ID: (0, 0), SECOND_SENSOR_ID: (0, 0)}
    assert _believed(two.arena, empty) == Came(Effect.DONE)
    two.seen[SECOND_SENSOR_ID] = (1, 0)
    assert _believed(two.arena, empty) == Came(Effect.DENIED, "e3", NOT_BELIEVED)
    two.arena.stage.journal = lambda **_: [odd, {"body": {"what": "perception", "fault": "UNTRUSTED"}}]
    assert _believed(two.arena, empty) == Came(Effect.DENIED, "e3", "UNTRUSTED")


def test_the_tap_keeps_the_frames_of_the_first_sensor_alone() -> None:
    begun: list[str] = []
    tap = FrameTap(SimpleNamespace(start_sensor=lambda *told: begun.extend(told)))
    first, second = (
        Sensor(keys.generate(), name=name, calibration=SENSOR_CALIBRATION) for name in (SENSOR_ID, SECOND_SENSOR_ID)
    )
    host, _, port = begun[1].rpartition(":")
    with ExitStack() as lines:
        lines.callback(tap.close)
        for sensor in (second, first):
            line = lines.enter_context(socket.create_connection((host, int(port))))
            frame = sensor.frame(captured_s=time.time())
            line.sendall(frame.encode() + b"\n")
            until(lambda: sensor is second or tap.newest() is not None, "a frame at the tap")
        assert tap.newest() == frame
        assert tap.earlier(0, 0) is None


@pytest.mark.parametrize(("mode", "second"), [("all", True), ("policy", True), ("tokens", False)])
def test_a_second_sensor_is_part_of_the_primitive_that_asks_for_it(monkeypatch, mode: str, second: bool) -> None:
    @contextmanager
    def opened(**given):
        yield given["second_sensor"]

    monkeypatch.setattr(run, "guarded_arena", opened)
    with run.arena(Setting(mode, approver=True)) as had:
        assert had is second
