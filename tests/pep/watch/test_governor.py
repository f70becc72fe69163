"""Governor: full speed counts until the robot says otherwise, and no speed swings.

A late or lost slowing ends the motion.
"""

import itertools
import math
import random
from dataclasses import dataclass, field, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.watch.governor import MARGIN, Governor, Offer, Pacing, ReportedSpeeds

from pep.pit import CellParameters

CELL = CellParameters()
PACING = Pacing.of(CELL)
DELAY_MS, CHANGE_MS, DWELL_MS = 100, 250, 500


@dataclass
class Rig:
    """Governor, a controller whose speed follows its slider, and a clock.

    `pass_ms` lets time go by in steps of 4 ms.
    """

    pendant: float = 1.0
    change_per_s: float = 4.0
    wire_ms: int = 12
    least: float = 0.0
    pacing: Pacing = PACING
    now: int = 1_000
    asked: list = field(default_factory=list)
    failed: bool = False

    def __post_init__(self):
        self.slider, self.scaling, self.coming = self.pendant, self.pendant, []
        self.governor = Governor(self, pacing=self.pacing, least=self.least, speeds=self.speeds(), now_ms=self.now)

    # the slider
    def set(self, fraction):
        self.asked.append(fraction)
        self.coming.append((self.now + self.wire_ms, fraction))

    def speeds(self):
        return ReportedSpeeds(self.slider, self.scaling, self.now)

    def pass_ms(self, ms, step_ms=4):
        """The first thing that is wrong in that time, or ""; each step one look."""
        for _ in range(0, ms, step_ms):
            self.now += step_ms
            while self.coming and self.coming[0][0] <= self.now:
                self.slider = self.coming.pop(0)[1]
            most = self.change_per_s * step_ms / 1000
            self.scaling += max(-most, min(most, self.slider - self.scaling))
            lost = self.governor.hear(self.speeds(), now_ms=self.now)
            if lost:
                return lost
        return ""

    def judged(self, holds, fraction=None, cause="person"):
        """One judgement, asked and answered at once."""
        offer = Offer(holds, fraction, 1_000 if holds else 2_100, "" if holds else cause)
        governor = self.governor
        return governor.take(offer, running=governor.running, heard_ms=governor.heard_ms, now_ms=self.now)


def test_the_pacing_is_the_cells():
    assert PACING == Pacing(DELAY_MS, CHANGE_MS, 0.1, DWELL_MS, 0.1)
    assert PACING.due_ms(1_000, 1.0) == 1_350
    assert PACING.due_ms(1_000, 0.4) == 1_200


def test_nothing_is_set_while_it_holds():
    rig = Rig()
    for _ in range(50):
        assert rig.pass_ms(40) == ""
        assert rig.judged(True, 1.0)
    assert rig.asked == rig.governor.changes == []
    assert not rig.governor.end(now_ms=rig.now)


def test_it_slows_down_and_is_as_fast_as_the_robot_says_until_then():
    rig = Rig()
    rig.pass_ms(40)
    assert rig.judged(False, 0.4)
    assert rig.asked == [0.4 - MARGIN]
    seen = []
    for _ in range(60):
        assert rig.pass_ms(4) == ""
        seen.append(rig.governor.running)
        assert rig.scaling <= rig.governor.running
    assert seen[0] == 1.0
    assert seen == sorted(seen, reverse=True)
    assert seen[-1] == 0.4
    (change,) = rig.governor.changes
    assert (change.fraction, change.cause, change.index_milli) == (0.4, "person", 2_100)
    assert change.at_ms == 1_040
    assert change.after_ms == 40
    assert change.at_ms + 100 < change.confirmed_ms < change.at_ms + 250
    assert rig.pass_ms(5_000) == ""
    assert change.told().keys() == {"t_ms", "after_ms", "percent", "cause", "index_milli", "t_confirmed_ms"}


@pytest.mark.parametrize("rig", [Rig(change_per_s=0.0), Rig(change_per_s=1.0), Rig(wire_ms=10_000)])
def test_a_slowing_that_does_not_come_in_time_ends_the_motion(rig):
    rig.pass_ms(40)
    assert rig.judged(False, 0.4)
    began = rig.now
    assert "not slowed" in rig.pass_ms(5_000)
    assert DELAY_MS + CHANGE_MS < rig.now - began <= DELAY_MS + CHANGE_MS + 4


def test_the_time_to_slow_down_counts_from_when_the_robot_was_heard_not_from_the_answer():
    rig = Rig(change_per_s=0.0)
    rig.pass_ms(40)
    heard_ms = rig.governor.heard_ms
    assert rig.pass_ms(100) == ""
    offer = Offer(False, 0.4, 2_100, "person")
    assert rig.governor.take(offer, running=1.0, heard_ms=heard_ms, now_ms=rig.now)
    assert rig.pass_ms(2_000) != ""
    assert heard_ms + 350 < rig.now <= heard_ms + 354


