"""Slices of the campaigns of cut corners, contacts and poses of streams; the whole of them by `make motions`."""

import time

import pytest
from tests.pep.pit.campaign import blends, contacts

pytestmark = [pytest.mark.timeout(120)]

CAMPAIGN_TRIALS = 200


def held(ask, numbers, seed=1):
    print("seed", seed, "trials", *numbers)
    for number in numbers:
        word, detail = ask(seed, number)
        assert word == "held", detail


def test_a_stop_on_a_slow_part_counts_with_the_speed_that_the_arm_goes_on_to():
    held(blends.trial, (366, 526, 944), seed=2026)


def test_no_corner_is_cut_where_a_mean_of_poses_turns_a_joint_faster_than_both_legs():
    assert blends.trial(2026, 6341) == ("refused", "corner")


@pytest.mark.parametrize("number", [790, 948])
def test_no_way_until_a_contact_leads_out_of_a_violation(number):
    """The arm goes back from a contact: each of these would go back into a person, or into itself."""
    word, detail = contacts.trial(2026, number)
    assert (word, "violation" in detail) == ("refused", True)


def test_no_contact_or_pose_of_a_stream_exceeds_its_answer():
    held(contacts.trial, (1, 4, 5, 8))


def test_an_answer_that_is_too_low_is_found(monkeypatch):
    """The referee can fail: with corners that count for nothing, one is."""
    from pep.pit.search import blended_course

    monkeypatch.setattr(blended_course, "_corner", lambda *_, **__: iter(()))
    blended_course._planned.cache_clear()
    words = [blends.trial(1, number)[0] for number in (1, 6, 7, 8)]
    blended_course._planned.cache_clear()
    assert "failed" in words


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("ask", [blends.trial, contacts.trial], ids=["blends", "contacts"])
def test_none_of_many_exceeds_its_answer(ask):
    began = time.monotonic()
    results = blends.piece(2026, 0, CAMPAIGN_TRIALS, ask)
    assert blends.told(ask.__module__, results, 2026, time.monotonic() - began)
