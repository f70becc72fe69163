"""Calls of a program in the judge's process, before a raw object and a judge that do what a test says."""

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from pep.rtde.command import command_values as v
from pep.rtde.command.rounding import on_grid
from pep.rtde.guarded import GuardedControl
from pep.rtde.held_calls import HANDED_MS
from pep.rtde.method_calls import call_of
from pep.rtde.motion.control_interface import UNWATCHED_HZ
from pep.rtde.program_stopper import ProgramStopper
from policies.words.reason_table import Reason
from tests.pep.kit import ManualClock
from tests.rtde.test_commands_of_ur_rtde import CALLS, HOME, Q
from tests.sim_controller.cell import until

pytestmark = pytest.mark.clause("LSD-8")

SPEED = (0.1, 0.0, 0.0, 0.0, 0.0, 0.0)
SERVO = (Q, 0.0, 0.0, 0.01, 0.1, 300.0)


class Raw:
    """Takes everything, and remembers it; a test may have it do something first."""

    def __init__(self):
        self.calls, self.first = [], {}

    def __getattr__(self, name):
        def call(*arguments):
            if name == "isProgramRunning":
                return True
            answer = self.first.get(name, lambda: True)()
            self.calls.append((name, arguments))
            return answer

        return call

    @property
    def names(self):
        return [name for name, _ in self.calls]


class Rehearsal:
    """The control, its judge and its stopper."""

    def __init__(self):
        self.loop = asyncio.new_event_loop()
        self.thread = threading.Thread(target=self.loop.run_forever)
        self.thread.start()
        self.raw, self.clock, self.asked, self.gone, self.stopped = Raw(), ManualClock(), [], [], []
        self.manner = lambda held: held.deny(Reason.NOT_GRANTED, "no")
        self.credentials, self.steps, self.left = object(), None, []
        self.stopper = ProgramStopper(lambda: self.stopped.append(self.clock.mono), self.clock)
        self.control = GuardedControl(
            self.raw, judge=self, stopper=self.stopper, holder=self, loop=self.loop, restarting=threading.Lock,
            clock=self.clock, stop_deceleration_rad_s2=8.0,
        )  # fmt: skip

    def judge(self, held):
        self.asked.append(held)
        self.manner(held)

    def withdrawn(self, held):
        self.gone.append(held)

    # its steps
    def step(self, command):
        return self.left.pop(0) if self.left else None

    def ended(self):
        self.gone.append("stream")

    def permits(self, held):
        held.forward(self if isinstance(held.command, v.ServoJ | v.SpeedJ) else None)

    def close(self):
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.thread.join()
        self.loop.close()


@pytest.fixture
def rehearsal():
    rehearsal = Rehearsal()
    yield rehearsal
    if not rehearsal.loop.is_closed():
        rehearsal.close()


JUDGED = [row for row in CALLS if isinstance(row[2], v.Move | v.Held | v.Setting) and row[0] != "stopContactDetection"]
JUDGED = [row for row in JUDGED if row[0] != "setWatchdog"]


@pytest.mark.parametrize(
    ("name", "arguments", "command"), JUDGED, ids=[f"{i}-{row[0]}" for i, row in enumerate(JUDGED)]
)
def test_a_call_is_the_command_that_it_is_on_the_wire_and_back(rehearsal, name, arguments, command):
    assert getattr(rehearsal.control, name)(*arguments) is False
    (held,) = rehearsal.asked
    assert held.command == on_grid(command)
    assert rehearsal.raw.calls == []
    if not isinstance(command, v.MovePath):
        back, said = call_of(command)
        getattr(rehearsal.control, back)(*said)
        assert rehearsal.asked[-1].command == on_grid(command)
    else:
        assert [point.target for point in held.path] == [tuple(row[:6]) for row in arguments[0]]


def test_exactly_what_was_judged_is_called(rehearsal):
    rehearsal.manner = rehearsal.permits
    assert rehearsal.control.moveJ((0.1000004, *Q[1:]), 1.0, 1.4, True)
    assert rehearsal.raw.calls == [("moveJ", ([0.1, *Q[1:]], 1.0, 1.4, True))]


