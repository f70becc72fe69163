"""Unmodified ur_rtde in a lease: it works when the judge permits, and the arm stands when not."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import textwrap
import time

import pytest
from pep.base.stop_model import STOP_DELAY_S
from pep.rtde.robot.connections import DASHBOARD, PRIMARY, REALTIME, SECONDARY
from pep.rtde.robot.dashboard import stop_program
from pep.rtde.robot.state_receiver import STILL_RAD_S
from tests.pep.rtde.packages import received
from tests.pep.rtde.leased_gateway import LATER_S, leased_gateway
from tests.pep.rtde.raw_program import Raw
from tests.ursim.cell import HOME, let_go, until, upload
from ursim.ports.launch import SimulatedController

rtde_control = pytest.importorskip("rtde_control", reason="ur_rtde is not installed")
rtde_io = pytest.importorskip("rtde_io", reason="ur_rtde is not installed")
rtde_receive = pytest.importorskip("rtde_receive", reason="ur_rtde is not installed")

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(120), pytest.mark.clause("RTDE-11", "RTDE-12", "RTDE-13", "RTDE-14")]

AWAY = (0.4, *HOME[1:])
POSE = (-0.25, -0.13, 0.35, 0.0, 3.1, 0.0)
X = (0.02, 0.0, 0.0, 0.0, 0.0, 0.0)
JOINTS = (0.1, 0.0, 0.0, 0.0, 0.0, 0.0)
ZERO = (0.0,) * 6
FREE = (1,) * 6
CYCLE_S = 0.002


class Here:
    """A gateway before a controller, with eyes of our own on the arm."""

    def __init__(self, controller, gateway, state):
        self.controller, self.gateway, self._state = controller, gateway, state
        self._kept = None

    def kept(self):
        """A control connection that stays for the next test, if that wants it too."""
        if self._kept is None or not self._kept.isProgramRunning():
            self.let_go()
            self._kept = self.control()
        return self._kept

    def let_go(self):
        kept, self._kept = self._kept, None
        if kept is not None:
            let_go(kept)

    @property
    def now(self):
        return self._state.read()

    def control(self):
        return rtde_control.RTDEControlInterface(self.gateway.host)

    def moved(self, q, beyond=1e-4):
        return max(abs(a - b) for a, b in zip(self.now.q_rad, q, strict=True)) > beyond

    def speed(self):
        return max(map(abs, self.now.qd_rad_s))

    def still(self):
        return self.speed() < STILL_RAD_S

    def asked(self, since):
        return [line for line in self.gateway.heard()[since:] if line.startswith("asked")]


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    with (
        SimulatedController.start(joints=HOME) as controller,
        leased_gateway(controller.host, tmp_path_factory.mktemp("gateway") / "said") as gateway,
    ):
        state = received(controller.host)
        here = Here(controller, gateway, state)
        yield here
        here.let_go()
        state.close()


@contextlib.contextmanager
def program(here, manner="permit"):
    """A control connection; the arm is at home before it."""
    here.let_go()
    here.gateway.tell("permit")
    control = here.control()
    try:
        if here.moved(HOME):
            assert control.moveJ(HOME, 2.0, 5.0)
        here.gateway.tell(manner)
        yield control
    finally:
        here.gateway.tell("permit")
        let_go(control)
        until(here.still)


def at_home(here):
    """Brings the arm home, without a control connection; ur_rtde is not asked if it is there."""
    here.let_go()
    here.gateway.tell("permit")
    if here.moved(HOME):
        with program(here):
            pass


MOVES = [
    ("moveJ", (AWAY, 2.0, 5.0)),
    ("moveJ", (AWAY, 2.0, 5.0, True)),
    ("moveJ_IK", (POSE, 2.0, 5.0)),
    ("moveL", (POSE, 0.2, 1.0)),
    ("moveL_FK", (AWAY, 0.2, 1.0, True)),
    ("moveJ", ([[*AWAY, 2.0, 5.0, 0.0]],)),
    ("moveL", ([[*POSE, 0.2, 1.0, 0.0]], True)),
    ("speedJ", (JOINTS, 1.0, 0.0)),
    ("speedL", (X, 1.0, 0.0)),
    ("servoJ", (AWAY, 0.0, 0.0, 0.1, 0.2, 100.0)),
    ("servoL", (POSE, 0.0, 0.0, 0.1, 0.2, 100.0)),
    ("servoC", (POSE, 0.2, 1.0, 0.0)),
    ("jogStart", (X, 0, 0.5, ZERO)),
]
LETS_MOVE = [
    ("forceMode", (ZERO, (0, 0, 1, 0, 0, 0), (0.0, 0.0, 10.0, 0.0, 0.0, 0.0), 2, (0.1,) * 6)),
    ("teachMode", ()),
    ("freedriveMode", (FREE, ZERO)),
    ("moveUntilContact", (X, ZERO, 1.0)),
    ("directTorque", (ZERO,)),
    ("startContactDetection", (X,)),
    ("setTcp", (X,)),
    ("setPayload", (0.5, (0.0, 0.0, 0.05))),
    ("setTargetPayload", (0.5, (0.0, 0.0, 0.05), ZERO)),
    ("setGravity", ((0.0, 0.0, 9.82),)),
    ("zeroFtSensor", ()),
    ("forceModeSetDamping", (0.1,)),
    ("forceModeSetGainScaling", (0.1,)),
    ("ftRtdeInputEnable", (True, 0.1, (0.0,) * 3, (0.0,) * 3)),
    ("enableExternalFtSensor", (True, 0.1, (0.0,) * 3, (0.0,) * 3)),
]
AT_ONCE = {"speedJ", "speedL", "servoJ", "servoL", "servoC", "forceMode", "directTorque"}


def names(rows):
    return [f"{number}-{row[0]}" for number, row in enumerate(rows)]


@pytest.mark.parametrize(("name", "arguments"), MOVES + LETS_MOVE, ids=names(MOVES + LETS_MOVE))
def test_what_the_judge_refuses_does_not_happen_and_fails_at_once(here, name, arguments):
    here.gateway.tell("permit")
    control = here.kept()
    here.gateway.tell("refuse")
    begun, asked, where = time.monotonic(), len(here.gateway.heard()), here.now.q_rad
    answer = getattr(control, name)(*arguments)
    # For a path ur_rtde ends its script first and sends it again, with pauses of its own.
    assert time.monotonic() - begun < 1.5
    if name not in AT_ONCE:
        assert answer is False
    time.sleep(0.1)  # fifty cycles of the controller
    assert not here.moved(where)
    assert len(here.asked(asked)) == 1


@pytest.mark.parametrize(("name", "arguments"), MOVES, ids=names(MOVES))
def test_what_the_judge_permits_happens(here, name, arguments):
    with program(here) as control:
        asked = len(here.gateway.heard())
        assert getattr(control, name)(*arguments)
        until(lambda: here.moved(HOME))
        assert len(here.asked(asked)) == 1


READ_DEADLINE_S = 2.5
"""ur_rtde's: so long it waits for a word of its robot."""