def test_a_slider_that_refuses_ends_the_motion_at_once():
    rig = Rig()
    assert rig.judged(False, 0.4)
    rig.failed = True
    assert "not set" in rig.pass_ms(4)


@pytest.mark.parametrize("offered", [None, 0.04, math.nan])
def test_without_a_speed_of_any_use_it_stops(offered):
    rig = Rig(least=0.05)
    rig.pass_ms(40)
    assert not rig.judged(False, offered)
    assert rig.asked == []


def test_a_motion_that_would_look_like_standstill_stops():
    assert not Rig(least=0.31).judged(False, 0.3)
    assert Rig(least=0.3).judged(False, 0.3)
    assert not Rig().judged(False, 0.09), "slower than the cell finds of use"


def test_nearer_is_slower_still_and_the_first_deadline_stays():
    rig = Rig(wire_ms=10_000)
    rig.pass_ms(40)
    assert rig.judged(False, 0.6)
    began = rig.now
    for fraction in (0.5, 0.4, 0.4, 0.45):
        assert rig.pass_ms(60) == ""
        assert rig.judged(False, fraction)
    assert rig.asked == [f - MARGIN for f in (0.6, 0.5, 0.4)]
    assert rig.pass_ms(1_000) != ""
    assert rig.now - began <= 354


def test_a_judgement_about_a_slower_arm_leaves_less_time():
    """It counts on the slower arm taking up its speed sooner; a stuck one is stopped by then."""
    rig = Rig(change_per_s=8.0)
    rig.pass_ms(40)
    assert rig.judged(False, 0.2)
    first_ms = rig.governor.heard_ms + 350
    assert rig.pass_ms(80) == ""
    assert 0.2 < rig.governor.running < 0.6
    rig.change_per_s = 0.0
    due_ms = PACING.due_ms(rig.governor.heard_ms, rig.governor.running)
    assert due_ms < first_ms - 30
    assert rig.judged(False, 0.2)
    assert rig.pass_ms(2_000) != ""
    assert rig.now <= due_ms + 4


@pytest.mark.parametrize("slowed", [True, False])
def test_somebody_elses_hand_on_the_slider_ends_the_motion(slowed):
    rig = Rig()
    rig.pass_ms(40)
    assert rig.judged(False, 0.4)
    assert rig.pass_ms(400 if slowed else 100) == ""
    rig.coming.append((rig.now, 1.0))
    assert "faster" in rig.pass_ms(40)


def test_before_it_was_set_here_the_pendant_counts_for_nothing():
    """A person may push a low pendant up at any time: the full speed is judged."""
    rig = Rig(pendant=0.3)
    rig.pass_ms(40)
    assert rig.governor.running == 1.0
    assert rig.judged(False, 0.6)
    assert rig.asked == [0.3], "never above where it stands"
    assert rig.pass_ms(40) == ""
    assert rig.governor.running == 0.6
    for _ in range(20):
        assert rig.judged(True, 1.0)
        assert rig.pass_ms(40) == ""
    assert rig.asked == [0.3, 0.3]
    assert rig.governor.running == 1.0


def slow(rig, fraction=0.4):
    rig.pass_ms(40)
    assert rig.judged(False, fraction)
    assert rig.pass_ms(400) == ""


def offers(rig, ms, fraction, every_ms=40):
    for _ in range(0, ms, every_ms):
        assert rig.judged(True, fraction() if callable(fraction) else fraction)
        assert rig.pass_ms(every_ms) == ""


def test_it_goes_on_as_asked_when_the_way_has_been_clear_for_a_while():
    rig = Rig()
    slow(rig)
    offers(rig, DWELL_MS, 1.0)
    assert len(rig.asked) == 1
    offers(rig, 120, 1.0)
    assert rig.asked[1:] == [1.0]
    assert rig.governor.running == 1.0
    assert rig.pass_ms(400) == ""
    assert [c.cause for c in rig.governor.changes] == ["person", "clear"]
    assert rig.governor.changes[-1].confirmed_ms is not None
    assert rig.slider == rig.scaling == 1.0


def test_the_lowest_of_what_was_offered_meanwhile_is_taken_up():
    rig = Rig()
    slow(rig)
    coming = itertools.chain([1.0, 0.8, 0.65, 0.9], itertools.repeat(0.95))
    offers(rig, DWELL_MS + 80, lambda: next(coming))
    assert rig.asked[1:] == [0.65 - MARGIN]
    assert rig.governor.running == 0.65


def test_a_little_more_is_not_worth_a_change():
    rig = Rig()
    slow(rig)
    offers(rig, 3 * DWELL_MS, 0.49)
    assert len(rig.asked) == 1
    offers(rig, DWELL_MS + 80, 0.5)
    assert rig.asked[1:] == [0.5 - MARGIN]


