"""Command registers of a lease: no motion is written without the judge, in any order."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pep.rtde.command.command_table import EVERY_CYCLE, ROWS, CommandClass, Wait, decode, encode, row_of
from pep.rtde.command.register_image import RegisterImage
from pep.rtde.command.rounding import on_grid
from pep.rtde.command.stop_rules import MODES, STOPS
from pep.rtde.lease.lease import LeaseEnding
from pep.rtde.line.command_registers import LeasedCommands
from pep.rtde.line.script_terms import DONE, END_MS, READY, TAKEN_MS, WATCHDOG_HZ
from pep.rtde.line.effects import PATIENCE_MS, AskJudge, Halt, Note, Refresh, StopWritten, Tell, Withdraw, Write
from pep.rtde.line.register_echo import QUIET
from pep.rtde.line.refused_stream import PAUSE_MS
from pep.rtde.script.move_path import PathMove, Waypoint
from pep.rtde.wire.recipes import DOUBLE, EXTERNAL_WRENCH, INT, WritableVariables
from policies.words.reason_table import Reason
from tests.pep.rtde.command.test_commands import of_row
from tests.pep.rtde.line.script_model import Script

from pep.rtde.command import command_values as v

pytestmark = pytest.mark.clause("RTDE-11", "RTDE-12", "RTDE-13")

PROFILE = WritableVariables.of(0, control=True, io=False)
CLAIMED = PROFILE.names - {EXTERNAL_WRENCH}
A = 8.0
Q = (0.1, -1.5, 1.4, -1.3, -1.2, 0.2)
MOVE = v.MoveJ(Q, 1.0, 1.4, asynchronous=False)
SPEED, SERVO = v.SpeedJ((0.1,) * 6, 1.0, 0.0), v.ServoJ(Q, 0.002, 0.1, 300.0)
PATH = (Waypoint(PathMove.MOVEJ, is_pose=False, target=Q, speed=1.0, acceleration=1.0, blend_m=0.0),)


class Steps:
    """Answers what it is told to, and keeps what it was asked."""

    def __init__(self, *answers):
        self.answers, self.asked, self.over = list(answers), [], 0

    def step(self, command):
        self.asked.append(command)
        return self.answers.pop(0) if self.answers else None

    def written(self, command):
        return command

    def ended(self):
        self.over += 1


class Line:
    """One connection, with time and acts in hand."""

    def __init__(self, *, running=True, claimed=CLAIMED, profile=PROFILE):
        self.profile = profile
        self.commands = LeasedCommands(profile, claimed, stop_deceleration_rad_s2=A)
        self.at_ms, self.sent = 0, RegisterImage.blank(profile)
        if running:
            self.commands.begin(PATH)

    def write(self, values):
        """Acts that follow from a package."""
        self.commands.package(values, at_ms=self.at_ms)
        return self.acts()

    def say(self, command):
        return self.write(encode(command, self.profile.offset))

    def acts(self):
        acts = self.commands.take()
        for act in acts:
            if isinstance(act, Write):
                after = self.sent.merge(act.values)
                assert isinstance(after, RegisterImage)
                self.sent = after
        return acts

    def written(self, acts):
        """The commands that were written."""
        found = []
        for act in acts:
            if isinstance(act, Write):
                image = RegisterImage.blank(self.profile).merge(act.values)
                found.append(decode(image))
        return found

    def ask(self, command):
        (asked,) = self.say(command)
        assert isinstance(asked, AskJudge)
        return asked.question

    def forward(self, question, steps=None):
        sent = self.commands.forward(question, steps, at_ms=self.at_ms)
        return sent, self.acts()

    def permitted(self, command, steps=None):
        sent, acts = self.forward(self.ask(command), steps)
        assert sent
        assert self.written(acts) == [command]
        return self

    def robot(self, command, said, *, still=False):
        self.commands.robot(command, said, still=still)

    def idle(self):
        """The script has done what stood, and the program has cleared it."""
        self.robot(self.sent.whole(0), DONE)
        self.write({INT[0]: 0})
        self.robot(0, READY)
        self.acts()
        return self

    def wait(self, ms):
        self.at_ms += ms
        self.commands.look(at_ms=self.at_ms)
        return self.acts()


def reasons(acts):
    return [act.text.partition(":")[0] for act in acts if isinstance(act, Tell)]


def noted(acts):
    """Reasons that go on record, with their commands."""
    return [(str(act.refused.reason), act.what) for act in acts if isinstance(act, Note)]


EXAMPLES = {number: of_row(row) for number, row in ROWS.items()}
PASSES = {n for n, row in ROWS.items() if row.command_class is CommandClass.GETTER} | {63}
JUDGED = set(ROWS) - PASSES - set(STOPS) - {0, 35, 55}
UNWAITED = {number for number in JUDGED if ROWS[number].wait is Wait.AT_ONCE}


@pytest.mark.parametrize("number", sorted(JUDGED))
@given(data=st.data())
@settings(max_examples=10)
def test_what_moves_or_changes_waits_and_is_written_once_exactly_as_it_was_judged(number, data):
    command = data.draw(EXAMPLES[number])
    line = Line()
    question = line.ask(command)
    judged = on_grid(command)
    assert question.command == judged
    assert question.path == (PATH if number == 45 else ())
    sent, (written,) = line.forward(question)
    assert sent
    assert written.values == {
        name: {**RegisterImage.blank(PROFILE).values, **encode(judged, 0)}[name] for name in CLAIMED
    }
    assert line.forward(question) == (False, [])


@pytest.mark.parametrize("number", sorted(JUDGED - UNWAITED))
@given(data=st.data())
@settings(max_examples=10)
def test_what_is_refused_is_never_written_and_fails_until_it_is_cleared(number, data):
    line = Line()
    question = line.ask(data.draw(EXAMPLES[number]))
    line.commands.deny(question, Reason.ABOVE_CEILING, "too high")
    acts = line.acts()
    assert reasons(acts) == ["ABOVE_CEILING"]
    assert noted(acts) == [], "the judge has it on record"
    assert not line.written(acts)
    assert line.commands.denied
    assert line.forward(question) == (False, [])
    assert line.say(MOVE) == [], "nothing is asked while the last refusal stands"
    assert line.write({INT[0]: 0}) == [Refresh()]
    assert not line.commands.denied


@pytest.mark.clause("LSD-11")
@pytest.mark.parametrize("number", sorted(UNWAITED))
@given(data=st.data())
@settings(max_examples=10)
def test_a_refused_call_that_does_not_wait_fails_no_other_call(number, data):
    line = Line()
    question = line.ask(data.draw(EXAMPLES[number]))
    line.commands.deny(question, Reason.ABOVE_CEILING, "too high")
    acts = line.acts()
    assert (reasons(acts), noted(acts), line.written(acts)) == (["ABOVE_CEILING"], [], [])
    assert not line.commands.denied
    assert line.forward(question) == (False, [])
    line.permitted(MOVE)


@pytest.mark.clause("LSD-11")
def test_the_value_after_a_refused_one_is_asked_about_at_once():
    far, near = v.ServoJ((3.0,) * 6, 0.002, 0.1, 300.0), v.ServoJ(Q, 0.002, 0.1, 300.0)
    line = Line()
    first = line.ask(far)
    assert line.say(near) == [], "one question at a time"
    line.commands.deny(first, Reason.ABOVE_CEILING, "too high")
    (asked,) = [act for act in line.acts() if isinstance(act, AskJudge)]
    assert asked.question.command == near
    sent, acts = line.forward(asked.question, Steps())
    assert sent
    assert line.written(acts) == [near]


@pytest.mark.clause("LSD-11")
@given(st.lists(st.booleans(), min_size=200, max_size=400))
@settings(max_examples=20)
def test_a_program_that_goes_on_with_a_refused_stream_asks_four_times_a_second(repeats):
    line, asked = Line(), 0
    value = Q
    for number, repeated in enumerate(repeats):
        line.at_ms = 2 * number
        value = value if repeated else (0.001 * number, *Q[1:])
        for act in line.say(v.ServoJ(value, 0.002, 0.1, 300.0)):
            if isinstance(act, AskJudge):
                asked += 1
                line.commands.deny(act.question, Reason.ABOVE_CEILING, "too high")
        line.acts()
    assert 2 <= asked <= 2 + 2 * len(repeats) // PAUSE_MS + 1
    assert not line.commands.denied


@pytest.mark.clause("LSD-11")
def test_a_value_that_breaks_a_stream_off_stops_it_and_leaves_the_script_ready():
    line = Line().permitted(SERVO, Steps(Reason.IMPACT_ROSE))
    acts = line.say(v.ServoJ((0.2,) * 6, 0.002, 0.1, 300.0))
    assert reasons(acts) == ["IMPACT_ROSE"]
    assert line.written(acts) == [v.ServoStop(10.0)]
    assert not line.commands.denied
    assert line.say(MOVE) == [], "it waits for the end of the stop"
    line.robot(16, READY)
    line.robot(16, DONE)
    acts = line.acts()
    assert line.written(acts) == [v.Clear()]
    (asked,) = [act for act in acts if isinstance(act, AskJudge)]
    line.robot(0, READY)
    assert line.forward(asked.question)[0]


@pytest.mark.parametrize("number", sorted(PASSES))
@given(data=st.data())
@settings(max_examples=10)
def test_questions_pass(number, data):
    command = data.draw(EXAMPLES[number])
    line = Line()
    assert line.written(line.say(command)) == [command]


@pytest.mark.parametrize("number", sorted(STOPS))
@given(data=st.data())
@settings(max_examples=10)
def test_stops_pass_at_once_and_none_is_weak(number, data):
    command = data.draw(EXAMPLES[number])
    line = Line()
    acts = line.say(command)
    (written,) = line.written(acts)
    assert type(written) is type(command)
    assert StopWritten() in acts
    for name in ("deceleration", "deceleration_rad_s2", "deceleration_m_s2"):
        if hasattr(written, name):
            assert getattr(written, name) >= A


@pytest.mark.parametrize("number", sorted(set(STOPS) & {15, 16, 33, 34}))
@pytest.mark.parametrize("said", [math.nan, -1.0, 0.0, math.inf, 1e-300])
def test_a_stop_that_is_badly_said_is_a_stop(number, said):
    line = Line()
    (written,) = line.written(line.write({INT[0]: number, DOUBLE[0]: said, INT[1]: 7 if said == 0.0 else 0}))
    assert row_of(written).id == number
    assert line.sent.double(0) >= A


@pytest.mark.parametrize("number", [254, 99, 5, 32, 72, 100, -1, 2**31 - 1, 13, 48])
def test_an_unknown_id_is_refused(number):
    line = Line()
    acts = line.write({INT[0]: number})
    assert reasons(acts) == ["TOOL_UNKNOWN"]
    assert noted(acts) == [("TOOL_UNKNOWN", "command")]
    assert not line.written(acts)


@pytest.mark.parametrize("values", [{DOUBLE[0]: math.nan}, {DOUBLE[3]: math.inf}, {DOUBLE[6]: 3.2}, {INT[1]: 2}])
def test_a_command_with_a_number_that_it_cannot_have_is_refused(values):
    line = Line()
    acts = line.write({**encode(MOVE, 0), **values})
    assert reasons(acts)[0] in {"NOT_FINITE", "ROBOT_LIMIT", "PARAMETERS_WRONG"}
    assert noted(acts) == [(reasons(acts)[0], "moveJ")]
    assert noted(line.write({DOUBLE[1]: math.nan})) == [], "once, until it is cleared"
    assert not line.written(acts)


def test_without_the_control_script_nothing_is_written():
    line = Line(running=False)
    for command in (MOVE, SPEED, v.SetWatchdog(10.0), v.Read(v.Reading.STEADY)):
        acts = line.say(command)
        assert reasons(acts) == ["ROBOT_NOT_RUNNING"]
        assert noted(acts) == [("ROBOT_NOT_RUNNING", row_of(command).name)]
        waits = row_of(command).wait is not Wait.AT_ONCE
        assert line.write({INT[0]: 0}) == ([Refresh()] if waits else [])
    assert line.say(v.StopJ(1.0, asynchronous=False)) == [Halt()], "a stop needs no register"


# ---- the attacks of the reference, 6.2


def test_staged_registers_are_judged_with_the_command_that_uses_them():
    line = Line()
    staged = {name: value for name, value in encode(MOVE, 0).items() if name != INT[0]}
    assert line.write(staged) == []
    (asked,) = line.write({INT[0]: 1})
    assert asked.question.command == MOVE


def test_what_was_staged_for_something_else_is_not_written():
    line = Line()
    line.write({DOUBLE[17]: 5.0, INT[7]: 1})
    line.permitted(MOVE)
    assert (line.sent.double(17), line.sent.whole(7)) == (0.0, 0)


def test_a_drift_without_steps_ends_the_stream():
    line = Line().permitted(SPEED)
    acts = line.say(v.SpeedJ((0.2,) * 6, 1.0, 0.0))
    assert line.written(acts) == [v.SpeedStop(10.0)]
    assert reasons(acts) == ["NOT_WHAT_WAS_DECIDED"]
    assert noted(acts) == [("NOT_WHAT_WAS_DECIDED", "speedJ")]


def test_each_value_of_a_stream_is_judged_and_the_first_that_is_not_permitted_ends_it():
    steps = Steps(None, Reason.IMPACT_ROSE)
    line = Line().permitted(SERVO, steps)
    second, third = v.ServoJ((0.2,) * 6, 0.002, 0.1, 300.0), v.ServoJ((0.3,) * 6, 0.002, 0.1, 300.0)
    assert line.written(line.say(second)) == [second]
    acts = line.say(third)
    assert line.written(acts) == [v.ServoStop(10.0)]
    assert reasons(acts) == ["IMPACT_ROSE"]
    assert noted(acts) == [], "the stream's own record says it"
    assert (steps.asked, steps.over) == ([second, third], 1)
    assert line.say(second) == [], "and nothing more"


def test_the_same_value_once_more_is_judged_too_and_one_request_without_steps_stands():
    steps = Steps(None, Reason.VERDICT_EXPIRED)
    line = Line().permitted(SPEED, steps)
    assert line.written(line.say(SPEED)) == [SPEED]
    assert line.written(line.say(SPEED)) == [v.SpeedStop(10.0)]
    assert (steps.asked, steps.over) == ([SPEED, SPEED], 1)
    alone = Line().permitted(SPEED)
    assert alone.say(SPEED) == []


def test_a_value_that_is_none_ends_a_stream():
    steps = Steps()
    line = Line().permitted(SERVO, steps)
    acts = line.write({DOUBLE[0]: math.nan})
    assert line.written(acts) == [v.ServoStop(10.0)]
    assert steps.over == 1


def test_a_judgement_that_breaks_ends_a_stream():
    class Broken(Steps):
        def step(self, command):
            raise ValueError

    line = Line().permitted(SERVO, Broken())
    acts = line.say(v.ServoJ((0.2,) * 6, 0.002, 0.1, 300.0))
    assert reasons(acts) == ["POLICY_ERROR"]
    assert noted(acts) == [("POLICY_ERROR", "servoJ")]


def test_the_newest_value_of_a_stream_is_judged_when_the_first_is_forwarded():
    line = Line()
    question, newest = line.ask(SERVO), v.ServoJ((0.3,) * 6, 0.002, 0.1, 300.0)
    assert line.say(newest) == []
    _, acts = line.forward(question, Steps())
    assert line.written(acts) == [SERVO, newest]
    line = Line()
    question = line.ask(SERVO)
    line.say(newest)
    _, acts = line.forward(question)
    assert line.written(acts) == [SERVO, v.ServoStop(10.0)]


def test_a_swap_before_the_script_has_read_is_refused():
    line = Line().permitted(MOVE)
    acts = line.write({DOUBLE[0]: 2.0})
    assert reasons(acts) == ["NOT_WHAT_WAS_DECIDED"]
    assert noted(acts) == [("NOT_WHAT_WAS_DECIDED", "moveJ")]
    assert not line.written(acts)


def test_a_swap_while_it_waits_withdraws_it():
    line = Line()
    question = line.ask(MOVE)
    acts = line.write({DOUBLE[0]: 2.0})
    assert Withdraw(question) in acts
    assert line.forward(question) == (False, [])


def test_one_id_over_another_is_refused_for_the_script_would_not_carry_it_out():
    line = Line().permitted(MOVE)
    acts = line.say(v.MoveL(Q, 0.1, 1.0, asynchronous=False))
    assert reasons(acts) == ["BUSY"]
    assert noted(acts) == [("BUSY", "moveL")]


def test_registers_that_the_program_has_not_set_up_are_not_used():
    line = Line(claimed={INT[0], DOUBLE[0]})
    acts = line.say(MOVE)
    assert reasons(acts) == ["NOT_GRANTED"]
    assert noted(acts) == [("NOT_GRANTED", "moveJ")]


def test_what_an_external_sensor_says_is_not_taken():
    line = Line()
    assert line.write({EXTERNAL_WRENCH: (1.0,) * 6}) == []
    assert reasons(line.say(v.SetExternalWrench((1.0,) * 6))) == ["NOT_GRANTED"]


# ---- waiting


def test_a_clear_a_stop_and_another_command_withdraw_what_waits():
    for said in ({INT[0]: 0}, encode(v.StopJ(9.0, asynchronous=False), 0), encode(SPEED, 0)):
        line = Line()
        question = line.ask(MOVE)
        assert Withdraw(question) in line.write(said)
        assert not line.forward(question)[0]


def test_deferred_is_told_and_ends():
    line = Line()
    question = line.ask(MOVE)
    line.commands.defer(question, "somebody is asked")
    assert reasons(line.acts()) == ["somebody is asked"]
    assert line.wait(PATIENCE_MS) == []
    acts = line.wait(1)
    assert acts[0] == Withdraw(question)
    assert reasons(acts) == ["APPROVAL_TIMEOUT"]
    assert not line.forward(question)[0]


def test_what_waits_when_the_script_ends_has_failed():
    line = Line()
    line.ask(MOVE)
    line.commands.end(Reason.ROBOT_NOT_RUNNING)
    assert reasons(line.acts()) == ["ROBOT_NOT_RUNNING"]
    assert line.commands.denied


@pytest.mark.parametrize("command", [SPEED, SERVO, v.ServoC(Q, 0.1, 1.0, 0.0)])
def test_who_does_not_wait_is_refused_when_it_is_deferred(command):
    line = Line()
    question = line.ask(command)
    line.commands.defer(question, "somebody is asked")
    acts = line.acts()
    assert acts[0] == Withdraw(question)
    assert reasons(acts) == ["APPROVAL_REQUIRED"]
    assert not line.forward(question)[0]


def test_the_end_of_the_script_and_of_the_connection_withdraw_and_end():
    for end in (lambda c: c.end(Reason.ROBOT_NOT_RUNNING), lambda c: c.leave()):
        line, steps = Line(), Steps()
        line.permitted(SERVO, steps)
        question = line.ask(MOVE)
        end(line.commands)
        assert Withdraw(question) in line.acts()
        assert steps.over == 1
        assert not line.forward(question)[0]
        assert not [c for c in line.written(line.say(MOVE)) if c != v.Clear()]


def test_a_program_whose_lease_ends_hears_that_its_command_has_failed():
    line = Line().permitted(MOVE)
    line.commands.leave(LeaseEnding.AUTHORITY)
    acts = line.acts()
    assert line.commands.denied
    assert [act.text for act in acts if isinstance(act, Tell)] == ["LEASE_OVER: authority"]
    assert Refresh() in acts


def test_a_connection_that_ends_stops_what_it_moves():
    line = Line().permitted(SPEED, Steps())
    line.commands.leave()
    acts = line.acts()
    assert line.written(acts) == [v.SpeedStop(10.0)]
    assert acts[-1] == Halt()


# ---- streams and stops


def test_a_stream_outlives_a_clear_as_its_motion_does():
    steps = Steps()
    line = Line().permitted(SPEED, steps)
    assert line.written(line.write({INT[0]: 0})) == [v.Clear()]
    other = v.SpeedJ((0.2,) * 6, 1.0, 0.0)
    assert line.written(line.say(other)) == [other]
    assert steps.asked == [other]
    assert line.written(line.say(v.SpeedStop(20.0))) == [v.SpeedStop(20.0)]
    assert steps.over == 1


def test_a_stop_stays_until_the_script_has_carried_it_out():
    line = Line().permitted(SPEED, Steps(Reason.IMPACT_ROSE))
    line.say(v.SpeedJ((0.2,) * 6, 1.0, 0.0))
    assert line.sent.whole(0) == 15
    assert line.written(line.write({INT[0]: 0})) == [], "the clear waits for the stop"
    assert line.say(MOVE) == [], "it waits for the end of the stop"
    line.write({INT[0]: 0})
    line.robot(15, READY)
    assert line.acts() == []
    line.robot(15, DONE)
    assert line.written(line.acts()) == [v.Clear()]
    line.robot(0, READY)
    line.permitted(MOVE)


def test_no_register_reaches_a_script_that_is_in_a_move():
    line = Line().permitted(MOVE)
    assert Halt() in line.say(v.StopJ(9.0, asynchronous=False))


def test_nothing_is_asked_while_the_script_is_in_a_move():
    line = Line().permitted(MOVE)
    line.robot(1, READY)
    line.write({INT[0]: 0})
    for command in (SPEED, v.MoveJ(Q, 1.0, 1.0, asynchronous=True), v.Read(v.Reading.STEADY)):
        line.robot(0, READY)
        assert line.say(command) == []
        line.at_ms += END_MS
        line.commands.look(at_ms=line.at_ms)
        assert line.acts() == []
        line.commands.look(at_ms=line.at_ms + 1)
        acts = line.acts()
        assert (reasons(acts), noted(acts)) == (["BUSY"], [("BUSY", row_of(command).name)])
        line.write({INT[0]: 0})
    line.robot(0, DONE)
    line.ask(SPEED)


@pytest.mark.parametrize("command", [SPEED, MOVE])
def test_a_program_that_hears_of_the_end_before_we_do_goes_on(command):
    line = Line().permitted(MOVE)
    line.robot(1, READY)
    line.write({INT[0]: 0})
    assert line.say(command) == []
    line.robot(1, DONE)  # on its way while the clear was
    (asked,) = line.acts()
    assert asked.question.command == command
    assert line.forward(asked.question, Steps())[0]


def test_a_question_that_comes_before_the_end_is_passed_after_it():
    line = Line().permitted(MOVE)
    line.robot(1, READY)
    line.write({INT[0]: 0})
    assert line.say(v.Read(v.Reading.STEADY)) == []
    line.robot(1, DONE)
    assert line.written(line.acts()) == [v.Read(v.Reading.STEADY)]


def test_a_stream_that_begins_before_the_end_is_asked_as_it_stands_then():
    line, later = Line().permitted(MOVE), v.SpeedJ((0.2,) * 6, 1.0, 0.0)
    line.robot(1, READY)
    line.write({INT[0]: 0})
    assert line.say(SPEED) == line.say(later) == []
    line.robot(1, DONE)
    (asked,) = line.acts()
    assert asked.question.command == later


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({INT[0]: 0}, []),
        ({DOUBLE[0]: 2.0}, ["NOT_WHAT_WAS_DECIDED"]),
    ],
)
def test_what_is_withdrawn_or_swapped_before_the_end_is_not_asked(change, told):
    line = Line().permitted(MOVE)
    line.robot(1, READY)
    line.write({INT[0]: 0})
    assert line.say(MOVE) == []
    assert reasons(line.write(change)) == told
    line.robot(1, DONE)
    assert not [act for act in line.acts() if isinstance(act, AskJudge)]


def test_what_waits_for_an_end_fails_with_its_script():
    line = Line().permitted(MOVE)
    line.robot(1, READY)
    line.write({INT[0]: 0})
    line.say(MOVE)
    line.commands.end(Reason.ROBOT_NOT_RUNNING)
    assert reasons(line.acts()) == ["ROBOT_NOT_RUNNING"]


def test_a_move_whose_end_the_controller_skipped_is_over_when_script_and_arm_are_quiet():
    line = Line().permitted(MOVE)
    line.write({INT[0]: 0})
    for _ in range(QUIET + 1):
        assert line.say(SPEED) == []
        line.write({INT[0]: 0})
        line.robot(0, READY, still=True)
    line.ask(SPEED)


@pytest.mark.parametrize(
    "asked", [v.StopJ(0.1, asynchronous=False), v.StopL(99.0, asynchronous=True), v.SpeedStop(12.0), v.ServoStop(12.0)]
)
@pytest.mark.parametrize(("stream", "ends"), [(SPEED, v.SpeedStop), (SERVO, v.ServoStop)])
def test_any_stop_of_a_stream_is_given_as_that_ends_it(stream, ends, asked):
    steps = Steps()
    line = Line().permitted(stream, steps)
    assert not line.commands.stopping
    acts = line.say(asked)
    assert line.written(acts) == [ends(12.0 if type(asked) is ends else 10.0)]
    assert acts[-1] == StopWritten()
    assert steps.over == 1
    assert line.commands.stopping
    line.robot(line.sent.whole(0), DONE)
    assert not line.commands.stopping
    line.robot(0, READY, still=True)
    line.write({INT[0]: 0})
    assert line.written(line.say(v.StopJ(9.0, asynchronous=False))) == [v.StopJ(9.0, asynchronous=False)], "it is over"


def test_a_stop_waits_for_a_script_that_has_not_seen_the_clear_of_what_it_did():
    """The controller's words from before a question came are no words of that question."""
    read = v.Read(v.Reading.TARGET_WAYPOINT)
    line = Line()
    assert line.written(line.say(read)) == [read]
    line.robot(28, DONE)
    line.write({INT[0]: 0})
    assert line.written(line.say(read)) == [read]
    line.robot(0, READY)  # on its way while the second question was
    line.robot(28, DONE)
    line.write({INT[0]: 0})
    line.permitted(SERVO, Steps())
    line.robot(11, READY)  # both in one cycle: the script still waits for the end of the question
    assert line.written(line.say(v.ServoStop(9.0))) == [v.Clear()]
    assert line.commands.stopping
    line.robot(0, READY)
    acts = line.acts()
    assert line.written(acts) == [v.ServoStop(10.0)]
    assert StopWritten() in acts


