"""The frames of the primary, secondary and real-time interfaces: they survive the wire, and nothing else does."""

import struct
from dataclasses import fields

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.rtde.wire.messages import WireError, WireFault
from tests.ursim.framers import PrimaryFramer, RealtimeFramer

from pep.rtde.wire import primary_frames as f
from pep.rtde.wire import primary_state as state
from pep.rtde.wire import realtime_frames as realtime

NUMBERS = {
    "Q": st.integers(0, 2**64 - 1),
    "?": st.booleans(),
    "B": st.integers(0, 255),
    "b": st.integers(-128, 127),
    "d": st.floats(allow_nan=False),
    "f": st.floats(width=32, allow_nan=False),
    "i": st.integers(-(2**31), 2**31 - 1),
    "I": st.integers(0, 2**32 - 1),
}


def record(cls):
    def value(word):
        return st.tuples(*[NUMBERS[word[-1]]] * int(word[:-1])) if len(word) > 1 else NUMBERS[word]

    words = cls.LAYOUT.split()
    assert len(words) == len(fields(cls))
    return st.builds(cls, *map(value, words))


TEXT = st.text(max_size=40)
int32, uint32, byte = NUMBERS["i"], NUMBERS["I"], NUMBERS["B"]
PLAIN = (
    state.RobotMode,
    state.Tool,
    state.Masterboard,
    state.Cartesian,
    state.Kinematics,
    state.Configuration,
    state.Force,
    state.Additional,
)
PARTS = st.one_of(
    *map(record, PLAIN),
    st.builds(state.Joints, st.tuples(*[record(state.Joint)] * 6)),
    st.builds(state.OtherPart, st.integers(9, 255), st.binary(max_size=30)),
)
CONTENTS = st.one_of(
    st.builds(f.Version, TEXT, byte, byte, int32, int32, TEXT),
    st.builds(f.ErrorCode, int32, int32, int32, uint32, uint32, TEXT),
    st.builds(f.Key, int32, int32, TEXT, TEXT),
    st.builds(f.RuntimeException, int32, int32, TEXT),
    st.builds(f.OtherMessage, st.sampled_from([0, 1, 2, 5, 9, 99]), st.binary(max_size=30)),
)
FRAMES = st.one_of(
    st.builds(f.PrimaryState, st.lists(PARTS, max_size=9).map(tuple)),
    st.builds(f.PrimaryMessage, NUMBERS["Q"], NUMBERS["b"], CONTENTS),
    st.builds(f.OtherFrame, st.integers(21, 255), st.binary(max_size=30)),
)


def torn(framer, held, cuts):
    found, at = [], 0
    for cut in [*sorted(cuts), len(held)]:
        found += framer.feed(held[at:cut])
        at = max(at, cut)
    return found


@given(st.lists(FRAMES, max_size=4), st.lists(st.integers(0, 2000), max_size=6))
def test_frames_survive_the_wire_however_it_was_torn(frames, cuts):
    held = b"".join(map(f.encode_primary, frames))
    assert torn(PrimaryFramer(), held, [min(cut, len(held)) for cut in cuts]) == frames


@given(st.lists(record(realtime.RealtimeState), max_size=2), st.lists(st.integers(0, 2440), max_size=6))
def test_realtime_states_survive_the_wire_however_it_was_torn(states, cuts):
    held = b"".join(map(realtime.encode_realtime, states))
    assert len(held) == realtime.REALTIME_SIZE * len(states)
    assert torn(RealtimeFramer(), held, [min(cut, len(held)) for cut in cuts]) == states


@given(
    st.lists(
        st.one_of(
            st.binary(max_size=60),
            st.builds(
                lambda kind, body: struct.pack(">iB", 5 + len(body), kind) + body,
                st.sampled_from([16, 20, 21]),
                st.one_of(
                    st.binary(max_size=60),
                    st.builds(
                        lambda kind, held, lie: struct.pack(">iB", 5 + len(held) + lie, kind) + held,
                        st.integers(0, 10),
                        st.binary(max_size=60),
                        st.integers(-6, 3),
                    ),
                    st.builds(
                        lambda kind, held: bytes(9) + bytes([kind]) + held, st.integers(0, 12), st.binary(max_size=30)
                    ),
                ),
            ),
        ),
        max_size=4,
    )
)
def test_any_bytes_are_frames_or_a_wire_error(pieces):
    framer = PrimaryFramer()
    try:
        for piece in pieces:
            for frame in framer.feed(piece):
                assert PrimaryFramer().feed(f.encode_primary(frame)) is not None
    except WireError:
        pass
    try:
        RealtimeFramer().feed(b"".join(pieces))
    except WireError:
        pass


def part(kind, body, size=None):
    return struct.pack(">iB", 5 + len(body) if size is None else size, kind) + body


@pytest.mark.parametrize(
    ("held", "code"),
    [
        (struct.pack(">iB", 4, 16), WireFault.SIZE),
        (struct.pack(">iB", -1, 16), WireFault.SIZE),
        (struct.pack(">iB", f.MAX_FRAME + 1, 16), WireFault.TOO_LONG),
        (part(16, part(0, b"", size=99)), WireFault.TOO_LONG),
        (part(16, part(0, b"", size=0)), WireFault.SIZE),
        (part(16, b"\0\0"), WireFault.PAYLOAD),
        (part(16, part(0, bytes(41))), WireFault.PAYLOAD),
        (part(16, part(0, bytes(43))), WireFault.PAYLOAD),
        (part(16, part(1, bytes(41 * 6 + 1))), WireFault.PAYLOAD),
        (part(16, part(1, b"")), WireFault.PAYLOAD),
        (part(20, bytes(9)), WireFault.PAYLOAD),
        (part(20, bytes(9) + b"\3"), WireFault.PAYLOAD),
        (part(20, bytes(9) + b"\3\x09abc"), WireFault.PAYLOAD),
        (part(20, bytes(9) + b"\7" + bytes(8) + b"\5ab"), WireFault.PAYLOAD),
        (part(20, bytes(9) + b"\6" + bytes(19)), WireFault.PAYLOAD),
    ],
)
def test_what_contradicts_itself_is_refused(held, code):
    with pytest.raises(WireError) as caught:
        PrimaryFramer().feed(held)
    assert caught.value.code is code


def test_a_realtime_state_of_another_length_is_refused_at_once():
    with pytest.raises(WireError) as caught:
        RealtimeFramer().feed(struct.pack(">i", 1219))
    assert caught.value.code is WireFault.SIZE


def test_values_that_do_not_fit_are_refused():
    for frame in (
        f.PrimaryMessage(0, 0, f.Key(2**31, 0, "", "")),
        f.PrimaryMessage(0, 0, f.Key(0, 0, "x" * 256, "")),
        f.PrimaryState((state.Additional(256, 0, 0),)),
        f.PrimaryState((state.Joints(()),)),
        f.PrimaryState((state.Cartesian((0.0,) * 5, (0.0,) * 6),)),
    ):
        with pytest.raises(WireError) as caught:
            f.encode_primary(frame)
        assert caught.value.code is WireFault.VALUE
    with pytest.raises(WireError):
        f.encode_primary(f.OtherFrame(21, bytes(f.MAX_FRAME)))


def test_the_mode_part_has_the_size_that_clients_know_it_by():
    whole = f.PrimaryState((state.RobotMode(0, *[False] * 7, 7, 0, 1.0, 1.0, 1.0, 0),))
    assert struct.unpack_from(">iB", f.encode_primary(whole), 5) == (47, 0)
