"""The stop ladder, the life of the control script, and what a script port takes: pure parts of a lease."""

import asyncio
import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.base.clock import SystemClock
from pep.base.errors import PepFault, RobotError
from pep.base.stop_model import ESCALATE_MS
from pep.rtde.lease.lease import LeaseEnding
from pep.rtde.line.active_lease import ActiveLease
from pep.rtde.line.script_terms import DONE, READY
from pep.rtde.line.control_program import START_MS, WAIT_MS, ControlProgram, ControlStep, Phase
from pep.rtde.line.controller_ports import LeasedPorts
from pep.rtde.line.conversations import LeasedRtdePort
from pep.rtde.line.lease_stop import OBEYS_MS, LeaseStopLadder, StopMeans
from pep.rtde.line.script_uploads import ONLY_STOPS, LeasedScripts
from pep.rtde.robot.connections import DASHBOARD, RTDE, SECONDARY
from pep.rtde.robot.state_receiver import SURE_MS, JointState
from pep.rtde.script.control_script import Upload, allow_list, installed_body, scripts_for
from pep.rtde.wire.messages import ControlVersion
from pep.rtde.wire.primary_frames import Key
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_table import Reason
from tests.pep.rtde.packages import ByHand, package

from pep.rtde.robot import program as program_words

pytestmark = pytest.mark.clause("RTDE-13", "RTDE-14", "RTDE-15")

SCRIPTS = scripts_for(11, allow_list(installed_body))
UPLOAD = Upload(SCRIPTS[0], ())
STOPPED, PLAYING = 1, 2


def seen(at_ms, speed=0.0, runtime=PLAYING, command=0, said=0, safety=1):
    state = JointState((0.0,) * 6, (speed, *(0.0,) * 5), 7, safety)
    return package(
        state, arrived_ms=at_ms, stamp_s=at_ms / 1000, runtime_state=runtime, registers={0: (command, said), 24: (7, 7)}
    )


# ---- the ladder


def test_an_arm_that_slows_down_and_stands_ends_it():
    ladder = LeaseStopLadder()
    assert ladder.begin(StopMeans.REGISTERS, newest=seen(0, 1.0), at_ms=0)
    assert ladder.look(seen(0, 0.0), at_ms=1) is None
    assert not ladder.over, "what was said before the stop tells nothing"
    for at_ms in range(2, OBEYS_MS * 2, 2):
        assert ladder.look(seen(at_ms, 0.9), at_ms=at_ms) is None
    assert ladder.look(seen(500, 0.0), at_ms=500) is None
    assert ladder.over


def test_an_arm_that_does_not_hear_the_registers_is_stopped_by_a_program():
    ladder = LeaseStopLadder()
    ladder.begin(StopMeans.REGISTERS, newest=seen(0, 1.0), at_ms=0)
    assert ladder.look(seen(OBEYS_MS, 1.0), at_ms=OBEYS_MS) is None
    assert ladder.look(seen(OBEYS_MS + 1, 1.0), at_ms=OBEYS_MS + 1) is StopMeans.PROGRAM


def test_each_rung_is_followed_by_the_next_and_the_last_by_itself():
    ladder, at_ms, rungs = LeaseStopLadder(), 0, []
    ladder.begin(StopMeans.REGISTERS, newest=seen(0, 1.0), at_ms=0)
    for at_ms in range(2, 4 * ESCALATE_MS, 2):
        rung = ladder.look(seen(at_ms, 0.5), at_ms=at_ms)
        if rung is not None:
            rungs.append((rung, at_ms))
    assert [rung for rung, _ in rungs] == [StopMeans.PROGRAM, StopMeans.DASHBOARD, StopMeans.DASHBOARD]
    assert all(b - a > ESCALATE_MS for (_, a), (_, b) in zip(rungs, rungs[1:], strict=False))


def test_a_controller_that_says_nothing_is_not_taken_for_an_arm_that_stands():
    ladder, old = LeaseStopLadder(), seen(0, 0.0)
    ladder.begin(StopMeans.REGISTERS, newest=old, at_ms=0)
    assert ladder.look(old, at_ms=OBEYS_MS + 1) is StopMeans.PROGRAM
    assert ladder.look(old, at_ms=2 * ESCALATE_MS) is StopMeans.DASHBOARD
    assert not ladder.over


