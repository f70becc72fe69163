"""False alarms: of the detectors on streams of exactly their assumed share, and of honest agents as a whole."""

from __future__ import annotations

import random
from itertools import islice
from typing import TYPE_CHECKING, Final

from evaluation.conduct.agents import PHASES, Worker, life
from evaluation.conduct.counting import interval
from evaluation.conduct.watching import false_alarms
from evaluation.harness.campaign import Campaign, Outcome
from policies.conduct.cusum import watched
from policies.evidence.conduct_readings import Feature
from policies.words.parameters import Parameters

if TYPE_CHECKING:
    from evaluation.harness.campaign import Settings

PARAMETERS: Final = Parameters()
STATED: Final = PARAMETERS.behaviour_false_alarm_count
"""Acts between two false alarms of one feature, at least."""
SHARES: Final = (30, 100, 200, 350, 500, 700)
SURE: Final = 0.001
"""Significance level: a rate is above the stated one when that one would show it less often."""
RHYTHMS: Final = {"independent": 30, "rounds": 10, "phases": 10, "long phases": 10}
"""Workers of each rhythm."""
ACTS: Final = 6_000
"""Acts of each."""


def detectors(settings: Settings) -> Outcome:
    """The worst case: every trial hits with just the probability that the detector is for."""
    trials = 100_000 if settings.quick else 2_000_000
    draw = random.Random(settings.seed)  # noqa: S311 - draws, no secrets
    figures: dict[str, int | float | str] = {}
    faults = []
    for share in SHARES:
        settings.told(f"share {share}")
        detector, level, alarms = watched(share, STATED), 0, 0
        for _ in range(trials):
            level = detector.step(level, hit=draw.random() * 1000 < share)
            if level >= detector.limit:
                alarms, level = alarms + 1, 0
        figures[f"{share} permille"] = rate(alarms, trials)
        if interval(alarms, side=SURE)[0] * STATED > trials:
            faults.append(f"share {share}: {alarms} alarms in {trials} trials")
    return Outcome(trials * len(SHARES), figures, tuple(faults))


def workers(settings: Settings, rhythm: str) -> Outcome:
    """Whole agents, each with the baseline that it taught."""
    count, acts = (4, 2_000) if settings.quick else (RHYTHMS[rhythm], ACTS)
    alarms, contracted = dict.fromkeys(Feature, 0), 0
    for n in range(count):
        settings.told(f"{rhythm} {n + 1} of {count}")
        worker = Worker(random.Random(f"{settings.seed} {n}"), rhythm)  # noqa: S311 - draws, no secrets
        found, wrongly = false_alarms(islice(life(worker), acts), PARAMETERS)
        contracted += wrongly
        for feature, times in found.items():
            alarms[feature] += times
    whole = count * acts
    figures: dict[str, int | float | str] = {str(feature): rate(times, whole) for feature, times in alarms.items()}
    if rhythm in PHASES:
        return Outcome(whole, {**figures, "contracted": contracted})
    # In a quick run even no alarm at all proves nothing: there only a rate that is plainly above is a fault.
    worst = {feature: interval(times)[0 if settings.quick else 1] * STATED for feature, times in alarms.items()}
    faults = [f"{feature}: {alarms[feature]} alarms in {whole} acts" for feature in Feature if worst[feature] > whole]
    return Outcome(whole, {**figures, "contracted": contracted}, tuple(faults))


def rate(alarms: int, trials: int) -> str:
    """Alarms in as many trials as one is stated for, with the interval of 95 %."""
    low, high = (end * STATED / trials for end in interval(alarms))
    return f"{alarms * STATED / trials:.2f} ({low:.2f} to {high:.2f})"


def _of(rhythm: str) -> Campaign:
    return Campaign(
        f"F-{rhythm}",
        f"honest agents whose acts come {TITLES[rhythm]}; per {STATED:,} acts",
        "shown: what is stated is of independent acts"
        if rhythm in PHASES
        else "each feature at most 1, upper end included",
        lambda settings: workers(settings, rhythm),
    )


TITLES: Final = {
    "independent": "independently",
    "rounds": "in rounds of one task",
    "phases": "in phases of a dozen",
    "long phases": "in phases of thirty",
}

CAMPAIGNS: Final = (
    Campaign(
        "F-detector", f"false alarms of the detector at its own share; per {STATED:,} trials", "at most 1", detectors
    ),
    *map(_of, RHYTHMS),
)
