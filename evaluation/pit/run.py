"""The whole benchmark of physics: every engine and workload in one run."""

from __future__ import annotations

import random
import time
from dataclasses import replace
from importlib import metadata
from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.harness import timing
from evaluation.harness.absent import AbsentError, package
from evaluation.harness.machine import machine
from evaluation.harness.timing import Plan
from evaluation.pit import cells, mujoco_sampled, workload
from evaluation.pit.bench import AMONG_20, SERVO_STEP, SPEED_STEP, Result, Row, peopled, row
from pep.pit.engine import chosen

if TYPE_CHECKING:
    from collections.abc import Callable

    from evaluation.pit.cells import Cell

FULL: Final = Plan(repeats=3, rounds=2, warm_up=1, burst=24)
QUICK: Final = Plan(repeats=1, rounds=2, warm_up=1, burst=4)
STREAMED: Final = 10
"""Steps of a stream are asked so many times more often: their 99th percentile is what counts."""
QUESTIONS: Final = 8
"""Different ones of each workload."""
SIZES: Final = (5, 20, 100)


def run(
    plan: Plan,
    *,
    seed: int,
    told: Callable[[str], None],
    sizes: tuple[int, ...] = SIZES,
    questions: int = QUESTIONS,
) -> Result:
    """All workloads, measured in turns.

    Args:
        plan: how often.
        seed: of the questions and of the order of turns.
        told: is told what happens now.
        sizes: with how many things about the arm, besides the twenty among which we are compared with sampling.
        questions: how many different ones of each workload.

    Raises:
        WrongAnswerError: when an answer is not what an independent engine sampled.
    """
    began = time.monotonic()
    engine = chosen()
    rows: list[Row] = []
    try:
        _, version = package("mujoco", "mujoco")
    except AbsentError as absent:
        version = ""
        rows.append(Row(mujoco_sampled.NAME, None, why=str(absent)))
    told("drawing questions, and sampling what is true of them")
    groups, streamed = _groups(np.random.default_rng(seed), sizes, questions, mujoco=bool(version))
    told("asking everybody for what is true, and for what is not")
    for group in (*groups, *streamed):
        for cell in group:
            timing.prove(cell)
    order = random.Random(seed)  # noqa: S311 - turns
    for some, often in ((groups, plan), (streamed, replace(plan, rounds=plan.rounds * STREAMED))):
        told("measuring")
        found = timing.measure(some, often, clock_ns=time.perf_counter_ns, order=order)
        for group, series in zip(some, found, strict=True):
            rows += [
                row(cell.peer, cell.load, cell.checks, one.figures(), one.count)
                for cell, one in zip(group, series, strict=True)
            ]
    versions = {"engine": engine.name, "pin": metadata.version("pin"), "coal": metadata.version("coal")}
    return Result(
        rows=tuple(rows),
        versions=versions | ({"mujoco": version} if version else {}),
        machine=machine(),
        plan=plan,
        seconds=time.monotonic() - began,
    )


def _groups(
    rng: np.random.Generator, sizes: tuple[int, ...], count: int, *, mujoco: bool
) -> tuple[list[list[Cell]], list[list[Cell]]]:
    """Cells that take turns with each other, and those that are asked more often."""
    among = [cells.ready(each) for each in workload.bare(rng, 20, count)]
    groups = [cells.beside_sampling(among, AMONG_20, mujoco=mujoco)]
    for things in sizes:
        asked = [cells.ready(each) for each in workload.peopled(rng, things, count)]
        name = peopled("moveJ", things)
        group = [cells.assessing(asked, name), cells.assessing_by_numpy(asked, name), cells.checking(asked, name)]
        groups.append(group)
    for things in sizes:
        asked = [cells.ready(each) for each in workload.lines(rng, things, count)]
        groups.append([cells.assessing(asked, peopled("moveL", things))])
    asked = [cells.legs_truth(each) for each in workload.sequences(rng, 20, max(1, count // 4))]
    groups.append([cells.assessing(asked, peopled("20 moves", 20))])
    prepared: list[Cell] = []
    whole: list[Cell] = []
    for servo, name in ((False, SPEED_STEP), (True, SERVO_STEP)):
        asked = [cells.ready(each) for each in workload.steps(rng, 20, count, servo=servo)]
        prepared.append(cells.streaming(asked, name))
        whole.append(cells.assessing(asked, name))
    # Each by itself: whoever serves a stream asks about nothing else in between.
    return groups, [prepared, whole]