def test_a_script_that_goes_on_is_not_over_and_a_safety_stop_needs_the_dashboard():
    ladder = LeaseStopLadder()
    ladder.begin(StopMeans.PROGRAM, newest=seen(0, 0.0), at_ms=0)
    assert ladder.look(seen(5, 0.0, PLAYING), at_ms=5) is None
    assert not ladder.over
    assert ladder.look(seen(6, 0.0, PLAYING, safety=3), at_ms=6) is StopMeans.DASHBOARD
    assert ladder.look(seen(9, 0.0, STOPPED), at_ms=9) is None
    assert ladder.over


def test_an_arm_that_stands_by_itself_has_not_been_stopped():
    """A servo thread that has come to its target holds the arm there, and goes on."""
    ladder = LeaseStopLadder()
    ladder.begin(StopMeans.REGISTERS, newest=seen(0, 1.0), at_ms=0)
    for at_ms in range(2, ESCALATE_MS + 1):
        assert ladder.look(seen(at_ms, 0.0), at_ms=at_ms, carried_out=False) is None
        assert not ladder.over
    at_ms = ESCALATE_MS + 1
    assert ladder.look(seen(at_ms, 0.0), at_ms=at_ms, carried_out=False) is StopMeans.PROGRAM
    assert ladder.look(seen(at_ms + 2, 0.0, STOPPED), at_ms=at_ms + 2, carried_out=False) is None
    assert ladder.over, "whatever was in its registers"


def test_the_ports_ask_the_tenant_what_its_script_has_carried_out(ports):
    tenant = ActiveLease(ports, object())
    tenant.control = SimpleNamespace(line=SimpleNamespace(commands=SimpleNamespace(stopping=True)))
    ports._tenant = tenant
    ports.state.heard = seen(2, 0.0)
    ports.ladder.begin(StopMeans.REGISTERS, newest=seen(0, 1.0), at_ms=0)
    ports._climb(10)
    assert not ports.ladder.over
    tenant.control.line.commands.stopping = False
    ports._climb(12)
    assert ports.ladder.over


@pytest.fixture
def ports():
    return LeasedPorts(
        "127.0.0.1", ByHand(seen(0)), None, scripts=SCRIPTS, stop_deceleration_rad_s2=8.0, clock=SystemClock(),
        closed=lambda *_: None,
    )  # fmt: skip


def test_a_program_that_is_paused_has_not_been_ended():
    """A paused program could be let go on: the dashboard is asked until it has ended."""
    ladder = LeaseStopLadder()
    ladder.begin(StopMeans.DASHBOARD, newest=seen(0, 0.0), at_ms=0)
    assert ladder.look(seen(2, 0.0, runtime=4), at_ms=2) is None
    assert not ladder.over
    assert ladder.look(seen(ESCALATE_MS + 1, 0.0, runtime=4), at_ms=ESCALATE_MS + 1) is StopMeans.DASHBOARD
    ladder.look(seen(ESCALATE_MS + 3, 0.0, runtime=STOPPED), at_ms=ESCALATE_MS + 3)
    assert ladder.over


def test_an_arm_of_which_nothing_new_is_heard_is_stopped_though_it_stood(ports):
    ports._take = (taken := []).append
    ports.state.heard = seen(ports.clock.monotonic_ms(), 0.0, STOPPED)
    ports.stop(StopMeans.PROGRAM)
    assert taken == []
    ports.state.heard = seen(ports.clock.monotonic_ms() - SURE_MS - 1, 0.0, STOPPED)
    ports.stop(StopMeans.PROGRAM)
    assert taken == [StopMeans.PROGRAM]
    assert not ports.ladder.over


class Broken:
    """A line in a state that nobody thought of."""

    commands = SimpleNamespace(stopping=False, offset=0, end=lambda _: None)
    running = True

    def __init__(self):
        self.line, self.parts = self, ()

    def leave(self, *_):
        raise IndexError

    refresh = settle = leave