def test_a_path_is_called_with_waypoints_that_nobody_else_holds(rehearsal):
    rehearsal.manner = rehearsal.permits
    assert rehearsal.control.moveJ([[*Q, 0.5, 0.5, 0.0]])
    ((name, (path, asynchronous)),) = rehearsal.raw.calls
    assert (name, path.size(), asynchronous) == ("movePath", 1, False)
    assert "movej([0.1,-1.5,1.4,-1.3,-1.2,0.2],a=0.5,v=0.5,r=0)" in path.toScriptCode()


@pytest.mark.parametrize("asynchronous", [True, False])
def test_a_stop_that_meets_a_call_which_is_handed_over(rehearsal, asynchronous):
    """It comes before the command: given again behind it, or past the script that is inside of the move."""
    inside, enough = threading.Event(), threading.Event()
    rehearsal.manner = rehearsal.permits
    rehearsal.raw.first["moveJ"] = lambda: inside.set() or enough.wait(10)
    with ThreadPoolExecutor(1) as pool:
        moving = pool.submit(rehearsal.control.moveJ, Q, 1.0, 1.4, asynchronous)
        assert inside.wait(10)
        rehearsal.control.stopJ()
        enough.set()
        moving.result(10)
    if asynchronous:
        assert rehearsal.raw.names == ["stopJ", "moveJ", "stopJ"]
        assert not rehearsal.stopped
    else:
        until(lambda: rehearsal.stopped)
        assert rehearsal.raw.names == ["moveJ"]


def test_a_move_that_the_controller_does_not_take_is_stopped_past_its_script(rehearsal):
    rehearsal.manner = rehearsal.permits
    rehearsal.raw.first["moveJ"] = lambda: False
    assert rehearsal.control.moveJ(Q) is False
    assert rehearsal.control.reason is Reason.EFFECT_FAILED
    until(lambda: rehearsal.stopped)


def test_a_stop_while_it_is_decided_voids_it(rehearsal):
    def stopped_meanwhile(held):
        rehearsal.control.stopJ()
        assert held.forward() is False

    rehearsal.manner = stopped_meanwhile
    assert rehearsal.control.moveJ(Q) is False
    assert rehearsal.control.reason is Reason.VERDICT_EXPIRED
    until(lambda: rehearsal.gone == rehearsal.asked)
    assert rehearsal.raw.names == ["stopJ"]


def test_what_is_handed_over_too_late_is_not(rehearsal):
    rehearsal.manner = rehearsal.permits
    rehearsal.raw.first["setWatchdog"] = lambda: rehearsal.clock.advance(HANDED_MS + 1) or True
    assert rehearsal.control.servoJ(*SERVO) is False
    assert rehearsal.control.reason is Reason.VERDICT_EXPIRED
    assert rehearsal.raw.names == ["setWatchdog", "setWatchdog"]
    assert rehearsal.raw.calls[-1][1] == (UNWATCHED_HZ,)
    until(lambda: rehearsal.gone == ["stream"])


def test_a_stop_between_the_answer_and_the_command_voids_it(rehearsal):
    rehearsal.manner = rehearsal.permits
    rehearsal.raw.first["setWatchdog"] = lambda: rehearsal.raw.first.clear() or rehearsal.control.servoStop()
    assert rehearsal.control.servoJ(*SERVO) is False
    assert rehearsal.control.reason is Reason.VERDICT_EXPIRED
    assert "servoJ" not in rehearsal.raw.names
    assert rehearsal.raw.calls[-1] == ("setWatchdog", (UNWATCHED_HZ,))


def test_what_is_deferred_is_waited_for_and_a_stop_ends_the_waiting(rehearsal):
    rehearsal.manner = lambda held: held.defer("APPROVAL_REQUIRED: ask")
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(rehearsal.control.moveJ, Q)
        until(lambda: rehearsal.control.reason is Reason.APPROVAL_REQUIRED)
        assert not waiting.done()
        rehearsal.control.stopL()
        assert waiting.result(10) is False
    until(lambda: rehearsal.gone == rehearsal.asked)
    assert rehearsal.raw.names == ["stopL"]


def test_a_stream_that_is_deferred_has_failed(rehearsal):
    rehearsal.manner = lambda held: held.defer("APPROVAL_REQUIRED: ask")
    assert rehearsal.control.servoJ(*SERVO) is False
    assert rehearsal.control.reason is Reason.APPROVAL_REQUIRED
    until(lambda: rehearsal.gone == rehearsal.asked)