def test_a_word_of_the_move_before_is_none_of_the_same_move_again():
    line = Line().permitted(MOVE)
    line.robot(1, DONE)
    line.write({INT[0]: 0})
    line.permitted(MOVE)
    line.robot(1, DONE)  # still of the first
    assert line.say(SPEED) == []
    line.write({INT[0]: 0})
    line.robot(0, READY)
    line.robot(1, READY)
    assert Halt() in line.say(v.StopJ(9.0, asynchronous=False)), "the script is in it"


def test_a_stop_of_two_kinds_of_streams_ends_the_program():
    line = Line().permitted(SPEED)
    line.write({INT[0]: 0})
    line.robot(0, READY)
    line.permitted(SERVO)
    acts = line.say(v.ServoStop(9.0))
    assert not line.written(acts)
    assert Halt() in acts


def test_the_end_of_a_mode_beside_a_stream_is_given_as_it_is():
    line = Line().permitted(SERVO)
    ending = v.End(v.StopKind.FORCE_MODE)
    assert line.written(line.say(ending)) == [ending]


def test_a_stop_after_what_was_not_cleared_is_given_once_the_script_listens():
    line = Line().permitted(v.ServoC(Q, 0.1, 1.0, 0.0))
    assert line.written(line.say(v.ServoStop(9.0))) == [v.Clear()]
    line.robot(12, DONE)
    line.robot(0, READY)
    acts = line.acts()
    assert line.written(acts) == [v.ServoStop(10.0)]
    assert StopWritten() in acts
    line = Line().permitted(v.ServoC(Q, 0.1, 1.0, 0.0))
    line.say(v.ServoStop(9.0))
    assert Halt() in line.wait(TAKEN_MS + 1)