def test_a_line_that_breaks_keeps_no_stop(ports):
    """Neither that of the judge nor that at the lease's end."""
    ports._primary = SimpleNamespace(connected=True, send=(sent := []).append)
    lease = object()
    tenant = ports._tenant = ActiveLease(ports, lease)
    tenant.control, tenant.program = Broken(), running()
    with pytest.raises(IndexError):
        ports.stop(StopMeans.PROGRAM)
    assert len(sent) == 1

    ports.ladder, tenant.program = LeaseStopLadder(), running()
    tenant.control, tenant.lines = None, {Broken()}
    with pytest.raises(IndexError):
        ports.over(lease, LeaseEnding.AUTHORITY)
    assert len(sent) == 2
    assert ports._tenant is None


@pytest.mark.parametrize(("major", "some"), [(5, True), (3, False), (10, False)])
def test_a_controller_of_another_kind_is_sent_no_script(ports, major, some):
    assert ports.scripts == ()
    ports.state.version = ControlVersion(major, 11, 0, 0)
    assert bool(ports.scripts) is some


def test_a_controller_that_is_not_there_is_waited_for_so_long(ports, monkeypatch):
    monkeypatch.setattr("pep.rtde.line.controller_ports.BEGINS_S", 0.2)

    async def scenario():
        try:
            await ports.begin()
        finally:
            ports.close()

    with pytest.raises(RobotError) as raised:
        asyncio.run(asyncio.wait_for(scenario(), 5.0))
    assert (raised.value.code, raised.value.detail) == (PepFault.ROBOT_UNREACHABLE, "127.0.0.1, port 30001")


def said_now(ports):
    ports.state.version = ControlVersion(5, 11, 0, 0)
    ports.state.heard = seen(ports.clock.monotonic_ms(), 0.0, STOPPED)


@pytest.mark.parametrize("port", [RTDE, SECONDARY, DASHBOARD])
def test_a_line_that_has_no_controller_is_none(ports, port):
    said_now(ports)
    assert asyncio.run(ports.open(object(), port, None)) is Reason.ROBOT_NOT_RUNNING
    assert ports._tenant.lines == set()


def test_where_the_slider_stands_is_known_for_twenty_packages(ports):
    said_now(ports)
    port = LeasedRtdePort(ActiveLease(ports, object()), None)
    assert port._slider() == ports.state.heard.state.slider
    ports.state.heard = replace(ports.state.heard, arrived_ms=ports.state.heard.arrived_ms - SURE_MS - 1)
    assert math.isnan(port._slider())


def test_a_look_that_breaks_is_told_and_the_next_one_comes(ports):
    told, looks = [], []

    class Bad:
        control, stopping = None, False

        def look(self, at_ms):
            looks.append(at_ms)
            raise IndexError

    async def scenario():
        asyncio.get_running_loop().set_exception_handler(lambda _, what: told.append(what["exception"]))
        looking = asyncio.create_task(ports._keep_looking())
        while len(looks) < 3:
            await asyncio.sleep(0.005)
        looking.cancel()

    ports._tenant = Bad()
    ports.ladder.begin(StopMeans.PROGRAM, newest=seen(0), at_ms=0)
    ports.state.heard = seen(2, 0.0, STOPPED)
    asyncio.run(asyncio.wait_for(scenario(), 5.0))
    assert {type(each) for each in told} == {IndexError}
    assert ports.ladder.over, "stops are seen to their end all the same"


def test_a_stop_that_goes_past_us_counts_and_is_seen_to_its_end(ports):
    ports.state.heard = seen(0, 1.0)
    assert ports.stopped_ms is None
    ports.note(StopMeans.PROGRAM)
    assert ports.stopped_ms is not None
    assert not ports.ladder.over


def test_a_weaker_stop_changes_nothing():
    ladder = LeaseStopLadder()
    assert ladder.begin(StopMeans.PROGRAM, newest=seen(0), at_ms=0)
    assert not ladder.begin(StopMeans.REGISTERS, newest=seen(0), at_ms=1)
    assert not ladder.begin(StopMeans.PROGRAM, newest=seen(0), at_ms=1)
    assert ladder.begin(StopMeans.DASHBOARD, newest=seen(0), at_ms=1)


