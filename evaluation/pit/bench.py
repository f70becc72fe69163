"""The benchmark of physics: every engine and workload in one run, beside sampling and the controller's cycle."""

from __future__ import annotations

from dataclasses import replace
from importlib import metadata
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from evaluation.harness import picture
from evaluation.harness.absent import package
from evaluation.harness.bench import Bench, LineUp, Row, installed
from evaluation.harness.tables import table
from evaluation.harness.timing import Plan
from evaluation.pit import mujoco_sampled, workload
from evaluation.pit.cells import (
    ASSESS,
    CHECKER,
    KERNEL,
    RULER,
    STREAM,
    PitKey,
    assessing,
    beside_sampling,
    checking,
    streaming,
)
from evaluation.pit.sampled import NAME as SAMPLED
from evaluation.pit.truth import legs_truth, ready
from pep.pit.search.engine import chosen
from ztpm.preparing import prepare_physics

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from rich.table import Table

    from evaluation.harness.bench import Result
    from evaluation.harness.timing import Cell

FULL: Final = Plan(repeats=3, rounds=2, warm_up=1, burst=24)
QUICK: Final = Plan(repeats=1, rounds=2, warm_up=1, burst=4)
STREAMED: Final = 10
"""Factor of the calls of a stream's step, since their 99th percentile counts."""
QUESTIONS: Final = 8
"""Different ones of each workload."""
SIZES: Final = (5, 20, 100)
CYCLE_US: Final = 2_000.0
"""One cycle of the controller at 500 Hz."""
AMONG_20: Final = "moveJ, 20 things"
SPEED_STEP: Final = "stream of joint speeds, 20 things, 2 people"
SERVO_STEP: Final = "stream of joint angles, 20 things, 2 people"


def peopled(form: str, things: int) -> str:
    """The name of a workload with two people."""
    return f"{form}, {things} things, 2 people"


TARGETS: Final[Mapping[PitKey, tuple[float, float]]] = MappingProxyType(
    {
        **{PitKey(ASSESS, peopled("moveJ", n)): (200.0, 1_000.0) for n in (5, 20, 100)},
        PitKey(ASSESS, peopled("moveL", 5)): (1_000.0, 4_000.0),
        PitKey(ASSESS, peopled("moveL", 20)): (1_000.0, 4_000.0),
        PitKey(ASSESS, peopled("moveL", 100)): (4_000.0, 15_000.0),
        PitKey(ASSESS, peopled("20 moves", 20)): (5_000.0, 20_000.0),
        PitKey(STREAM, SPEED_STEP): (20.0, 100.0),
        PitKey(STREAM, SERVO_STEP): (20.0, 100.0),
        PitKey(CHECKER, peopled("moveJ", 20)): (20_000.0, 100_000.0),
    }
)
"""Targets for the median and the 99th percentile, microseconds."""
SPEEDUPS: Final[Mapping[str, tuple[str, float]]] = MappingProxyType(
    {"kernel_speedup_20": (KERNEL, 100.0), "assess_speedup_20": (ASSESS, 10.0)}
)
"""Factors by which an engine is to be faster than sampling."""
_COLOURS: Final = {KERNEL: picture.OURS, RULER: "#3d85c6", ASSESS: "#6fa8dc"}


def line_up(
    plan: Plan,  # noqa: ARG001 - a question is asked as often as one likes
    *,
    seed: int,
    told: Callable[[str], None],
    sizes: tuple[int, ...] = SIZES,
    questions: int = QUESTIONS,
) -> LineUp[PitKey]:
    """Cells of all workloads; see `Bench.line_up`.

    Args:
        plan: how often.
        seed: of the questions.
        told: receives the name of each step.
        sizes: with how many things about the arm, besides the twenty among which we are compared with sampling.
        questions: how many different ones of each workload.
    """
    found, unmeasured = installed({mujoco_sampled.NAME: lambda: package("mujoco", "mujoco")[1]}, PitKey)
    mujoco = {"mujoco": found[0]} if found else {}
    told("drawing questions, and sampling what is true of them")
    groups, streamed = _groups(np.random.default_rng(seed), sizes, questions, mujoco=bool(mujoco))
    prepare_physics()
    versions = {"engine": chosen().name, "pin": metadata.version("pin"), "coal": metadata.version("coal")}
    bars = {name: bar for name, (_, bar) in SPEEDUPS.items()}
    return LineUp(groups, unmeasured, versions | mujoco, more={"bars": bars}, frequent=streamed, often=STREAMED)


