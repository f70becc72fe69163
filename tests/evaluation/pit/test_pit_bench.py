"""The benchmark of physics: every answer is held against a sampled one before it is timed, and what is printed."""

import importlib.util
import json
from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from tests.unread import unchecked
from evaluation.harness.absent import AbsentError
from evaluation.harness.bench import Bench, Result, Row
from evaluation.harness.timing import Plan, WrongAnswerError
from evaluation.pit.bench import AMONG_20, SERVO_STEP, SPEED_STEP
from evaluation.pit.cells import ASSESS, KERNEL, RULER, STREAM, PitKey
from evaluation.pit.truth import legs_truth, ready
from pep.pit import MoveL, assess
from pep.pit.assessment.dispatch import drive_of
from pep.pit.path.straight_path import GRID
from pep.pit.scene.obstacles import PairKind
from pep.pit.scene.pairs import pairs_of
from typer.testing import CliRunner

from evaluation import cli
from evaluation.harness import timing
from evaluation.pit import bench, cells, mujoco_sampled, sampled, workload

pytestmark = pytest.mark.long

MUJOCO = importlib.util.find_spec("mujoco") is not None


def drawn(kind, things=5, count=1, seed=3, **more):
    return kind(np.random.default_rng(seed), things, count, **more)


def with_upper(answer, upper):
    """The kernel's answer with another index; what it makes of its arrays is as it was."""
    other = copy(answer)
    vars(other)["upper"] = upper
    return other


@pytest.fixture(scope="module")
def among():
    return [ready(each) for each in drawn(workload.bare, things=6, count=2)]


def test_things_are_of_three_shapes_in_equal_parts_and_leave_the_way_free(among):
    for each in among:
        shapes = [type(thing.shape).__name__ for thing in each.question.scene.objects]
        assert {name: shapes.count(name) for name in shapes} == {"Sphere": 2, "Capsule": 2, "Box": 2}
        assert each.nearest > 0
        move = each.question.motion
        assert np.allclose(np.abs(np.array(move.target) - move.start), workload.WAY_RAD)
        assert each.pin.pairs == 6 * each.question.robot.world_bodies + len(each.question.robot.self_pairs)
        times = np.diff([0.008 * k for k in range(len(each.angles))])
        assert np.allclose(times, sampled.STEP_S)


def test_every_cell_answers_what_is_true_and_not_what_is_not(among):
    for cell in cells.beside_sampling(among, "moveJ", mujoco=MUJOCO):
        timing.prove(cell)


@pytest.mark.parametrize(
    ("peer", "lie"),
    [
        (sampled.NAME, lambda answer: answer + 1e-3),
        (KERNEL, lambda answer: with_upper(answer, answer.upper - 0.2)),
        (KERNEL, lambda answer: with_upper(answer, answer.upper + 0.2)),
        (RULER, lambda answer: replace(answer, proven=answer.proven + 0.01)),
        (RULER, lambda answer: replace(answer, proven=answer.proven - 0.01)),
        (ASSESS, lambda answer: unchecked(answer, index=0.9)),
        (ASSESS, lambda answer: unchecked(answer, index=4.0)),
        (ASSESS, lambda answer: None),
    ],
)
def test_a_wrong_answer_is_no_figure(among, peer, lie):
    (cell,) = (each for each in cells.beside_sampling(among, "moveJ", mujoco=False) if each.of.peer == peer)
    liar = replace(cell, act=lambda asked: (asked, lie(cell.act(asked)[1])))
    with pytest.raises(WrongAnswerError):
        timing.prove(liar)
    with pytest.raises(WrongAnswerError):
        timing.measure([[liar]], Plan(1, 1, 0), clock_ns=lambda: 0, order=__import__("random").Random(1))