def test_a_speed_that_is_no_number_is_no_standstill():
    ladder = LeaseStopLadder()
    ladder.begin(StopMeans.REGISTERS, newest=seen(0, 1.0), at_ms=0)
    assert ladder.look(seen(2, math.inf), at_ms=2) is None
    assert not ladder.over


# ---- the control script


BEGINS, ENDS = Key(0, 0, program_words.STARTED, program_words.OURS), Key(0, 0, program_words.STOPPED, "it")
ANOTHER = Key(0, 0, program_words.STARTED, "other")


def program():
    begun = ControlProgram()
    begun.begin(UPLOAD, at_ms=0)
    return begun


def running():
    begun = program()
    begun.look(seen(3, runtime=STOPPED), at_ms=3)
    begun.told(BEGINS)
    for sample in (seen(6, said=READY), seen(8, said=DONE, command=35), seen(10, said=READY)):
        begun.look(sample, at_ms=sample.arrived_ms)
    assert begun.phase is Phase.RUNNING
    return begun


def test_it_is_sent_armed_and_cleared_and_only_then_is_it_the_clients():
    begun = program()
    steps = [
        (seen(1, command=1, runtime=STOPPED), None, Phase.WAITING),
        (seen(2, runtime=PLAYING), None, Phase.WAITING),
        (seen(3, runtime=STOPPED), ControlStep.SEND, Phase.SENT),
        (seen(4, runtime=STOPPED, said=READY), None, Phase.SENT),
        (seen(5, said=DONE), None, Phase.SENT),
        (seen(6, said=READY), ControlStep.ARM, Phase.ARMING),
        (seen(7, said=READY, command=35), None, Phase.ARMING),
        (seen(8, said=DONE, command=35), ControlStep.CLEAR, Phase.CLEARING),
        (seen(9, said=DONE, command=35), None, Phase.CLEARING),
        (seen(10, said=READY), ControlStep.BEGIN, Phase.RUNNING),
        (seen(11, said=READY), None, Phase.RUNNING),
        (seen(12, runtime=0), ControlStep.END, Phase.NONE),
        (seen(13, runtime=PLAYING, said=READY), None, Phase.NONE),
    ]
    for sample, turn, phase in steps:
        assert (begun.look(sample, at_ms=sample.arrived_ms), begun.phase) == (turn, phase)
        if turn is ControlStep.SEND:
            begun.told(BEGINS)


@given(st.lists(st.tuples(st.integers(0, 5), st.sampled_from([0, 1, 9, 35, 255]), st.integers(0, 2)), max_size=30))
def test_it_is_never_sent_over_a_command_nor_the_clients_before_its_watchdog(said):
    begun, turns = program(), []
    for at_ms, (runtime, command, word) in enumerate(said):
        turn = begun.look(seen(at_ms, 0.0, runtime, command, word), at_ms=at_ms)
        if turn is not None:
            turns.append((turn, runtime, command, word))
        if turn is ControlStep.SEND:
            begun.told(BEGINS)
    order = [ControlStep.SEND, ControlStep.ARM, ControlStep.CLEAR, ControlStep.BEGIN, ControlStep.END]
    kinds = [turn for turn, *_ in turns if turn is not ControlStep.FAIL]
    assert kinds == order[: len(kinds)]
    assert all((runtime, command) == (STOPPED, 0) for turn, runtime, command, _ in turns if turn is ControlStep.SEND)


@pytest.mark.parametrize(("samples", "limit_ms"), [([], WAIT_MS), ([seen(1, runtime=STOPPED)], START_MS)])
def test_it_has_its_time_to_come_so_far(samples, limit_ms):
    begun, at_ms = program(), 0
    for sample in samples:
        begun.look(sample, at_ms=(at_ms := sample.arrived_ms))
    assert begun.late(at_ms=at_ms + limit_ms) is None
    assert begun.late(at_ms=at_ms + limit_ms + 1) is ControlStep.FAIL
    assert begun.phase is Phase.NONE


