"""Programs that are a list of known statements, and everything else, which is refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.rtde.command.command_values import StopJ, StopL
from pep.rtde.command.io_commands import Bank, SetDigitalOutputs
from pep.rtde.robot.program import OURS
from pep.rtde.script.move_path import PathMove, Waypoint
from pep.rtde.script.statements import NAME, Sleep, StraightLine, TextMessage, WriteOutputDouble, WriteOutputInteger
from pep.rtde.script.straight_line import MAX_STATEMENTS, MAX_TEXT, STATEMENTS, straight_line
from pep.rtde.script.urscript import ProgramStream, parse
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_codes import Reason
from tests.ursim.cell import upload
from ursim.ports.script_ports import compile_text

pytestmark = pytest.mark.clause("RTDE-9")

Q = (0.1, -1.5, 1.5, -1.5, -1.5, 0.0)
POSE = (-0.3, -0.13, 0.3, 0.0, 3.1, 0.05)

KNOWN = [
    ("movej([0.1,-1.5,1.5,-1.5,-1.5,0], a=1, v=0.5)", Waypoint(PathMove.MOVEJ, False, Q, 0.5, 1.0, 0.0)),
    ("movej([0.1, -1.5, +1.5, -1.5, -1.5, 0.0])", Waypoint(PathMove.MOVEJ, False, Q, 1.05, 1.4, 0.0)),
    ("movej(p[-0.3,-0.13,0.3,0,3.1,0.05],2,1,0,0.02)", Waypoint(PathMove.MOVEJ, True, POSE, 1.0, 2.0, 0.02)),
    ("movel(p[-0.3,-0.13,0.3,0,3.1,0.05], v=0.1, r=0)", Waypoint(PathMove.MOVEL, True, POSE, 0.1, 1.2, 0.0)),
    ("movel([0.1,-1.5,1.5,-1.5,-1.5,0])", Waypoint(PathMove.MOVEL, False, Q, 0.25, 1.2, 0.0)),
    ("stopj(2)", StopJ(2.0, asynchronous=False)),
    ("stopl(a=10.5)", StopL(10.5, asynchronous=False)),
    ("set_digital_out(3, True)", SetDigitalOutputs(Bank.STANDARD, 8, 8)),
    ("set_standard_digital_out(0, False)", SetDigitalOutputs(Bank.STANDARD, 1, 0)),
    ("set_configurable_digital_out(7, True)", SetDigitalOutputs(Bank.CONFIGURABLE, 128, 128)),
    ("set_tool_digital_out(1, True)", SetDigitalOutputs(Bank.TOOL, 2, 2)),
    ("write_output_integer_register(0 +24, 1)", WriteOutputInteger(24, 1)),
    ("write_output_integer_register(5, -2147483648)", WriteOutputInteger(5, -(2**31))),
    ("write_output_float_register(47, -0.0)", WriteOutputDouble(47, -0.0)),
    ("sleep(0.5)", Sleep(0.5)),
    ('textmsg("target: 1.5, done")', TextMessage("target: 1.5, done")),
]


@pytest.mark.parametrize(("text", "statement"), KNOWN)
def test_each_statement_alone_and_in_a_definition(text, statement):
    for program in (text + "\n", f"def anything():\n  {text}\nend\n", f"def a():\n{text}\n  # why\n{text}\nend"):
        found = straight_line(program)
        assert isinstance(found, StraightLine)
        assert set(found.statements) == {statement}
        assert straight_line(found.render()) == found
        assert found.render().startswith(f"def {NAME}():\n")


def test_no_program_passes_for_the_control_script():
    assert NAME != OURS
    assert straight_line(f"def {OURS}():\n  sleep(0)\nend\n").render().startswith(f"def {NAME}():\n")


def test_the_simulated_robot_takes_what_is_sent():
    program = StraightLine(tuple(statement for _, statement in KNOWN))
    compile_text(program.render())


def test_every_known_statement_is_tried():
    assert {text.partition("(")[0] for text, _ in KNOWN} == STATEMENTS


def test_what_is_sent_is_written_anew():
    text = (
        "def rtde_control():\n\tmovej( [0.10,-1.5e0,1.5,-1.5,-1.5,0x0] ,v=.5)# x\n set_digital_out(b=True,n=1)\nend\n"
    )
    assert straight_line(text).render() == (
        f"def {NAME}():\n"
        "  movej([0.1, -1.5, 1.5, -1.5, -1.5, 0.0], a=1.4, v=0.5, r=0.0)\n"
        "  set_standard_digital_out(1, True)\n"
        "end\n"
    )


def test_what_ur_rtde_wraps_around_a_function_of_its_user_s():
    sent = "def foo():\n\twrite_output_integer_register(0 +0, 1)\n\tstopl(3)\n\twrite_output_integer_register(0 +0, 2)\nend\n"
    (program,) = ProgramStream(10**6).feed(sent)
    assert straight_line(program).statements == (
        WriteOutputInteger(0, 1),
        StopL(3.0, asynchronous=False),
        WriteOutputInteger(0, 2),
    )


MOVE = "movej([0,0,0,0,0,0])"


@pytest.mark.parametrize(
    "text",
    [
        f"sec a():\n{MOVE}\nend",
        f"thread a():\n{MOVE}\nend",
        f"def a(x=1):\n{MOVE}\nend",
        f"def a():\n{MOVE}\nend\ndef b():\n{MOVE}\nend",
        f"def a():\ndef b():\n{MOVE}\nend\nb()\nend",
        f"def a():\nwhile True:\n{MOVE}\nend\nend",
        f"def a():\nif True:\n{MOVE}\nend\nend",
        "def a():\na()\nend",
        "def a():\nx = 1\nend",
        "def a():\nglobal x = 1\nend",
        "def a():\nlocal x\nend",
        f"def a():\n{MOVE}\nreturn 1\nend",
        f"def a():\n{MOVE}\nhalt\nend",
        "def a():\nenter_critical\nend",
        "def a():\nrun b()\nend",
        "def a():\nkill b\nend",
        "x = movej([0,0,0,0,0,0])",
        *(f"{name}()" for name in ("movec", "movep", "servoj", "speedj", "speedl", "freedrive_mode", "force_mode")),
        *(
            f"{name}()"
            for name in ("set_tcp", "set_payload", "set_gravity", "interpreter_mode", "socket_open", "popup")
        ),
        *(f"{name}()" for name in ("rpc_factory", "modbus_add_signal", "rtde_set_watchdog", "protective_stop", "sync")),
        "digital_out[2]=True",
        "set_tool_voltage(24)",
        "movec(p[0,0,0,0,0,0],p[0,0,0,0,0,0])",
        'popup("x")',
    ],
)
def test_anything_else_is_unknown(text):
    assert straight_line(text).reason is Reason.TOOL_UNKNOWN


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("movej()", Reason.PARAMETERS_WRONG),
        ("movej([0,0,0,0,0])", Reason.PARAMETERS_WRONG),
        ("movej([0,0,0,0,0,0,0])", Reason.PARAMETERS_WRONG),
        ("movej(q)", Reason.PARAMETERS_WRONG),
        ("movej(get_target_joint_positions())", Reason.PARAMETERS_WRONG),
        ("movej([0,0,0,0,0,x])", Reason.PARAMETERS_WRONG),
        ("movej([0,0,0,0,0,1+1])", Reason.PARAMETERS_WRONG),
        ("movej([0,0,0,0,0,--1])", Reason.PARAMETERS_WRONG),
        ("movej([0,0,0,0,0,True])", Reason.PARAMETERS_WRONG),
        ("movej([0,0,0,0,0,d2r(1)])", Reason.PARAMETERS_WRONG),
        ("movej([0,0,0,0,0,0],1,1,0,0,0)", Reason.PARAMETERS_WRONG),
        ("movej([0,0,0,0,0,0],q=[0,0,0,0,0,0])", Reason.PARAMETERS_WRONG),
        ("movej([0,0,0,0,0,0],z=1)", Reason.PARAMETERS_WRONG),
        ("movej([0,0,0,0,0,0],t=2)", Reason.ROBOT_LIMIT),
        ("movej([0,0,0,0,0,0],v=3.15)", Reason.ROBOT_LIMIT),
        ("movej([0,0,0,0,0,0],a=-1)", Reason.ROBOT_LIMIT),
        ("movel(p[0,0,0,0,0,0],v=3.1)", Reason.ROBOT_LIMIT),
        ("movel(p[0,0,0,0,0,0],r=2.1)", Reason.ROBOT_LIMIT),
        ("stopj(0)", Reason.ROBOT_LIMIT),
        ("stopl()", Reason.PARAMETERS_WRONG),
        ("sleep(601)", Reason.ROBOT_LIMIT),
        ("sleep(-1)", Reason.ROBOT_LIMIT),
        ("set_digital_out(8, True)", Reason.OUT_OF_RANGE),
        ("set_digital_out(-1, True)", Reason.OUT_OF_RANGE),
        ("set_tool_digital_out(2, True)", Reason.OUT_OF_RANGE),
        ("set_digital_out(1.0, True)", Reason.PARAMETERS_WRONG),
        ("set_digital_out(1, 1)", Reason.PARAMETERS_WRONG),
        ("write_output_integer_register(48, 1)", Reason.OUT_OF_RANGE),
        ("write_output_integer_register(0, 2147483648)", Reason.OUT_OF_RANGE),
        ("write_output_integer_register(0, 1.5)", Reason.PARAMETERS_WRONG),
        ("write_output_float_register(48, 1)", Reason.OUT_OF_RANGE),
        ("textmsg(1)", Reason.PARAMETERS_WRONG),
        ('textmsg("a", "b")', Reason.PARAMETERS_WRONG),
        ('textmsg("$(a)")', Reason.PARAMETERS_WRONG),
        ('textmsg("' + "a" * 201 + '")', Reason.PARAMETERS_WRONG),
        ("movej([nan,0,0,0,0,0])", Reason.PARAMETERS_WRONG),
        ("movej([1e400,0,0,0,0,0])", Reason.BODY_MALFORMED),
        ("stop program", Reason.BODY_MALFORMED),
        ("", Reason.BODY_MALFORMED),
        ("def a():\nend", Reason.BODY_MALFORMED),
        ("def a():", Reason.BODY_MALFORMED),
        ("\x00", Reason.BODY_MALFORMED),
        ("sleep(0)\n" * (MAX_STATEMENTS + 1), Reason.BODY_TOO_LARGE),
        ("#" * (MAX_TEXT + 1), Reason.BODY_TOO_LARGE),
    ],
)
def test_what_a_statement_may_not_be_given(text, reason):
    for program in (text, f"def a():\n{text}\nend") if "def" not in text and text else (text,):
        found = straight_line(program)
        assert isinstance(found, InputRefusal)
        assert found.reason is reason


def test_the_control_script_is_no_straight_line():
    assert straight_line(upload()).reason is Reason.TOOL_UNKNOWN


finite = st.floats(allow_nan=False, allow_infinity=False)
part = st.floats(0.0, 2.0)
banks = st.sampled_from([(Bank.STANDARD, 8), (Bank.CONFIGURABLE, 8), (Bank.TOOL, 2)])
statements = st.one_of(
    st.builds(
        Waypoint,
        *(st.sampled_from([PathMove.MOVEJ, PathMove.MOVEL]), st.booleans(), st.tuples(*[finite] * 6)),
        *(part, part, part),
    ),
    st.builds(StopJ, st.floats(1e-300, 1e9), st.just(False)),
    st.builds(StopL, st.floats(1e-300, 1e9), st.just(False)),
    banks.flatmap(
        lambda bank: st.builds(
            lambda n, high: SetDigitalOutputs(bank[0], 1 << n, high << n), st.integers(0, bank[1] - 1), st.booleans()
        )
    ),
    st.builds(WriteOutputInteger, st.integers(0, 47), st.integers(-(2**31), 2**31 - 1)),
    st.builds(WriteOutputDouble, st.integers(0, 47), finite),
    st.builds(Sleep, st.floats(0.0, 600.0)),
    st.builds(TextMessage, st.text("abcXYZ019 .,:_-", max_size=200)),
)


@pytest.mark.long
@given(st.lists(statements, min_size=1, max_size=8).map(tuple))
def test_any_program_survives_its_text(found):
    program = StraightLine(found)
    assert straight_line(program.render()) == program
    assert straight_line(program.render()).render() == program.render()


words = st.sampled_from(
    [
        *sorted(STATEMENTS),
        "def a():",
        "end",
        "(",
        ")",
        "[",
        "]",
        "p[",
        ",",
        "1",
        "-",
        "0.5",
        "True",
        "\n",
        "=",
        "a",
        '"x"',
    ]
)


@given(st.one_of(st.text(max_size=80), st.lists(words, max_size=40).map(" ".join)))
def test_whatever_is_sent_never_raises(text):
    found = straight_line(text)
    assert isinstance(found, StraightLine | InputRefusal)
    if isinstance(found, StraightLine):
        parse(found.render())