@pytest.mark.parametrize("number", sorted(MODES))
@given(data=st.data())
@settings(max_examples=3)
def test_the_judge_stops_what_it_has_forwarded(number, data):
    command = data.draw(EXAMPLES[number])
    line = Line()
    question = line.ask(command)
    line.forward(question, Steps())
    if number not in EVERY_CYCLE:
        line.idle()
    line.commands.stop(question, Reason.IMPACT_ROSE, "somebody came near")
    acts = line.acts()
    (written,) = line.written(acts)
    assert type(written) is type(MODES[number])
    assert reasons(acts) == ["IMPACT_ROSE"]


def test_the_judge_stops_a_move_on_its_way():
    line = Line()
    question = line.ask(v.MoveJ(Q, 1.0, 1.4, asynchronous=True))
    line.forward(question)
    line.idle()
    line.commands.stop(question, Reason.IMPACT_ROSE, "somebody came near")
    assert line.written(line.acts()) == [v.StopJ(A, asynchronous=False)]
    line = Line()
    question = line.ask(MOVE)
    line.forward(question)
    line.commands.stop(question, Reason.IMPACT_ROSE, "somebody came near")
    assert Halt() in line.acts()


# ---- the watchdog


def test_the_programs_watchdog_is_kept_here_and_the_scripts_is_ours():
    line = Line()
    assert line.written(line.say(v.SetWatchdog(2.0))) == [v.SetWatchdog(WATCHDOG_HZ)]
    line.idle()
    assert line.wait(500) == []
    line.write({INT[0]: 0})
    assert line.wait(500) == []
    assert line.wait(1) == [Halt()]


