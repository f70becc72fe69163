"""Frames of an open session: every attack singly, and all moves together against an obvious twin."""

from __future__ import annotations

import hashlib
import hmac
import inspect
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import CodeType, FrameType

import pytest
from capabilities.proof.session_frames import LAST_COUNTER, MOST_MISSING, OVERHEAD_BYTES, End, Session, SessionMessage
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import Fault, FaultCode
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

NOW = 1_800_000_000
ENDS = NOW + 600
THERE, BACK = hashlib.sha256(b"there").digest(), hashlib.sha256(b"back").digest()
OVER = (FaultCode.PROOF_STALE, "SES-6")
MALFORMED = (FaultCode.PROOF_MALFORMED, "SES-7")
NOT_THEIRS = (FaultCode.PROOF_WRONG_KEY, "SES-7")
REPLAYED = (FaultCode.REPLAYED, "SES-8")
GAP = (FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "SES-8")
EXHAUSTED = (FaultCode.PROOF_STALE, "SES-8")


def ends(**other: object) -> tuple[Session, Session]:
    """The holder's end and the verifier's."""
    common = {"at": NOW, "not_after": ENDS, "most_missing": 0, "caps": DEFAULT, **other}
    return Session(sending=THERE, receiving=BACK, **common), Session(sending=BACK, receiving=THERE, **common)


def code(found: object) -> tuple[FaultCode, str]:
    assert isinstance(found, Fault), found
    return found.code, found.clause


def framed(kind: int, counter: int, message: bytes, *, key: bytes = THERE, image: bytes | None = None) -> bytes:
    """A frame after the text of the specification, by hand."""
    head = bytes([kind]) + counter.to_bytes(8, "big")
    covered = b"ztpm-session/1 frame" + head + len(message).to_bytes(4, "big") + message
    return head + message + hmac.new(key, covered if image is None else image, "sha256").digest()


@pytest.mark.clause("SES-6", "SES-7")
@pytest.mark.parametrize("message", [b"", b"\0", b"move", bytes(200), bytes(DEFAULT.frame_bytes)])
def test_frames_are_those_of_the_spec(message):
    holder, verifier = ends()
    frame = holder.seal(message, at=NOW)
    assert frame == framed(0, 1, message)
    assert len(frame) == len(message) + OVERHEAD_BYTES
    assert verifier.open(frame, at=NOW) == SessionMessage(message, 0)
    assert holder.seal(message, at=NOW) == framed(0, 2, message)
    assert holder.close(at=NOW) == framed(1, 3, b"")


@pytest.mark.clause("SES-8")
def test_a_frame_once():
    holder, verifier = ends()
    frames = [holder.seal(bytes([n]), at=NOW) for n in range(3)]
    for n, frame in enumerate(frames):
        assert verifier.open(frame, at=NOW) == SessionMessage(bytes([n]), 0)
        for old in frames[: n + 1]:
            assert code(verifier.open(old, at=NOW)) == REPLAYED


@pytest.mark.clause("SES-8")
def test_a_frame_that_somebody_took_out_is_missed():
    """On a carriage that loses nothing, what comes after a stop that was taken out is refused, now and later."""
    holder, verifier = ends()
    first, stop, after = (holder.seal(message, at=NOW) for message in (b"move", b"stop", b"move on"))
    verifier.open(first, at=NOW)
    assert code(verifier.open(after, at=NOW)) == GAP
    assert verifier.open(stop, at=NOW) == SessionMessage(b"stop", 0)
    assert verifier.open(after, at=NOW) == SessionMessage(b"move on", 0)


@pytest.mark.clause("SES-8")
@pytest.mark.parametrize(
    ("most", "skipped", "expected"),
    [
        (0, 0, 0),
        (0, 1, GAP),
        (3, 3, 3),
        (3, 4, GAP),
        (MOST_MISSING, MOST_MISSING, MOST_MISSING),
        (MOST_MISSING, MOST_MISSING + 1, GAP),
    ],
)
def test_how_many_may_be_missing(most, skipped, expected):
    holder, verifier = ends(most_missing=most)
    for _ in range(skipped):
        holder.seal(b"lost", at=NOW)
    found = verifier.open(holder.seal(b"x", at=NOW), at=NOW)
    assert found == SessionMessage(b"x", expected) if isinstance(expected, int) else code(found) == expected