def test_a_script_that_ends_while_it_is_armed_has_failed():
    begun = program()
    for sample in (seen(3, runtime=STOPPED), seen(6, said=READY)):
        begun.look(sample, at_ms=sample.arrived_ms)
    assert begun.look(seen(7, runtime=STOPPED, command=35), at_ms=7) is ControlStep.FAIL


@pytest.mark.parametrize("event", [ENDS, ANOTHER, BEGINS, None])
def test_whatever_starts_or_ends_after_it_has_taken_its_place(event):
    """The controller says that a program is playing before and after."""
    begun = running()
    assert begun.look(seen(12, said=READY), at_ms=12) is None
    if event is None:
        begun.unheard()
    else:
        begun.told(event)
    assert begun.look(seen(14, said=READY), at_ms=14) is ControlStep.END
    assert begun.phase is Phase.NONE


def test_what_started_or_ended_before_it_was_of_others():
    begun = program()
    begun.told(ANOTHER)
    begun.look(seen(3, runtime=STOPPED), at_ms=3)
    for event in (ENDS, BEGINS):
        begun.told(event)
    for sample in (seen(6, said=READY), seen(8, said=DONE, command=35)):
        begun.look(sample, at_ms=sample.arrived_ms)
    assert begun.look(seen(10, said=READY), at_ms=10) is ControlStep.BEGIN


def test_without_the_controllers_word_that_it_has_started_it_is_not_the_clients():
    begun = program()
    for sample in (seen(3, runtime=STOPPED), seen(6, said=READY), seen(8, said=DONE, command=35)):
        begun.look(sample, at_ms=sample.arrived_ms)
    begun.told(ANOTHER)
    assert begun.look(seen(10, said=READY), at_ms=10) is None
    assert begun.phase is Phase.CLEARING
    assert begun.late(at_ms=11 + START_MS) is ControlStep.FAIL


# ---- what a script port takes


def torn(text, size):
    return [text[at : at + size] for at in range(0, len(text), size)]


def fed(port, pieces):
    found = []
    for piece in pieces:
        answer = port.feed(piece)
        if isinstance(answer, InputRefusal):
            return answer
        found += answer
    return found


@pytest.mark.parametrize("size", [1, 997, 100_000])
def test_control_scripts_one_after_another(size):
    pieces = torn(UPLOAD.render(), size)
    assert fed(LeasedScripts(SCRIPTS), [*pieces, *pieces]) == [UPLOAD, UPLOAD]


@pytest.mark.parametrize("text", [b"stopj(2)\n", b"def p():\n  stopl(3)\nend\n", b"stop program\n"])
def test_programs_that_only_stop(text):
    assert fed(LeasedScripts(SCRIPTS), torn(text, 3) * 2) == [ONLY_STOPS, ONLY_STOPS]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (UPLOAD.render().replace(b"stopl(3)", b"stopl(4)", 1), Reason.TOOL_DEFINITION_CHANGED),
        (UPLOAD.render() + b"x", Reason.TOOL_DEFINITION_CHANGED),
        (b"movej([1,1,1,1,1,1])\n", Reason.NOT_GRANTED),
        (b"def p():\n  stopj(2)\n  movej([1,1,1,1,1,1])\nend\n", Reason.NOT_GRANTED),
        (b"\xff\xfe\n", Reason.BODY_MALFORMED),
    ],
)
@pytest.mark.parametrize("size", [500, 100_000])
def test_anything_else_is_refused(text, reason, size):
    refused = fed(LeasedScripts(SCRIPTS), torn(text, size))
    assert isinstance(refused, InputRefusal)
    assert refused.reason is reason


@pytest.mark.parametrize("size", [500, 100_000])
def test_a_long_program_is_refused_though_it_only_stops(size):
    assert isinstance(
        fed(LeasedScripts(SCRIPTS), torn(b"def p():\n" + b"  stopj(2)\n" * 500 + b"end\n", size)), InputRefusal
    )
