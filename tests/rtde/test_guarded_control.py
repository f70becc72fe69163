"""`GuardedControl` over the real ur_rtde and a simulated controller: the gateway's judge and the gateway's records, in process."""

import asyncio
import inspect
import re
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest
from capabilities.values.scope import Range
from pep.base.stop_model import STOP_DECELERATION_RAD_S2
from pep.rtde.command import command_values as v
from pep.rtde.command.limits import LIMITS
from pep.rtde.guarded import GuardedControl
from pep.rtde.lease.lease import Lease
from pep.rtde.program_stopper import ProgramStopper
from pep.rtde.robot.dashboard import stop_program
from pep.rtde.robot.program import ProgramWatch
from pep.rtde.robot.state_receiver import STILL_RAD_S
from policies.words.reason_table import Reason
from tests.pit.scenes import HOME
from tests.rtde.leased import Arm, Held, leased_scope
from tests.rtde.robot_cell import RobotCell, controller
from tests.sim_controller.cell import until

rtde_control = pytest.importorskip("rtde_control", reason="ur_rtde is not installed")

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(120), pytest.mark.clause("LSD-2", "LSD-3", "LSD-8")]

README = Path(__file__).parents[2] / "README.md"
THERE = (0.15, *HOME[1:])
FAR = (0.5, *HOME[1:])
SPEED = (0.2, 0.0, 0.0, 0.0, 0.0, 0.0)


class Workshop:
    """A program's own robot: the controller, the judge on a loop in a thread, and the guarded connection."""

    def __init__(self, tmp):
        self.controller = controller()
        host = self.controller.host
        self.loop = asyncio.new_event_loop()
        self.thread = threading.Thread(target=self.loop.run_forever)
        self.thread.start()
        self.cell = RobotCell(tmp)
        self.stopper = ProgramStopper(partial(stop_program, host), self.cell.clock)
        self.program = ProgramWatch(host)
        assert self.program.listening(within_s=5.0)
        raw = self.raw = rtde_control.RTDEControlInterface(host)
        assert self.program.claim(within_s=5.0)
        self.judge = self.on_loop(self.opened(host))
        self.lease = Lease(b"l" * 16, "robotic", self.granted(), None, 2**40)
        self.restarting = partial(self.program.restarted, within_s=2.0)
        self.control = GuardedControl(
            raw, judge=self.judge, stopper=self.stopper, holder=self, loop=self.loop,
            restarting=self.restarting, clock=self.cell.clock,
            stop_deceleration_rad_s2=STOP_DECELERATION_RAD_S2,
        )  # fmt: skip

    async def opened(self, host):
        return self.cell.open(host, stopper=self.stopper, program=self.program)

    @property
    def credentials(self):
        return self.lease.credentials

    def granted(self, **changes):
        return self.cell.credentials(self.cell.agent(scope=leased_scope(self.cell.clock.wall_s(), **changes)))

    def on_loop(self, work):
        return asyncio.run_coroutine_threadsafe(work, self.loop).result(60)

    @property
    def now(self):
        return self.cell.state.read()

    def moved(self, q=HOME, beyond=1e-4):
        return max(abs(a - b) for a, b in zip(self.now.q_rad, q, strict=True)) > beyond

    def speed(self):
        return max(map(abs, self.now.qd_rad_s))

    def still(self):
        return self.speed() < STILL_RAD_S

    def permitted(self):
        """The decisions that something came of."""
        return [r for r in self.cell.records("decision") if r["body"]["decision"]["effect"] == "PERMIT"]

    def ended(self, decision=-1):
        """The record of how the newest permit ended, or an earlier one, once that is known."""
        request = self.permitted()[decision]["body"]["request"]["id"]

        def told():
            return next((r for r in self.cell.records("outcome") if r["body"]["request_id"] == request), None)

        return until(told, deadline_s=20.0)

    def outcome(self):
        """How the newest permit ended, in a word."""
        return self.ended()["body"]["result"]["outcome"]

    def home(self):
        """The arm rests there, its script runs, and every token is whole."""
        self.lease = Lease(b"l" * 16, "robotic", self.granted(), None, 2**40)
        until(self.still)
        if not self.control.isProgramRunning():
            self.again()
        if self.moved():
            until(lambda: self.control.moveJ(HOME, 0.8, 2.0), pause_s=0.1)

    def again(self):
        """The control script runs, and every connection has heard of it."""
        assert self.control.reuploadScript()
        until(lambda: self.control.isProgramRunning() and self.cell.readiness.reading().exclusive)

    def close(self):
        self.control.disconnect()
        self.on_loop(self.cell.close())
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.thread.join()
        self.loop.close()
        self.controller.stop()


