"""Text for a program: one line that fits, its reason once, its end not cut off within a word."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.rtde.wire.client_texts import CUT, TOLD_BYTES, fits, fitted, said, told
from pep.rtde.wire.codec import Framer, decode_answer, encode_answer
from pep.rtde.wire.messages import RtdeMessage
from policies.words.reason_table import REASONS, Reason

pytestmark = pytest.mark.clause("RTDE-17")

DETAIL = "parameter=acceleration_rad_s2, unit=urad_s2, nearest_permitted=-2147483648"
"""As long as one is that says what would be permitted."""


@given(st.text(max_size=600))
def test_whatever_it_was_it_fits_then(text):
    line = fitted(text)
    assert fits(line) is bool(text)
    assert len(line.encode()) <= TOLD_BYTES
    if fits(text):
        assert line == text


@given(st.lists(st.text("abcXYZ_=,", min_size=1, max_size=30), min_size=60, max_size=90))
def test_what_is_too_long_ends_after_a_word(words):
    text = " ".join(words)
    line = fitted(text)
    if len(text) > TOLD_BYTES:
        kept = line.removesuffix(CUT).split(" ")
        assert line.endswith(CUT)
        assert kept == words[: len(kept)]
        assert len(" ".join(words[: len(kept) + 1])) > TOLD_BYTES - len(CUT), "and no earlier than it must"


@pytest.mark.parametrize("reason", sorted(REASONS))
def test_there_is_room_for_what_would_be_permitted(reason):
    assert told(reason, DETAIL).endswith(f"({DETAIL})")
    assert told(reason).count(str(reason)) == 1


@pytest.mark.parametrize("reason", [Reason.BUSY, Reason.NOT_GRANTED])
def test_the_reason_is_said_once(reason):
    assert said(reason, told(reason)) == told(reason)
    assert said(reason, "some text") == f"{reason}: some text"


def test_the_longest_is_a_text_message_of_the_wire():
    line = "A" * TOLD_BYTES
    (frame,) = Framer(0xFFFF).feed(encode_answer(RtdeMessage(line, "ZTPM", 1), 2))
    assert decode_answer(frame, 2) == RtdeMessage(line, "ZTPM", 1)
    assert not fits(line + "A")
