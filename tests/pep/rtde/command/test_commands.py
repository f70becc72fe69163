"""Every command of the table, out of an image and back, and the meaning of any package."""

import math
import re
from dataclasses import fields

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.rtde.command.command_table import EVERY_CYCLE, READS, ROWS, CommandClass, Wait, decode, encode, row_of
from pep.rtde.command.image_changes import Change, Cleared, Commanded, Drifted, Staged, Swapped, Unchanged, changes
from pep.rtde.command.io_commands import (
    Bank,
    Quantity,
    SetAnalogOutput,
    SetDigitalOutputs,
    SetInputDouble,
    SetInputInteger,
    SetSpeedSlider,
    decode_io,
)
from pep.rtde.command.register_image import RegisterImage
from pep.rtde.wire.recipes import DOUBLE, EXTERNAL_WRENCH, INT, WritableVariables
from pep.rtde.wire.refusal import InputRefusal
from pep.rtde.wire.variables import INPUTS, VariableType
from policies.words.reason_codes import Reason

from pep.rtde.command import command_values as v
from pep.rtde.command import fields as f

OFFSETS = (0, 24)
PROFILES = {offset: WritableVariables.of(offset, control=True, io=True) for offset in OFFSETS}
NAN, INF = math.nan, math.inf

finite = st.floats(allow_nan=False, allow_infinity=False)
offsets = st.sampled_from(OFFSETS)


def blank(offset=0):
    return RegisterImage.blank(PROFILES[offset])


def image_of(command, offset=0):
    image = blank(offset).merge(encode(command, offset))
    assert isinstance(image, RegisterImage)
    return image


def in_span(span):
    low = None if math.isinf(span.low) else span.low
    return st.floats(low, None if math.isinf(span.high) else span.high, allow_nan=False, allow_infinity=False)


def value_of(field):
    match field:
        case f.Number(_, span):
            return in_span(span)
        case f.Numbers(_, count):
            return st.tuples(*[finite] * count)
        case f.Whole(_, low, high):
            return st.integers(low, high)
        case f.Flag():
            return st.booleans()
        case f.Flags():
            return st.tuples(*[st.booleans()] * 6)
        case f.FrameNumber():
            return st.sampled_from(v.JogFrame)
        case f.Vector():
            return st.tuples(*[finite] * 6)
        case f.Fixed(value):
            return st.just(value)
        case _:
            raise AssertionError(field)


def of_row(row):
    return st.builds(row.make, *map(value_of, row.fields))


commands = st.sampled_from(sorted(ROWS)).flatmap(lambda number: of_row(ROWS[number]))


def anything(kind):
    match kind:
        case VariableType.DOUBLE:
            return st.floats()
        case VariableType.VECTOR6D:
            return st.tuples(*[st.floats()] * 6)
        case VariableType.UINT8:
            return st.integers(0, 255)
        case VariableType.UINT32:
            return st.integers(0, 2**32 - 1)
        case VariableType.INT32:
            return st.integers(-3, 260) | st.integers(-(2**31), 2**31 - 1)
        case _:
            raise AssertionError(kind)


def packages(offset):
    names = sorted(PROFILES[offset].names)
    return st.lists(st.sampled_from(names), unique=True, max_size=40).flatmap(
        lambda chosen: st.fixed_dictionaries({name: anything(INPUTS[name]) for name in chosen})
    )


# ---------------------------------------------------------------------------------------------------------- every row


@pytest.mark.clause("RTDE-3")
@given(commands, offsets)
def test_every_command_survives_the_registers(command, offset):
    assert decode(image_of(command, offset)) == command


@pytest.mark.clause("RTDE-3")
@pytest.mark.parametrize("number", sorted(ROWS))
def test_every_row_is_of_a_type_of_its_own_and_names_its_fields_in_order(number):
    row = ROWS[number]
    assert row.id == number
    if row.make not in (v.Read, v.End):
        assert [other.id for other in ROWS.values() if other.make is row.make] == [number]
    assert len(fields(row.make)) == len(row.fields)