def test_instants_of_a_line_are_on_it_and_end_at_its_target():
    (question,) = drawn(workload.lines)
    assert isinstance(question.motion, MoveL)
    places = sampled.instants(question)
    first, last = (np.array(sampled.pose_of(question.robot, tuple(q)))[:3] for q in (places[0][0], places[-1][0]))
    assert np.allclose(places[0][0], question.motion.start)
    assert np.allclose(last, question.motion.target[:3], atol=1e-8)
    for q, _ in places[:: len(places) // 7]:
        at = np.array(sampled.pose_of(question.robot, tuple(q)))
        assert np.linalg.norm(np.cross(at[:3] - first, last - first)) <= 1e-8
        assert np.allclose(at[3:], question.motion.target[3:], atol=1e-8)
    (before, qd), (after, _) = places[len(places) // 2], places[len(places) // 2 + 1]
    assert np.allclose((after - before) / sampled.STEP_S, qd, atol=0.05)


def test_lines_are_proven_to_their_end_and_meet_nothing():
    questions = workload.lines(np.random.default_rng(3), 4, 7)
    for each in questions:
        drive = drive_of(each.robot, each.motion, each.cell, perception_age_s=0.1, check_time=lambda: None)
        pairs = pairs_of(each.robot, replace(each.scene, people=()), each.cell, grown_m=0.0)
        things = np.flatnonzero(pairs.kind == pairs.code_of(PairKind.RIGID))
        assert len(things) == 4 * each.robot.world_bodies
        for s in np.linspace(0, 1, 9):
            assert drive.course.clearance_at(pairs, int(s * GRID), things).min() > workload.ROOM_M


@pytest.mark.parametrize(
    ("kind", "more"), [(workload.peopled, {}), (workload.steps, {"servo": False}), (workload.steps, {"servo": True})]
)
def test_assess_answers_at_least_what_was_sampled(kind, more):
    (question,) = drawn(kind, **more)
    timing.prove(cells.assessing([ready(question)], "any"))


@pytest.mark.parametrize("servo", [False, True])
def test_a_prepared_stream_answers_at_least_what_was_sampled_and_no_more_than_its_tier(servo):
    asked = [ready(each) for each in drawn(workload.steps, count=2, servo=servo)]
    cell = cells.streaming(asked, "any")
    timing.prove(cell)
    assert cell.checks.endswith("of 2")
    question, answer = cell.act(cell.fresh())
    for lie in (question.index - 0.1, question.extra["authorised"] / 1000 + 0.1):
        assert cell.judge((question, answer)) is timing.Verdict.ALLOWED
        assert cell.judge((question, replace(answer, index=lie))) is timing.Verdict.REFUSED


def test_a_sequence_is_as_bad_as_its_worst_leg():
    (question,) = drawn(workload.sequences)
    truth = legs_truth(question)
    answer = assess(
        question.robot, question.scene, question.motion, question.cell,
        perception_age_s=workload.AGE_S, touch=cells.NOTHING, seed=b"",
    )  # fmt: skip
    assert len(question.motion.legs) == 20
    assert truth.index - 1e-4 <= answer.index


# ---- what is printed


def row(peer, load, p50, p99=None):
    figures = {"p50_us": p50, "first_us": p50 + 200.0, "min_us": p50, "p99_us": p99 or 2 * p50}
    return bench.wanted(Row(PitKey(peer, load), **figures, n=10))


def ratios(rows):
    return bench.ratios(rows, {}, "p50_us")


ROWS = (
    row(sampled.NAME, AMONG_20, 10_000.0),
    row(KERNEL, AMONG_20, 200.0),
    row(RULER, AMONG_20, 400.0),
    row(ASSESS, AMONG_20, 5_000.0),
    row(STREAM, SPEED_STEP, 10.0, 50.0),
    row(STREAM, SERVO_STEP, 30.0, 40.0),
)


def test_ratios():
    assert ratios(ROWS) == {
        "kernel_speedup_20": 50.0,
        "assess_speedup_20": 2.0,
        "kernel_speedup_20_first": 25.5,
        "assess_speedup_20_first": 1.96,
        "clearance_speedup_20": 25.0,
        "stream_cycle_p50": 0.015,
        "stream_cycle_p99": 0.025,
    }
    assert set(ratios(ROWS[1:4]).values()) == {None}


def test_a_target_is_met_by_both_figures_or_missed():
    assert [each.more["met"] for each in ROWS] == ["", "", "", "", "met", "missed"]
    assert row(STREAM, SPEED_STEP, 10.0, 150.0).more["met"] == "missed"
    assert bench.wanted(Row(PitKey("MuJoCo"), why="not installed")).more["met"] == ""


def test_the_ratios_are_the_last_line_and_everything_is_in_the_json(monkeypatch):
    bars = {name: bar for name, (_, bar) in bench.SPEEDUPS.items()}
    place = {"processor": "x", "load": [0.0]}
    result = Result(ROWS, ratios(ROWS), {"engine": "numba-1"}, {"bars": bars}, place, Plan(1, 1), 1.0)
    monkeypatch.setattr(Bench, "run", lambda *a, **k: result)
    said = CliRunner().invoke(cli.app, ["bench", "pit"])
    assert said.exit_code == 0, said.output
    assert "kernel_speedup_20 50.00" in " ".join(said.output.strip().splitlines()[-2:])
    told = json.loads(CliRunner().invoke(cli.app, ["bench", "pit", "--json"]).output)
    assert told["ratios"]["assess_speedup_20"] == 2.0
    assert told["bars"] == {"kernel_speedup_20": 100.0, "assess_speedup_20": 10.0}
    assert len(told["rows"]) == len(ROWS)
    assert told["rows"][-1]["met"] == "missed"
    assert told["rows"][-1].keys() == {
        "peer", "load", "p50_us", "first_us", "min_us", "p99_us", "n", "overruns", "checks", "why", "met",
        "cycles_p50", "cycles_p99", "target_p50", "target_p99",
    }  # fmt: skip


def test_a_peer_that_is_not_installed_is_a_row_that_says_so(monkeypatch):
    def absent(module, distribution):
        raise AbsentError(f"not installed: {distribution}")

    monkeypatch.setattr(bench, "package", absent)
    monkeypatch.setattr(bench, "_groups", lambda *a, mujoco: ([], []) if not mujoco else pytest.fail("is not there"))
    result = bench.BENCH.run(Plan(1, 1), seed=1, told=lambda what: None)
    assert [each.of for each in result.rows] == [PitKey(mujoco_sampled.NAME)]


@pytest.mark.skipif(importlib.util.find_spec("matplotlib") is None, reason="matplotlib is not installed")
def test_the_picture_is_drawn(tmp_path):
    machine = {"processor": "x", "cores": 2, "python": "3"}
    bench.draw(Result(ROWS, {}, {}, {}, machine, Plan(1, 1), 1.0), tmp_path / "pit.png")
    assert (tmp_path / "pit.png").read_bytes()[1:4] == b"PNG"
