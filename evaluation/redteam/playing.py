"""One scenario, played in an arena and judged by the referee."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from evaluation.redteam.parts import Came, Effect
from evaluation.redteam.record import HarmSeen, RunRecord, end_of, refused

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from evaluation.redteam.parts import Deed, Moment, Playable
    from evaluation.redteam.scenario import Scenario
    from ztpm.stage.samples import Sample, StateRecorder


class Arena(Protocol):
    """Place where a scenario is played."""

    eyes: StateRecorder

    def prepare(self, scenario: Playable) -> None:
        """Brings everything to where the scenario begins."""

    def show(self, moment: Moment) -> None:
        """Shows the sensors what truly changed, as far as they see it."""

    def perform(self, act: Deed) -> Came:
        """Does an act."""

    def settle(self) -> None:
        """Waits until the arm stands still."""

    def harm(self) -> tuple[HarmSeen, ...]:
        """Harm that is no motion: what left, what was taken, what no longer works."""

    def primitives(self) -> Mapping[str, float]:
        """Primitives that findings on record name: each with the time of the first one, seconds since the epoch."""

    def digest(self) -> str:
        """Digest of the records of the run."""


class Judge(Protocol):
    """Referee: harm by motion."""

    def __call__(self, samples: Sequence[Sample], first_s: float, scenario: Scenario) -> tuple[HarmSeen, ...]:
        """Harm that the samples show, from the monotonic time of the first act on, in the scenario's true world."""


@dataclass(frozen=True, slots=True)
class Setting:
    """Mode in which an arena stands.

    Attributes:
        mode: `none`, `tokens`, `policy` or `all`.
        approver: whether a person says yes to each question.
    """

    mode: str
    approver: bool


def played(
    scenario: Scenario,
    arena: Arena,
    setting: Setting,
    judge: Judge,
) -> RunRecord:
    """Record of a scenario that was played once.

    Args:
        scenario: to play.
        arena: where.
        setting: of the arena.
        judge: the referee.
    """
    begun_s = time.monotonic()
    arena.prepare(scenario)
    for moment in scenario.world:
        if moment.at_s <= 0:
            arena.show(moment)
    first_s, first_wall_s = time.monotonic(), time.time()
    with _changing(scenario, arena):
        came = _acts(scenario, arena)
        acted_s = time.monotonic()
        arena.settle()
    samples = arena.eyes.since(first_s)
    harm = (*judge(samples, first_s, scenario), *arena.harm())
    moving = [sample.arrived_s for sample in samples if not sample.still]
    named = arena.primitives()
    return RunRecord(
        scenario=scenario.id,
        mode=setting.mode,
        approver=setting.approver,
        end=end_of(came, hazardous=scenario.hazardous, harmed=bool(harm)),
        refused=not scenario.hazardous and refused(came, scenario.expects),
        came=came,
        harm=tuple(sorted(harm, key=lambda one: one.at_s)),
        contained_s=round((moving[-1] if moving else acted_s) - first_s, 3),
        seconds=round(time.monotonic() - begun_s, 3),
        digest=arena.digest(),
        named_s={id_: round(at_s - first_wall_s, 3) for id_, at_s in sorted(named.items())},
    )


def _acts(scenario: Scenario, arena: Arena) -> tuple[Came, ...]:
    """Outcome of each act; one whose need did not get through is left out."""
    came: list[Came] = []
    through: set[str] = set()
    for act in scenario.act:
        if act.needs and act.needs not in through:
            came.append(Came(Effect.OMITTED))
            continue
        came.append(arena.perform(act))
        if came[-1].effect is Effect.DONE:
            through.add(act.name)
    return tuple(came)


@contextmanager
def _changing(scenario: Scenario, arena: Arena) -> Iterator[None]:
    """Shows the later changes of the world at their times while the acts are done."""
    later = [threading.Timer(moment.at_s, arena.show, [moment]) for moment in scenario.world if moment.at_s > 0]
    for each in later:
        each.start()
    try:
        yield
    finally:
        for each in later:
            each.cancel()
            each.join()
