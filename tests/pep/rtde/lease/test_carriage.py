"""Carriage of a lease: one spelling of each word, two ends that agree, and nothing out of its place."""

from collections import deque

import pytest
from capabilities.proof.session_frames import OVERHEAD_BYTES
from capabilities.values.caps import DEFAULT
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from pep.rtde.lease.lease_messages import (
    CONNECTIONS,
    HEAD_BYTES,
    Beat,
    Bytes,
    Closed,
    LeaseMessageError,
    LeaseMessageFault,
    LeaseOver,
    Open,
    Opened,
    OpenLines,
    OpenRefused,
    RefusalNotice,
    SessionFrameSplitter,
    decode,
    delimited,
    encode,
)
from pep.rtde.wire.client_texts import TOLD_BYTES

LINE = st.integers(0, 255)
WORDS = st.one_of(
    st.just(Beat()),
    st.builds(Open, LINE, st.integers(1, 0xFFFF)),
    st.builds(Opened, LINE),
    st.builds(OpenRefused, LINE, st.sampled_from(["LEASE_HELD", "A", "X9_" * 21])),
    st.builds(Bytes, LINE, st.binary(min_size=1, max_size=300)),
    st.builds(Closed, LINE),
    st.builds(
        RefusalNotice,
        LINE,
        st.text(st.characters(min_codepoint=32, max_codepoint=126), min_size=1, max_size=TOLD_BYTES),
    ),
    st.builds(LeaseOver, st.sampled_from(["AUTHORITY", "LEFT"])),
)


@given(WORDS)
def test_every_word_comes_back(word):
    assert decode(encode(word)) == word


@given(st.binary(max_size=80))
def test_what_is_read_has_one_spelling(message):
    try:
        word = decode(message)
    except LeaseMessageError as error:
        assert error.code is LeaseMessageFault.MALFORMED
        return
    assert encode(word) == message


def test_bytes_without_content_are_no_word():
    head = encode(Bytes(3, b"."))[:-1]
    with pytest.raises(LeaseMessageError) as refused:
        decode(head)
    assert refused.value.code is LeaseMessageFault.MALFORMED


@pytest.mark.parametrize(
    "word",
    [Open(0, 0), Open(0, 65_536), Open(256, 1), Open(-1, 1), Bytes(0, b""), OpenRefused(0, ""), OpenRefused(0, "no"),
     OpenRefused(0, "X" * 65), OpenRefused(0, "Ä"), OpenRefused(0, "A B"), Closed(256), LeaseOver("no"), RefusalNotice(256, "A"), RefusalNotice(0, ""),
     RefusalNotice(0, "a\nb"), RefusalNotice(0, "\x1b[2J"), RefusalNotice(0, "\x7f"), RefusalNotice(0, "ä"), RefusalNotice(0, "A" * (TOLD_BYTES + 1))],
)  # fmt: skip
def test_what_no_message_says_is_refused(word):
    with pytest.raises(LeaseMessageError) as refused:
        encode(word)
    assert refused.value.code is LeaseMessageFault.MALFORMED


@given(st.lists(st.binary(min_size=OVERHEAD_BYTES, max_size=200), max_size=6), st.data())
def test_frames_come_whole_however_the_stream_is_torn(frames, data):
    stream, cutter, found = b"".join(map(delimited, frames)), SessionFrameSplitter(), []
    while stream:
        cut = data.draw(st.integers(1, len(stream)))
        found += cutter.feed(stream[:cut])
        stream = stream[cut:]
    assert found == frames


def test_a_frame_in_a_frame_is_none_where_the_stream_is_torn_there():
    inner = delimited(bytes(OVERHEAD_BYTES))
    outer = delimited(bytes(OVERHEAD_BYTES) + inner)
    cutter = SessionFrameSplitter()
    assert cutter.feed(outer[: -len(inner)]) == []
    assert cutter.feed(inner) == [outer[4:]]
    assert cutter.feed(inner) == [inner[4:]]


