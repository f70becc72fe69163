"""Arm that a force or a hand leads, under an unmodified ur_rtde program in a whole cell: asked, bounded, stopped."""

import contextlib
import os
import signal
import textwrap
import threading
import time

import numpy as np
import pytest
from capabilities.values.scope import Grant, Limit, Range
from pep.base.operations import FORCE_MODE, FREEDRIVE, MOVE_LINEAR, SET_FORCE_DAMPING
from pep.pit.robot.inverse_kinematics import solved, stance
from pep.rtde.command.limits import widest
from tests.e2e.test_gateway import House, Run
from tests.pep.pit.scenes import ROBOT
from ztpm.stage.scene import front, person
from ztpm.stage.samples import StateRecorder
from ztpm.stage.stage import LEFT, until

pytestmark = [
    pytest.mark.e2e, pytest.mark.campaign, pytest.mark.timeout(180), pytest.mark.clause("LSD-18", "LSD-19", "LSD-20"),
]  # fmt: skip

MM_S, NEWTON, MS, MM = 1_000, 1_000, 1, 1_000
TABLE_M = -0.01
FINGERS_M = 0.0135
"""Length by which closed fingers reach beyond the tool point."""
FORCE = """
def pressed(force=-10.0):
    return control.forceMode([0] * 6, [0, 0, 1, 0, 0, 0], [0, 0, force, 0, 0, 0], 2, [2, 2, 1.5, 1, 1, 1])

def waits(what, s=20.0):
    due = time.monotonic() + s
    while not what() and time.monotonic() < due:
        time.sleep(0.005)
    return what()

height = lambda: receive.getActualTCPPose()[2]
z = height()
"""


def bounded(operation, **ranges):
    """The robot's own limits, but for these."""
    limits = (Limit(each.parameter, ranges.get(each.parameter.name, each.bound)) for each in operation.limits)
    return Grant(operation.object, operation.name, tuple(limits))


PRESSING = bounded(
    FORCE_MODE,
    fz=Range(-20 * NEWTON, 20 * NEWTON),
    **{f"v{axis}": Range(0, 10 * MM_S) for axis in "xyz"},
    **{f"w{axis}": Range(0, 0) for axis in "xyz"},
    duration=Range(100 * MS, 20_000 * MS),
    distance=Range(1 * MM, 60 * MM),
)
LEADING = bounded(
    FREEDRIVE,
    tool_speed=Range(10 * MM_S, 150 * MM_S),
    joint_speed=Range(20_000, 150_000),
    duration=Range(100 * MS, 20_000 * MS),
    distance=Range(1 * MM, 200 * MM),
)


class LedHouse(House):
    """A cell with what a test does to its arm and its people."""

    def scene(self, *people):
        """The sensor sees these from now on."""
        self.cell.sensor.tell({"people": list(people), "objects": []})

    def robot(self, fault, **details):
        self.cell.robot.tell({"fault": fault, **details})


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    house = LedHouse(tmp_path_factory.mktemp("led"))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("tests.e2e.test_gateway.widest", lambda each: each if isinstance(each, Grant) else widest(each))
        house.agent("mover", MOVE_LINEAR, SET_FORCE_DAMPING, PRESSING, LEADING)
        briefly = house.agent
        house.agent = lambda name: briefly(name, PRESSING)
        yield house
    house.stage.close()
    house.cell.stop()


@pytest.fixture
def eyes(house):
    house.scene()
    house.robot("push", joints_rad_s=[0.0] * 6)
    eyes = StateRecorder(house.cell.addresses.host)
    yield eyes
    until(lambda: eyes.now().still, "standstill")
    eyes.close()


def led(house, text, holder="mover"):
    """A program that is led."""
    return Run(house, FORCE + textwrap.dedent(text), holder)


@contextlib.contextmanager
def approving(house):
    """A person who approves all that is asked; what was asked."""
    asked, over = [], threading.Event()

    def answer():
        alice = house.stage.operator_from_disk("alice")
        while not over.wait(0.05):
            for row in alice.approvals():
                if row["ask_id"] not in asked:
                    asked.append(row["ask_id"])
                    alice.approve(row["ask_id"])

    thread = threading.Thread(target=answer)
    thread.start()
    try:
        yield asked
    finally:
        over.set()
        thread.join()


def placed(house, eyes, height_m):
    """Puts the arm, its tool point at that height."""
    there = here = stance(ROBOT, np.array(LEFT))
    for z_m in np.linspace(here.position[2], height_m, 10):
        there = solved(ROBOT, (np.array((*here.position[:2], z_m)), here.rotation), there.q)
    house.robot("placed", joints_rad=there.q.tolist())
    until(
        lambda: max(abs(a - b) for a, b in zip(eyes.now().q_rad, there.q, strict=True)) < 1e-6, "the arm in its place"
    )


