"""Last state on a connection after its lease: the last package, in which nothing runs, until the client has gone."""

import struct

import pytest
from pep.rtde.wire.codec import Framer, Recipe, decode_answer, encode_answer, encode_request
from pep.rtde.wire.messages import (
    InputsAnswer,
    OutputsAnswer,
    Pause,
    PauseAnswer,
    ProtocolAnswer,
    RequestProtocol,
    SetupInputs,
    SetupOutputs,
    Start,
    StartAnswer,
    Values,
)
from pep.rtde.wire.variables import VariableType
from ztpm.program.last_state import LastState

pytestmark = pytest.mark.clause("LSD-12")

NAMES = ("timestamp", "runtime_state", "robot_mode", "actual_q")
TYPES = (VariableType.DOUBLE, VariableType.UINT32, VariableType.INT32, VariableType.VECTOR6D)
Q = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
INPUTS = ("input_int_register_0",)


def shown(at_s):
    packed = Recipe(NAMES, TYPES).pack({"timestamp": at_s, "runtime_state": 2, "robot_mode": 7, "actual_q": Q})
    return encode_answer(Values(1, packed), 2)


def asked(state, request, answer, protocol=2):
    state.said(encode_request(request, protocol))
    state.answered(encode_answer(answer, protocol))


def set_up(*, outputs=True, inputs=False):
    state = LastState()
    asked(state, RequestProtocol(2), ProtocolAnswer(accepted=True), protocol=1)
    if outputs:
        asked(state, SetupOutputs(NAMES, 500.0), OutputsAnswer(TYPES, 1))
    if inputs:
        asked(state, SetupInputs(INPUTS), InputsAnswer((VariableType.INT32,), 1))
    if outputs:
        asked(state, Start(), StartAnswer(accepted=True))
    return state


def test_the_last_package_is_repeated_and_says_that_nothing_runs():
    state = set_up()
    # As the pieces come: two whole packages, and the begin of a third.
    state.answered(shown(1.0) + shown(2.0) + shown(3.0)[:20])
    (frame,) = Framer().feed(state.repeated())
    values = decode_answer(frame, 2)
    assert Recipe(NAMES, TYPES).unpack(values.packed) == {
        "timestamp": 2.0,
        "runtime_state": 1,
        "robot_mode": -1,
        "actual_q": Q,
    }


def test_a_client_that_leaves_is_answered_and_nothing_else_is():
    state = set_up(outputs=False, inputs=True)
    assert state.repeated() == b""
    assert state.farewell(encode_request(Values(1, struct.pack(">i", 7)), 2)) == b""
    leaving = encode_request(Pause(), 2)
    assert state.farewell(leaving[:2]) == b""
    assert state.farewell(leaving[2:]) == encode_answer(PauseAnswer(accepted=True), 2)
    assert state.farewell(b"\x00\x01?") == b""


@pytest.mark.parametrize(
    ("outputs", "inputs", "commands"), [(True, False, False), (False, True, False), (True, True, True)]
)
def test_commands_go_where_inputs_stand_beside_outputs(outputs, inputs, commands):
    state = set_up(outputs=outputs, inputs=inputs)
    assert (state.stays, state.commands) == (True, commands)


@pytest.mark.parametrize("said", [b"hello, robot", b"\xff\xff\xff"])
def test_what_is_no_rtde_does_not_stay(said):
    assert not LastState().stays
    state = set_up()
    state.answered(shown(1.0))
    state.said(said)
    assert not state.stays
    assert state.repeated() == b""
