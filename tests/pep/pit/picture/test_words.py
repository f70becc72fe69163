"""Words of a picture: each kind of cause has a sentence, and names cannot push its numbers out."""

from types import SimpleNamespace

import pytest
from pep.pit.picture.words import VIOLATIONS, headline, sentence, told
from policies.evidence.evidence import Contribution

from capabilities.statements.people.ask_words import NAME_LIMIT

pytestmark = pytest.mark.clause("LIV-5")


def cause(kind, link="gripper_high", thing="glass", clearance_um=133_000, speed_um_s=380_000):
    return Contribution(kind, 2310, link, thing, 730, clearance_um, speed_um_s, "camera-1")


def said(*causes, violations=()):
    return SimpleNamespace(tier=3, index=2.31, violations=violations, contributions=causes)


@pytest.mark.parametrize(
    ("each", "words"),
    [
        (cause("person", thing="p1/torso"), "the gripper passes person p1's torso at 133 mm, 0.38 m/s, 0.73 s after it begins"),
        (cause("person", "payload", "p1/lower_arm", -2_000), "the held object meets person p1's lower arm, 0.38 m/s, 0.73 s after it begins"),
        (cause("fragile", "forearm_tube", speed_um_s=0), "the forearm passes glass, which is fragile, at 133 mm, 0.00 m/s, 0.73 s after it begins"),
        (cause("self", "wrist_3", "upper_arm_tube"), "the wrist passes the arm's own upper arm at 133 mm, 0.38 m/s, 0.73 s after it begins"),
        (cause("perception", "", "missing", 0, 0), "the sensors' view of the cell is missing: nobody knows who is near"),
        (cause("torque", "", "", 0, 1), "the torque of a joint decides: the arm moves at up to 0.01 m/s"),
        (cause("undeclared_output", "", "pin-4", 0, 0), "the output pin-4 is switched, which the cell file does not have"),
        (cause("something_new", "", "x", 0, 0), "something_new decides: arm x, 0.00 m/s"),
    ],
)  # fmt: skip
def test_a_cause_in_words(each, words):
    assert told(each) == words
    assert sentence(said(each)) == words


def test_tier_and_index_come_first_and_a_violation_says_that_no_speed_helps():
    assert headline(said()) == "Tier 3, index 2.31: nothing raises it"
    assert sentence(said(cause("person"), violations=("person", "joint_limit"))) == (
        f"refused at any speed, since {VIOLATIONS['person']} and {VIOLATIONS['joint_limit']}"
    )


def test_a_name_is_spelled_apart_and_does_not_push_the_numbers_out():
    long = sentence(said(cause("fragile", thing="x" * 10_000)))
    assert len(long) < 200 and "0.38 m/s" in long and "x" * NAME_LIMIT not in long
    assert "⟨U+202E⟩" in sentence(said(cause("fragile", thing="a\u202eb")))
