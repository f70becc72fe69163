"""Three pictures: trust over time, detector levels of four agents, and delays beside their bars."""

from __future__ import annotations

import importlib
import random
from itertools import islice
from typing import TYPE_CHECKING, Any, Final

from evaluation.conduct import agents
from evaluation.conduct.agents import BEGIN, Worker, life
from evaluation.conduct.delays import CHANGES, LEARNED
from evaluation.conduct.trusting import (
    ATTEMPT,
    DAY,
    PARAMETERS,
    PRIOR,
    THETA,
    WORK,
    WRONG,
    after,
    liars,
    on_off,
    permille,
    told,
    veteran,
)
from evaluation.conduct.watching import caught
from policies.conduct.baseline import FEATURES, Watch
from policies.conduct.behaviour import NOTHING_KNOWN, observe
from policies.conduct.trust import NOTHING_REPORTED

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from evaluation.conduct.agents import Draft
    from policies.conduct.history import AgentHistory
    from policies.conduct.trust import TrustState

SHOWN: Final = {
    "slow drift to a limit": (agents.drifter(500), 500),
    "new operations": (agents.tool_changer, 40),
    "one act in three not lent": (agents.prober, 60),
    "ten acts a second": (agents.flooder, 100),
}
"""Agents whose detectors are drawn, and for how many acts after the change."""
DOTS: Final = 80
DRAWN: Final = 20
"""Runs of each change whose delays are drawn."""


def plot(directory: Path, *, seed: int) -> tuple[Path, ...]:
    """Writes the pictures.

    Raises:
        ModuleNotFoundError: matplotlib is not installed.
    """
    importlib.import_module("matplotlib").use("Agg")
    pyplot = importlib.import_module("matplotlib.pyplot")
    directory.mkdir(parents=True, exist_ok=True)
    drawn = {
        "trust.png": _trust(pyplot),
        "detectors.png": _detectors(pyplot, seed),
        "delays.png": _delays(pyplot, seed),
    }
    for name, figure in drawn.items():
        figure.savefig(directory / name, dpi=DOTS)
        pyplot.close(figure)
    return tuple(directory / name for name in drawn)


def _trust(pyplot: Any) -> Any:
    figure, (fading, playing, lying) = pyplot.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    hours = range(121)
    done = {
        "stranger, one attempt at more": after(NOTHING_REPORTED, [told(ATTEMPT, BEGIN, 0)]),
        "veteran, one attempt at more": after(veteran(BEGIN), [told(ATTEMPT, BEGIN, 0)]),
        "stranger, three wrongs": after(NOTHING_REPORTED, [told(WRONG, BEGIN, n) for n in range(3)]),
        "stranger, charged to the cap": liars(1, 10),
    }
    for title, state in done.items():
        fading.plot([hour / 24 for hour in hours], _curve(state, [BEGIN + hour * 3_600 for hour in hours]), label=title)
    fading.set(title="without further acts", xlabel="days", ylabel="trust in the edge, permille", ylim=(0, 850))
    curve, wrongs = on_off(2)
    playing.plot([at / DAY for at, _ in curve], [found for _, found in curve], linewidth=0.8, label="its trust")
    playing.plot([at / DAY for at in wrongs], [THETA - 30] * len(wrongs), "r|", label=f"its {len(wrongs)} wrongs")
    playing.set(title="a veteran that does wrong when it can", xlabel="days", ylim=(650, 820))
    for count in (1, 2, 3):
        lying.plot(range(21), [permille(liars(count, lies), BEGIN) for lies in range(21)], label=f"{count} against it")
    witness = after(NOTHING_REPORTED, [told(WRONG, BEGIN, n) for n in range(5)])
    praise = [
        permille(after(witness, (told(WORK, BEGIN, n, reporter="liar") for n in range(lies))), BEGIN)
        for lies in range(21)
    ]
    lying.plot(range(21), praise, "k:", label="for what another saw do wrong")
    lying.set(title="false words, all at one instant", xlabel="words of each reporter", ylim=(0, 850))
    for axes, place in ((fading, "lower right"), (playing, "upper right"), (lying, (0.38, 0.5))):
        axes.axhline(PRIOR, color="grey", linewidth=0.6)
        axes.axhline(THETA, color="grey", linewidth=0.6, linestyle="--")
        axes.legend(fontsize=7, loc=place)
    return figure


def _curve(state: TrustState, times: Sequence[int]) -> list[int]:
    return [permille(state, at) for at in times]


def _detectors(pyplot: Any, seed: int) -> Any:
    figure, every = pyplot.subplots(2, 2, figsize=(10, 5.6), layout="constrained")
    colours = {watch: f"C{list(Watch).index(watch) % 10}" for watch in Watch}
    for axes, (title, (script, acts)) in zip(every.flat, SHOWN.items(), strict=True):
        levels = _levels(script, acts, seed)
        for watch in Watch:
            if max(levels[watch]) >= 1:
                name = f"{FEATURES[watch]}: {watch.name.lower().replace('_', ' ')}"
                axes.plot(range(-100, acts), levels[watch], linewidth=0.9, color=colours[watch], label=name)
        axes.axhline(1, color="grey", linewidth=0.6, linestyle="--")
        axes.axvline(0, color="grey", linewidth=0.6)
        axes.set(title=title, xlabel="acts after the change", ylabel="level / limit", ylim=(0, 1.3))
        axes.legend(fontsize=7, loc="upper left")
    return figure


def _levels(script: Callable[[random.Random, int, Draft], Draft], acts: int, seed: int) -> dict[Watch, list[float]]:
    """Level of each detector as a share of its limit, from a hundred acts before the change.

    An alarm is at least 1.
    """
    rng = random.Random(seed)  # noqa: S311 - draws, no secrets
    state, levels = NOTHING_KNOWN, {watch: list[float]() for watch in Watch}
    for n, report in enumerate(islice(life(Worker(rng), change_at=LEARNED, script=script), LEARNED + acts)):
        before = state.careers.get(report.agent)
        state = observe(state, report, PARAMETERS, now=report.at)
        if before is None or n < LEARNED - 100:
            continue
        for watch in Watch:
            levels[watch].append(_share(state.careers[report.agent], watch, before))
    return levels


def _share(career: AgentHistory, watch: Watch, before: AgentHistory) -> float:
    detector = career.detector(watch, None, PARAMETERS)
    if detector is None:
        return 0.0
    level, last = career.levels[watch], before.levels[watch]
    if level == 0 and last and last + detector.up >= detector.limit and career.alarmed == before.acts:
        return 1.0  # it alarmed, and started afresh
    return level / detector.limit


def _delays(pyplot: Any, seed: int) -> Any:
    figure, axes = pyplot.subplots(figsize=(8, 4), layout="constrained")
    names = [change.name for change in CHANGES]
    found = [[run.acts for n in range(DRAWN) if (run := _one(change, seed + n)) is not None] for change in CHANGES]
    axes.boxplot(found, orientation="horizontal", whis=(0, 100), tick_labels=names)
    axes.plot([change.bar for change in CHANGES], range(1, len(CHANGES) + 1), "r|", markersize=12, label="bar")
    axes.set(xlabel=f"acts until the first deviation (box: middle half; whiskers: all of {DRAWN})", xscale="log")
    axes.invert_yaxis()
    axes.legend()
    return figure


def _one(change: Any, seed: int) -> Any:
    return caught(change.script, PARAMETERS, seed=seed, change_at=change.change_at, patience=4 * change.bar)
