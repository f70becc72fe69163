"""ur_rtde's control script and nothing else: every byte of it, and a path in a grammar without choices."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.base.errors import ConfigError, PepFault
from pep.rtde.script.control_script import (
    MAX_SCRIPT,
    Recogniser,
    Upload,
    allow_list,
    installed_body,
    scripts_for,
)
from pep.rtde.script.move_path import MAX_LINE, MAX_WAYPOINTS, PathMove, Waypoint, render_path
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_codes import Reason
from tests.ursim.cell import HOME, upload

rtde_control = pytest.importorskip("rtde_control", reason="ur_rtde is not installed")

pytestmark = [pytest.mark.clause("RTDE-7"), pytest.mark.version]

MINORS = (0, 1, 2, 3, 4, 8, 9, 10, 11, 15, 22, 23, 25, 26, 30)
PATH = (
    Waypoint(PathMove.MOVEJ, False, (0.1, -1.5, 1.4, -1.3, -0.000123457, 1e-05), 0.5, 0.75, 0.01),
    Waypoint(PathMove.MOVEJ, True, (-0.3, -0.13, 0.3, -0.0, 3.1, 0.05), 1.0, 1.5, 0.0),
    Waypoint(PathMove.MOVEL, True, (-0.3, -0.13, 0.31, 0.1, 3.1, 0.05), 0.25, 1.2, 0.02),
    Waypoint(PathMove.MOVEP, True, (-0.3, -0.13, 0.3, 0.1, 123457.0, 1e300), 0.1, 1.2, 0.0),
)


@pytest.fixture(scope="module")
def scripts():
    return allow_list(installed_body)


def recognise(scripts, program, size=4096):
    recogniser = Recogniser(scripts)
    answer = None
    for at in range(0, len(program), size):
        answer = recogniser.feed(program[at : at + size])
        if answer is not None:
            return answer
    return answer


def refusal(scripts, program, size=4096):
    found = recognise(scripts, program, size)
    assert isinstance(found, InputRefusal), found
    return found.reason


def with_path(block, minor=11, offset=0):
    text = upload(5, minor, offset)
    head, mark, tail = text.partition("# inject move path\n")
    return (head + mark).encode() + block + tail.encode()


# ----------------------------------------------------------------------------------------------------------- the whole


@pytest.mark.parametrize("minor", MINORS)
@pytest.mark.parametrize("offset", [0, 24])
def test_each_version_and_offset_is_recognised_and_rendered_byte_for_byte(scripts, minor, offset):
    program = upload(5, minor, offset).encode()
    found = recognise(scripts_for(minor, scripts), program)
    assert isinstance(found, Upload)
    assert found.script.offset == offset
    assert found.script.since <= minor
    assert found.path == ()
    assert found.render() == program
    assert recognise(scripts, program) == found
    assert len(program) <= MAX_SCRIPT


def test_a_version_takes_its_own_scripts_alone(scripts):
    assert len(scripts) == 14
    for minor in MINORS:
        own = scripts_for(minor, scripts)
        assert [script.offset for script in own] == [0, 24]
        for other in MINORS:
            if scripts_for(other, scripts) != own:
                assert refusal(own, upload(5, other).encode()) is Reason.TOOL_DEFINITION_CHANGED


@pytest.mark.parametrize("size", [1, 7, 1000, 10**6])
def test_however_it_is_torn(scripts, size):
    program = with_path(render_path(PATH))
    found = recognise(scripts_for(11, scripts), program, size)
    assert isinstance(found, Upload)
    assert found.path == PATH
    assert found.render() == program


def test_a_tampered_library_is_no_allow_list():
    for minor in (0, 11, 26):
        body = installed_body(minor)
        for changed in (body.replace("stopl(10)", "stopl(1)", 1), body + " ", body[:-1], body.replace("e", "E", 1)):
            assert changed != body
            with pytest.raises(ConfigError) as raised:
                allow_list(lambda n, changed=changed, minor=minor: changed if n >= minor else installed_body(n))
            assert raised.value.code is PepFault.CONFIG_INVALID
    with pytest.raises(ConfigError):
        allow_list(lambda n: "")


# ---------------------------------------------------------------------------------------------------- one byte, anywhere


def test_one_other_byte_anywhere_is_refused_as_soon_as_it_comes(scripts):
    own = scripts_for(11, scripts)
    program = upload().encode()
    places = random.Random(7).sample(range(len(program)), 1500)
    for place in (0, 1, len(program) - 1, *places):
        changed = bytearray(program)
        changed[place] ^= 1 << place % 8
        recogniser = Recogniser(own)
        before = recogniser.feed(bytes(changed[:place]))
        assert before is None
        found = recogniser.feed(bytes(changed[place : place + 1]))
        if found is None:  # a tab in the place of the path: refused at the end of its line
            assert changed[place] == 0x09 or program[place : place + 1] in (b"0", b"2")
            found = recogniser.feed(bytes(changed[place + 1 :]))
        assert isinstance(found, InputRefusal), place


def test_a_byte_left_out_or_put_in_is_refused(scripts):
    own = scripts_for(11, scripts)
    program = upload().encode()
    for place in random.Random(8).sample(range(len(program) - 1), 500):
        if program[place] != program[place + 1]:
            assert isinstance(recognise(own, program[:place] + program[place + 1 :]), InputRefusal), place
        assert isinstance(recognise(own, program[:place] + b"\x01" + program[place:]), InputRefusal), place


@pytest.mark.long
def test_each_byte_of_the_path_counts(scripts):
    """A changed byte that gives another path is that path, as it was read; all others are refused."""
    own = scripts_for(11, scripts)
    block = render_path(PATH)
    begin = with_path(b"").index(b"# inject move path\n") + len(b"# inject move path\n")
    read = 0
    for place in range(len(block)):
        for bit in range(8):
            changed = bytearray(block)
            changed[place] ^= 1 << bit
            program = with_path(bytes(changed))
            assert program[begin : begin + len(block)] == bytes(changed)
            found = recognise(own, program, 10**6)
            if isinstance(found, Upload):
                assert found.path != PATH
                assert found.render() == program
                assert chr(block[place]) in "0123456789jlp-+"
                read += 1
    assert 0 < read < len(block)


@pytest.mark.parametrize(
    "statement", ["\tset_tcp(p[0,0,0,0,0,0])\n", "    movej([0,0,0,0,0,0])\n", "#\n", "\n", " ", "\t"]
)
def test_an_extra_statement_is_refused_wherever_it_stands(scripts, statement):
    own = scripts_for(11, scripts)
    lines = upload().splitlines(keepends=True)
    for at in range(0, len(lines), 37):
        program = "".join((*lines[:at], statement, *lines[at:])).encode()
        if program != upload().encode():
            assert isinstance(recognise(own, program), InputRefusal), at
    path = render_path(PATH).decode().splitlines(keepends=True)
    for at in range(len(path) + 1):
        found = recognise(own, with_path("".join((*path[:at], statement, *path[at:])).encode()))
        assert isinstance(found, InputRefusal), at


def test_nothing_may_follow(scripts):
    own = scripts_for(11, scripts)
    program = upload().encode()
    for rest in (b"\n", b" ", b"def a():\nend\n", b"\0", b"end\n"):
        assert refusal(own, program + rest, 10**6) is Reason.TOOL_DEFINITION_CHANGED
        recogniser = Recogniser(own)
        assert isinstance(recogniser.feed(program), Upload)
        assert isinstance(recogniser.feed(rest), InputRefusal)
    assert recognise(own, program[:-1]) is None
    assert recognise(own, b"") is None
    assert Recogniser(own).feed(b"stop program\n") == InputRefusal(Reason.TOOL_DEFINITION_CHANGED, "control script")


# ------------------------------------------------------------------------------------------------------------- the path

MOVE = b"\tmovej([0.1,0.2,0.3,0.4,0.5,0.6],a=2,v=1,r=0.03)\n"


def signal(index):
    return b"\tsignal_async_progress(%d)\n" % index


@pytest.mark.clause("RTDE-8")
@pytest.mark.parametrize("text", [b"nan", b"-nan", b"inf", b"-inf", b"1e+999", b"-1e+400"])
def test_numbers_that_are_none_are_refused(scripts, text):
    own = scripts_for(11, scripts)
    for old in (b"0.1", b"0.6", b"=2", b"=1", b"=0.03"):
        new = b"=" + text if old.startswith(b"=") else text
        found = recognise(own, with_path(signal(0) + MOVE.replace(old, new, 1)))
        assert found == InputRefusal(Reason.NOT_FINITE, "waypoint 0")


@pytest.mark.clause("RTDE-8")
@pytest.mark.parametrize(
    "text",
    [b"0.10", b"+0.1", b".1", b"1e5", b"1.", b"00.1", b"1E-05", b"0x1", b"1e-5", b"0.1234567", b"1_0", b"", b" 0.1"]
    + [b"0.1+0", b"d2r(1)", b"1..2", b"1e", b"--1", b"NaN", b"Inf", b"infinity", b"1234567", b"0.00001"],
)
def test_a_number_has_one_text(scripts, text):
    found = recognise(scripts_for(11, scripts), with_path(signal(0) + MOVE.replace(b"0.1", text, 1)))
    assert found == InputRefusal(Reason.BODY_MALFORMED, "waypoint 0")


@pytest.mark.clause("RTDE-8")
@pytest.mark.parametrize(
    ("old", "new"),
    [
        *((b"a=2", b"a=41"), (b"a=2", b"a=-1"), (b"v=1", b"v=3.15"), (b"v=1", b"v=-0.1")),
        *((b"r=0.03", b"r=2.1"), (b"r=0.03", b"r=-0.1")),
    ],
)
def test_speed_acceleration_and_blend_are_what_the_client_would_send(scripts, old, new):
    found = recognise(scripts_for(11, scripts), with_path(signal(0) + MOVE.replace(old, new)))
    assert found == InputRefusal(Reason.ROBOT_LIMIT, "waypoint 0")
    linear = MOVE.replace(b"movej(", b"movel(p").replace(b"v=1", b"v=3.1")
    assert refusal(scripts_for(11, scripts), with_path(signal(0) + linear)) is Reason.ROBOT_LIMIT


@pytest.mark.clause("RTDE-8")
@pytest.mark.parametrize(
    "block",
    [
        signal(1) + MOVE,
        signal(0) + MOVE + signal(2) + MOVE,
        signal(0) + MOVE + signal(0) + MOVE,
        signal(0) + MOVE + MOVE,
        signal(0) + signal(1) + MOVE,
        MOVE,
        signal(0),
        signal(0) + MOVE + signal(1),
        b"\tsignal_async_progress(00)\n" + MOVE,
        b"\tsignal_async_progress(0) \n" + MOVE,
        signal(0) + MOVE.replace(b"movej", b"movec"),
        signal(0) + MOVE.replace(b"movej", b"servoj"),
        signal(0) + MOVE.replace(b"a=2,v=1", b"v=1,a=2"),
        signal(0) + MOVE.replace(b",r=0.03", b""),
        signal(0) + MOVE.replace(b",0.6", b""),
        signal(0) + MOVE.replace(b",0.6", b",0.6,0.7"),
        signal(0) + MOVE.replace(b"\n", b"\r\n"),
        signal(0) + MOVE.replace(b"\n", b" #\n"),
        signal(0) + b"\t" + MOVE,
        signal(0) + MOVE.replace(b"\tm", b" m"),
    ],
)
def test_other_blocks_are_refused(scripts, block):
    assert refusal(scripts_for(11, scripts), with_path(block)) is Reason.BODY_MALFORMED


@pytest.mark.clause("RTDE-8")
def test_the_65th_kibibyte_does_not_come(scripts):
    own = scripts_for(11, scripts)
    many = b"".join(signal(index) + MOVE for index in range(MAX_WAYPOINTS))
    assert len(recognise(own, with_path(many)).path) == MAX_WAYPOINTS
    assert refusal(own, with_path(many + signal(MAX_WAYPOINTS) + MOVE)) is Reason.BODY_TOO_LARGE
    assert refusal(own, with_path(b"\t" + b"x" * (65 * 1024))) is Reason.BODY_MALFORMED
    recogniser = Recogniser(own)
    assert recogniser.feed(with_path(b"").partition(b"path\n")[0] + b"path\n\t") is None
    # A line that never ends is refused before it is longer than any line of ur_rtde.
    assert [recogniser.feed(b"x") is None for _ in range(MAX_LINE)] == [True] * (MAX_LINE - 1) + [False]
    assert refusal(own, b"a" * (65 * 1024), 1) is Reason.TOOL_DEFINITION_CHANGED


numbers = (
    st.floats(allow_nan=False, allow_infinity=False).map(lambda x: float(f"{x:g}")).filter(lambda x: abs(x) < 1e308)
)
small = st.floats(0.0, 2.0).map(lambda x: float(f"{x:g}"))
waypoints = st.builds(
    Waypoint, st.sampled_from(PathMove), st.booleans(), st.tuples(*[numbers] * 6), small, small, small
)


@pytest.mark.clause("RTDE-8")
@given(st.lists(waypoints, max_size=8).map(tuple))
def test_any_path_survives_its_text(scripts, path):
    program = with_path(render_path(path))
    found = recognise(scripts_for(11, scripts), program)
    assert isinstance(found, Upload)
    assert found.path == path
    assert found.render() == program
    assert max(map(len, render_path(path).split(b"\n"))) <= MAX_LINE


@given(st.data())
def test_whatever_comes_never_raises(scripts, data):
    recogniser = Recogniser(scripts_for(11, scripts))
    program = with_path(render_path(PATH))
    at = data.draw(st.integers(0, len(program)))
    recogniser.feed(program[:at])
    for piece in data.draw(st.lists(st.binary(max_size=200), max_size=5)):
        assert isinstance(recogniser.feed(piece), InputRefusal | Upload | None)


# ------------------------------------------------------------------------------------------------- what ur_rtde writes


def entries():
    entry = rtde_control.PathEntry
    kinds = {PathMove.MOVEJ: entry.MoveJ, PathMove.MOVEL: entry.MoveL, PathMove.MOVEP: entry.MoveP}
    path = rtde_control.Path()
    for point in PATH:
        position = entry.PositionTcpPose if point.is_pose else entry.PositionJoints
        numbers = [*point.target, point.speed, point.acceleration, point.blend_m]
        path.addEntry(entry(kinds[point.move], position, numbers))
    return path


@pytest.mark.clause("RTDE-8")
def test_our_text_of_a_path_is_ur_rtde_s_own():
    assert entries().toScriptCode().encode() == render_path(PATH)
    path = rtde_control.Path()
    entry = rtde_control.PathEntry
    path.addEntry(entry(entry.MoveJ, entry.PositionJoints, [float("nan")] * 6 + [1.0, 1.0, 0.0]))
    assert "nan" in path.toScriptCode()  # its client does not look at targets


@pytest.mark.e2e
def test_what_the_real_client_uploads_is_recognised(scripts, tmp_path):
    from tests.pep.rtde.relay import relay
    from ursim.ports.launch import SimulatedController

    with SimulatedController.start(joints=HOME) as robot, relay(robot.host, tmp_path / "said") as between:
        control = rtde_control.RTDEControlInterface(between.host)
        try:
            joints = [*HOME[:5], 0.1]
            assert control.moveJ([[*joints, 1.0, 2.0, 0.0], [*HOME, 0.5, 1.0, 0.0]])
        finally:
            control.disconnect()
        (said,) = between.said(30003)
    length = len(upload().encode())
    own = scripts_for(11, scripts)
    assert recognise(own, said[:length]).path == ()
    found = recognise(own, said[length:])
    short = tuple(float(f"{angle:g}") for angle in HOME)
    assert found.path == (
        Waypoint(PathMove.MOVEJ, False, (*short[:5], 0.1), 1.0, 2.0, 0.0),
        Waypoint(PathMove.MOVEJ, False, short, 0.5, 1.0, 0.0),
    )
    assert found.render() == said[length:]