def _groups(
    rng: np.random.Generator, sizes: tuple[int, ...], count: int, *, mujoco: bool
) -> tuple[list[list[Cell[PitKey]]], list[list[Cell[PitKey]]]]:
    """Cells that take turns with each other, and those that are asked more often."""
    among = [ready(each) for each in workload.bare(rng, 20, count)]
    groups = [beside_sampling(among, AMONG_20, mujoco=mujoco)]
    for things in sizes:
        asked, name = [ready(each) for each in workload.peopled(rng, things, count)], peopled("moveJ", things)
        groups.append([assessing(asked, name), checking(asked, name)])
    for things in sizes:
        asked = [ready(each) for each in workload.lines(rng, things, count)]
        groups.append([assessing(asked, peopled("moveL", things))])
    asked = [legs_truth(each) for each in workload.sequences(rng, 20, max(1, count // 4))]
    groups.append([assessing(asked, peopled("20 moves", 20))])
    prepared: list[Cell[PitKey]] = []
    whole: list[Cell[PitKey]] = []
    for servo, name in ((False, SPEED_STEP), (True, SERVO_STEP)):
        asked = [ready(each) for each in workload.steps(rng, 20, count, servo=servo)]
        prepared.append(streaming(asked, name))
        whole.append(assessing(asked, name))
    # Each by itself: the server of a stream asks about nothing else in between.
    return groups, [prepared, whole]


def wanted(row: Row[PitKey]) -> Row[PitKey]:
    """The row with its figures in cycles of 2 ms, those that we want, and whether they are met."""
    p50, p99 = (None if us is None else us / CYCLE_US for us in (row.p50_us, row.p99_us))
    target = TARGETS.get(row.of)
    most = (None, None) if target is None else tuple(us / CYCLE_US for us in target)
    met = ""
    if p50 is not None and p99 is not None and target is not None:
        met = "met" if p50 * CYCLE_US <= target[0] and p99 * CYCLE_US <= target[1] else "missed"
    cycles = {
        "cycles_p50": None if p50 is None else round(p50, 4),
        "cycles_p99": None if p99 is None else round(p99, 4),
    }
    return replace(row, more={**cycles, "target_p50": most[0], "target_p99": most[1], "met": met})


def ratios(rows: Sequence[Row[PitKey]], _: Mapping[str, Any], name: str) -> dict[str, float | None]:
    """Speed-ups over sampling, and shares of the controller's cycle; None for one that was not measured.

    `_first`: of the calls that follow another engine's, which left its own content in the processor's caches.
    """
    by = {row.of: row for row in rows if row.p50_us is not None}
    sampling = by.get(PitKey(SAMPLED, AMONG_20))

    def faster(peer: str, figure: str = name) -> float | None:
        ours = by.get(PitKey(peer, AMONG_20))
        if ours is None or sampling is None:
            return None
        return round(float(getattr(sampling, figure) / getattr(ours, figure)), 2)

    found = {key: faster(peer) for key, (peer, _) in SPEEDUPS.items()}
    found |= {f"{key}_first": faster(peer, "first_us") for key, (peer, _) in SPEEDUPS.items()}
    found["clearance_speedup_20"] = faster(RULER)
    steps = [by[of] for of in (PitKey(STREAM, SPEED_STEP), PitKey(STREAM, SERVO_STEP)) if of in by]
    for each in ("p50", "p99"):
        shares = (row.more[f"cycles_{each}"] for row in steps)
        found[f"stream_cycle_{each}"] = max(shares, default=None)
    return found


def tables(result: Result[PitKey]) -> Iterator[Table]:
    """Tables of durations, and of the contents of each answer."""
    measured = [row for row in result.rows if row.of.load is not None]
    yield table(
        "milliseconds, and cycles of 2 ms",
        ("of what", "by"),
        ("p50 ms", "first ms", "p99 ms", "cycles p50", "wanted", "cycles p99", "wanted", ""),
        ([str(row.of.load), row.of.peer, *_figures(row), row.more["met"]] for row in measured),
    )
    yield table("what an answer says", ("by", "says"), rows={row.of.peer: row.checks for row in measured}.items())


def _figures(row: Row[PitKey]) -> Iterator[str]:
    for us in (row.p50_us, row.first_us, row.p99_us):
        yield "" if us is None else f"{us / 1_000:.3f}"
    for name in ("cycles_p50", "target_p50", "cycles_p99", "target_p99"):
        share = row.more[name]
        yield "" if share is None else f"{share:.3f}"


def draw(result: Result[PitKey], file: Path) -> None:
    """A bar for each workload and answerer, the controller's cycle as a line."""
    bars = []
    for row in result.rows:
        if row.p50_us is not None and row.p99_us is not None:
            colour = _COLOURS.get(row.of.peer, picture.OTHERS)
            bars.append((f"{row.of.load}: {row.of.peer}", row.p50_us / 1_000, row.p99_us / 1_000, colour))
    cycle = (CYCLE_US / 1_000, "one cycle of 2 ms")
    picture.bars(file, "Certified physics and sampling", result.machine, bars, unit="ms", line=cycle)


def _absent(result: Result[PitKey]) -> Iterable[str]:
    return (f"{row.of.peer}: {row.why}" for row in result.rows if row.of.load is None)


BENCH: Final = Bench(
    line_up,
    FULL,
    QUICK,
    ratios,
    "times faster than sampling, and shares of a cycle of 2 ms",
    tables,
    draw,
    few={"sizes": (5,), "questions": 2},
    remarks=_absent,
    wanted=wanted,
)