@pytest.mark.clause("SES-8")
def test_a_frame_that_comes_late_is_never_accepted():
    holder, verifier = ends(most_missing=5)
    early, late = holder.seal(b"early", at=NOW), holder.seal(b"late", at=NOW)
    assert verifier.open(late, at=NOW) == SessionMessage(b"late", 1)
    assert code(verifier.open(early, at=NOW)) == REPLAYED


@pytest.mark.clause("SES-8")
@pytest.mark.parametrize("most", [-1, MOST_MISSING + 1, 2**64])
def test_a_gap_has_a_bound(most):
    with pytest.raises(ValueError, match="missing"):
        ends(most_missing=most)


@pytest.mark.clause("SES-7")
def test_a_frame_comes_back_to_its_own_sender():
    """Reflection: each direction has its key."""
    holder, verifier = ends(most_missing=5)
    assert code(holder.open(holder.seal(b"move", at=NOW), at=NOW)) == NOT_THEIRS
    assert code(verifier.open(verifier.seal(b"move", at=NOW), at=NOW)) == NOT_THEIRS
    assert code(holder.open(holder.close(at=NOW), at=NOW)) == OVER


@pytest.mark.clause("SES-7", "SES-8")
def test_a_counter_is_read_after_the_mac():
    """A forged counter neither moves the window nor tells where it stands."""
    holder, verifier = ends(most_missing=5)
    frame = holder.seal(b"x", at=NOW)
    for counter in (0, 1, 2, 7, LAST_COUNTER):
        forged = frame[:1] + counter.to_bytes(8, "big") + frame[9:]
        if forged != frame:
            assert code(verifier.open(forged, at=NOW)) == NOT_THEIRS
    assert verifier.open(frame, at=NOW) == SessionMessage(b"x", 0)


@pytest.mark.clause("SES-8")
def test_the_counter_zero_is_never_accepted():
    _, verifier = ends(most_missing=5)
    assert code(verifier.open(framed(0, 0, b"x"), at=NOW)) == REPLAYED


@pytest.mark.clause("SES-8")
def test_no_counter_is_left():
    holder, verifier = ends()
    holder._sealed = verifier._opened = LAST_COUNTER - 1
    last = holder.seal(b"last", at=NOW)
    assert last[1:9] == b"\xff" * 8
    assert verifier.open(last, at=NOW) == SessionMessage(b"last", 0)
    assert code(verifier.open(last, at=NOW)) == REPLAYED
    for _ in range(2):
        assert code(holder.seal(b"one more", at=NOW)) == EXHAUSTED
        assert code(holder.close(at=NOW)) == EXHAUSTED
    assert code(verifier.open(framed(0, 0, b"x"), at=NOW)) == REPLAYED


@pytest.mark.clause("SES-7")
def test_sizes():
    caps = replace(DEFAULT, frame_bytes=10)
    holder, verifier = ends(caps=caps)
    assert code(holder.seal(bytes(11), at=NOW)) == MALFORMED
    assert verifier.open(holder.seal(bytes(10), at=NOW), at=NOW) == SessionMessage(bytes(10), 0)
    assert code(verifier.open(framed(0, 2, bytes(11)), at=NOW)) == MALFORMED
    assert code(verifier.open(bytes(10**6), at=NOW)) == MALFORMED
    for size in range(OVERHEAD_BYTES):
        assert code(verifier.open(framed(0, 2, b"")[:size], at=NOW)) == MALFORMED
    assert verifier.open(framed(0, 2, b""), at=NOW) == SessionMessage(b"", 0)


@pytest.mark.clause("SES-7")
@pytest.mark.parametrize(("kind", "message"), [(2, b""), (2, b"x"), (255, b""), (1, b"x"), (1, bytes(10))])
def test_no_other_kind(kind, message):
    _, verifier = ends()
    assert code(verifier.open(framed(kind, 1, message), at=NOW)) == MALFORMED
    assert not verifier.over
    assert verifier.open(framed(0, 1, b"x"), at=NOW) == SessionMessage(b"x", 0)


HEAD = b"\0" + (1).to_bytes(8, "big")


