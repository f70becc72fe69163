"""The cell as it is now, told as the watch has it; no arm where the controller is silent."""

from types import SimpleNamespace

import pytest
from pep.perception.sensor_frames import Unseen
from pep.pit.picture.postures import posture_at
from tests.pep.pit.scenes import CELL, HOME, ROBOT, sweep
from ztpm.point.live_report import OLD_MS, WAY_STEPS, LiveReport

from pep.pit import SpeedJ

pytestmark = pytest.mark.clause("LIV-3")


class Gateway:
    """Parts that a report is made of."""

    def __init__(self):
        self.now_ms, self.motion, self.permit = 10_000, sweep(), None
        self.state = SimpleNamespace(q_rad=HOME, still=True)
        point = SimpleNamespace(
            holding=SimpleNamespace(robot=ROBOT),
            cell=CELL,
            frames=SimpleNamespace(view=Unseen),
            state=SimpleNamespace(newest=lambda: SimpleNamespace(state=self.state, arrived_ms=10_000)),
            physics=SimpleNamespace(motion_of=lambda _: self.motion),
            clock=SimpleNamespace(monotonic_ms=lambda: self.now_ms),
        )
        self.report = LiveReport(point, lambda: self.permit)


def test_the_arm_is_where_its_joints_say_and_is_none_once_the_controller_is_silent():
    gateway = Gateway()
    now = gateway.report.now()
    expected = posture_at(ROBOT, HOME)
    assert now["arm"]["tcp"] == pytest.approx(expected.tcp_m, abs=1e-5)
    assert (now["arm"]["moving"], now["bodies"], now["motion"]) == (False, [], "")
    assert len(now["arm"]["ends"]) == len(gateway.report.standing()["parts"])
    gateway.now_ms += OLD_MS
    assert gateway.report.now()["arm"] is not None
    gateway.now_ms += 1
    assert gateway.report.now()["arm"] is None
    gateway.now_ms, gateway.state = 10_000, None
    assert gateway.report.now()["arm"] is None


def test_the_way_of_a_motion_is_told_where_all_of_it_is_known_before():
    gateway = Gateway()
    assert gateway.report.way() == {"motion": "", "postures": []}
    gateway.permit = SimpleNamespace(request_id="m1")
    told = gateway.report.way()
    assert (told["motion"], len(told["postures"])) == ("m1", WAY_STEPS)
    assert told["postures"][-1]["tcp"] == pytest.approx(posture_at(ROBOT, sweep().target).tcp_m, abs=1e-4)
    for motion in (None, SpeedJ(HOME, (0.1, 0, 0, 0, 0, 0), 1.0, 0.1)):
        gateway.motion = motion
        assert gateway.report.way() == {"motion": "m1", "postures": []}