def test_what_is_held_for_longer_than_ur_rtde_waits_for_a_word_is_carried_out(here):
    with program(here, "defer:2.7") as control:
        begun, resting = time.monotonic(), here.now.q_rad
        assert control.moveJ(AWAY, 1.0, 2.0)
        assert time.monotonic() - begun > 2.7 > READ_DEADLINE_S
        assert here.moved(resting, beyond=0.3)
        assert not here.moved(AWAY)


def hears_again(control):
    """Waits until ur_rtde takes commands after a refused one, which it does with the controller's next state."""
    while not control.isSteady():
        time.sleep(0.002)


def test_a_judge_that_breaks_has_refused(here):
    with program(here, "break") as control:
        where = here.now.q_rad
        assert not control.moveJ(AWAY, 1.0, 2.0)
        assert not here.moved(where)
        here.gateway.tell("permit")
        hears_again(control)
        assert control.moveJ(AWAY, 1.0, 2.0)


def test_a_refusal_leaves_nothing_behind(here):
    with program(here, "refuse") as control:
        for _ in range(3):
            assert not control.moveJ(AWAY, 1.0, 2.0)
        here.gateway.tell("permit")
        hears_again(control)
        assert control.moveJ(AWAY, 1.0, 2.0)


def test_questions_and_settings_of_a_program_are_answered(here):
    with program(here) as control:
        assert control.isSteady()
        assert control.getTCPOffset() == pytest.approx(ZERO)
        assert len(control.getInverseKinematics(POSE)) == 6
        assert control.setWatchdog(1.0)
        assert control.setPayload(0.5, (0.0, 0.0, 0.05))
        assert control.kickWatchdog()
        control.reuploadScript()
        until(control.isProgramRunning)
        assert control.moveJ(AWAY, 1.0, 2.0)


