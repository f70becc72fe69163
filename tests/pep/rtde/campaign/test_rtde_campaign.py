"""Slice of `make rtde-campaign`; each of its claims fails where a defence is taken out."""

import json
import re
from collections import Counter

import pytest

pytest.importorskip("rtde_control", reason="ur_rtde is not installed")

from tests.pep.rtde.campaign import __main__ as campaign
from tests.pep.rtde.campaign import broken, fuzz, kills, race
from tests.pep.rtde.campaign.figures import Figures
from ztpm.stage.samples import Sample
from ztpm.stage.stopping import BAR_S

pytestmark = [pytest.mark.timeout(120), pytest.mark.clause("RTDE-11", "RTDE-12", "RTDE-13")]

SEQUENCES, CLEARS = 30, 12
BROKEN = "tests.pep.rtde.campaign.broken"


@pytest.mark.e2e
def test_a_slice_of_the_sequences_meets_every_claim(tmp_path):
    found = fuzz.piece(7, 0, SEQUENCES, tmp_path)
    assert found.failed == []
    assert found.counts["sequences"] == SEQUENCES
    assert found.counts["sequences that moved"] > 0
    assert found.counts["permits"] > 0
    assert found.counts["told NOT_WHAT_WAS_DECIDED"] > 0


@pytest.mark.e2e
def test_a_slice_of_the_clears_meets_every_claim(tmp_path):
    found = race.piece(7, 0, CLEARS, tmp_path)
    assert found.failed == []
    assert found.counts["clears"] == CLEARS
    assert found.counts["motions"] == CLEARS
    assert found.counts["stopped half-way"] == CLEARS // race.STOPPED_EACH


# ---- each claim, broken once


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("name", "seed", "count", "seen"),
    [
        ("swapped_images", 7, SEQUENCES // 2, "may be at"),
        ("no_record", 7, SEQUENCES // 2, "may be at"),
        ("no_stops", 3, 4, "no standstill in time"),  # each of which is waited for
        ("breaking", 7, SEQUENCES // 2, "Traceback"),
    ],
)
def test_a_gateway_without_a_defence_misses(tmp_path, monkeypatch, name, seed, count, seen):
    monkeypatch.setenv(broken.VARIABLE, name)
    assert seen in " ".join(fuzz.piece(seed, 0, count, tmp_path, BROKEN).failed)


@pytest.mark.e2e
def test_a_keep_alive_that_writes_what_was_cleared_is_seen(tmp_path, monkeypatch):
    monkeypatch.setenv(broken.VARIABLE, "stale_rewrites")
    told = " ".join(race.piece(7, 0, 3, tmp_path, BROKEN).failed)
    assert re.search("carried out [2-9] times|[2-9] motions", told)


# ---- what kills claim, on samples made by hand

SPEED_RAD_S, DT_S = 0.5, 0.002


def way(*, brakes_after_s, deceleration=8.0, again=False):
    """Samples of an arm that goes on for so long after t0 = 1 s, and then brakes."""
    samples, q, speed = [], 0.0, SPEED_RAD_S
    for i in range(1000):
        at_s = i * DT_S
        if at_s > 1.0 + brakes_after_s:
            speed = max(0.0, speed - deceleration * DT_S)
        if again and i > 900:
            speed = 0.1
        q += speed * DT_S
        samples.append(Sample(at_s, at_s, (q,) * 6, (speed,) * 6, (speed,) * 6))
    return samples


def judged(samples, stood_s=1.7, death="client", done_s=1.0):
    found = Figures()
    kills.judge(death, samples, done_s, 1.0, stood_s, found, "this one")
    kills.judged(found)
    return found


def test_a_stop_in_time_is_one():
    found = judged(way(brakes_after_s=0.02))
    assert found.failed == []
    assert found.values["t1 - t0, s"][0] == pytest.approx(0.022, abs=0.004)


@pytest.mark.parametrize(
    ("samples", "seen"),
    [
        (way(brakes_after_s=BAR_S + 0.01), "p99 of t1 - t0"),
        (way(brakes_after_s=0.02, deceleration=3.0), "outside of the stop model"),
        (way(brakes_after_s=0.02, again=True), "it moved again"),
        (way(brakes_after_s=9.0), "no stop is to be seen"),
    ],
)
def test_a_stop_that_is_late_long_or_none_is_seen(samples, seen):
    assert seen in " ".join(judged(samples).failed)


@pytest.mark.parametrize(
    ("death", "done_s", "early_s", "fails"),
    [
        ("provider", 0.5, kills.PULL_S - 0.05, False),  # its last answer was so old already
        ("provider", 0.5, kills.PULL_S + 0.05, True),
        ("expiry", 0.5, 0.1, True),
        ("servo-revoked", 0.8, 0.1, False),  # it takes effect before it is acknowledged
    ],
)
def test_a_stop_before_its_time_is_seen(death, done_s, early_s, fails):
    found = judged(way(brakes_after_s=-early_s), death=death, done_s=done_s)
    assert ["before its time" in failed for failed in found.failed] == [True] * fails
    assert found.values["t1 - t0, s"][0] == pytest.approx(-early_s, abs=0.004)


# ---- the ledger


def test_a_run_goes_on_where_it_was_ended(tmp_path, monkeypatch):
    ledger, done = tmp_path / "ledger", []

    def one_piece(seed, first, count, folder):
        done.append(first)
        return Figures(Counter(trials=count), {"number": [first]}, ["13"] if first == 10 else [])

    monkeypatch.setitem(campaign.PARTS, "fuzz", (one_piece, 40, 10))
    more = {"ledger": ledger, "told": lambda *a: None}
    campaign.run("fuzz", 5, 20, until=float("inf"), **more)
    ledger.write_text(ledger.read_text() + '{"part": "fu')
    whole, tried = campaign.run("fuzz", 5, 40, until=float("inf"), **more)
    assert (done, tried, whole.counts["trials"]) == ([0, 10, 20, 30], 40, 40)
    assert (whole.failed, whole.values["number"]) == (["13"], [0, 10, 20, 30])
    assert campaign.run("fuzz", 5, 40, until=float("-inf"), **more)[1] == 40
    assert campaign.run("fuzz", 6, 40, until=float("-inf"), **more)[1] == 0
    monkeypatch.setattr(campaign, "sources", lambda kind: "others")
    assert campaign.run("fuzz", 5, 40, until=float("-inf"), **more)[1] == 0
    assert {json.loads(line)["part"] for line in ledger.read_text().splitlines() if line.endswith("}")} == {"fuzz"}


def test_what_was_missed_or_not_tried_is_told_by_the_exit_status(monkeypatch, capsys):
    told = {"failed": []}
    monkeypatch.setitem(campaign.PARTS, "fuzz", (lambda *a: Figures(failed=list(told["failed"])), 10, 10))
    assert campaign.main(["--only", "fuzz"]) == 0
    assert campaign.main(["--only", "fuzz", "--minutes", "0"]) == 1
    told["failed"].append("a claim")
    assert campaign.main(["--only", "fuzz"]) == 1
