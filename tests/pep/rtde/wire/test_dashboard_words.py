"""The dashboard's grammar: every command, its class, and nothing of a client's text but safe arguments."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.rtde.wire.dashboard_grammar import LINES, MAX_LINE, ArgumentKind, DashboardLine, LineClass, parse_line
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_codes import Reason
from tests.pep.rtde.relay import relay
from ursim.ports.launch import SimulatedController

pytestmark = pytest.mark.clause("RTDE-10")

ARGUMENTS = {
    ArgumentKind.NONE: "",
    ArgumentKind.FILE: "programs/pick_1.urp",
    ArgumentKind.TEXT: "Done: 3 of 4.",
    ArgumentKind.ROLE: "operator",
    ArgumentKind.MODE: "manual",
    ArgumentKind.REPORT: "system",
}


def line_of(row):
    return f"{row.words} {ARGUMENTS[row.argument]}".strip().encode()


@pytest.mark.parametrize("words", sorted(LINES))
def test_each_command_is_read_and_written_anew(words):
    row = LINES[words]
    line = line_of(row)
    found = parse_line(line)
    assert found == DashboardLine(row, ARGUMENTS[row.argument])
    assert found.render() == line + b"\n"
    assert parse_line(line + b"\r") == found
    for other in (b" " + line, line + b" ", line.replace(b" ", b"  ") + b"\t", line + b"\n", line.upper() + b"!"):
        assert isinstance(parse_line(other), InputRefusal), other
    if row.argument is ArgumentKind.NONE:
        assert parse_line(line + b" now").reason in (Reason.PARAMETERS_WRONG, Reason.TOOL_UNKNOWN)
    else:
        assert parse_line(words.encode()) == InputRefusal(Reason.PARAMETERS_WRONG, words)
        assert parse_line(words.encode() + b" ") == InputRefusal(Reason.PARAMETERS_WRONG, words)


def test_the_classes_are_those_of_the_reference():
    def words(kind):
        return {row.words for row in LINES.values() if row.line_class is kind}

    assert words(LineClass.ALLOW) == {"stop", "pause", "power off", "close popup"}
    assert words(LineClass.DECIDE) == {"popup", "addToLog", "power on", "brake release"}
    assert words(LineClass.HUMAN) == {"unlock protective stop", "close safety popup", "restart safety"}
    assert words(LineClass.LOCAL) == {"quit"}
    assert {"play", "load", "load installation", "shutdown", "setUserRole", "set operational mode"} <= words(
        LineClass.DENY
    )
    assert len(LINES) == 36


INJECTIONS = (
    *(
        ";reboot",
        "$(reboot)",
        "`reboot`",
        "|sh",
        "&&sh",
        "> /x",
        "< /x",
        "a\nstop",
        "a\rstop",
        "'a'",
        '"a"',
        "a\\b",
        "~",
    ),
    *("*", "?", "#", "{a}", "[a]", "!a", "%s", "a\0b", "\x1b[2J", "é", "a\u2028b", "a\x85b", "(a)", "=a", "a@b"),
)


@pytest.mark.parametrize("words", sorted(row.words for row in LINES.values()))
def test_no_line_carries_a_shell_s_characters(words):
    argument = ARGUMENTS[LINES[words].argument]
    for injection in INJECTIONS:
        for text in (f"{words} {injection}", f"{words} {argument}{injection}", f"{words} {injection}{argument}"):
            assert isinstance(parse_line(text.encode("utf-8")), InputRefusal), text


def test_files_do_not_climb_and_lines_end():
    for name in ("../a", "a/../b", "/etc/passwd", "a//b", "a/", ".hidden", "a..b", "-", "-rf", "a/-b", "a b"):
        assert parse_line(b"load " + name.encode()) == InputRefusal(Reason.PARAMETERS_WRONG, "load"), name
    assert parse_line(b"popup -x").reason is Reason.PARAMETERS_WRONG
    longest = b"popup " + b"a" * (MAX_LINE - 6)
    assert isinstance(parse_line(longest), DashboardLine)
    assert parse_line(longest + b"a").reason is Reason.BODY_TOO_LARGE
    assert parse_line(b"").reason is Reason.TOOL_UNKNOWN
    assert parse_line(b"reboot").reason is Reason.TOOL_UNKNOWN
    assert parse_line(b"stopx").reason is Reason.TOOL_UNKNOWN


SAFE = re.compile(rb"[A-Za-z0-9 .,:_/-]{1,256}\n")


@given(
    st.one_of(
        st.binary(max_size=300), st.builds(lambda w, t: f"{w} {t}".encode(), st.sampled_from(sorted(LINES)), st.text())
    )
)
def test_whatever_is_said_is_refused_or_says_itself_again(line):
    found = parse_line(line)
    if isinstance(found, DashboardLine):
        assert SAFE.fullmatch(found.render())
        assert found.render() == line.removesuffix(b"\r") + b"\n"
        assert parse_line(found.render()[:-1]) == found


ASKED = {
    "addToLog": ("a text",), "popup": ("a text",), "loadURP": ("a.urp",), "closePopup": (), "closeSafetyPopup": (),
    "getLoadedProgram": (), "getRobotModel": (), "getSerialNumber": (), "isInRemoteControl": (), "isProgramSaved": (),
    "pause": (), "polyscopeVersion": (), "programState": (), "robotmode": (), "running": (), "safetymode": (),
    "safetystatus": (), "brakeRelease": (), "powerOn": (), "restartSafety": (), "unlockProtectiveStop": (), "stop": (),
    "play": (), "powerOff": (),
}  # fmt: skip
NOT_TRIED = {"connect", "disconnect", "isConnected", "receive", "send", "quit", "setUserRole", "shutdown"}


@pytest.mark.e2e
def test_every_line_of_the_dashboard_client_is_one_of_ours(tmp_path):
    dashboard_client = pytest.importorskip("dashboard_client", reason="ur_rtde is not installed")
    methods = {name for name in dir(dashboard_client.DashboardClient) if name[0].islower()}
    assert methods == {*ASKED, *NOT_TRIED}
    with SimulatedController.start() as robot, relay(robot.host, tmp_path / "said") as between:
        client = dashboard_client.DashboardClient(between.host)
        client.connect()
        for name, arguments in ASKED.items():
            try:
                getattr(client, name)(*arguments)
            except RuntimeError:  # the robot does not play, has no such file, or asks for patience
                pass
        client.disconnect()
        (said,) = between.said(29999)
    lines = said.split(b"\n")
    assert lines.pop() == b""
    found = [parse_line(line) for line in lines]
    assert [line.render() for line in found] == [line + b"\n" for line in lines]
    assert {"load", "popup", "stop", "power on", "brake release"} <= {line.row.words for line in found}
