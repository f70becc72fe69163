"""Telling of the story: each step in order, observed before, meanwhile and afterwards, and judged."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from ztpm.stage.stage import until

if TYPE_CHECKING:
    from collections.abc import Callable

    from ztpm.stage.calls import Answer
    from ztpm.stage.stage import Stage
    from ztpm.stage.stopping import Stopped

MOVED_RAD: Final = 1e-3
"""Less than this on every joint is standing still (the simulator's and the sensor's noise is far below)."""


@dataclass(frozen=True, slots=True)
class Expect:
    """Expected observations of a step.

    Attributes:
        decision, reason, tier: as answered; None stands for anything.
        moves: whether the arm must move (True) or must not (False).
        recorded: whether the PEP's journal must hold a record with this decision and reason.
        ledger: kind of the entry that the identity provider's ledger must have gained, or None.
        attack: a request beyond what was lent, or forged, stolen or repeated.
    """

    decision: str
    reason: str | None = None
    tier: int | None = None
    moves: bool = False
    recorded: bool = True
    ledger: str | None = None
    attack: bool = False


@dataclass(frozen=True, slots=True)
class StepObservation:
    """Observations of a step.

    Attributes:
        told: one sentence, with the observed values in it.
        decision, reason, tier, latency_ms: of the decisive call.
        ok: all other expectations of the step itself hold.
        stop: stop whose cause had an instant, as measured.
    """

    told: str
    decision: str
    reason: str
    tier: int | None = None
    latency_ms: float = 0.0
    ok: bool = True
    stop: Stopped | None = None

    @classmethod
    def answer(cls, told: str, answer: Answer, *, ok: bool = True, stop: Stopped | None = None) -> StepObservation:
        """Observation of an answer from the tool server."""
        return cls(told, answer.decision, answer.reason, answer.tier, answer.latency_ms, ok, stop)


@dataclass(frozen=True, slots=True)
class StoryStep:
    """One step of the story: id, expected observations, action, requirements, preparation.

    Motion and decisions of `prepare` are not observed.
    """

    id: str
    expect: Expect
    play: Callable[[Stage], StepObservation]
    needs: tuple[str, ...] = ()
    prepare: Callable[[Stage], None] | None = None


@dataclass(frozen=True, slots=True)
class StepReport:
    """One played step, as reported.

    Attributes:
        moved_rad: way of the joint that went farthest.
        recorded: the PEP's journal has a record with this decision and reason.
        attack: see `Expect`.
        stop_ms: from the cause of a stop to standstill, or None.
        ok: everything is as told.
    """

    id: str
    told: str
    decision: str
    reason: str
    tier: int | None
    latency_ms: float
    moved_rad: float
    recorded: bool
    attack: bool
    stop_ms: float | None
    ok: bool


@dataclass
class Story:
    """The steps of a chapter, or of all, in order."""

    title: str
    steps: list[StoryStep] = field(default_factory=list)

    def step(
        self,
        name: str,
        expect: Expect,
        *,
        needs: tuple[str, ...] = (),
        prepare: Callable[[Stage], None] | None = None,
    ) -> Callable[[Callable[[Stage], StepObservation]], Callable[[Stage], StepObservation]]:
        """Adds a step."""

        def add(play: Callable[[Stage], StepObservation]) -> Callable[[Stage], StepObservation]:
            self.steps.append(StoryStep(name, expect, play, needs, prepare))
            return play

        return add

    def only(self, names: frozenset[str] | None) -> list[StoryStep]:
        """Named steps and those that they need, in order; all of them for None."""
        if names is None:
            return self.steps
        wanted, rows = set(names), {step.id: step for step in self.steps}
        frontier = list(names)
        while frontier:
            for need in rows[frontier.pop()].needs:
                if need not in wanted:
                    wanted.add(need)
                    frontier.append(need)
        return [step for step in self.steps if step.id in wanted]


def play(on_stage: Stage, step: StoryStep) -> StepReport:
    """Plays and judges the step. An exception is a step that is not as told."""
    started = time.perf_counter()
    try:
        if step.prepare is not None:
            step.prepare(on_stage)
            until(lambda: on_stage.still, "standstill")
        before = on_stage.joints
        on_stage.begin()
        started = time.perf_counter()
        seen = step.play(on_stage)
        until(lambda: on_stage.still, "standstill")
    except Exception as error:  # noqa: BLE001 - the story goes on, and tells the error
        elapsed = (time.perf_counter() - started) * 1e3
        return StepReport(
            step.id, f"{type(error).__name__}: {error}"[:400], "NONE", "STEP_FAILED", None, elapsed, 0.0,
            recorded=False, attack=step.expect.attack, stop_ms=None, ok=False,
        )  # fmt: skip
    moved = max(abs(now - then) for now, then in zip(on_stage.joints, before, strict=True))
    expect = step.expect
    recorded = (seen.decision, seen.reason) in map(_verdict, on_stage.journal())
    entered = expect.ledger is None or expect.ledger in on_stage.new_ledger_kinds()
    ok = (
        seen.ok
        and (recorded or not expect.recorded)
        and entered
        and seen.decision == expect.decision
        and expect.reason in (None, seen.reason)
        and expect.tier in (None, seen.tier)
        and (moved > MOVED_RAD) == expect.moves
    )
    stop_ms = None if seen.stop is None else (seen.stop.reaction_s + seen.stop.braking_s) * 1e3
    return StepReport(
        step.id, seen.told, seen.decision, seen.reason, seen.tier, seen.latency_ms, moved,
        recorded=recorded, attack=expect.attack, stop_ms=stop_ms, ok=ok,
    )  # fmt: skip


def _verdict(row: dict[str, Any]) -> tuple[object, object]:
    """Effect and reason of a decision or a refusal as the PEP recorded it."""
    body = row["body"]
    said = body["decision"] if row["kind"] == "decision" else body
    return said.get("effect"), said.get("reason")
