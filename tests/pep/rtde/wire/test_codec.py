"""The RTDE wire: every message survives it, however it was torn, and nothing else does."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.rtde.wire.codec import Framer, Recipe, RtdeFrame
from pep.rtde.wire.messages import FrameKind, WireError, WireFault
from pep.rtde.wire.variables import INPUTS, LAYOUT, OUTPUTS, VariableType

from pep.rtde.wire import codec as c
from pep.rtde.wire import messages as m

words = st.lists(st.sampled_from(sorted(OUTPUTS)), min_size=1, max_size=20).map(tuple)
types = st.lists(st.sampled_from(list(VariableType)), min_size=1, max_size=20).map(tuple)
short = st.text(max_size=40).map(lambda t: t.encode("utf-8", "ignore").decode()[:60])
byte = st.integers(0, 255)
packed = st.binary(max_size=80)
frequency = st.floats(allow_nan=False, allow_infinity=False)


def requests(protocol):
    return st.one_of(
        st.builds(m.RequestProtocol, st.integers(0, 65535)),
        st.just(m.AskControlVersion()),
        st.builds(m.RtdeMessage, short, st.just("") if protocol == 1 else short, byte),
        st.builds(m.SetupOutputs, words, st.none() if protocol == 1 else frequency),
        st.builds(m.SetupInputs, words),
        st.just(m.Start()),
        st.just(m.Pause()),
        st.builds(m.Values, byte, packed),
    )


def answers(protocol):
    flag = st.booleans()
    return st.one_of(
        st.builds(m.ProtocolAnswer, flag),
        st.builds(m.ControlVersion, *[st.integers(0, 2**32 - 1)] * 4),
        st.builds(m.RtdeMessage, short, st.just("") if protocol == 1 else short, byte),
        st.builds(m.OutputsAnswer, types, st.none() if protocol == 1 else byte),
        st.builds(m.InputsAnswer, types, byte),
        st.builds(m.StartAnswer, flag),
        st.builds(m.PauseAnswer, flag),
        st.builds(m.Values, st.none() if protocol == 1 else byte, packed),
    )


def torn(data, cuts):
    at, pieces = 0, []
    for cut in [*cuts, len(data)]:
        pieces.append(data[at : at + cut])
        at += cut
    return pieces


@given(st.sampled_from([1, 2]), st.data(), st.lists(st.integers(0, 9), max_size=60))
def test_requests_survive_the_wire(protocol, data, cuts):
    sent = data.draw(st.lists(requests(protocol), max_size=5))
    framer, read = Framer(), []
    for piece in torn(b"".join(c.encode_request(r, protocol) for r in sent), cuts):
        read += [c.decode_request(frame, protocol) for frame in framer.feed(piece)]
    assert read == sent
    assert framer.pending == 0


@given(st.sampled_from([1, 2]), st.data(), st.lists(st.integers(0, 9), max_size=60))
def test_answers_survive_the_wire(protocol, data, cuts):
    sent = data.draw(st.lists(answers(protocol), max_size=5))
    framer, read = Framer(c.MAX_FRAME), []
    for piece in torn(b"".join(c.encode_answer(r, protocol) for r in sent), cuts):
        read += [c.decode_answer(frame, protocol) for frame in framer.feed(piece)]
    assert read == sent


@given(st.sampled_from([1, 2]), st.lists(st.binary(max_size=40), max_size=6), st.booleans())
def test_any_bytes_are_messages_or_a_wire_error(protocol, pieces, framed):
    framer = Framer()
    try:
        for piece in pieces:
            if framed:  # a good header over a bad payload reaches further in
                piece = RtdeFrame(list(FrameKind)[len(piece) % len(FrameKind)], piece).encode()
            for frame in framer.feed(piece):
                for decode, encode in ((c.decode_request, c.encode_request), (c.decode_answer, c.encode_answer)):
                    try:
                        read = decode(frame, protocol)
                    except WireError:
                        continue
                    again = encode(read, protocol)
                    (second,) = Framer(c.MAX_FRAME).feed(again)
                    assert decode(second, protocol) == read
    except WireError:
        pass


@given(st.data())
def test_values_survive_their_recipe(data):
    known = {VariableType.BOOL: st.booleans(), VariableType.UINT8: byte, VariableType.UINT32: st.integers(0, 2**32 - 1)}
    known |= {VariableType.UINT64: st.integers(0, 2**64 - 1), VariableType.INT32: st.integers(-(2**31), 2**31 - 1)}
    real = st.floats(allow_nan=False)
    known |= {VariableType.DOUBLE: real, VariableType.VECTOR3D: st.tuples(*[real] * 3)}
    known |= {VariableType.VECTOR6D: st.tuples(*[real] * 6)}
    known |= {VariableType.VECTOR6INT32: st.tuples(*[known[VariableType.INT32]] * 6)}
    known |= {VariableType.VECTOR6UINT32: st.tuples(*[known[VariableType.UINT32]] * 6)}
    assert known.keys() == LAYOUT.keys()
    kinds = data.draw(st.lists(st.sampled_from(sorted(known)), min_size=1, max_size=12))
    recipe = Recipe([f"v{i}" for i in range(len(kinds))], kinds)
    values = {f"v{i}": data.draw(known[kind]) for i, kind in enumerate(kinds)}
    assert recipe.unpack(recipe.pack(values)) == values
    assert len(recipe.pack(values)) == recipe.size


def fault(call, *arguments):
    with pytest.raises(WireError) as caught:
        call(*arguments)
    return caught.value.code


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (b"\0\0V", WireFault.SIZE),
        (b"\0\2V", WireFault.SIZE),
        (b"\x10\x01U", WireFault.TOO_LONG),
        (b"\xff\xffU", WireFault.TOO_LONG),
        (b"\0\3X", WireFault.KIND),
        (b"\0\x20\0", WireFault.KIND),  # seen before its payload has come
    ],
)
def test_bad_frames(data, code):
    assert fault(Framer().feed, data) is code


@pytest.mark.parametrize(
    ("kind", "payload", "code"),
    [
        (FrameKind.PROTOCOL_VERSION, b"\0", WireFault.PAYLOAD),
        (FrameKind.PROTOCOL_VERSION, b"\0\2\0", WireFault.PAYLOAD),
        (FrameKind.START, b"\0", WireFault.PAYLOAD),
        (FrameKind.VALUES, b"", WireFault.PAYLOAD),
        (FrameKind.SETUP_OUTPUTS, b"\0" * 7, WireFault.PAYLOAD),
        (FrameKind.SETUP_OUTPUTS, struct.pack(">d", math.nan) + b"a", WireFault.FREQUENCY),
        (FrameKind.SETUP_OUTPUTS, struct.pack(">d", 1.0), WireFault.FIELD_LIST),
        (FrameKind.SETUP_INPUTS, b"", WireFault.FIELD_LIST),
        (FrameKind.SETUP_INPUTS, b",", WireFault.FIELD_LIST),
        (FrameKind.SETUP_INPUTS, b"a,,b", WireFault.FIELD_LIST),
        (FrameKind.SETUP_INPUTS, b"a,b,,", WireFault.FIELD_LIST),
        (FrameKind.SETUP_INPUTS, b"a b", WireFault.FIELD_LIST),
        (FrameKind.SETUP_INPUTS, "é".encode(), WireFault.FIELD_LIST),
        (FrameKind.SETUP_INPUTS, b"a," * 257, WireFault.FIELD_LIST),
        (FrameKind.SETUP_INPUTS, b"a" * 2049, WireFault.FIELD_LIST),
        (FrameKind.TEXT, b"\5abc", WireFault.PAYLOAD),
        (FrameKind.TEXT, b"\1a\0", WireFault.PAYLOAD),
    ],
)
def test_bad_requests(kind, payload, code):
    assert fault(c.decode_request, RtdeFrame(kind, payload), 2) is code


def test_one_trailing_comma_is_allowed():
    assert c.decode_request(RtdeFrame(FrameKind.SETUP_INPUTS, b"a,b,"), 2) == m.SetupInputs(("a", "b"))


def test_a_record_of_another_length_fits_no_recipe():
    recipe = Recipe(["external_force_torque"], [INPUTS["external_force_torque"]])
    assert fault(recipe.unpack, b"\0" * 52) is WireFault.PAYLOAD
    assert fault(Recipe, ["a"], [VariableType.IN_USE]) is WireFault.TYPE_NAME
    assert fault(recipe.pack, {"external_force_torque": (1.0,) * 5}) is WireFault.VALUE