OWN = """
    import sys, time
    import rtde_control
    from ztpm.program.startup.patient_calls import make_patient
    make_patient(rtde_control, sys.argv[1])
    control = rtde_control.RTDEControlInterface(sys.argv[1])
    began = time.monotonic()
    sent = control.sendCustomScriptFunction("mine", "movej([0.4, -1.5708, 1.5708, -1.5708, -1.5708, 0.0], a=3, v=3)\\n")
    print(sent, time.monotonic() - began < 5, flush=True)  # a fifth of a second; it would wait for ten minutes
"""


@pytest.mark.clause("LSD-30")
def test_a_program_of_its_own_is_refused(here):
    at_home(here)
    where = here.now.q_rad
    command = [sys.executable, "-c", textwrap.dedent(OWN), here.gateway.host]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=20)
    assert ended.stdout.split() == ["False", "True"], ended.stderr
    assert not here.moved(where)


def test_a_stream_of_500_hz_is_served(here):
    with program(here) as control:
        seen = rtde_receive.RTDEReceiveInterface(here.gateway.host, 500.0, ["timestamp", "target_q"])
        q, sent, begun, first = list(HOME), 0, time.monotonic(), seen.getTimestamp()
        for _ in range(750):
            start = control.initPeriod()
            q[0] += 0.0003
            sent += control.servoJ(q, 0.0, 0.0, 0.002, 0.05, 500.0)
            control.waitPeriod(start)
        lasted = time.monotonic() - begun
        assert sent == 750
        assert abs(seen.getTargetQ()[0] - q[0]) < 0.06
        control.servoStop()
        assert seen.getTimestamp() - first == pytest.approx(lasted, abs=1.0)
        let_go(seen)


def test_a_stream_that_is_no_longer_permitted_is_stopped(here):
    with program(here, "steps:50") as control:
        speeds = [[0.2 + i * 1e-4, *ZERO[1:]] for i in range(500)]
        sent = 0
        for qd in speeds:
            sent += control.speedJ(qd, 2.0, 0.0)
            time.sleep(0.004)
            if not control.isProgramRunning():
                break
        assert 50 <= sent < 500
        until(here.still, deadline_s=1.0)


def test_a_stop_in_flight_by_the_judge(here):
    for motion in (lambda c: c.moveJ((2.0, *HOME[1:]), 0.5, 1.0), lambda c: c.speedJ((0.3, *ZERO[1:]), 1.0, 0.0)):
        with program(here, "stop") as control:
            motion(control)
            until(lambda: here.speed() > 0.2)
            until(here.still, deadline_s=2.0)
            assert not here.moved(HOME, beyond=1.0)


@pytest.mark.parametrize("deceleration", [0.01, 1e-6])
def test_a_weak_stop_is_as_hard_as_the_cells(here, deceleration):
    with program(here) as control:
        assert control.speedJ((0.8, *ZERO[1:]), 4.0, 0.0)
        until(lambda: here.speed() > 0.75)
        begun = time.monotonic()
        control.speedStop(deceleration)
        assert time.monotonic() - begun < 1.0
        assert here.still()


# ---- the end of a client, of a lease, of the gateway

SPEEDING = """
    import sys, time
    from rtde_control import RTDEControlInterface
    control = RTDEControlInterface(sys.argv[1])
    assert control.speedJ([0.6, 0, 0, 0, 0, 0], 4.0, 0.0)
    print("moving", flush=True)
    time.sleep(60)
"""


@contextlib.contextmanager
def speeding(here, gateway):
    at_home(here)
    command = [sys.executable, "-c", textwrap.dedent(SPEEDING), gateway.host]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout.readline() == "moving\n"
            until(lambda: here.speed() > 0.55)
            yield process
        finally:
            process.kill()


def stands(here, seconds=0.15 + STOP_DELAY_S + 0.6 / 8.0 + 0.3):
    """It stands in time: 0.15 s until it brakes, its stop, and what a busy machine adds."""
    begun = time.monotonic()
    until(here.still, deadline_s=5.0)
    assert time.monotonic() - begun < seconds
    where = here.now.q_rad
    time.sleep(0.3)
    assert not here.moved(where, beyond=2e-3)