# ---- any order


manners = st.sampled_from(["forward", "steps", "deny", "defer", "leave it"])
SOME = [
    MOVE,
    v.MoveJ(Q, 1.0, 1.0, asynchronous=True),
    SPEED,
    SERVO,
    v.ServoC(Q, 0.1, 1.0, 0.0),
    v.SetTcp(Q),
    v.TeachMode(),
]
SOME += [
    v.MovePath(asynchronous=False),
    v.StopJ(0.1, asynchronous=False),
    v.SpeedStop(0.1),
    v.ServoStop(0.1),
    v.Clear(),
]
SOME += [v.Read(v.Reading.STEADY), v.SetWatchdog(1.0), v.StartContactDetection(Q), v.End(v.StopKind.PROGRAM)]
words = st.one_of(
    st.sampled_from(SOME).map(lambda c: encode(c, 0)),
    st.sampled_from([{INT[0]: 254}, {INT[0]: 1}, {INT[0]: 9}, {INT[0]: 11}, {INT[0]: 0}, {DOUBLE[0]: math.nan}]),
    st.floats(-1.0, 1.0).map(lambda x: {DOUBLE[0]: x}),
)
events = st.one_of(
    words.map(lambda w: ("says", w)),
    manners.map(lambda m: ("judge", m)),
    st.integers(1, 6).map(lambda n: ("cycles", n)),
    st.sampled_from([10, TAKEN_MS + 1, PATIENCE_MS + 1]).map(lambda ms: ("waits", ms)),
    st.just(("restarts", None)),
)


