"""Words to a Robotiq gripper: a closed grammar, and widths, speeds and forces that give the same registers back."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.base.operations import FINGER_SPEED_UM_S, GRIP_MN, STROKE_UM
from pep.rtde.command.gripper_commands import (
    CLOSED,
    MAX_LINE,
    MoveFingers,
    ReadRegister,
    SetRegisters,
    byte_of,
    parse_gripper_line,
)
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_table import Reason

pytestmark = pytest.mark.clause("LSD-28")

BYTE = st.integers(0, 255)


@pytest.mark.parametrize("end", [b"", b"\r"])
def test_what_client_libraries_send_is_read(end):
    assert parse_gripper_line(b"GET POS" + end) == ReadRegister("POS")
    line = b"SET POS 255 SPE 128 FOR 30 GTO 1"
    assert parse_gripper_line(line + end) == SetRegisters({"POS": 255, "SPE": 128, "FOR": 30, "GTO": 1})
    assert parse_gripper_line(b"SET ACT 1" + end) == SetRegisters({"ACT": 1})


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"", Reason.TOOL_UNKNOWN),
        (b"GET", Reason.TOOL_UNKNOWN),
        (b"GET XYZ", Reason.TOOL_UNKNOWN),
        (b"get POS", Reason.TOOL_UNKNOWN),
        (b"GET POS SET POS 0", Reason.TOOL_UNKNOWN),
        (b"SET POS", Reason.TOOL_UNKNOWN),
        (b"SET SID 9", Reason.TOOL_UNKNOWN),
        (b"SET OBJ 0", Reason.TOOL_UNKNOWN),
        (b"SET  POS 1", Reason.TOOL_UNKNOWN),
        (b"SET POS 256", Reason.OUT_OF_RANGE),
        (b"SET POS -1", Reason.OUT_OF_RANGE),
        (b"SET POS 1.0", Reason.OUT_OF_RANGE),
        (b"SET POS 0001", Reason.OUT_OF_RANGE),
        (b"SET POS \xb2", Reason.OUT_OF_RANGE),
        (b"SET GTO 2", Reason.OUT_OF_RANGE),
        (b"SET POS 0 POS 255", Reason.PARAMETERS_WRONG),
        (b"SET POS 1 " * 40, Reason.BODY_TOO_LARGE),
    ],
)
def test_everything_else_is_refused_with_its_reason(line, reason):
    refused = parse_gripper_line(line)
    assert isinstance(refused, InputRefusal)
    assert refused.reason == reason


@given(st.binary(max_size=2 * MAX_LINE))
def test_no_line_breaks_the_reader(line):
    assert isinstance(parse_gripper_line(line), ReadRegister | SetRegisters | InputRefusal)


@given(BYTE, BYTE, BYTE)
def test_what_is_decided_on_gives_the_registers_that_the_program_named(position, speed, force):
    asked = MoveFingers(position, speed, force)
    assert 0 <= asked.width_um <= STROKE_UM
    assert byte_of(asked.speed_um_s, *FINGER_SPEED_UM_S) == speed
    assert byte_of(asked.force_mn, *GRIP_MN) == force
    assert round((STROKE_UM - asked.width_um) * CLOSED / STROKE_UM) == min(position, CLOSED)
