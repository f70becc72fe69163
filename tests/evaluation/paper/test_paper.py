"""The paper's traces: figures computed of them, and their replay as a user runs it."""

from tests.shared_data import SHARED
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from evaluation.paper.replay import Motion, Replayed
from evaluation.paper.result import Margin, PaperResult, last_line, tables
from evaluation.paper.sweep import LENT_RAD_S, WAY, Bound, Sweep
from evaluation.paper.traces import Trace, paper_traces, spreads
from policies.decision.load import load_shipped
from rich.console import Console

FIGURE = SHARED / "paper-traces.json"
BOUNDS = {"C0": Bound(1.05, 1.05), "C1": Bound(1.05, 1.05), "C2": Bound(None, 0.413)}
ASKED = ("DEFER TIER_NEEDS_APPROVAL", "PERMIT PERMITTED")
PERMITTED = ("PERMIT PERMITTED",)


@pytest.mark.shared
def test_the_traces_are_those_of_the_figure():
    if not FIGURE.exists():
        pytest.skip("the reference data folder is not beside this checkout")
    figure = json.loads(FIGURE.read_text())["traces"]
    told = [(t.model, t.condition, t.speed_rad_s) for t in paper_traces()]
    assert told == [(m, c, v) for m, conditions in figure.items() for c, speeds in conditions.items() for v in speeds]


def test_statistics_are_those_of_numpy():
    for model, row in spreads(paper_traces()).items():
        for condition, said in row.items():
            speeds = [t.speed_rad_s for t in paper_traces() if (t.model, t.condition) == (model, condition)]
            quartiles = np.percentile(speeds, [25, 50, 75])
            assert (said.n, said.low, said.high) == (10, min(speeds), max(speeds))
            assert (said.mean, said.sd) == pytest.approx((np.mean(speeds), np.std(speeds, ddof=1)))
            assert (said.q1, said.median, said.q3) == pytest.approx(tuple(quartiles))


def test_the_bound_of_a_scene_is_the_last_speed_that_is_allowed():
    limits = load_shipped("paper-default").parameters
    sweep = Sweep(limits)
    assert sweep.bound("C0") == sweep.bound("C1") == Bound(LENT_RAD_S, LENT_RAD_S)
    near = sweep.bound("C2")
    assert near.alone is None
    assert near.approved is not None
    hit = [
        max(each.contact_ratio for each in sweep.assessed("C2", v, WAY)) for v in (near.approved, near.approved + 0.002)
    ]
    assert hit[0] * 1000 <= limits.approved_contact_permille < hit[1] * 1000


def executed(condition, speed, decisions, reached=None):
    motions = tuple(Motion(speed, decisions, 1, speed if reached is None else reached) for _ in WAY[1:])
    return Replayed(Trace("model", condition, 0, speed), motions)


def test_an_absent_approver_ends_a_trace_at_its_first_question():
    alone = executed("C2", 0.3, ASKED).unapproved
    assert (alone.ended_by, alone.executed_rad_s, alone.fastest_rad_s) == (ASKED[0], None, 0.0)
    assert [motion.decisions for motion in alone.motions] == [ASKED[:1]]
    free = executed("C0", 0.3, PERMITTED)
    assert free.unapproved is free


def test_within_the_bound_is_executed_whole_and_no_faster_than_the_scene_allows():
    asked = executed("C2", 0.5, ASKED, reached=0.41)
    beyond = executed("C2", 0.5, (), reached=0.5)
    slow = executed("C0", 0.4, PERMITTED)
    stopped = Replayed(slow.trace, slow.motions[:4], "DENY ROBOT_LIMIT")
    result = PaperResult(
        traces=spreads(paper_traces()),
        bounds=BOUNDS,
        margins=dict.fromkeys(BOUNDS, Margin(1, 1.0, 1.0)),
        replayed={
            "unenforced": [slow, beyond],
            "enforced": [stopped, asked.unapproved],
            "enforced_approved": [slow, asked],
        },
        seconds=1.0,
        machine={"processor": "p", "load": [0.0]},
    )
    told = result.to_json()
    assert told["within_bounds"] == {"unenforced": 1, "enforced": 0, "enforced_approved": 2}
    assert told["counts"]["enforced"] == {"executed": 0, "deferred": 1, "denied": 1}
    assert told["ok"]
    assert result.ordering("unenforced", "model") == "C2 > C0 (C1)"
    assert last_line(result).endswith("unenforced 1, enforced 0, enforced_approved 2")
    with Console(width=80, record=True, file=open("/dev/null", "w")) as console:
        for table in tables(result):
            console.print(table)
    assert max(map(len, console.export_text().splitlines())) <= 80
    faster = executed("C2", 0.5, ASKED, reached=0.42)
    assert not PaperResult(
        result.traces, BOUNDS, result.margins, {**result.replayed, "enforced_approved": [slow, faster]}, 1.0, {}
    ).ok


@pytest.mark.campaign
@pytest.mark.e2e
@pytest.mark.timeout(600)
def test_one_trace_of_each_model_and_scene_before_the_gate(tmp_path):
    command = [str(Path(sys.executable).with_name("ztpm")), "eval", "paper", "--each", "1", "--json"]
    done = subprocess.run([*command, "--out", str(tmp_path)], capture_output=True, text=True, timeout=580)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["within_bounds"] == {"unenforced": 4, "enforced": 4, "enforced_approved": 6}
    assert said["executed_speed"]["enforced"]["gemma-4"]["C2"] is None
    assert said["executed_speed"]["enforced_approved"]["gemma-4"]["C2"] < said["bound_rad_s"]["C2"]["approved"] + 5e-4
    assert (tmp_path / "paper.png").stat().st_size > 10_000
