"""The RTDE connection of a lease, byte by byte: what the controller is sent, and what the client sees."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.rtde.command.command_table import encode
from pep.rtde.command.command_values import End, MoveJ, StopJ, StopKind
from pep.rtde.command.io_commands import Bank, SetDigitalOutputs, SetSpeedSlider
from pep.rtde.line.script_terms import WATCHDOG_HZ
from pep.rtde.line.effects import AskJudge, Note, Tell, Withdraw
from pep.rtde.line.rtde_line import LeasedLine
from pep.rtde.wire.codec import Framer, Recipe, decode_answer, decode_request, encode_answer, encode_request
from pep.rtde.wire.messages import (
    InputsAnswer,
    OutputsAnswer,
    Pause,
    PauseAnswer,
    ProtocolAnswer,
    RequestProtocol,
    RtdeMessage,
    SetupInputs,
    SetupOutputs,
    Start,
    StartAnswer,
    Values,
    WireError,
)
from pep.rtde.wire.recipes import DOUBLE, EXTERNAL_WRENCH, INT, control_recipes, io_recipes
from pep.rtde.wire.variables import INPUTS, VariableType
from policies.words.reason_table import Reason

pytestmark = pytest.mark.clause("RTDE-11", "RTDE-12")

Q = (0.1, -1.5, 1.4, -1.3, -1.2, 0.2)
MOVE = MoveJ(Q, 1.0, 1.4, asynchronous=False)
SHOWN = ("runtime_state", "robot_status_bits", "timestamp")
OUTPUTS = Recipe(SHOWN, (VariableType.UINT32, VariableType.UINT32, VariableType.DOUBLE))
PLAYING = {"runtime_state": 2, "robot_status_bits": 3, "timestamp": 7.0}


class Talk:
    """A line between a client and a controller that are both made by hand."""

    def __init__(self, *, may=True, slider=1.0, line=LeasedLine):
        self.line = line(lambda: may, stop_deceleration_rad_s2=8.0)
        self.inputs, self.slider, self.seen = [], slider, []
        self.say(RequestProtocol(2), protocol=1)
        self.answer(ProtocolAnswer(True), protocol=1)

    def say(self, *requests, protocol=2):
        said = self.line.said(b"".join(encode_request(r, protocol) for r in requests), slider=self.slider, at_ms=0)
        return self._went(said)

    def answer(self, *answers, protocol=2):
        return self._went(self.line.answered(b"".join(encode_answer(a, protocol) for a in answers)))

    def _went(self, said):
        self.seen += [decode_answer(frame, 2) for frame in Framer(0xFFFF).feed(said.to_client)]
        return [decode_request(frame, 2) for frame in Framer(0xFFFF).feed(said.to_robot)]

    def had(self, names):
        """The controller gives these inputs."""
        self.inputs.append(names)
        return self.answer(InputsAnswer(tuple(INPUTS[n] for n in names), len(self.inputs)))

    def begun(self, recipes, *, start=True, more=None):
        """Every recipe is set up; what was written to the controller at the end of that."""
        for names in recipes:
            self.say(SetupInputs(names))
            self.had(names)
        if not start:
            return self
        self.say(SetupOutputs(SHOWN, 500.0))
        self.answer(OutputsAnswer(OUTPUTS.types, 1))
        if more is not None:
            self.say(SetupOutputs(more.names, 500.0))
            self.answer(OutputsAnswer(more.types, 2))
        own, started = self.say(Start())
        assert started == Start()
        self.blank = self.had(own.names)
        self.own = Recipe(own.names, [INPUTS[n] for n in own.names])
        self.answer(StartAnswer(True))
        self.seen.clear()
        return self

    def running(self):
        self.line.running = True
        self.line.commands.begin(())
        return self

    def write(self, values):
        """The client writes these through the first recipe that has them all; the packages that went on."""
        number, names = next((i + 1, n) for i, n in enumerate(self.inputs) if set(values) <= set(n))
        packed = Recipe(names, [INPUTS[n] for n in names]).pack({n: values.get(n, 0) for n in names})
        return self.say(Values(number, packed))

    def settled(self):
        return self._went(self.line.settle())

    def package(self, **values):
        self.answer(Values(1, OUTPUTS.pack({**PLAYING, **values})))
        return OUTPUTS.unpack(self.seen[-1].packed)


def controlling(more=None):
    return Talk().begun(control_recipes(0), more=more)


def test_after_the_clients_recipes_comes_one_of_ours_and_it_is_written_blank():
    talk = controlling()
    assert set(talk.own.names) == set().union(*control_recipes(0)) - {EXTERNAL_WRENCH}
    (blank,) = talk.blank
    assert blank.recipe == 24
    assert set(talk.own.unpack(blank.packed).values()) == {0, 0.0}


@pytest.mark.parametrize("offset", [0, 24])
def test_the_registers_of_stops_and_watchdog_are_ours_though_the_client_leaves_them_out(offset):
    talk = Talk().begun([(INT[offset], INT[offset + 1])])
    ours = {INT[offset], INT[offset + 1], DOUBLE[offset]}
    assert set(talk.own.names) == ours
    (blank,) = talk.blank
    assert set(talk.own.unpack(blank.packed).values()) == {0, 0.0}
    talk.line.commands.arm()
    (armed,) = talk.settled()
    assert talk.own.unpack(armed.packed)[DOUBLE[offset]] == WATCHDOG_HZ
    talk.running()
    talk.line.commands.package(encode(StopJ(1e-9, asynchronous=False), offset), at_ms=0)
    (stopped,) = talk.settled()
    assert talk.own.unpack(stopped.packed)[DOUBLE[offset]] == 8.0


def test_not_one_package_of_the_client_goes_on():
    talk = controlling().running()
    written = talk.write(encode(MOVE, 0))
    assert written == []
    (asked,) = talk.line.take()
    talk.line.commands.forward(asked.question, None, at_ms=0)
    (written,) = talk.settled()
    assert written.recipe == 24
    image = talk.own.unpack(written.packed)
    assert {name: image[name] for name in encode(MOVE, 0)} == encode(MOVE, 0)
    assert not any(image[name] for name in set(image) - set(encode(MOVE, 0)))


def test_the_same_image_is_written_again():
    talk = controlling().running()
    talk.line.rewrite()
    assert talk.settled() == talk.blank


def test_a_refused_command_looks_like_a_program_that_has_ended_until_it_is_cleared():
    talk = controlling().running()
    assert talk.package()["runtime_state"] == 2
    talk.write(encode(MOVE, 0))
    (asked,) = talk.line.take()
    talk.line.commands.deny(asked.question, Reason.ABOVE_CEILING, "too high")
    talk.settled()
    assert talk.seen[-1] == RtdeMessage("ABOVE_CEILING: too high", "ZTPM", 1)
    assert [type(act) for act in talk.line.take()] == [Tell], "and beside the connection"
    shown = talk.package(timestamp=8.0)
    assert shown == {"runtime_state": 1, "robot_status_bits": 3, "timestamp": 8.0}, "and no lie about anything else"
    talk.write({INT[0]: 0})
    assert OUTPUTS.unpack(talk.seen[-1].packed) == {**PLAYING, "timestamp": 8.0}, "at once"


def test_a_line_that_commands_sees_no_other_program_than_its_own():
    talk = controlling()
    assert (talk.package()["runtime_state"], talk.package()["robot_status_bits"]) == (1, 1)
    talk.running()
    assert (talk.package()["runtime_state"], talk.package()["robot_status_bits"]) == (2, 3)


@pytest.mark.clause("LSD-30")
def test_a_refused_script_of_the_programs_own_is_over_once_the_control_script_is_and_ends_no_other_wait():
    state = Recipe((*SHOWN, "output_int_register_0"), (*OUTPUTS.types, VariableType.INT32))

    def told(talk):
        talk.answer(Values(2, state.pack({**PLAYING, "output_int_register_0": 1})))
        return state.unpack(talk.seen[-1].packed)["output_int_register_0"]

    def begun():
        talk = controlling(state)
        return talk.running()

    talk = begun()
    talk.write(encode(MOVE, 0))
    talk.line.commands.script_refused()
    talk.line.running = False
    assert told(talk) == 1, "a move waits, and was not carried out"
    talk = begun()
    talk.write(encode(End(StopKind.PROGRAM), 0))
    talk.line.commands.script_refused()
    talk.settled()
    assert told(talk) == 1, "the control script is not over"
    talk.line.running = False
    assert told(talk) == 2
    talk.running()
    assert told(talk) == 1


def test_a_line_that_only_looks_sees_everything():
    talk = Talk()
    talk.say(SetupOutputs(SHOWN, 500.0))
    talk.answer(OutputsAnswer(OUTPUTS.types, 1))
    assert talk.say(Start()) == [Start()]
    talk.answer(StartAnswer(True))
    assert talk.package() == PLAYING


@pytest.mark.parametrize(
    "names",
    [
        ("input_int_register_0", "input_int_register_0"),
        ("input_int_register_0", "input_int_register_24"),
        ("input_bit_registers0_to_31",),
        ("input_int_register_9",),
        ("input_int_register_0", "speed_slider_mask"),
        ("nothing",),
    ],
)
def test_recipes_of_other_variables_are_not_had(names):
    talk = Talk()
    assert talk.say(SetupInputs(names)) == []
    assert talk.seen[-1].recipe == 0


def test_who_may_not_command_has_no_registers():
    talk = Talk(may=False)
    assert talk.say(SetupInputs(control_recipes(0)[0])) == []
    assert set(talk.seen[-1].types) == {VariableType.IN_USE}


def test_inputs_that_the_controller_refuses_are_not_had():
    talk = Talk()
    names = control_recipes(0)[0]
    talk.say(SetupInputs(names))
    talk.answer(InputsAnswer((VariableType.IN_USE,) * len(names), 0))
    assert talk.seen[-1].recipe == 0
    with pytest.raises(WireError):
        talk.say(Values(1, b"\0" * 72))


@pytest.mark.parametrize(
    "request_",
    [
        SetupInputs(("input_int_register_0",)),
        Values(24, b"\0" * 4),
        Values(99, b"\0" * 4),
        Values(0, b""),
        RequestProtocol(1),
        RtdeMessage("go", "me", 3),
    ],
)
def test_what_a_client_may_not_say_ends_the_connection(request_):
    talk = controlling().running()
    with pytest.raises(WireError):
        talk.say(request_)


def test_a_package_of_another_length_is_ignored():
    talk = controlling().running()
    assert talk.say(Values(6, b"\0" * 100)) == []
    assert talk.line.take() == []


def test_a_controller_that_gives_the_client_what_it_does_not_give_us_ends_it():
    talk = Talk()
    talk.say(SetupInputs(control_recipes(0)[3]))
    talk.had(control_recipes(0)[3])
    talk.say(Values(1, struct.pack(">i", 0)))
    with pytest.raises(WireError):
        talk.answer(InputsAnswer((VariableType.IN_USE,), 0))


@given(st.lists(st.binary(max_size=40), max_size=8), st.booleans())
def test_nothing_but_a_wire_error_comes_of_any_bytes_and_nothing_is_written(pieces, robot):
    talk = controlling().running()
    for piece in pieces:
        try:
            said = talk.line.answered(piece) if robot else talk.line.said(piece, slider=1.0, at_ms=0)
        except WireError:
            return
        assert not [f for f in Framer(0xFFFF).feed(said.to_robot) if isinstance(decode_request(f, 2), Values)]


# ---- outputs


def setting(slider=1.0):
    """An IO connection: it never starts, and its first package ends its set-up."""
    talk = Talk(slider=slider).begun(io_recipes(0), start=False)
    (own,) = talk.write({"standard_digital_output_mask": 0})
    assert talk.had(own.names) == []
    talk.own = Recipe(own.names, [INPUTS[n] for n in own.names])
    return talk


def test_an_output_is_judged_and_sets_nothing_else():
    talk = setting()
    for command, values in (
        (SetDigitalOutputs(Bank.STANDARD, 8, 8), {"standard_digital_output_mask": 8, "standard_digital_output": 255}),
        (SetDigitalOutputs(Bank.TOOL, 1, 0), {"tool_digital_output_mask": 1}),
    ):
        assert talk.write(values) == []
        (asked,) = talk.line.take()
        assert asked.question.command == command
        assert talk.line.outputs.forward(asked.question)
        assert not talk.line.outputs.forward(asked.question)
        (written,) = talk.settled()
        image = talk.own.unpack(written.packed)
        masks = {name: image[name] for name in image if name.endswith("_mask") and image[name]}
        assert masks == {f"{command.bank.value}_mask": command.mask}
        assert image[command.bank.value] == command.levels


def test_a_refused_output_is_not_written():
    talk = setting()
    talk.write({"standard_digital_output_mask": 8, "standard_digital_output": 8})
    (asked,) = talk.line.take()
    talk.seen.clear()
    talk.line.outputs.deny(asked.question, Reason.NOT_GRANTED, "NOT_GRANTED: no")
    assert not talk.line.outputs.forward(asked.question)
    assert talk.settled() == []
    assert talk.seen == [], "a client that has not started takes the next frame for an answer"
    assert talk.line.take() == [Tell("NOT_GRANTED: no", 1)], "but whoever runs it is told"


@pytest.mark.parametrize(
    ("slider", "fraction", "written", "asked"),
    [(1.0, 0.5, 1, 0), (0.5, 0.5, 0, 0), (0.5, 0.6, 0, 1), (float("nan"), 0.1, 0, 1)],
)
def test_the_slider_goes_down_without_a_judge_and_up_with_one(slider, fraction, written, asked):
    """A slider at its place is not set: written late, that would raise a slider just lowered."""
    talk = setting(slider)
    assert len(talk.write({"speed_slider_mask": 1, "speed_slider_fraction": fraction})) == written
    assert [act.question.command for act in talk.line.take()] == [SetSpeedSlider(fraction)] * asked


def test_an_output_that_is_asked_for_again_is_asked_for_once():
    talk = setting()
    for _ in range(3):
        talk.write({"standard_digital_output_mask": 8, "standard_digital_output": 8})
    assert [type(act) for act in talk.line.take()] == [AskJudge]


@pytest.mark.parametrize(
    ("first", "then", "same"),
    [
        ({"standard_digital_output": 8}, {"standard_digital_output": 0}, True),
        ({"standard_digital_output": 8}, {"standard_digital_output_mask": 12}, True),
        ({"standard_digital_output": 8}, {"standard_digital_output_mask": 4}, False),
        ({"standard_analog_output_mask": 1}, {"standard_analog_output_mask": 1, "standard_analog_output_0": 0.5}, True),
        ({"standard_analog_output_mask": 1}, {"standard_analog_output_mask": 2}, False),
        ({"speed_slider_mask": 1, "speed_slider_fraction": 1.0}, {"speed_slider_mask": 1}, True),
        ({INT[18]: 5}, {INT[18]: 6}, True),
        ({INT[18]: 5}, {DOUBLE[18]: 6.0}, False),
    ],
)
def test_who_asks_anew_for_the_same_output_does_not_want_what_was_asked_before(first, then, same):
    """A late decision on the older request is not set over the newer."""
    talk = setting(0.5)
    digital = {"standard_digital_output_mask": 8}
    talk.write({**(digital if "standard_digital_output" in first else {}), **first})
    (asked,) = talk.line.take()
    talk.write({**(digital if any(name.startswith("standard_digital") for name in then) else {}), **then})
    assert [act for act in talk.line.take() if isinstance(act, Withdraw)] == [Withdraw(asked.question)] * same
    assert talk.line.outputs.forward(asked.question) is not same


def test_an_output_that_the_line_refuses_itself_goes_on_record():
    talk = setting()
    for values, reason in (
        ({"tool_digital_output_mask": 255}, Reason.OUT_OF_RANGE),
        ({"speed_slider_mask": 1, "speed_slider_fraction": float("nan")}, Reason.NOT_FINITE),
    ):
        assert talk.write(values) == []
        noted, told = talk.line.take()
        assert isinstance(noted, Note)
        assert noted.refused.reason is reason
        assert told.text.startswith(f"{reason}: ")
        talk.write(dict.fromkeys(values, 0))
        talk.line.take()


def test_a_free_register_keeps_what_was_judged():
    talk = setting()
    talk.write({INT[18]: 5})
    (asked,) = talk.line.take()
    talk.line.outputs.forward(asked.question)
    talk.settled()
    talk.write({DOUBLE[19]: 0.5})
    (asked,) = talk.line.take()
    talk.line.outputs.forward(asked.question)
    (written,) = talk.settled()
    image = talk.own.unpack(written.packed)
    assert (image[INT[18]], image[DOUBLE[19]]) == (5, 0.5)


def test_what_waits_has_a_bound_and_an_end():
    talk = setting()
    for output in range(8):
        talk.write({"standard_digital_output_mask": 1 << output})
    talk.write({INT[18]: 1})
    *asked, noted, told = talk.line.take()
    assert [type(act) for act in asked] == [AskJudge] * 8
    assert (noted.refused.reason, noted.what) == (Reason.BUSY, "SetInputInteger")
    assert isinstance(told, Tell)
    talk.line.outputs.look(at_ms=60_001)
    talk.settled()
    assert [type(act) for act in talk.line.take()] == [Withdraw, Tell] * 8
    assert not talk.line.outputs.forward(asked[0].question)


# ---- a recipe of outputs that comes in place of another


def test_a_recipe_that_has_the_number_of_an_older_one_is_shown_in_its_own_form():
    """A controller may number the next one as the last: what was found in that says nothing of this."""
    talk = controlling()
    assert talk.package()["runtime_state"] == 1
    talk.say(Pause())
    talk.answer(PauseAnswer(True))
    talk.say(SetupOutputs(("timestamp", "robot_status_bits"), 500.0))
    shorter = Recipe(("timestamp", "robot_status_bits"), (VariableType.DOUBLE, VariableType.UINT32))
    talk.answer(OutputsAnswer(shorter.types, 1))
    talk.line.refresh()
    assert talk.settled() == []
    talk.say(Start())
    talk.answer(StartAnswer(True))
    talk.seen.clear()
    talk.answer(Values(1, shorter.pack({"timestamp": 7.0, "robot_status_bits": 3})))
    assert shorter.unpack(talk.seen[-1].packed) == {"timestamp": 7.0, "robot_status_bits": 1}


@pytest.mark.parametrize("answered", [True, False])
def test_outputs_are_not_set_up_while_they_are_sent(answered):
    talk = controlling()
    if not answered:
        talk.say(Pause())
        talk.answer(PauseAnswer(True))
        talk.say(Start())
    with pytest.raises(WireError):
        talk.say(SetupOutputs(SHOWN, 500.0))