@pytest.mark.clause("RTDE-4")
def test_ids_without_a_row_are_no_command():
    undefined = {*range(-3, 300)} - set(ROWS)
    assert {5, 32, 99, 254, 13, 14, 22, 23, 48, 49, 50} <= undefined
    for number in (*undefined, -(2**31), 2**31 - 1):
        image = blank().merge({INT[0]: number})
        assert decode(image) == InputRefusal(Reason.TOOL_UNKNOWN, "command id")


def bad_values(row, offset):
    """Each way in which one register of a row can be wrong: name, value, reason."""
    for field in row.fields:
        for name in field.names(offset):
            match field:
                case f.Numbers():
                    for value in (NAN, INF, -INF):
                        yield name, value, Reason.NOT_FINITE
                case f.Vector():
                    for value in (NAN, INF, -INF):
                        yield name, (0.0, 0.0, value, 0.0, 0.0, 0.0), Reason.NOT_FINITE
                case f.Number(_, span):
                    for value in (NAN, INF, -INF):
                        yield name, value, Reason.NOT_FINITE
                    for edge, beyond in ((span.low, -INF), (span.high, INF)):
                        if math.isfinite(edge):
                            yield name, math.nextafter(edge, beyond), Reason.ROBOT_LIMIT
                case f.Whole(_, low, high):
                    for value in {low - 1, min(high + 1, 2**31 - 1), -(2**31)} - set(range(low, min(high, 9) + 1)):
                        if not low <= value <= high:
                            yield name, value, Reason.OUT_OF_RANGE
                case f.Flag() | f.Flags():
                    for value in (2, -1, 2**31 - 1):
                        yield name, value, Reason.PARAMETERS_WRONG
                case f.FrameNumber():
                    yield name, NAN, Reason.NOT_FINITE
                    for value in (0.5, 3.0, -1.0):
                        yield name, value, Reason.PARAMETERS_WRONG
                case _:
                    raise AssertionError(field)


GOOD = {
    f.JOINT_SPEED: 1.0,
    f.LOOKAHEAD: 0.1,
    f.GAIN: 300.0,
    f.FORCE_DAMPING: 0.5,
}