@pytest.mark.parametrize("length", [0, OVERHEAD_BYTES - 1, DEFAULT.frame_bytes + OVERHEAD_BYTES + 1, 2**32 - 1])
@pytest.mark.parametrize("whole", [False, True])
def test_a_length_that_no_frame_has_is_refused_with_its_bytes_and_before_they_are_waited_for(length, whole):
    content = bytes(length) if whole and length < 2**31 else b""
    with pytest.raises(LeaseMessageError) as refused:
        SessionFrameSplitter().feed(length.to_bytes(4, "big") + content)
    assert refused.value.code is LeaseMessageFault.TOO_LONG


def test_the_largest_package_of_the_controller_fits_a_word():
    assert DEFAULT.frame_bytes - HEAD_BYTES >= 4096  # its longest request; what comes back may be cut


@pytest.mark.parametrize(
    "text", [b"", b"a\nb", b"\x1b[2J", b"\0", b"\x7f", "ä".encode(), b"\xff", b"A" * (TOLD_BYTES + 1), b"A" * 60_000]
)
@pytest.mark.clause("RTDE-17")
def test_a_text_that_is_no_line_is_no_word(text):
    head = encode(RefusalNotice(3, "."))[:-1]
    assert decode(head + b"A" * TOLD_BYTES) == RefusalNotice(3, "A" * TOLD_BYTES)
    with pytest.raises(LeaseMessageError) as refused:
        decode(head + text)
    assert refused.value.code is LeaseMessageFault.MALFORMED


def opened(line=0):
    """Both ends, with one line open."""
    program, gateway = OpenLines(asking=True), OpenLines(asking=False)
    assert program.said(Open(line, 30004))
    assert gateway.heard(Open(line, 30004))
    assert gateway.said(Opened(line))
    assert program.heard(Opened(line))
    return program, gateway


def test_bytes_that_cross_a_closing_are_dropped_and_the_number_waits_for_both():
    program, gateway = opened()
    assert program.said(Closed(0))
    assert gateway.said(Bytes(0, b"late"))  # it has not heard yet
    assert not program.heard(Bytes(0, b"late"))
    assert program.free() == 1
    assert gateway.heard(Closed(0))
    assert not gateway.said(Bytes(0, b"later"))  # not worth saying
    assert gateway.said(Closed(0))
    assert program.heard(Closed(0))
    assert program.free() == 0


@pytest.mark.parametrize(
    ("asking", "word"),
    [
        (False, Open(0, 30004)),  # in use
        (False, Opened(0)),  # the gateway's word
        (False, OpenRefused(1, "NO")),
        (False, Bytes(1, b"x")),  # never opened
        (False, Closed(1)),
        (True, Open(1, 30004)),  # the program's word
        (True, Opened(0)),  # it is already
        (True, Opened(1)),  # never asked for
        (True, OpenRefused(0, "NO")),
        (True, RefusalNotice(1, "BUSY")),  # of no line
        (False, RefusalNotice(0, "BUSY")),  # the gateway's word
        (False, RefusalNotice(1, "BUSY")),
    ],
)
def test_a_word_out_of_place_ends_the_lease(asking, word):
    program, gateway = opened()
    end = program if asking else gateway
    with pytest.raises(LeaseMessageError) as refused:
        end.heard(word)
    assert refused.value.code is LeaseMessageFault.OUT_OF_PLACE


@pytest.mark.clause("RTDE-17")
def test_the_gateway_alone_tells_as_long_as_either_end_has_not_closed_the_line():
    program, gateway = OpenLines(asking=True), OpenLines(asking=False)
    assert program.said(Open(0, 30004))
    assert gateway.heard(Open(0, 30004))
    why = RefusalNotice(0, "BUSY: why")
    for say in (gateway.said, program.heard, program.said, gateway.heard):
        with pytest.raises(LeaseMessageError):
            say(why)  # it is not open yet
    program, gateway = opened()
    assert gateway.said(why)
    assert program.heard(why)
    with pytest.raises(LeaseMessageError):
        program.said(why)
    assert program.said(Closed(0))
    assert program.heard(why), "it was said before the gateway heard of the closing"
    assert gateway.heard(Closed(0))
    assert gateway.said(why)
    assert gateway.said(Closed(0))
    with pytest.raises(LeaseMessageError):
        gateway.said(why)
    assert program.heard(Closed(0))
    with pytest.raises(LeaseMessageError):
        program.heard(why)


