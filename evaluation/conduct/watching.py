"""Reports of simulated agents through the reducers of `policies.conduct.behaviour`: alarms, delays, levels."""

from __future__ import annotations

import random
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

from evaluation.conduct.agents import BEGIN, Worker, life
from policies.conduct.behaviour import NOTHING_KNOWN, observe, reading, restore

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from evaluation.conduct.agents import Draft
    from policies.conduct.report import Report
    from policies.evidence.conduct_readings import Feature
    from policies.words.parameters import Parameters


@dataclass(frozen=True, slots=True)
class Caught:
    """Time at which a change was noticed, from the change on.

    Attributes:
        acts, seconds: until the first deviation.
        contracted: acts until the agent was contracted, or None when it was not.
        features: that deviated by then.
        crossed: an act was over a limit before the first deviation.
    """

    acts: int
    seconds: int
    contracted: int | None
    features: tuple[Feature, ...]
    crossed: bool


def false_alarms(reports: Iterable[Report], parameters: Parameters) -> tuple[dict[Feature, int], int]:
    """Deviations by feature, and contractions, of one agent that a person restores after each alarm it contracts for.

    Every report must be of an honest agent. An alarm without contraction is restored at once as well: the rate is what
    is measured, and after an alarm the detectors start afresh in any case.
    """
    alarms: dict[Feature, int] = {}
    state, contracted = NOTHING_KNOWN, 0
    for report in reports:
        state = observe(state, report, parameters, now=report.at)
        known = state.careers[report.agent]
        if known.deviations:
            for deviation in known.deviations:
                alarms[deviation.feature] = alarms.get(deviation.feature, 0) + 1
            contracted += known.contracted
            state = restore(state, report.agent, by="person", at=report.at)
    return alarms, contracted


def caught(
    script: Callable[[random.Random, int, Draft], Draft],
    parameters: Parameters,
    *,
    seed: int,
    change_at: int,
    patience: int,
) -> Caught | None:
    """Time at which the change of a worker was noticed; None when it was not in `patience` acts.

    A false alarm before the change is restored by a person, as it would be.
    """
    rng = random.Random(seed)  # noqa: S311 - draws, no secrets
    state, first, crossed, begun = NOTHING_KNOWN, None, False, BEGIN
    reports = life(Worker(rng), change_at=change_at, script=script)
    for n, report in enumerate(islice(reports, change_at + patience)):
        state = observe(state, report, parameters, now=report.at)
        word = reading(state, report.agent, report.at, 0, parameters)
        if n < change_at:
            begun = report.at
            if word.deviations:
                state = restore(state, report.agent, by="person", at=report.at)
            continue
        k = n - change_at + 1
        if first is None and word.deviations:
            features = tuple(deviation.feature for deviation in word.deviations)
            first = Caught(k, report.at - begun, None, features, crossed)
        crossed = crossed or report.near_permille == 1000
        if first is not None and word.contracted:
            return Caught(first.acts, first.seconds, k, first.features, first.crossed)
    return first