def test_whoever_comes_and_goes_does_not_make_it_swing():
    """Twice a second clear and not: it stays slow, since the way was never clear for long enough."""
    rig = Rig()
    slow(rig)
    for _ in range(20):
        offers(rig, 240, 1.0)
        offers(rig, 240, 0.4)
    assert len(rig.asked) == 1
    for _ in range(20):
        offers(rig, 240, 1.0)
        assert rig.judged(False, 0.4)
        assert rig.pass_ms(40) == ""
    assert len(rig.asked) == 1


def test_it_never_goes_on_before_it_was_seen_to_slow_down():
    rig = Rig(change_per_s=0.0, pacing=replace(PACING, dwell_ms=0.0, delay_ms=5_000.0))
    rig.pass_ms(40)
    assert rig.judged(False, 0.4)
    offers(rig, 1_000, 1.0)
    assert len(rig.asked) == 1


def test_after_the_motion_the_slider_is_where_it_was():
    rig = Rig(pendant=0.7)
    slow(rig)
    assert rig.governor.end(now_ms=rig.now)
    assert not rig.governor.put_back(rig.speeds(), now_ms=rig.now)
    rig.pass_ms(40)
    assert rig.governor.put_back(rig.speeds(), now_ms=rig.now)
    assert rig.asked[-1] == rig.slider == 0.7
    last = rig.governor.changes[-1]
    assert (last.cause, last.fraction, last.confirmed_ms is not None) == ("ended", 1.0, True)


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -0.1, 1.1])
def test_a_slider_that_stood_nowhere_is_put_back_to_full_speed(wrong):
    rig = Rig()
    rig.governor = Governor(rig, pacing=PACING, least=0.0, speeds=ReportedSpeeds(wrong, 1.0, rig.now), now_ms=rig.now)
    slow(rig)
    assert rig.governor.end(now_ms=rig.now)
    assert rig.asked == [0.4 - MARGIN, 1.0]


def test_nothing_is_asked_for_below_no_speed():
    rig = Rig(pacing=replace(PACING, slowest=MARGIN / 4))
    assert rig.judged(False, MARGIN / 2)
    assert rig.asked == [0.0]


def test_a_judgement_about_a_slower_arm_than_there_is_raises_nothing():
    rig = Rig(pacing=replace(PACING, dwell_ms=0.0))
    slow(rig)
    offer = Offer(True, 1.0, 1_000, "")
    assert rig.governor.take(offer, running=0.39, heard_ms=rig.governor.heard_ms, now_ms=rig.now)
    assert len(rig.asked) == 1
    assert rig.governor.take(offer, running=0.4, heard_ms=rig.governor.heard_ms, now_ms=rig.now)
    assert len(rig.asked) == 2


def test_a_change_is_confirmed_once():
    rig = Rig()
    slow(rig)
    offers(rig, DWELL_MS + 80, 1.0)
    rig.pass_ms(400)
    told = list(rig.governor.changes)
    assert all(change.confirmed_ms is not None for change in told)
    rig.pass_ms(400)
    assert rig.governor.changes == told


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf, -0.1, 1.1])
@pytest.mark.parametrize("first", [True, False])
def test_what_is_no_speed_is_full_speed(wrong, first):
    assert ReportedSpeeds(*((wrong, 0.1) if first else (0.1, wrong)), 0).fastest == 1.0
    rig = Rig()
    slow(rig)
    heard = ReportedSpeeds(*((wrong, 0.1) if first else (0.1, wrong)), rig.now)
    assert rig.governor.hear(heard, now_ms=rig.now) != ""


@given(seed=st.integers(0, 2**32), change=st.floats(0.5, 8.0), wire_ms=st.integers(0, 80))
def test_whatever_comes_the_arm_is_never_faster_than_it_counts_as(seed, change, wire_ms):
    """Over random offers and controllers the arm is no faster than `running`, or the motion ended in time."""
    chance = random.Random(seed)
    rig = Rig(change_per_s=change, wire_ms=wire_ms)
    due, changed = None, []
    for _ in range(150):
        before = rig.governor.running
        if chance.random() < 0.3:
            holds = chance.random() < 0.6
            fraction = chance.choice([0.1, 0.3, 0.5, 0.8, 1.0])
            fraction = max(fraction, before) if holds else fraction
            if not holds and not fraction < before:
                fraction = None
            if not rig.judged(holds, fraction):
                return
            if not holds and fraction < before:
                due = min(due or math.inf, rig.now + 350)
        if rig.pass_ms(chance.choice([4, 8, 40])) != "":
            return
        assert rig.scaling <= rig.governor.running + 1e-9
        if rig.governor.running <= rig.governor.ordered:
            due = None
        assert due is None or rig.now <= due + 4, "neither slow nor ended"
        changed = [c.at_ms for c in rig.governor.changes if c.cause == "clear"]
    assert all(b - a >= DWELL_MS for a, b in zip(changed, changed[1:]))
