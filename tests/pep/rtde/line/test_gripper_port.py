"""The gripper's port in a lease: what moves the fingers waits for the judge."""

from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.rtde.command.gripper_commands import ActivateFingers, MoveFingers
from pep.rtde.line.gripper_port import LINES, LeasedGripperPort
from pep.rtde.wire.client_texts import told
from policies.words.reason_table import Reason

pytestmark = pytest.mark.clause("LSD-28")

MOVE = b"SET POS 200 SPE 128 FOR 30 GTO 1\n"
ASKED = MoveFingers(200, 128, 30)


class Talk:
    """A line between a program and a gripper that are both made by hand, and a judge that only listens."""

    def __init__(self):
        self.heard, self.sent, self.told, self.closed = b"", b"", [], False
        self.asked, self.withdrawn, self.noted = [], [], []
        judge = SimpleNamespace(judge=self.asked.append, withdrawn=self.withdrawn.append)
        note = lambda refused, what: self.noted.append(refused.reason)  # noqa: E731
        tenant = SimpleNamespace(ports=SimpleNamespace(judge=judge), lease=object(), note=note)
        self.port = LeasedGripperPort(tenant, self)
        self.port.robot = SimpleNamespace(send=self._sends, close=lambda: None)

    def _sends(self, content):
        self.sent += content

    # the way back
    def send(self, content):
        self.heard += content

    def close(self):
        self.closed = True

    def tell(self, text):
        self.told.append(text)

    def says(self, content):
        """Words that the program hears at once, and those that the gripper is sent."""
        self.heard = self.sent = b""
        self.port.received(content)
        return self.heard, self.sent

    def gripper(self, content):
        """Words that the program hears when the gripper says that."""
        self.heard = self.sent = b""
        self.port._heard(content)
        return self.heard


@pytest.fixture
def talk():
    return Talk()


def test_a_register_is_read_from_the_gripper(talk):
    assert talk.says(b"GET OBJ\n") == (b"", b"GET OBJ\n")
    assert talk.gripper(b"OBJ 3\n") == b"OBJ 3\n"


def test_a_move_waits_for_the_judge_and_is_acknowledged_when_it_may(talk):
    assert talk.says(MOVE) == (b"", b"")
    (held,) = talk.asked
    assert held.command == ASKED
    assert held.lease is talk.port._tenant.lease
    assert held.forward()
    assert (talk.heard, talk.sent) == (b"ack\n", b""), "the gateway moves the fingers by a line of its own"
    assert talk.says(b"GET PRE\n") == (b"PRE 200\n", b""), "as clients wait for"


def test_a_denied_move_is_not_taken_and_its_reason_is_told(talk):
    talk.says(MOVE)
    talk.asked[0].deny(Reason.NOT_GRANTED, told(Reason.NOT_GRANTED))
    assert talk.heard == b"?\n"
    assert talk.told == [told(Reason.NOT_GRANTED)]
    assert talk.says(MOVE) == (b"", b""), "the same move is asked about again"
    assert len(talk.asked) == 2


def test_lines_wait_for_the_one_before(talk):
    talk.says(MOVE + b"GET POS\n")
    assert talk.sent == b""
    talk.asked[0].forward()
    assert (talk.heard, talk.sent) == (b"ack\n", b"GET POS\n")


def test_what_only_sets_is_kept_and_counts_with_the_next_way(talk):
    for line in (b"SET SPE 10\n", b"SET FOR 20\n", b"SET POS 30\n"):
        assert talk.says(line) == (b"ack\n", b"")
    assert talk.asked == []
    talk.says(b"SET GTO 1\n")
    assert talk.asked[0].command == MoveFingers(30, 10, 20)
    talk.asked[0].forward()
    talk.says(b"SET POS 31\n")
    assert talk.asked[1].command == MoveFingers(31, 10, 20), "it is on its way already"
    talk.asked[1].forward()
    talk.says(b"SET FOR 255\n")
    assert talk.asked[2].command == MoveFingers(31, 10, 255), "also a harder grip is another one"


def test_the_same_move_again_changes_nothing_and_is_no_question(talk):
    talk.says(MOVE)
    talk.asked[0].forward()
    assert talk.says(MOVE) == (b"ack\n", b"")
    assert len(talk.asked) == 1


def test_a_stop_passes_at_once_and_the_same_move_is_a_new_one_after_it(talk):
    talk.says(MOVE)
    talk.asked[0].forward()
    assert talk.says(b"SET GTO 0\n") == (b"", b"SET GTO 0\n")
    assert talk.gripper(b"ack\n") == b"ack\n"
    talk.says(MOVE)
    assert len(talk.asked) == 2


@pytest.mark.parametrize(
    ("line", "ready", "heard", "asked"),
    [
        (b"SET ACT 1\n", 3, b"ack\n", []),
        (b"SET ACT 1\n", 0, b"", [ActivateFingers()]),
        (b"SET ACT 0\n", 0, b"ack\n", []),
        (b"SET ACT 0\n", 3, b"?\n", []),
    ],
    ids=["ready already", "an activation", "not active", "a reset of a ready one"],
)
def test_an_activation_is_decided_where_it_makes_a_stroke(talk, line, ready, heard, asked):
    assert talk.says(line) == (b"", b"GET STA\n")
    assert talk.gripper(b"STA %d\n" % ready) == heard
    assert [each.command for each in talk.asked] == asked


def test_what_lets_go_of_a_part_is_refused(talk):
    assert talk.says(b"SET ATR 1\n") == (b"?\n", b"")
    assert talk.noted == [Reason.NOT_GRANTED]
    assert talk.says(b"SET ATR 0\n") == (b"ack\n", b"")


def test_a_program_that_leaves_withdraws_its_question(talk):
    talk.says(MOVE)
    talk.port.left()
    assert talk.withdrawn == talk.asked
    assert not talk.asked[0].forward()
    assert talk.heard == b""


def test_fingers_on_their_way_stop_when_the_program_leaves(talk):
    talk.says(MOVE)
    talk.asked[0].forward()
    talk.sent = b""
    talk.port.left()
    assert talk.sent == b"SET GTO 0\n"


def test_a_flood_of_lines_ends_the_line(talk):
    talk.says(MOVE + b"GET POS\n" * (LINES + 1))
    assert talk.closed


def test_an_answer_that_is_none_ends_the_line(talk):
    talk.says(b"GET POS\n")
    talk.gripper(b"POS 1; rm\n")
    assert talk.closed


@given(st.lists(st.sampled_from([MOVE, b"SET POS 9 GTO 1\n", b"SET SPE 3\n", b"SET GTO 1\n", b"SET POS 77\n", b"x\n"])))
def test_nothing_of_a_program_reaches_the_gripper_but_questions_and_stops(lines):
    talk = Talk()
    for line in lines:
        _, sent = talk.says(line)
        assert sent in (b"", b"SET GTO 0\n")