@pytest.mark.clause("SES-7")
@pytest.mark.parametrize(
    "image",
    [
        HEAD + (1).to_bytes(4, "big") + b"x",
        b"ztpm-session/1 frame" + HEAD + b"x",
        b"ztpm-session/1 keys" + HEAD + (1).to_bytes(4, "big") + b"x",
        b"ztpm-session/2 frame" + HEAD + (1).to_bytes(4, "big") + b"x",
        b"ztpm-session/1 frame" + HEAD + (2).to_bytes(4, "big") + b"x",
        b"ztpm-session/1 frame" + HEAD + (1).to_bytes(4, "little") + b"x",
        b"ztpm-session/1 frame" + HEAD + (0).to_bytes(4, "big"),
    ],
)
def test_a_mac_over_another_image(image):
    _, verifier = ends()
    assert code(verifier.open(framed(0, 1, b"x", image=image), at=NOW)) == NOT_THEIRS


@pytest.mark.clause("SES-7")
def test_every_bit_counts():
    holder, verifier = ends(most_missing=MOST_MISSING)
    frame = holder.seal(b"move", at=NOW)
    for at in range(len(frame) * 8):
        forged = bytearray(frame)
        forged[at // 8] ^= 1 << at % 8
        assert code(verifier.open(bytes(forged), at=NOW)) == NOT_THEIRS
    for cut in range(len(frame)):
        assert code(verifier.open(frame[:cut], at=NOW))[1] == "SES-7"
        assert code(verifier.open(frame[:cut] + b"\0" + frame[cut:], at=NOW))[1] == "SES-7"
    assert verifier.open(frame, at=NOW) == SessionMessage(b"move", 0)


@pytest.mark.clause("SES-7")
def test_bytes_do_not_flow_between_frames():
    """Two messages glued together, or one in two pieces, are not what was sealed."""
    holder, verifier = ends(most_missing=5)
    one, two = holder.seal(b"mo", at=NOW), holder.seal(b"ve", at=NOW)
    assert code(verifier.open(one + two, at=NOW)) == NOT_THEIRS
    assert code(verifier.open(one[:9] + b"move" + one[-32:], at=NOW)) == NOT_THEIRS


class TestTheEnd:
    @pytest.mark.clause("SES-9")
    def test_of_one_end_is_the_end_of_both(self):
        holder, verifier = ends()
        under_way = verifier.seal(b"state", at=NOW)
        end = holder.close(at=NOW)
        assert verifier.open(end, at=NOW) == End(0)
        for session in (holder, verifier):
            assert session.over
            assert code(session.seal(b"x", at=NOW)) == OVER
            assert code(session.close(at=NOW)) == OVER
            assert code(session.open(framed(0, 2, b"x"), at=NOW)) == OVER
        assert code(holder.open(under_way, at=NOW)) == OVER

    @pytest.mark.clause("SES-8", "SES-9")
    def test_tells_what_is_missing(self):
        holder, verifier = ends(most_missing=5)
        holder.seal(b"lost", at=NOW)
        assert verifier.open(holder.close(at=NOW), at=NOW) == End(1)

    @pytest.mark.clause("SES-9")
    def test_does_not_come_before_what_was_sent(self):
        holder, verifier = ends()
        sent = holder.seal(b"x", at=NOW)
        end = holder.close(at=NOW)
        assert code(verifier.open(end, at=NOW)) == GAP
        assert verifier.open(sent, at=NOW) == SessionMessage(b"x", 0)
        assert verifier.open(end, at=NOW) == End(0)

    @pytest.mark.clause("SES-9")
    def test_of_another_session_ends_nothing(self):
        _, verifier = ends()
        assert code(verifier.open(framed(1, 1, b"", key=BACK), at=NOW)) == NOT_THEIRS
        assert not verifier.over


class TestTime:
    @pytest.mark.clause("SES-6")
    @pytest.mark.parametrize("at", [NOW - DEFAULT.skew_s, NOW, NOW + 0.5, ENDS - 1, ENDS - 0.001])
    def test_inside(self, at):
        holder, verifier = ends()
        assert verifier.open(holder.seal(b"x", at=at), at=at) == SessionMessage(b"x", 0)

    @pytest.mark.clause("SES-6")
    @pytest.mark.parametrize(
        "at", [ENDS, ENDS + 1, 1e300, NOW - DEFAULT.skew_s - 0.001, 0, float("nan"), float("inf"), float("-inf")]
    )
    def test_outside_is_over_for_good(self, at):
        """Also when the clock comes back into the session's time: an expired session is not revived."""
        holder, verifier = ends()
        frame = holder.seal(b"x", at=NOW)
        assert code(verifier.open(frame, at=at)) == OVER
        assert code(verifier.open(frame, at=NOW)) == OVER
        assert code(holder.seal(b"x", at=at)) == OVER
        assert code(holder.seal(b"x", at=NOW)) == OVER
        assert code(holder.close(at=NOW)) == OVER


def in_between(code: CodeType, line: str, meanwhile: Callable[[], object]) -> Callable[[], None]:
    """Stops this thread once before `line` of the function, until `meanwhile` has run in another thread or cannot."""
    source, first = inspect.getsourcelines(code)
    (number,) = (first + n for n, text in enumerate(source) if text.strip() == line)
    other = threading.Thread(target=meanwhile, daemon=True)

    def trace(frame: FrameType, event: str, _: object) -> object:
        if frame.f_code is not code:
            return None
        if event == "line" and frame.f_lineno == number and other.ident is None:
            other.start()
            other.join(0.05)
        return trace

    def finish() -> None:
        sys.settrace(None)
        assert other.ident is not None, "the line was never reached"
        other.join(10)

    sys.settrace(trace)
    return finish


@pytest.mark.clause("SES-8")
def test_one_winner_when_two_open_at_the_same_time():
    """The second comes when the first has found the counter to be new and has not noted it yet."""
    holder, verifier = ends()
    frame, found = holder.seal(b"x", at=NOW), []
    finish = in_between(
        Session.open.__code__, "self._opened = counter", lambda: found.append(verifier.open(frame, at=NOW))
    )
    found.append(verifier.open(frame, at=NOW))
    finish()
    assert sorted(str(type(each).__name__) for each in found) == ["Fault", "SessionMessage"]


@pytest.mark.clause("SES-8")
def test_two_counters_when_two_seal_at_the_same_time():
    """The second comes when the first has taken its counter and has not made its MAC yet."""
    holder, verifier = ends()
    found: list[object] = []
    finish = in_between(
        Session._seal.__code__, "self._over = kind == _END", lambda: found.append(holder.seal(b"x", at=NOW))
    )
    found.append(holder.seal(b"x", at=NOW))
    finish()
    assert sorted(found) == [framed(0, 1, b"x"), framed(0, 2, b"x")]
    assert [verifier.open(frame, at=NOW) for frame in sorted(found)] == [SessionMessage(b"x", 0)] * 2


# --- the twin


@dataclass
class Twin:
    """Twin of one end: a list of really sealed messages, and the number taken. No MAC, no bytes."""

    most_missing: int
    sealed: list[tuple[str, bytes]]
    taken: int = 0
    over: bool = False

    def looks(self, at: float) -> bool:
        self.over = self.over or not NOW - 5 <= at < ENDS
        return not self.over


class Sessions(RuleBasedStateMachine):
    """Two ends, a carriage that may do anything, and a stranger's session beside them."""

    @initialize(most=st.sampled_from([0, 1, 3]))
    def open(self, most):
        self.ends = ends(most_missing=most)
        self.twins = (Twin(most, []), Twin(most, []))
        self.frames: list[tuple[int, int, bytes]] = []  # who sealed it, as its n-th, the bytes
        self.strangers = [framed(0, n, b"x", key=hashlib.sha256(b"stranger").digest()) for n in (1, 2)]
        self.at = float(NOW)

    @rule(end=st.integers(0, 1), message=st.sampled_from([b"", b"stop", b"move", bytes(100)]))
    def seal(self, end, message):
        found, twin = self.ends[end].seal(message, at=self.at), self.twins[end]
        if twin.looks(self.at):
            twin.sealed.append(("message", message))
            self.frames.append((end, len(twin.sealed), found))
        else:
            assert code(found) == OVER

    @rule(end=st.integers(0, 1), chance=st.integers(0, 3))
    def close(self, end, chance):
        if chance:
            return
        found, twin = self.ends[end].close(at=self.at), self.twins[end]
        if twin.looks(self.at):
            twin.sealed.append(("end", b""))
            twin.over = True
            self.frames.append((end, len(twin.sealed), found))
        else:
            assert code(found) == OVER

    @rule(end=st.integers(0, 1), which=st.integers(-4, 40), data=st.data())
    def deliver(self, end, which, data):
        """Any frame of either end, mostly one of the last, to any end, whole or with one bit turned."""
        if not self.frames:
            return
        sealer, number, frame = self.frames[which % len(self.frames) if which >= 0 else max(which, -len(self.frames))]
        spoilt = data.draw(st.integers(0, 5)) == 0
        if spoilt:
            bit = data.draw(st.integers(0, len(frame) * 8 - 1))
            frame = bytes(byte ^ (1 << bit % 8 if n == bit // 8 else 0) for n, byte in enumerate(frame))
        found, twin, theirs = self.ends[end].open(frame, at=self.at), self.twins[end], self.twins[1 - end]
        if not twin.looks(self.at):
            assert code(found) == OVER
        elif spoilt or sealer == end:
            assert code(found) == NOT_THEIRS
        elif number <= twin.taken:
            assert code(found) == REPLAYED
        elif number - twin.taken - 1 > twin.most_missing:
            assert code(found) == GAP
        else:
            missing, twin.taken = number - twin.taken - 1, number
            kind, message = theirs.sealed[number - 1]
            twin.over = kind == "end"
            assert found == (End(missing) if kind == "end" else SessionMessage(message, missing))

    @rule(end=st.integers(0, 1), which=st.integers(0, 1))
    def stranger(self, end, which):
        found = self.ends[end].open(self.strangers[which], at=self.at)
        assert code(found) == (NOT_THEIRS if self.twins[end].looks(self.at) else OVER)

    @rule(by=st.sampled_from([0.002, 1.0, 5.0, -1.0, -4.0]))
    def wait(self, by):
        self.at += by

    @rule(far=st.sampled_from([ENDS - 1.0, float(ENDS), NOW - 6.0, float(NOW)]), chance=st.integers(0, 9))
    def jump(self, far, chance):
        if not chance:
            self.at = far

    @invariant()
    def both_agree_who_is_over(self):
        if hasattr(self, "ends"):
            assert [end.over for end in self.ends] == [twin.over for twin in self.twins]


Sessions.TestCase.settings = settings(stateful_step_count=40)
test_any_moves_agree_with_the_twin = Sessions.TestCase


LONGEST_S = DEFAULT.skew_s + DEFAULT.session_lifetime_s


@pytest.mark.clause("SES-10")
def test_a_renewed_session_goes_on_with_its_keys_and_counters_to_its_new_end():
    holder, verifier = ends()
    assert verifier.open(holder.seal(b"before", at=NOW), at=NOW) == SessionMessage(b"before", 0)
    later = ENDS + 300
    assert (holder.renew(later, at=ENDS - 1), verifier.renew(later, at=ENDS - 1)) == (None, None)
    frame = holder.seal(b"after", at=ENDS)
    assert frame == framed(0, 2, b"after")
    assert verifier.open(frame, at=later - 1) == SessionMessage(b"after", 0)
    assert code(verifier.open(holder.seal(b"late", at=later - 1), at=later)) == OVER


@pytest.mark.clause("SES-10")
def test_a_renewal_may_end_a_session_sooner_too():
    holder, _ = ends()
    assert holder.renew(NOW + 10, at=NOW) is None
    assert code(holder.seal(b"", at=NOW + 10)) == OVER


@pytest.mark.clause("SES-10")
@pytest.mark.parametrize("not_after", [NOW, NOW - 1, NOW + LONGEST_S + 1])
def test_an_end_that_no_session_may_have_changes_nothing(not_after):
    holder, _ = ends()
    assert code(holder.renew(not_after, at=NOW)) == (FaultCode.PROOF_STALE, "SES-10")
    assert not isinstance(holder.seal(b"", at=ENDS - 1), Fault)
    assert code(holder.seal(b"", at=ENDS)) == OVER


@pytest.mark.clause("SES-10")
def test_a_session_that_is_over_is_not_renewed():
    closed, late = ends()
    closed.close(at=NOW)
    assert code(closed.renew(ENDS, at=NOW)) == OVER
    assert code(late.renew(ENDS + 10, at=ENDS)) == OVER
    assert code(late.seal(b"", at=NOW)) == OVER