def good(row):
    """A command of the row."""

    def value(field):
        match field:
            case f.Number(_, span):
                return GOOD.get(span, 1.0)
            case f.Numbers(_, count):
                return tuple(0.1 * i for i in range(count))
            case f.Whole(_, low, _):
                return low
            case f.Flag():
                return True
            case f.Flags():
                return (True, False, True, False, True, False)
            case f.FrameNumber():
                return v.JogFrame.TOOL
            case f.Vector():
                return (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
            case f.Fixed(fixed):
                return fixed

    return row.make(*map(value, row.fields))


@pytest.mark.clause("RTDE-4")
@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("number", sorted(ROWS))
def test_every_wrong_parameter_is_refused_with_its_reason_and_its_command(number, offset):
    row = ROWS[number]
    image = image_of(good(row), offset)
    tried = 0
    for name, value, reason in bad_values(row, offset):
        found = decode(image.merge({name: value}))
        assert isinstance(found, InputRefusal), (name, value)
        assert (found.reason, found.command) == (reason, number), (name, value)
        tried += 1
    assert bool(tried) == bool(READS[number, offset])


@pytest.mark.clause("RTDE-4")
@pytest.mark.parametrize("number", sorted(ROWS))
def test_a_command_does_not_look_at_what_it_does_not_use(number):
    command = good(ROWS[number])
    image = image_of(command)
    rubbish = {name: NAN for name in PROFILES[0].names if INPUTS[name] is VariableType.DOUBLE}
    rubbish |= {EXTERNAL_WRENCH: (NAN,) * 6, **dict.fromkeys(INT[1:8], -7)}
    used = READS[number, 0]
    assert decode(image.merge({name: value for name, value in rubbish.items() if name not in used})) == command


@pytest.mark.parametrize("number", sorted(ROWS))
def test_what_a_command_reads_is_what_is_written_for_it(number):
    for offset in OFFSETS:
        assert set(encode(good(ROWS[number]), offset)) == {INT[offset], *READS[number, offset]}


@pytest.mark.clause("RTDE-4")
def test_a_stop_that_is_badly_said_is_known_for_a_stop():
    stops = [row for row in ROWS.values() if row.command_class is CommandClass.STOP]
    assert {row.id for row in stops} == {7, 15, 16, 19, 31, 33, 34, 42, 53, 255}
    for row in (row for row in stops if row.fields and READS[row.id, 0]):
        for weak in (0.0, -1.0, NAN, INF):
            found = decode(image_of(good(row)).merge({DOUBLE[0]: weak}))
            assert isinstance(found, InputRefusal)
            assert found.command == row.id


def test_the_reference_names_the_same_classes_and_ways_to_wait():
    def ids(choose):
        return {row.id for row in ROWS.values() if choose(row)}

    assert ids(lambda r: r.command_class is CommandClass.MOTION) == {
        *(1, 2, 3, 4, 6, 9, 10, 11, 12, 18, 24, 41, 45, 51, 52, 66)
    }
    assert ids(lambda r: r.command_class is CommandClass.CONFIGURATION) == {8, 17, 20, 21, 29, 55, 56, 57, 59, 65}
    assert ids(lambda r: r.command_class is CommandClass.CONTROL) == {0, 35, 62, 63}
    assert ids(lambda r: r.wait is Wait.AT_ONCE) == {0, 6, 9, 10, 11, 12, 24, 25, 26, 27, 38, 55, 58, *range(66, 72)}
    assert ids(lambda r: r.wait is Wait.PROGRAM_END) == {255}
    assert row_of(v.End(v.StopKind.JOG)).id == 42


# -------------------------------------------------------------------------------------- against the script that runs it


@pytest.fixture(scope="module")
def script():
    client = pytest.importorskip("script_client", reason="ur_rtde is not installed")
    return client.ScriptClient("127.0.0.1", 5, 26).getScript()


def test_the_rows_are_the_branches_of_the_control_script(script):
    body = script[script.index("def process_cmd(cmd):") :]
    branches = {int(n) for n in re.findall(r"if cmd == (\d+):", body)} - {0}  # 0 in the main loop is no command
    assert branches - {254} == set(ROWS) - {0, 55}


def test_what_is_read_again_in_each_cycle_is_what_the_script_says(script):
    (line,) = re.findall(r"if ((?:cmd == \d+ or )+cmd == \d+):", script)
    assert {int(n) for n in re.findall(r"\d+", line)} == EVERY_CYCLE


READ_BUT_NOT_USED = {11: {"d6", "d7"}, 24: {"d6", "d7"}, 66: {f"d{i}" for i in range(6, 18)}}


def test_the_registers_are_those_that_the_script_reads(script):
    body = script[script.index("def process_cmd(cmd):") :]
    pieces = re.split(r"if cmd == (\d+):", body[: body.index("HEADER_END")])
    stop = script[script.index("def exec_stopl_stopj") : script.index("thread force_thread")]
    for number, piece in zip(map(int, pieces[1::2]), pieces[2::2], strict=True):
        text = stop if "exec_stopl_stopj" in piece else piece
        read = {f"d{i}" for i in re.findall(r"read_input_float_reg\((\d+)\)", text)}
        read |= {f"i{i}" for i in re.findall(r"read_input_integer_reg\((\d+)\)", text)}
        for first in map(int, re.findall(r"(?:q|pose)_from_input_float_registers\((\d+)\)", text)):
            read |= {f"d{i}" for i in range(first, first + 6)}
        if number in ROWS and number != 255:
            known = {name.replace("input_double_register_", "d") for name in READS[number, 0]}
            known = {name.replace("input_int_register_", "i") for name in known}
            assert read - READ_BUT_NOT_USED.get(number, set()) == known, number


# ------------------------------------------------------------------------------------------------- whatever is written


@pytest.mark.long
@pytest.mark.clause("RTDE-3", "RTDE-5")
@given(st.data(), offsets)
def test_nothing_that_a_client_writes_raises(data, offset):
    image = blank(offset)
    for package in data.draw(st.lists(packages(offset), max_size=6)):
        after = image.merge(package)
        assert isinstance(after, RegisterImage)
        assert isinstance(decode(after), v.Command | InputRefusal)
        assert isinstance(changes(image, after), Change | InputRefusal)
        assert isinstance(decode_io(after, package), tuple | InputRefusal)
        image = after


@given(st.data(), offsets)
def test_a_refused_or_decoded_command_never_holds_what_is_not_finite(data, offset):
    found = decode(blank(offset).merge(data.draw(packages(offset))))
    if isinstance(found, InputRefusal):
        return
    for each in fields(found):
        value = getattr(found, each.name)
        for number in value if isinstance(value, tuple) else (value,):
            assert not isinstance(number, float) or math.isfinite(number)


@pytest.mark.clause("RTDE-2")
def test_an_image_takes_only_its_own_variables_in_their_types():
    image = RegisterImage.blank(WritableVariables.of(24, control=True, io=False))
    for name in (INT[0], DOUBLE[5], "speed_slider_mask", DOUBLE[47], "nonsense"):
        assert image.merge({name: 0}) == InputRefusal(Reason.TOOL_UNKNOWN, "a variable outside the profile")
    for name, value, reason in (
        (INT[24], 1.0, Reason.PARAMETERS_WRONG),
        (INT[24], True, Reason.PARAMETERS_WRONG),
        (INT[24], 2**31, Reason.OUT_OF_RANGE),
        (INT[24], -(2**31) - 1, Reason.OUT_OF_RANGE),
        (DOUBLE[24], 1, Reason.PARAMETERS_WRONG),
        (EXTERNAL_WRENCH, (0.0,) * 5, Reason.PARAMETERS_WRONG),
        (EXTERNAL_WRENCH, (0.0,) * 5 + (1,), Reason.PARAMETERS_WRONG),
        (EXTERNAL_WRENCH, 1.0, Reason.PARAMETERS_WRONG),
    ):
        assert image.merge({name: value}) == InputRefusal(reason, name)
    outputs = RegisterImage.blank(WritableVariables.of(0, control=False, io=True))
    assert outputs.merge({"standard_digital_output": 256}).reason is Reason.OUT_OF_RANGE
    assert outputs.merge({"speed_slider_mask": -1}).reason is Reason.OUT_OF_RANGE
    assert isinstance(image.merge({DOUBLE[24]: NAN}), RegisterImage)


@pytest.mark.clause("RTDE-2")
def test_what_was_never_written_is_zero_and_what_was_stays():
    image = blank(24)
    assert decode(image) == v.Clear()
    staged = image.merge({DOUBLE[24 + 3]: 0.4, DOUBLE[24 + 9]: 0.1, DOUBLE[24 + 10]: 300.0, DOUBLE[24 + 8]: 0.002})
    servo = staged.merge({INT[24]: 11})
    assert decode(servo) == v.ServoJ((0.0, 0.0, 0.0, 0.4, 0.0, 0.0), 0.002, 0.1, 300.0)
    assert servo.doubles(2, 2) == (0.0, 0.4)
    assert image.vector(EXTERNAL_WRENCH) == (0.0,) * 6
    assert RegisterImage.blank(WritableVariables.of(0, control=False, io=True)).vector(EXTERNAL_WRENCH) == (0.0,) * 6


# -------------------------------------------------------------------------------------------------- what a package meant

MOVE = v.MoveJ((0.1, 0.2, 0.3, 0.4, 0.5, 0.6), 1.0, 2.0, asynchronous=False)
SPEED = v.SpeedJ((0.1, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0, 0.0)


def step(image, package):
    after = image.merge(package)
    assert isinstance(after, RegisterImage)
    return after, changes(image, after)


@pytest.mark.clause("RTDE-5")
def test_staged_registers_count_when_the_id_comes_alone():
    parameters = {name: value for name, value in encode(MOVE, 0).items() if name != INT[0]}
    image, found = step(blank(), parameters)
    assert found == Staged(tuple(name for name in image.values if image.values[name] != blank().values[name]))
    assert set(found.names) == set(parameters) - {INT[1]}  # not asynchronous: 0 stood there already
    assert step(image, {INT[0]: 1})[1] == Commanded(MOVE)


@pytest.mark.clause("RTDE-5")
def test_parameters_of_a_live_command_drift_without_its_id():
    image, found = step(blank(), encode(SPEED, 0))
    assert found == Commanded(SPEED)
    image, found = step(image, {DOUBLE[1]: 3.0})
    assert found == Drifted(v.SpeedJ((0.1, 3.0, 0.0, 0.0, 0.0, 0.0), 1.0, 0.0))
    assert step(image, {DOUBLE[1]: NAN})[1] == InputRefusal(Reason.NOT_FINITE, "speedJ: doubles from 0", 9)
    assert step(image, {DOUBLE[8]: 3.0})[1] == Staged((DOUBLE[8],))


@pytest.mark.clause("RTDE-5")
def test_rubbish_that_stays_is_no_news():
    image, _ = step(blank(), {**encode(SPEED, 0), DOUBLE[8]: NAN})
    assert step(image, {**encode(SPEED, 0), DOUBLE[8]: float("nan")})[1] == Unchanged()
    assert step(image, {DOUBLE[8]: 0.0})[1] == Staged((DOUBLE[8],))


@pytest.mark.clause("RTDE-5")
def test_parameters_of_a_command_that_is_read_once_are_swapped_without_its_id():
    image, _ = step(blank(), encode(MOVE, 0))
    assert step(image, {DOUBLE[0]: 3.0})[1] == Swapped(
        v.MoveJ((3.0, 0.2, 0.3, 0.4, 0.5, 0.6), 1.0, 2.0, asynchronous=False)
    )
    assert step(image, {INT[1]: 2})[1] == InputRefusal(Reason.PARAMETERS_WRONG, "moveJ: integer 1", 1)


@pytest.mark.parametrize("number", sorted(set(ROWS) - {0}))
def test_each_register_of_a_standing_command_counts_and_no_other(number):
    row = ROWS[number]
    image = image_of(good(row))
    for name in sorted(PROFILES[0].names - {INT[0]}):
        kind = INPUTS[name]
        other = {
            VariableType.DOUBLE: 0.15 if image.values[name] != 0.15 else 0.16,
            VariableType.VECTOR6D: (0.5,) * 6,
        }.get(kind, 0 if image.values[name] == 1 else 1)
        if number == 6 and name == INT[1]:
            other = 2
        if row.make is v.JogStart and name == DOUBLE[6]:
            other = 2.0
        if isinstance(row.make, type) and row.make in (v.ServoJ, v.ServoL) and name == DOUBLE[10]:
            other = 400.0
        found = step(image, {name: other})[1]
        if name in READS[number, 0]:
            assert isinstance(found, Drifted if row.every_cycle else Swapped), name
            assert decode(image.merge({name: other})) == found.command != good(row)
        else:
            assert found == Staged((name,))


@pytest.mark.clause("RTDE-5")
def test_one_command_in_the_place_of_another_is_a_new_one():
    image, _ = step(blank(), encode(SPEED, 0))
    image, found = step(image, {INT[0]: 10})
    assert found == Commanded(v.SpeedL(SPEED.qd_rad_s, 1.0, 0.0))
    image, found = step(image, {INT[0]: 0, DOUBLE[0]: 9.0})
    assert found == Cleared()
    assert step(image, {INT[0]: 0})[1] == Unchanged()
    assert step(image, {INT[0]: 10})[1] == Commanded(v.SpeedL((9.0, *SPEED.qd_rad_s[1:]), 1.0, 0.0))
    assert step(image, {INT[0]: 254})[1] == InputRefusal(Reason.TOOL_UNKNOWN, "command id")


@given(commands, offsets)
def test_the_same_package_again_says_nothing(command, offset):
    image = image_of(command, offset)
    assert step(image, encode(command, offset))[1] == Unchanged()


# --------------------------------------------------------------------------------------------------------------- outputs


@pytest.mark.clause("RTDE-6")
def test_outputs_count_by_their_mask_and_each_time_that_they_are_written():
    image = blank()
    for bank, mask, levels in ((Bank.STANDARD, 0x81, 0xFF), (Bank.CONFIGURABLE, 2, 1), (Bank.TOOL, 3, 2)):
        package = {f"{bank.value}_mask": mask, bank.value: levels}
        after = image.merge(package)
        for _ in range(2):
            assert decode_io(after, package) == (SetDigitalOutputs(bank, mask, levels & mask),)
        assert decode_io(after, {DOUBLE[0]}) == ()
        assert decode_io(after, {bank.value}) == (SetDigitalOutputs(bank, mask, levels & mask),)  # a staged mask
        assert decode_io(after.merge({f"{bank.value}_mask": 0}), package) == ()
    tool = image.merge({"tool_digital_output_mask": 4})
    assert decode_io(tool, {"tool_digital_output"}) == InputRefusal(Reason.OUT_OF_RANGE, "tool_digital_output_mask")


@pytest.mark.clause("RTDE-6")
def test_rubbish_under_no_mask_is_no_analog_output():
    names = ["mask", "type", "0", "1"]

    def said(*values):
        package = {f"standard_analog_output_{n}": x for n, x in zip(names, values, strict=True)}
        return decode_io(blank().merge(package), package)

    assert said(1, 0b01, 0.5, NAN) == (SetAnalogOutput(0, Quantity.VOLTAGE, 0.5),)
    assert said(2, 0b01, NAN, 1.0) == (SetAnalogOutput(1, Quantity.CURRENT, 1.0),)
    assert said(3, 0b10, 0.0, 0.25) == (
        SetAnalogOutput(0, Quantity.CURRENT, 0.0),
        SetAnalogOutput(1, Quantity.VOLTAGE, 0.25),
    )
    assert said(0, 3, NAN, INF) == ()
    assert said(2, 0, 0.0, NAN) == InputRefusal(Reason.NOT_FINITE, "standard_analog_output_1")
    assert said(1, 0, 1.01, 0.0) == InputRefusal(Reason.ROBOT_LIMIT, "standard_analog_output_0")
    assert said(4, 0, 0.0, 0.0) == InputRefusal(Reason.OUT_OF_RANGE, "standard_analog_output_mask")


@pytest.mark.clause("RTDE-6")
@pytest.mark.parametrize("offset", OFFSETS)
def test_the_slider_the_free_registers_and_the_wrench(offset):
    def said(package):
        return decode_io(blank(offset).merge(package), package)

    slider = {"speed_slider_mask": 1, "speed_slider_fraction": 0.5}
    assert said(slider) == (SetSpeedSlider(0.5),)
    assert said(slider | {"speed_slider_mask": 0}) == ()
    assert said(slider | {"speed_slider_mask": 2}) == InputRefusal(Reason.OUT_OF_RANGE, "speed_slider_mask")
    assert said(slider | {"speed_slider_fraction": NAN}) == InputRefusal(Reason.NOT_FINITE, "speed_slider_fraction")
    for fraction in (1.0000001, -0.1):
        assert said(slider | {"speed_slider_fraction": fraction}).reason is Reason.ROBOT_LIMIT
    for register in range(offset + 18, offset + 23):
        assert said({INT[register]: -5}) == (SetInputInteger(register, -5),)
        assert said({DOUBLE[register]: 0.0}) == (SetInputDouble(register, 0.0),)
        assert said({DOUBLE[register]: INF}) == InputRefusal(Reason.NOT_FINITE, DOUBLE[register])
    assert said({INT[offset + 23]: 49}) == ()
    wrench = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert said({EXTERNAL_WRENCH: wrench}) == (v.SetExternalWrench(wrench),)
    assert said({EXTERNAL_WRENCH: (NAN,) * 6}) == InputRefusal(Reason.NOT_FINITE, EXTERNAL_WRENCH)