def moves(command):
    return not (
        isinstance(command, v.Clear | v.Stop | v.SetWatchdog | v.StopContactDetection)
        or row_of(command).command_class is CommandClass.GETTER
    )


@given(st.lists(events, max_size=40), st.booleans())
def test_nothing_that_moves_reaches_the_script_but_what_the_judge_has_forwarded(said, ending):
    line, script = Line(), Script(PROFILE)
    script.start()
    waiting, permitted, written = [], [], []

    class Judged(Steps):
        def step(self, command):
            reason = None if len(self.asked) % 3 else Reason.IMPACT_ROSE
            super().step(command)
            if reason is None:
                permitted.append(command)
            return reason

    def follow(acts):
        for act in acts:
            match act:
                case Write(values):
                    script.write(values)
                    written.extend(c for c in line.written([act]) if moves(c))
                case AskJudge(question):
                    waiting.append(question)
                case Withdraw(question):
                    waiting.remove(question)
                case Halt():
                    script.running = False
                    line.commands.end(Reason.ROBOT_NOT_RUNNING)
                    follow(line.acts())

    for what, how in said:
        match what:
            case "says":
                follow(line.write(how))
            case "judge" if waiting:
                question = waiting.pop(0) if how != "leave it" and how != "defer" else waiting[0]
                if how in ("forward", "steps"):
                    permitted.append(question.command)
                    sent, acts = line.forward(question, Judged() if how == "steps" else None)
                    if not sent:
                        permitted.pop()
                    follow(acts)
                elif how == "deny":
                    line.commands.deny(question, Reason.ABOVE_CEILING, "too high")
                elif how == "defer":
                    line.commands.defer(question, "somebody is asked")
                follow(line.acts())
            case "cycles":
                for _ in range(how):
                    line.robot(*script.tick())
                    follow(line.acts())
            case "waits":
                follow(line.wait(how))
            case "restarts":
                line.commands.end(Reason.ROBOT_NOT_RUNNING)
                follow(line.acts())
                assert script.image.whole(0) == 0, "a script that starts finds no command"
                script.start()
                line.commands.begin(PATH)
                follow(line.acts())
            case _:
                pass
        assert written == permitted, "each once, in order, and no other"
    if ending:
        line.commands.leave()
        follow(line.acts())
        for word in ({INT[0]: 0}, encode(MOVE, 0), {INT[0]: 0}, encode(SPEED, 0), encode(v.SpeedStop(9.0), 0)):
            assert line.write(word) == []
    once = [c for c in script.done if moves(c) and row_of(c).id not in EVERY_CYCLE]
    assert all(once.count(c) <= permitted.count(c) for c in once), "no move is carried out again"
    assert all(c in permitted for c in script.done if moves(c))