def test_nothing_comes_on_a_line_before_it_is_opened_or_after_it_was_closed():
    gateway = OpenLines(asking=False)
    gateway.heard(Open(0, 30004))
    for word in (Bytes(0, b"x"), Closed(0), Open(0, 29999)):
        with pytest.raises(LeaseMessageError):
            gateway.heard(word)
    program, gateway = opened()
    gateway.heard(Closed(0))
    for word in (Bytes(0, b"x"), Closed(0)):
        with pytest.raises(LeaseMessageError):
            gateway.heard(word)


def test_so_many_lines_and_no_more():
    gateway = OpenLines(asking=False)
    for line in range(CONNECTIONS):
        assert gateway.heard(Open(line, 30004))
    with pytest.raises(LeaseMessageError) as refused:
        gateway.heard(Open(CONNECTIONS, 30004))
    assert refused.value.code is LeaseMessageFault.TOO_MANY
    with pytest.raises(LeaseMessageError):
        gateway.free()


class TwoEnds(RuleBasedStateMachine):
    """Both ends over a connection that delays but neither loses nor reorders: neither ever hears what it must not."""

    def __init__(self):
        super().__init__()
        self.program, self.gateway = OpenLines(asking=True), OpenLines(asking=False)
        self.to_gateway, self.to_program = deque(), deque()
        self.asked, self.wire = set(), {}

    def say(self, end, word):
        queue = self.to_gateway if end is self.program else self.to_program
        if end.said(word):
            queue.append(word)

    @rule()
    def ask(self):
        try:
            line = self.program.free()
        except LeaseMessageError:
            return
        self.say(self.program, Open(line, 30004))

    @precondition(lambda self: self.to_gateway)
    @rule(allowed=st.booleans())
    def gateway_hears(self, allowed):
        word = self.to_gateway.popleft()
        self.gateway.heard(word)
        if isinstance(word, Open):
            self.say(self.gateway, Opened(word.line) if allowed else OpenRefused(word.line, "NO"))

    @precondition(lambda self: self.to_program)
    @rule()
    def program_hears(self):
        self.program.heard(self.to_program.popleft())

    @precondition(lambda self: self.program.open)
    @rule(data=st.data(), close=st.booleans())
    def program_says(self, data, close):
        line = data.draw(st.sampled_from(sorted(self.program.open)))
        self.say(self.program, Closed(line) if close else Bytes(line, b"x"))

    @precondition(lambda self: self.gateway.open)
    @rule(data=st.data(), close=st.booleans())
    def gateway_says(self, data, close):
        line = data.draw(st.sampled_from(sorted(self.gateway.open)))
        self.say(self.gateway, Closed(line) if close else Bytes(line, b"x"))

    @precondition(lambda self: self.gateway.open or self.gateway.leaving)
    @rule(data=st.data())
    def gateway_tells(self, data):
        self.say(
            self.gateway,
            RefusalNotice(data.draw(st.sampled_from(sorted(self.gateway.open | self.gateway.leaving))), "NO"),
        )

    @precondition(lambda self: self.program.leaving)
    @rule()
    def program_closes_too(self):
        self.say(self.program, Closed(min(self.program.leaving)))

    @precondition(lambda self: self.gateway.leaving)
    @rule()
    def gateway_closes_too(self):
        self.say(self.gateway, Closed(min(self.gateway.leaving)))

    @invariant()
    def both_agree_when_nothing_is_under_way(self):
        if not self.to_gateway and not self.to_program:
            assert self.program.open == self.gateway.open


test_two_ends = TwoEnds.TestCase
