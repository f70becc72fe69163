"""Simulated agents: an honest worker, and the ways in which one may change. Everything is drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import count
from typing import TYPE_CHECKING, Final

from policies.conduct.report import Report

if TYPE_CHECKING:
    import random
    from collections.abc import Callable, Iterator

BEGIN: Final = 1_700_000_000
"""Seconds since the epoch at which every simulation begins."""
SPONSOR: Final = "ann"
OPERATIONS: Final = ("move_joint", "move_linear", "gripper_move", "read_state")
JOINTS: Final = 6
TASK: Final = ("read_state", "move_joint", "move_linear", "gripper_move", "move_linear", "move_joint", "gripper_move")
"""One round of a worker that always does the same."""


PHASES: Final = {"phases": 12, "long phases": 30}
"""Acts of one phase."""


@dataclass(frozen=True, slots=True)
class Draft:
    """Act before it is reported: a script may change it.

    Attributes:
        operation, tier, values, near: as in a report; near is None for an act without a limit.
        gap_s: seconds since the act before, with fractions.
        refused: the reason of a refusal; "" for a PERMIT.
    """

    operation: str
    tier: int
    values: tuple[tuple[str, int], ...]
    near: int | None
    gap_s: float
    refused: str = ""


@dataclass(slots=True)
class Worker:
    """An honest worker with habits of its own, the same all its life.

    Attributes:
        rng: of every draw.
        rhythm: "independent" draws each operation for itself; "rounds" repeats one task; "phases" does a dozen acts of
            one kind, then of another, so that acts are like the ones before; "long phases" thirty.
    """

    rng: random.Random
    rhythm: str = "independent"
    weights: list[float] = field(init=False)
    centres: list[list[float]] = field(init=False)
    slips: float = field(init=False)
    gap_s: float = field(init=False)
    closeness: tuple[float, float] = field(init=False)
    turn: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        draw = self.rng
        self.weights = [draw.uniform(1, 4) for _ in OPERATIONS]
        self.centres = [[draw.uniform(-1.5e6, 1.5e6) for _ in range(JOINTS)] for _ in OPERATIONS]
        self.slips = draw.uniform(0, 0.02)
        self.gap_s = draw.uniform(2, 20)
        self.closeness = draw.uniform(1.5, 3), draw.uniform(4, 8)

    def draft(self) -> Draft:
        """Its next act."""
        draw = self.rng
        if self.rhythm == "rounds":
            operation = TASK[self.turn % len(TASK)]
        elif self.rhythm in PHASES:
            operation = OPERATIONS[self.turn // PHASES[self.rhythm] % len(OPERATIONS)]
        else:
            operation = draw.choices(OPERATIONS, self.weights)[0]
        self.turn += 1
        centres = self.centres[OPERATIONS.index(operation)]
        values: tuple[tuple[str, int], ...] = ()
        near = None
        if operation.startswith("move"):
            values = tuple((f"q_urad.{joint}", round(draw.gauss(c, 2e5))) for joint, c in enumerate(centres))
        elif operation == "gripper_move":
            values = (("width_um", round(draw.uniform(20_000, 85_000))),)
        if values:
            near = round(1000 * draw.betavariate(*self.closeness))
        refused = "LIMIT_EXCEEDED_BY_REQUEST" if draw.random() < self.slips else ""
        return Draft(operation, int(bool(values)), values, near, draw.expovariate(1 / self.gap_s), refused)


def life(
    worker: Worker,
    *,
    agent: str = "worker",
    reporter: str = "pep",
    change_at: int | None = None,
    script: Callable[[random.Random, int, Draft], Draft] | None = None,
) -> Iterator[Report]:
    """Its reports, without end; from act `change_at` on as the script has it."""
    at = float(BEGIN)
    for n in count():
        draft = worker.draft()
        if script is not None and change_at is not None and n >= change_at:
            draft = script(worker.rng, n - change_at, draft)
        at += draft.gap_s
        yield reported(draft, at=int(at), n=n, agent=agent, reporter=reporter)


def reported(draft: Draft, *, at: int, n: object, agent: str = "worker", reporter: str = "pep") -> Report:
    """The report of one act."""
    return Report(
        reporter=reporter,
        request_id=f"{reporter}-{n}",
        agent=agent,
        delegators=(SPONSOR, agent),
        at=at,
        operation=draft.operation,
        base_tier=draft.tier,
        runtime_tier=draft.tier,
        effect="DENY" if draft.refused else "PERMIT",
        reason=draft.refused or "PERMITTED",
        outcome="none" if draft.refused else "done",
        values=draft.values,
        near_permille=draft.near,
    )


# --- changes of an agent ---------------------------------------------------------------------------------------------


def drifter(milli_per_act: int) -> Callable[[random.Random, int, Draft], Draft]:
    """Script whose acts come closer to their limit one by one; over 1000 permille they are refused."""

    def script(_: random.Random, k: int, draft: Draft) -> Draft:
        if draft.near is None:
            return draft
        near = draft.near + k * milli_per_act // 1000
        return replace(draft, near=min(near, 1000), refused="LIMIT_EXCEEDED_BY_REQUEST" if near > 1000 else "")

    return script


def tool_changer(draw: random.Random, _: int, draft: Draft) -> Draft:
    """Every second act is of operations that it never used."""
    if draw.random() < 0.5:
        return replace(draft, operation=draw.choice(("set_output", "run_program")), values=(), near=None)
    return draft


def mix_changer(draw: random.Random, _: int, draft: Draft) -> Draft:
    """The operations that it knows, in another mixture: nine in ten acts look, one moves."""
    if draw.random() < 0.9:
        return replace(draft, operation="read_state", tier=0, values=(), near=None)
    return draft


def elsewhere(draw: random.Random, _: int, draft: Draft) -> Draft:
    """Script of the same operations at another place: every joint 0.8 rad away."""
    del draw
    return replace(draft, values=tuple((name, value + 800_000) for name, value in draft.values))


def salami(draw: random.Random, k: int, draft: Draft) -> Draft:
    """A forbidden move in many small, quick steps, each well inside every limit."""
    steps = tuple((f"q_urad.{joint}", 2_000_000 + 1_000 * k) for joint in range(JOINTS))
    return replace(draft, operation="move_joint", tier=1, values=steps, near=draw.randrange(100, 200), gap_s=0.4)


def prober(draw: random.Random, _: int, draft: Draft) -> Draft:
    """Script in which one act in three asks for more than was lent."""
    return replace(draft, refused="NOT_GRANTED") if draw.random() < 1 / 3 else draft


def flooder(_: random.Random, __: int, draft: Draft) -> Draft:
    """Script of the same acts, ten a second."""
    return replace(draft, gap_s=0.1)


def hasty(_: random.Random, __: int, draft: Draft) -> Draft:
    """Script of the same acts, three times as fast."""
    return replace(draft, gap_s=draft.gap_s / 3)


def at_the_edge(draw: random.Random, _: int, draft: Draft) -> Draft:
    """Script with half of the moves in the last tenth of the allowed range."""
    if draft.near is None or draw.random() < 0.5:
        return draft
    return replace(draft, near=draw.randrange(900, 1000))


def turncoat(draw: random.Random, k: int, draft: Draft) -> Draft:
    """Script of a sleeper that wakes: edge, probe and new tools at once."""
    return prober(draw, k, at_the_edge(draw, k, tool_changer(draw, k, draft)))