@pytest.fixture(scope="module")
def shop(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pep.gate.gate.PHYSICS_TIMEOUT_S", 60.0)
        patch.setattr("pep.world.cell_stream.STEP_S", 20.0)
        shop = Workshop(tmp_path_factory.mktemp("workshop"))
        yield shop
        shop.close()


@pytest.fixture
def control(shop):
    shop.home()
    yield shop.control
    shop.control.speedStop()
    until(shop.still)


def test_a_granted_move_moves_and_is_waited_for(shop, control):
    assert control.moveJ(THERE, 0.8, 2.0), control.told
    assert control.reason is None
    assert not shop.moved(THERE, beyond=1e-3)
    assert shop.outcome() == "reached"


def test_what_is_not_granted_gives_false_and_nothing_moves(shop, control):
    shop.lease = Lease(b"m" * 16, "robotic", shop.granted(without=("move_joint",)), None, 2**40)
    assert control.moveJ(THERE, 0.8, 2.0) is False
    assert control.reason is Reason.NOT_GRANTED
    assert control.told.startswith("NOT_GRANTED")
    assert not shop.moved()
    decision = shop.cell.records("decision")[-1]["body"]["decision"]
    assert (decision["effect"], decision["reason"]) == ("DENY", "NOT_GRANTED")


@pytest.mark.parametrize(
    ("call", "reason"),
    [
        (lambda c: c.moveJ((float("nan"), *HOME[1:]), 0.8, 2.0), Reason.NOT_FINITE),
        (lambda c: c.moveJ(THERE, 3.2, 2.0), Reason.ROBOT_LIMIT),
        (lambda c: c.moveJ(HOME[:5], 0.8, 2.0), Reason.PARAMETERS_WRONG),
        (lambda c: c.moveJ([[*THERE, 0.8, 2.0]]), Reason.PARAMETERS_WRONG),
        (lambda c: c.moveJ([[*THERE, 0.8, 2.0, 0.01]]), Reason.PARAMETERS_WRONG),
        (lambda c: c.moveJ_IK((-0.3, -0.13, 0.3, 0.0, 3.1, 0.0)), Reason.NOT_GRANTED),
        (lambda c: c.setPayload(2.5, (0.0, 0.0, 0.0)), Reason.PAYLOAD_MISMATCH),
        (lambda c: c.teachMode(), Reason.NOT_GRANTED),
        (lambda c: c.setExternalForceTorque(SPEED), Reason.NOT_GRANTED),
        (lambda c: c.forceMode((0.0,) * 6, (0, 0, 2, 0, 0, 0), SPEED, 2, SPEED), Reason.PARAMETERS_WRONG),
        (lambda c: c.sendCustomScript("movej([0,0,0,0,0,0])"), Reason.NOT_GRANTED),
    ],
)
def test_a_call_that_no_request_stands_for_is_refused(shop, control, call, reason):
    assert call(control) is False
    assert control.reason is reason
    assert not shop.moved()


def test_what_is_set_again_is_taken_and_questions_are_answered(shop, control):
    assert control.setPayload(1.0, (0.0, 0.0, 0.0)), control.told
    assert control.getTCPOffset()[2] == pytest.approx(0.1767)
    assert control.isSteady()
    assert len(control.getInverseKinematics(control.getForwardKinematics())) == 6
    assert control.kickWatchdog()


def test_a_path_is_judged_by_its_waypoints(shop, control):
    assert control.moveJ([[*THERE, 0.8, 2.0, 0.0], [*HOME, 0.8, 2.0, 0.0]]), control.told
    assert not shop.moved(beyond=1e-3)
    request = shop.cell.records("decision")[-1]["body"]["request"]
    assert request["operation"] == "move_path"
    assert control.moveJ(THERE, 0.8, 2.0), "its own script runs after a path"


def test_two_lines_of_one_agent_follow_each_other(shop, control):
    pose = control.getForwardKinematics()
    up = [*pose[:2], pose[2] + 0.03, *pose[3:]]
    assert control.moveL(up, 0.1, 0.5), control.told
    assert control.moveL(pose, 0.1, 0.5), control.told
    assert not shop.moved(beyond=2e-3)


def test_a_stop_ends_a_move_that_is_waited_for(shop, control):
    with ThreadPoolExecutor(1) as pool:
        moving = pool.submit(control.moveJ, FAR, 0.3, 1.0)
        until(lambda: shop.speed() > 0.2)
        control.stopJ()
        assert moving.result(10) is False
    until(shop.still, deadline_s=2.0)
    assert shop.moved(FAR, beyond=0.05)
    assert shop.outcome() == "stopped"
    assert control.moveJ(THERE, 0.8, 2.0) is False
    assert control.reason is Reason.ROBOT_NOT_RUNNING
    shop.again()
    assert control.moveJ(THERE, 0.8, 2.0), control.told


def test_a_stop_ends_a_move_that_is_not_waited_for_and_the_script_goes_on(shop, control):
    assert control.moveJ(FAR, 0.3, 1.0, True), control.told
    until(lambda: shop.speed() > 0.2)
    control.stopJ(0.01)
    assert shop.still(), "as hard as the cell's"
    assert shop.outcome() == "stopped"
    assert control.moveJ(THERE, 0.8, 2.0), control.told


def test_a_revocation_stops_what_moves(shop, control):
    chain = shop.credentials.chain
    with ThreadPoolExecutor(1) as pool:
        moving = pool.submit(control.moveJ, FAR, 0.3, 1.0)
        until(lambda: shop.speed() > 0.2)
        shop.cell.feed.revoke("token", chain.token_id)
        assert moving.result(10) is False
    until(shop.still, deadline_s=2.0)
    assert control.reason is Reason.REVOKED
    assert shop.moved(FAR, beyond=0.05)


def leased_limits():
    return LIMITS["servo_joint"]


def servoing(control, seconds, speed=0.1):
    """Targets at 100 Hz that run ahead of each other by so much; how many were taken."""
    q, taken, until_s = list(HOME), 0, time.monotonic() + seconds
    while time.monotonic() < until_s:
        start = control.initPeriod()
        q[0] += speed * 0.01
        if not control.servoJ(q, 0.0, 0.0, 0.01, 0.1, 300.0):
            break
        taken += 1
        control.waitPeriod(start)
        time.sleep(0.008)
    return taken


def test_a_stream_flows_and_is_ended_by_its_program(shop, control):
    assert servoing(control, 1.0) > 50, control.told
    control.servoStop()
    assert shop.moved(beyond=0.05)
    assert shop.outcome() in {"ended", "stopped"}  # whichever the watch sees first
    assert shop.cell.records("stream-values")
    assert control.moveJ(THERE, 0.8, 2.0), control.told


def test_a_stream_whose_values_leave_the_grant_is_stopped(shop, control):
    bound = {"servo_joint": {**leased_limits(), "q0": Range(-100_000, 50_000)}}
    shop.lease = Lease(b"n" * 16, "robotic", shop.granted(limits=bound), None, 2**40)
    assert servoing(control, 3.0) >= 20
    assert control.reason is Reason.LIMIT_EXCEEDED_BY_REQUEST
    until(shop.still, deadline_s=2.0)
    assert shop.now.q_rad[0] <= 0.05 + 1e-3
    assert shop.outcome() == "stopped"


def test_a_stream_whose_program_stops_calling_is_stopped(shop, control):
    assert control.speedJ(SPEED, 1.0, 0.2), control.told
    until(lambda: shop.speed() > 0.15)
    until(shop.still, deadline_s=2.0)
    assert control.speedJ(SPEED, 1.0, 0.2) is False, "the program learns it once"
    assert control.reason is Reason.VERDICT_EXPIRED


def test_a_stream_that_nobody_here_ends_is_ended_by_the_controller(shop, control, monkeypatch):
    monkeypatch.setattr(control, "_end", lambda *_: None)  # as when this process is gone
    monkeypatch.setattr(shop.stopper, "stop", lambda reason: None)
    assert control.speedJ(SPEED, 1.0, 0.2), control.told
    until(lambda: shop.speed() > 0.15)
    until(shop.still, deadline_s=2.0)
    assert not control.isProgramRunning()


def test_a_stop_of_another_kind_ends_a_stream_too(shop, control):
    assert control.speedJ(SPEED, 1.0, 1.0), control.told
    until(lambda: shop.speed() > 0.15)
    control.stopJ()
    until(shop.still, deadline_s=1.0)
    assert control.isProgramRunning()


def form(value):
    """Every name of a record, and what kind of thing it has."""
    match value:
        case dict():
            return {name: form(each) for name, each in value.items()}
        case list():
            return [form(each) for each in value[:1]]
        case bool() | None | str():
            return type(value).__name__
        case _:
            return "number"  # JSON has one kind


def held_move(shop):
    """How a line's move ended that an arm carried out which is none."""
    line = Held(Arm(), shop.lease, v.MoveJ(THERE, 0.8, 2.0, asynchronous=False))
    shop.on_loop(asked(shop.judge, line))
    until(lambda: line.answers)
    return shop.ended()


def test_records_are_those_of_the_gateways_line(shop, control):
    """Of the same move: as a held command of a line, which an arm that is none carries out, and as a call."""
    until(lambda: "watch" not in held_move(shop)["body"])  # the watch ends what it sees too late on a busy machine
    until(lambda: control.moveJ(THERE, 0.8, 2.0), pause_s=0.1)
    theirs, ours = shop.permitted()[-2:]
    assert form(ours) == form(theirs)
    assert form(shop.ended()) == form(shop.ended(-2))
    assert ours["body"]["request"]["values"] == theirs["body"]["request"]["values"]
    assert ours["body"]["request"]["points"] == ["e5"]


async def asked(judge, held):
    judge.judge(held)


def test_nobody_waits_for_an_answer_on_the_loop_that_gives_it(shop, control):
    async def call():
        return control.moveJ(THERE, 0.8, 2.0)

    with pytest.raises(RuntimeError):
        shop.on_loop(call())


def test_the_readmes_example_runs(shop, control, capsys):
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    names = {
        "RTDEControlInterface": {shop.controller.host: shop.raw}.__getitem__, "HOST": shop.controller.host,
        "JUDGE": shop.judge, "STOPPER": shop.stopper, "LOOP": shop.loop, "HOLDER": shop, "RESTARTING": shop.restarting,
        "CLOCK": shop.cell.clock, "TOO_FAST": THERE, "THERE": THERE,
    }  # fmt: skip
    exec(compile(example, "README.md", "exec"), names)  # noqa: S102 - our own page
    assert capsys.readouterr().out.startswith("LIMIT_EXCEEDED_BY_REQUEST")
    assert not shop.moved(THERE, beyond=1e-3)


def public(kind):
    return {name for name in dir(kind) if name[0].islower()}


def test_every_method_of_the_interface_is_there_and_no_other():
    interface = rtde_control.RTDEControlInterface
    own = {"judge", "holder", "clock", "reason", "told", "tell", "halt"}
    assert public(GuardedControl) - own == public(interface)


OVERLOADED = {"moveJ", "moveL"}


@pytest.mark.parametrize("name", sorted(public(rtde_control.RTDEControlInterface) - OVERLOADED))
def test_parameters_have_the_interfaces_names_and_defaults(name):
    ours = inspect.signature(getattr(GuardedControl, name)).parameters
    if any(parameter.kind is inspect.Parameter.VAR_KEYWORD for parameter in ours.values()):
        return  # a question: what it is given is passed on
    said = getattr(rtde_control.RTDEControlInterface, name).__doc__.split("\n")[0]
    theirs = re.findall(r"(\w+): [\w.\[\]]+(?: = (\[[^\]]*\]|[^,)]+))?", said)[1:]
    theirs = [(given, default) for given, default in theirs if f"{given}:" in said]
    assert len(ours) - 1 == len(theirs)
    for parameter, (given, default) in zip(list(ours.values())[1:], theirs, strict=True):
        if given.startswith("arg"):
            assert parameter.kind is inspect.Parameter.POSITIONAL_ONLY
        else:
            assert parameter.name == given
        assert (parameter.default is inspect.Parameter.empty) is (default == "")
        if default and not default.startswith("<"):
            shown = list(parameter.default) if isinstance(parameter.default, tuple) else parameter.default
            assert shown == eval(default)  # noqa: S307 - of a docstring of the library


def test_the_package_exports_it_without_loading_it():
    script = "import sys, pep.rtde; assert 'pep.rtde.guarded' not in sys.modules; from pep.rtde import GuardedControl"
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)