def test_a_client_that_is_killed_leaves_an_arm_that_stands(here):
    with speeding(here, here.gateway) as process:
        os.kill(process.pid, signal.SIGKILL)
        stands(here)


def test_a_client_that_hangs_is_stopped_with_its_lease(here):
    with speeding(here, here.gateway) as process:
        os.kill(process.pid, signal.SIGSTOP)
        time.sleep(0.2)
        assert here.speed() > 0.5, "ur_rtde goes on, and the lease's beat is not its"
        here.gateway.tell("over")
        stands(here)


def test_a_gateway_that_is_killed_leaves_an_arm_that_stands(here, tmp_path):
    with leased_gateway(here.controller.host, tmp_path / "said") as other, speeding(here, other):
        other.process.kill()
        stands(here)


def test_a_controller_that_is_not_heard_is_stopped(here):
    with speeding(here, here.gateway):
        here.controller.fault("delay", seconds=0.5)
        time.sleep(0.6)
        here.controller.fault("sound_network")
        until(here.still, deadline_s=2.0)
        where = here.now.q_rad
        time.sleep(0.5)
        assert not here.moved(where, beyond=2e-3)


def test_what_a_safety_stop_has_interrupted_does_not_go_on_afterwards(here):
    with program(here) as control:
        assert control.moveJ((2.0, *HOME[1:]), 0.5, 1.0, True)
        until(lambda: here.speed() > 0.4)
        here.controller.fault("protective_stop")
        until(here.still, deadline_s=2.0)
        where = here.now.q_rad
        with (
            socket.create_connection((here.controller.host, DASHBOARD), timeout=5) as link,
            link.makefile("rwb") as lines,
        ):
            lines.readline()

            def said(line):
                lines.write(line + b"\n")
                lines.flush()
                return lines.readline()

            until(lambda: said(b"programState").startswith(b"STOPPED"), deadline_s=2.0)
            here.controller.fault("protective_stop_ages")
            until(lambda: said(b"unlock protective stop").startswith(b"Protective stop releasing"))
            said(b"play")
        time.sleep(0.5)
        assert not here.moved(where, beyond=2e-3)


def test_a_controller_without_us_has_no_program_afterwards(here):
    with program(here):
        pass
    with socket.create_connection((here.controller.host, DASHBOARD), timeout=5) as link, link.makefile("rwb") as lines:
        lines.readline()

        def said():
            lines.write(b"running\n")
            lines.flush()
            return lines.readline()

        until(lambda: said() == b"Program running: false\n")


# ---- a program that speaks RTDE by itself


@contextlib.contextmanager
def raw(here, manner):
    at_home(here)
    client = Raw(here.gateway.host)
    try:
        here.gateway.tell(manner)
        yield client
    finally:
        here.gateway.tell("permit")
        client.close()
        until(here.still)


FAST = {f"input_double_register_{i}": value for i, value in enumerate((0.5, *ZERO[1:], 2.0, 0.0))}
COMMAND = "input_int_register_0"
STILL = dict.fromkeys(FAST, 0.0) | {"input_double_register_6": 2.0}
ATTACKS = {
    "staged, then the id alone": ("refuse", [(2, FAST), (1, {COMMAND: 9})]),
    "the id alone, then what it reads": ("refuse", [(1, {COMMAND: 9}), (2, FAST)]),
    "refused, cleared and said again": ("refuse", [(2, FAST), (1, {COMMAND: 9}), (1, {COMMAND: 0}), (1, {COMMAND: 9})]),
    "a drift without steps": ("zeros", [(2, STILL), (1, {COMMAND: 9}), (2, FAST)]),
    "a drift behind a clear": (
        "zeros",
        [(2, STILL), (1, {COMMAND: 9}), (1, {COMMAND: 0}), (2, FAST), (1, {COMMAND: 9})],
    ),
    "a stop that is cleared at once": (
        "zeros",
        [(2, STILL), (1, {COMMAND: 9}), (2, FAST), (1, {COMMAND: 0}), (2, FAST), (1, {COMMAND: 9})],
    ),
    "a swap while it waits": ("defer", [(2, STILL), (1, {COMMAND: 1}), (2, FAST)]),
    "the script's own id": ("permit", [(2, FAST), (1, {COMMAND: 254})]),
    "no number": ("permit", [(2, FAST | {"input_double_register_1": float("nan")}), (1, {COMMAND: 9})]),
    "nobody answers": ("silent", [(2, FAST), (1, {COMMAND: 9}), (2, STILL), (2, FAST)]),
}