@pytest.mark.clause("LSD-14")
def test_what_was_judged_in_a_commands_place_is_written_and_its_end_is_the_commands():
    line, judged = Line(), v.MoveJ((0.1,) * 6, 0.5, 1.4, False)
    question = line.ask(v.MoveJIk((0.3, 0.1, 0.2, 0.0, 3.1, 0.0), 0.5, 1.4, False))
    assert line.commands.forward(question, None, at_ms=0, written=judged)
    assert line.written(line.acts()) == [judged]


@pytest.mark.clause("LSD-15")
def test_a_stream_is_written_as_its_judge_says_and_never_followed_by_its_bytes():
    class Angles(Steps):
        def written(self, command):
            return v.ServoJ(tuple(2 * number for number in command.pose_m_rad), 0.002, 0.1, 300.0)

    line, first = Line(), v.ServoL((0.1,) * 6, 0.002, 0.1, 300.0)
    question = line.ask(first)
    assert line.commands.forward(question, Angles(), at_ms=0, written=Angles().written(first))
    line.acts()
    assert line.written(line.say(v.ServoL((0.2,) * 6, 0.002, 0.1, 300.0))) == [v.ServoJ((0.4,) * 6, 0.002, 0.1, 300.0)]
    assert line.written(line.say(v.ServoStop(10.0))) == [v.ServoStop(10.0)]


@pytest.mark.clause("LSD-29")
def test_a_value_that_stands_is_written_as_its_judge_says_it_anew_but_never_over_another_command():
    class Anew(Steps):
        later = None

        def renewed(self):
            return self.later

    judge, tool = Anew(), v.SpeedL((0.1,) * 6, 0.5, 0.5)
    line = Line()
    line.commands.renew()
    assert line.acts() == [], "there is no stream"
    line.permitted(tool, judge)
    line.commands.renew()
    assert line.acts() == [], "it stands as it was written"
    judge.later = SPEED
    line.commands.renew()
    assert line.written(line.acts()) == [SPEED]
    line.say(v.Read(v.Reading.STEP_TIME))
    line.commands.renew()
    assert line.acts() == [], "the script has not read the question yet"
    line.say(v.SpeedStop(10.0))
    line.commands.renew()
    assert line.acts() == [], "the stream is over"