def test_a_tool_presses_on_the_table_as_hard_as_asked_and_no_faster_than_granted(house, eyes):
    placed(house, eyes, TABLE_M + FINGERS_M + 0.02)
    house.robot("surface", z_m=TABLE_M + FINGERS_M)
    with approving(house) as asked, led(house, """
        say(control.forceModeSetDamping(0.05))
        say(pressed())
        say(waits(lambda: receive.getActualTCPForce()[2] > 9.5), receive.getActualTCPForce()[2] < 10.5)
        say(control.moveJ(q, 0.3, 1.0))
        say(waits(control.forceModeStop, 2.0))
        say(receive.getActualTCPPose()[2] < z - 0.019)
        say(moves(control.moveJ, q, 0.1, 1.0))
    """) as run:  # fmt: skip
        status, said, errors = run.ended()
    assert (status, said) == (0, ["True", "True", "True True", "False", "True", "True", "True"]), (said, errors)
    assert len(asked) == 1
    assert "ztpm: LIMITS_LOWERED" in errors
    assert "vz=10000 um_s" in errors
    assert "ztpm: BUSY" in errors and "forceModeStop() first" in errors
    house.robot("no_surface")


def test_a_force_above_the_grant_is_refused_with_what_would_be_permitted_and_asks_nobody(house, eyes):
    with approving(house) as asked, led(house, """
        pressed(-60.0)
        say(waits(lambda: not control.isProgramRunning() or height() < z - 0.001, 1.0))
    """) as run:  # fmt: skip
        _, _, errors = run.ended()
    assert "ztpm: LIMIT_EXCEEDED_BY_REQUEST" in errors, errors
    assert "parameter=fz" in errors and "nearest_permitted=-20000" in errors
    assert asked == []
    assert eyes.now().still


def begun(house, eyes, run):
    """Waits until the tool goes down."""
    at = eyes.now().q_rad
    assert run.line() == "begins"
    until(lambda: max(abs(a - b) for a, b in zip(eyes.now().q_rad, at, strict=True)) > 5e-3, "the tool on its way")


def stands(eyes):
    t0 = time.monotonic()
    until(lambda: eyes.now().still, "standstill")
    return time.monotonic() - t0


GOES = """
pressed()
say("begins")
waits(lambda: False, 60.0)
"""


def test_a_revoked_token_stops_it(house, eyes):
    placed(house, eyes, 0.2)
    name = house.agent_to_revoke()
    with approving(house), led(house, GOES, name) as run:
        begun(house, eyes, run)
        house.stage.person("alice").revoke("hop", house.issued[name].hop_id, reason="test")
        assert stands(eyes) < 1.0
        until(lambda: house.endings()[-1:] == ["authority"], "the end on record")


def test_a_killed_program_leaves_a_standing_arm(house, eyes):
    placed(house, eyes, 0.2)
    with approving(house), led(house, "import os\nsay(os.getpid())\n" + GOES) as run:
        pid = int(run.line())
        begun(house, eyes, run)
        os.kill(pid, signal.SIGKILL)
        assert stands(eyes) < 1.0


def test_a_person_who_comes_near_stops_it(house, eyes):
    placed(house, eyes, 0.2)
    with approving(house), led(house, GOES) as run:
        begun(house, eyes, run)
        house.scene(person("person-1", *front(0.5)))
        assert stands(eyes) < 1.0
        until(lambda: house.journal("outcome")[-1]["result"].get("reason") == "IMPACT_ROSE", "the reason on record")


def test_a_hand_leads_the_arm_and_is_stopped_where_it_is_faster_than_granted(house, eyes):
    placed(house, eyes, 0.2)
    with approving(house) as asked, led(house, """
        say(control.freedriveMode())
        say(waits(lambda: abs(receive.getActualQ()[0] - q[0]) > 0.02))
        say(control.endFreedriveMode(), waits(control.isSteady, 1.0))
        say(control.teachMode())
        say("led")
        say(waits(lambda: not control.isProgramRunning(), 10.0))
        at = receive.getActualQ()
        say(waits(lambda: max(abs(v) for v in receive.getActualQd()) < 1e-3, 2.0))
    """) as run:  # fmt: skip
        assert run.line() == "True", run.ended()
        house.robot("push", joints_rad_s=[0.1, 0.0, 0.0, 0.0, 0.0, 0.1])
        assert [run.line(), run.line(), run.line(), run.line()] == ["True", "True True", "True", "led"]
        house.robot("push", joints_rad_s=[0.6, 0.0, 0.0, 0.0, 0.0, 0.0])
        status, said, errors = run.ended()
    assert (status, said) == (0, ["True", "True"]), errors
    assert "ztpm: LED_OUT_OF_BOUNDS" in errors, errors
    assert len(asked) == 2
    assert house.journal("outcome")[-1]["result"]["outcome"] == "stopped"