@pytest.mark.parametrize("attack", ATTACKS)
def test_no_order_of_packages_moves_the_arm_past_the_judge(here, attack):
    manner, packages = ATTACKS[attack]
    for pause_s in (0.0, 0.003):
        with raw(here, manner) as client:
            where = here.now.q_rad
            for package in packages:
                client.say(package)
                time.sleep(pause_s)
            time.sleep(0.2 if manner != "defer" else 1.2)
            assert not here.moved(where)


def test_whoever_waits_for_people_hears_each_cycle_of_the_robot(here):
    with raw(here, "defer") as client:
        packages = [(2, dict(zip(FAST, (*AWAY, 1.0, 2.0), strict=True))), (1, {COMMAND: 1})]
        begun = time.monotonic()
        client.say(*packages)
        heard = client.until(lambda: here.moved(HOME))
        assert time.monotonic() - begun > LATER_S
        states, stamps = zip(*heard, strict=True)
        assert set(states) == {2}
        assert stamps[-1] - stamps[0] > LATER_S
        assert max(b - a for a, b in zip(stamps, stamps[1:], strict=False)) < 1.1 * CYCLE_S


# ---- outputs


def test_outputs_are_judged_one_by_one_and_the_slider_goes_down_alone(here):
    seen = rtde_receive.RTDEReceiveInterface(here.controller.host)
    io = rtde_io.RTDEIOInterface(here.gateway.host)
    try:
        here.gateway.tell("permit")
        assert io.setStandardDigitalOut(3, True)
        until(lambda: seen.getDigitalOutState(3))
        here.gateway.tell("refuse")
        asked = len(here.gateway.heard())
        io.setStandardDigitalOut(3, False)
        io.setStandardDigitalOut(4, True)
        until(lambda: len(here.asked(asked)) == 2)
        io.setSpeedSlider(0.5)
        until(lambda: seen.getTargetSpeedFraction() == pytest.approx(0.5))
        assert len(here.asked(asked)) == 2
        io.setSpeedSlider(0.9)
        until(lambda: len(here.asked(asked)) == 3)
        time.sleep(0.1)
        assert seen.getTargetSpeedFraction() == pytest.approx(0.5)
        assert (seen.getDigitalOutState(3), seen.getDigitalOutState(4)) == (True, False)
        here.gateway.tell("permit")
        io.setSpeedSlider(1.0)
        until(lambda: seen.getTargetSpeedFraction() == pytest.approx(1.0))
    finally:
        let_go(io, seen)


# ---- who else would


def test_a_second_one_that_would_command_is_refused(here):
    with program(here), pytest.raises(RuntimeError, match="already in use"):
        here.control()


@pytest.mark.parametrize("port", [PRIMARY, SECONDARY, REALTIME])
@pytest.mark.parametrize(
    "spoil", [lambda t: t.replace("stopl(3)", "stopl(4)", 1), lambda t: t + "movej([1,1,1,1,1,1])\n"]
)
def test_a_script_that_is_not_the_control_script_is_refused_and_its_connection_closed(here, port, spoil):
    with program(here):
        where = here.now.q_rad
        with socket.create_connection((here.gateway.host, port), timeout=5) as link:
            link.settimeout(5)
            link.sendall(spoil(upload()).encode())
            with contextlib.suppress(ConnectionResetError):
                while link.recv(65_536):
                    pass
        assert not here.moved(where)


@pytest.mark.parametrize(
    "line", ["play", "power on", "brake release", "load x.urp", "unlock protective stop", "popup x"]
)
def test_the_dashboard_refuses_what_is_nobodys(here, line):
    with socket.create_connection((here.gateway.host, DASHBOARD), timeout=5) as link, link.makefile("rwb") as lines:
        lines.readline()
        lines.write(line.encode() + b"\n")
        lines.flush()
        assert lines.readline().startswith(b"Failed to execute")


def test_a_dashboard_stop_ends_the_script_and_nothing_is_written_after_it(here):
    with program(here) as control:
        assert control.speedJ((0.3, *ZERO[1:]), 2.0, 0.0)
        until(lambda: here.speed() > 0.2)
        stop_program(here.gateway.host)
        until(here.still, deadline_s=2.0)
        asked = len(here.gateway.heard())
        assert not control.moveJ(AWAY, 1.0, 2.0)
        assert here.asked(asked) == []
