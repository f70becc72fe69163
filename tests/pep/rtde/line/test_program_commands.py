"""Force mode on the line of a program: lowered to its grant, and held while people are asked."""

import pytest
from capabilities.values.scope import Grant, Limit, Range
from pep.base.operations import FORCE_MODE
from pep.rtde.command.command_table import encode
from pep.rtde.line.effects import AskJudge, Tell, Withdraw, Write
from pep.rtde.line.program_commands import ProgramCommands
from pep.rtde.line.script_terms import READY
from pep.rtde.wire.recipes import INT, WritableVariables
from policies.words.reason_table import Reason

from pep.rtde.command import command_values as v

ZERO = (0.0,) * 6
PUBLIC = v.ForceMode(
    ZERO,
    (False, False, True, False, False, False),
    (0.0, 0.0, -10.0, 0.0, 0.0, 0.0),
    2,
    (2.0, 2.0, 1.5, 1.0, 1.0, 1.0),
)
MOVE = v.MoveJ((0.1, *ZERO[1:]), 0.5, 1.0, asynchronous=False)
GRANT = Grant(
    "ur3e",
    "force_mode",
    tuple(Limit(p.parameter, Range(0, 10_000) if p.parameter.name == "vz" else p.bound) for p in FORCE_MODE.limits),
)
pytestmark = pytest.mark.clause("LSD-19")


class Steps:
    """Judge of later values, which takes all."""

    def __init__(self):
        self.taken = []

    def step(self, command):
        self.taken.append(command)

    def written(self, command):
        return command

    def ended(self):
        self.taken.append(None)


class Line:
    """A program's registers, with a control script that listens."""

    def __init__(self):
        profile = WritableVariables.of(0, control=True, io=False)
        self.commands = ProgramCommands(profile, profile.names, stop_deceleration_rad_s2=8.0, granted=lambda _: GRANT)
        self.commands.begin(())
        self.commands.robot(0, READY, still=True)
        self.acts()

    def acts(self):
        return self.commands.take()

    def say(self, command, at_ms=0):
        self.commands.package(encode(command, 0), at_ms=at_ms)
        return self.acts()


def only(acts, kind):
    return [act for act in acts if isinstance(act, kind)]


def test_what_is_asked_and_written_has_the_limits_of_the_grant_and_the_program_is_told_once():
    line = Line()
    acts = line.say(PUBLIC)
    (asked,) = only(acts, AskJudge)
    assert asked.question.command.limits == (0.01, 0.01, 0.01, 0.1, 0.1, 0.1)
    (told,) = only(acts, Tell)
    assert told.text.startswith(f"{Reason.LIMITS_LOWERED}: ")
    assert "vz=10000 um_s" in told.text
    steps = Steps()
    assert line.commands.forward(asked.question, steps, at_ms=0)
    (written,) = only(line.acts(), Write)
    assert written.values["input_double_register_14"] == 0.01
    again = line.say(PUBLIC)
    assert not only(again, Tell)
    assert steps.taken == [asked.question.command]
    weaker = v.ForceMode(ZERO, PUBLIC.selection, (0.0, 0.0, -5.0, 0.0, 0.0, 0.0), 2, PUBLIC.limits)
    (written,) = only(line.say(weaker), Write)
    assert steps.taken[-1].wrench_n_nm[2] == -5.0
    assert written.values["input_double_register_14"] == 0.01


@pytest.mark.clause("LSD-20")
def test_force_mode_is_held_while_people_are_asked_and_other_commands_take_its_place():
    line = Line()
    (asked,) = only(line.say(PUBLIC), AskJudge)
    line.commands.defer(asked.question, "APPROVAL_REQUIRED: somebody is asked")
    assert not only(line.acts(), Withdraw)
    assert not line.commands.denied
    line.say(PUBLIC)
    line.commands.package({INT[0]: 0}, at_ms=1)
    assert only(line.acts(), Withdraw)
    assert not line.commands.forward(asked.question, Steps(), at_ms=2)


def test_a_stream_of_angles_is_not_held():
    line = Line()
    (asked,) = only(line.say(v.ServoJ(ZERO, 0.002, 0.1, 300.0)), AskJudge)
    line.commands.defer(asked.question, "APPROVAL_REQUIRED: somebody is asked")
    acts = line.acts()
    assert only(acts, Withdraw)
    assert not only(acts, Write)
    assert not line.commands.forward(asked.question, Steps(), at_ms=1)