def test_a_judge_that_breaks_has_refused(rehearsal):
    rehearsal.manner = lambda held: 1 / 0
    assert rehearsal.control.moveJ(Q) is False
    assert rehearsal.control.reason is Reason.POLICY_ERROR


def test_without_a_loop_nobody_decides_and_stops_pass(rehearsal):
    rehearsal.close()
    assert rehearsal.control.moveJ(Q) is False
    assert rehearsal.control.reason is Reason.EVIDENCE_MISSING
    rehearsal.control.stopJ()
    assert rehearsal.raw.names == ["stopJ"]


def test_each_value_of_a_stream_is_judged_and_one_that_is_not_taken_ends_it(rehearsal):
    rehearsal.manner = rehearsal.permits
    assert rehearsal.control.servoJ(*SERVO)
    rehearsal.left = [None, Reason.IMPACT_ROSE]
    assert rehearsal.control.servoJ(HOME, *SERVO[1:])
    assert rehearsal.control.servoJ(*SERVO) is False
    assert rehearsal.control.reason is Reason.IMPACT_ROSE
    until(lambda: "servoStop" in rehearsal.raw.names)
    assert rehearsal.raw.names[:3] == ["setWatchdog", "servoJ", "servoJ"]
    assert len(rehearsal.asked) == 1
    until(lambda: "stream" in rehearsal.gone)


def test_a_tool_speed_is_one_request_and_another_one_ends_it(rehearsal):
    rehearsal.manner = rehearsal.permits
    assert rehearsal.control.speedL(SPEED, 0.5, 0.5)
    assert rehearsal.control.speedL(SPEED, 0.5, 0.5)
    assert rehearsal.raw.names == ["setWatchdog", "speedL", "speedL"]
    assert rehearsal.control.speedL((0.2, *SPEED[1:]), 0.5, 0.5) is False
    assert rehearsal.control.reason is Reason.NOT_WHAT_WAS_DECIDED
    until(lambda: "speedStop" in rehearsal.raw.names)


def test_a_stream_whose_program_stops_calling_is_ended(rehearsal):
    rehearsal.manner = rehearsal.permits
    for _ in range(3):
        assert rehearsal.control.speedJ(SPEED, 0.5, 0.1)
        rehearsal.clock.advance(200)
    assert "speedStop" not in rehearsal.raw.names
    rehearsal.clock.advance(1)
    until(lambda: "speedStop" in rehearsal.raw.names)
    assert rehearsal.control.speedJ(SPEED, 0.5, 0.1) is False
    assert rehearsal.control.reason is Reason.VERDICT_EXPIRED


@pytest.mark.parametrize(
    ("begin", "stop", "given"),
    [
        (lambda c: c.speedJ(SPEED, 0.5, 1.0), lambda c: c.stopJ(0.1), ("speedStop", (10.0,))),
        (lambda c: c.servoJ(*SERVO), lambda c: c.servoStop(0.1), ("servoStop", (10.0,))),
        (lambda c: c.speedJ(SPEED, 0.5, 1.0), lambda c: c.stopScript(), ("stopScript", ())),
        (lambda c: c.moveJ(Q, 1.0, 1.4, True), lambda c: c.stopJ(0.1), ("stopJ", (8.0, False))),
        (lambda c: None, lambda c: c.stopL(float("nan")), ("stopL", (10.0, False))),
    ],
)
def test_a_stop_is_the_one_of_what_goes_on_and_as_hard_as_the_cells(rehearsal, begin, stop, given):
    rehearsal.manner = rehearsal.permits
    begin(rehearsal.control)
    before = len(rehearsal.raw.calls)
    stop(rehearsal.control)
    assert rehearsal.raw.calls[before] == given
    assert rehearsal.stopper.stopped_ms == rehearsal.clock.mono


def test_the_programs_own_watchdog_is_the_one_that_stays(rehearsal):
    rehearsal.manner = rehearsal.permits
    assert rehearsal.control.setWatchdog(2.0)
    rehearsal.control.speedJ(SPEED, 0.5, 0.1)
    rehearsal.control.speedStop()
    told = [arguments[0] for name, arguments in rehearsal.raw.calls if name == "setWatchdog"]
    assert told[0] == told[-1] == 2.0
    assert told[1] == pytest.approx(1 / 0.3)
