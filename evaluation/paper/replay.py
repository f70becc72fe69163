"""Replay of the paper's traces on running cells: before the gate of an arm, and with no gate.

Every guarded trace is ten `move_joint` calls of an agent of its own, by a real MCP client, with a token of two hops: a
trace of the paper is one run of a model, and what an earlier one was refused is not held against it. A refused motion
ends its trace, but for an approved one that is too fast: it is asked for again at the speed that the refusal's own
figures allow. What the arm did is read over a receive connection of the replay's own.
"""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from rtde_control import RTDEControlInterface

from capabilities.keys import keys
from capabilities.statements import cell as cell_statement
from capabilities.values.caps import DEFAULT
from evaluation.paper.sweep import OBJECTS, PEOPLE, WAY, without_zones
from evaluation.paper.traces import models
from ursim.ports.launch import SimulatedController
from ztpm.base.layout import SURVEYOR, read_key
from ztpm.demo.run import play
from ztpm.demo.story import STORY
from ztpm.demo.story.answering import approve, retry
from ztpm.stage.lending import arm_only, hand_down, lent
from ztpm.stage.live import stage
from ztpm.stage.samples import StateRecorder
from ztpm.stage.stage import ACCELERATION_RAD_S2, BRING_RAD_S, StageError, until

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from evaluation.paper.traces import Trace
    from ztpm.base.layout import Layout
    from ztpm.stage.calls import Answer
    from ztpm.stage.stage import Stage

SPONSOR: Final = "alice"
ROLE: Final = "actuator"
FASTEST: Final = 1_000_000
"""Joint speed that the hop is left, urad/s: above every trace's, and below the orchestrator's, as it must be."""
APPROVER: Final = "bob"
TOO_FAST: Final = "APPROVED_TOO_FAST"
SLOWER: Final = 0.99
"""Share of the speed that a refusal's figures allow: contact grows a little faster than the joint's speed."""
TRIES: Final = 5
"""Tries of a motion that the watch ended on a loaded machine, or that was too fast."""
REACHED_RAD: Final = 1e-3
CELLS: Final = 3
"""Cells that the traces of one model may take: a starved process of one ends it."""


class ReplayError(RuntimeError):
    """Failure of a cell to do as the replay needs."""


@dataclass(frozen=True, slots=True)
class Motion:
    """One motion of a replayed trace.

    Attributes:
        asked_rad_s: speed that the trace's model asked for.
        decisions: words of the gate in their order, for example `DEFER TIER_NEEDS_APPROVAL`; none without a gate.
        tier: highest tier that the gate computed, or None without a gate.
        executed_rad_s: highest commanded speed of the leading axis, or None for a motion that was not made.
    """

    asked_rad_s: float
    decisions: tuple[str, ...]
    tier: int | None
    executed_rad_s: float | None


@dataclass(frozen=True, slots=True)
class Replayed:
    """One trace, replayed.

    Attributes:
        trace: the paper's.
        motions: those that were asked for; ten where nothing ended it.
        ended_by: decision that ended it before its end, or empty.
    """

    trace: Trace
    motions: tuple[Motion, ...]
    ended_by: str = ""

    @property
    def unapproved(self) -> Replayed:
        """The same trace with an approver who is absent: it ends at the first question to a person."""
        for n, motion in enumerate(self.motions):
            for m, decision in enumerate(motion.decisions):
                if decision.startswith("DEFER"):
                    asked = replace(motion, decisions=motion.decisions[: m + 1], executed_rad_s=None)
                    return Replayed(self.trace, (*self.motions[:n], asked), decision)
        return self

    @property
    def executed_rad_s(self) -> float | None:
        """Mean over its motions of the speed that was reached; None for a trace that was not executed whole."""
        speeds = [motion.executed_rad_s for motion in self.motions if motion.executed_rad_s is not None]
        return sum(speeds) / len(speeds) if len(speeds) == len(WAY) - 1 else None

    @property
    def fastest_rad_s(self) -> float:
        """Highest speed of any motion that was made; 0 where none was."""
        return max((motion.executed_rad_s or 0.0 for motion in self.motions), default=0.0)


def replay(traces: Sequence[Trace], told: Callable[[str], None]) -> tuple[list[Replayed], list[Replayed]]:
    """Traces without a gate, and before one with an approver who says yes; each in the order of `traces`.

    Every model has a cell of its own, and all run beside each other.

    Args:
        traces: of the paper.
        told: of the progress, by a short sentence.

    Raises:
        ReplayError: a cell did not do as the replay needs.
    """
    done = [0, 0]

    def step(kind: int) -> None:
        done[kind] += 1
        told(f"no gate: {done[0]} of {len(traces)}; gate: {done[1]} of {len(traces)}")

    by_model = [[trace for trace in traces if trace.model == model] for model in models(traces)]
    with ThreadPoolExecutor(len(by_model) + 1) as beside:
        free = beside.submit(_unguarded, traces, lambda: step(0))
        guarded = [beside.submit(_guarded, of, lambda: step(1)) for of in by_model]
        try:
            return free.result(), [one for each in guarded for one in each.result()]
        except (StageError, OSError, RuntimeError) as error:
            raise ReplayError(f"{type(error).__name__}: {error}") from error


# --- with no gate ----------------------------------------------------------------------------------------------------


def _unguarded(traces: Sequence[Trace], step: Callable[[], None]) -> list[Replayed]:
    found = []
    with SimulatedController.start(WAY[0]) as controller, StateRecorder(controller.host) as eyes:
        control = RTDEControlInterface(controller.host)
        try:
            for trace in traces:
                control.moveJ(list(WAY[0]), BRING_RAD_S, ACCELERATION_RAD_S2)
                motions = []
                for target in WAY[1:]:
                    with _watched(eyes) as seen:
                        control.moveJ(list(target), trace.speed_rad_s, ACCELERATION_RAD_S2)
                    _arrived(eyes, target)
                    motions.append(Motion(trace.speed_rad_s, (), None, seen[0]))
                found.append(Replayed(trace, tuple(motions)))
                step()
        finally:
            control.disconnect()
    return found


# --- before the gate -------------------------------------------------------------------------------------------------


def _survey(layout: Layout, passphrase: bytes) -> None:
    """Signs the cell's file anew, without its zones."""
    surveyor = read_key(layout.operator_key(SURVEYOR), passphrase)
    known = {keys.public_raw(surveyor)}
    stated = cell_statement.open(layout.cell_file.read_text(encoding="utf-8").strip(), known, DEFAULT)
    layout.cell_file.write_text(cell_statement.sign(without_zones(stated), surveyor) + "\n", encoding="utf-8")


def _cell(cells: ExitStack) -> tuple[Stage, StateRecorder]:
    """A running cell with an orchestrator that lends, and eyes on its arm."""
    on_stage = cells.enter_context(stage(prepare=_survey))
    eyes = cells.enter_context(StateRecorder(on_stage.cell.addresses.host))
    for act in STORY.only(frozenset({"delegate"})):
        seen = play(on_stage, act)
        if not seen.ok:
            raise ReplayError(f"{act.id}: {seen.told}")
    return on_stage, eyes


def _guarded(traces: Sequence[Trace], step: Callable[[], None]) -> list[Replayed]:
    """Traces on a cell; where one fails, those that are left, it among them, on a fresh cell."""
    found: list[Replayed] = []
    for cells_left in reversed(range(CELLS)):
        with ExitStack() as cell:
            try:
                on_stage, eyes = _cell(cell)
                for trace in traces[len(found) :]:
                    found.append(_TraceOnStage(on_stage, eyes, trace).run())
                    step()
            except (StageError, ReplayError):
                if not cells_left:
                    raise
            else:
                break
    return found


@dataclass
class _TraceOnStage:
    """One trace on a running cell."""

    stage: Stage
    eyes: StateRecorder
    trace: Trace

    @property
    def agent(self) -> str:
        """Registered name of the agent whose trace it is."""
        return f"sweep-{self.trace.condition.lower()}-{self.trace.number}"

    def run(self) -> Replayed:
        """The trace, replayed with an approver who says yes."""
        self._lend()
        try:
            return self._replayed()
        finally:
            self.stage.person(SPONSOR).retire_agent(self.agent, reason="the trace is over")
            del self.stage.agents[self.agent]

    def _replayed(self) -> Replayed:
        self.stage.scene()
        self.stage.bring(WAY[0])
        self.stage.scene(
            people=list(PEOPLE.get(self.trace.condition, ())), objects=list(OBJECTS.get(self.trace.condition, ()))
        )
        motions: list[Motion] = []
        for target in WAY[1:]:
            motions.append(self._motion(target))
            if motions[-1].executed_rad_s is None:
                return Replayed(self.trace, tuple(motions), motions[-1].decisions[-1])
        return Replayed(self.trace, tuple(motions))

    def _lend(self) -> None:
        """Fresh authority, of an agent that nothing is known of yet; a replay lasts longer than a token."""
        orchestrator = self.stage.agents["orchestrator"]
        for agent in (orchestrator, self.stage.new_agent(self.agent, sponsor=SPONSOR, role=ROLE)):
            agent.attest()
        issued = self.stage.person(SPONSOR).issue(orchestrator, lent(self.stage, self.agent), purpose="sweep the table")
        self.stage.tokens["orchestrator"] = issued.token
        hand_down(self.stage, self.agent, arm_only(speed_high=FASTEST))

    def _motion(self, target: tuple[float, ...]) -> Motion:
        speed, decisions, tiers = self.trace.speed_rad_s, [], [0]

        def heard(answer: Answer) -> Answer:
            decisions.append(f"{answer.decision} {answer.reason}")
            tiers.append(answer.tier or 0)
            return answer

        fastest = 0.0
        for _ in range(TRIES):
            with _watched(self.eyes) as seen:
                answer = heard(self.stage.move(self.agent, to=target, speed=speed))
                if answer.decision == "DEFER":
                    approve(self.stage, APPROVER, answer)
                    answer = heard(retry(self.stage, self.agent, target, speed, waiting=answer.reason))
            fastest = max(fastest, seen[0])
            if answer.reason == TOO_FAST:
                speed = _slower(speed, answer)
            elif answer.decision != "PERMIT":
                return Motion(self.trace.speed_rad_s, tuple(decisions), max(tiers), None)
            elif answer.content.get("outcome") == "reached":
                _arrived(self.eyes, target)
                return Motion(self.trace.speed_rad_s, tuple(decisions), max(tiers), fastest)
        raise ReplayError(f"{self.trace}: {decisions} in {TRIES} tries")


def _slower(speed: float, refusal: Answer) -> float:
    """Speed that the figures of a refusal allow, rad/s."""
    told = refusal.content
    shares: list[float] = [
        told["tcp_speed_limit_um_s"] / told["tcp_speed_um_s"],
        told["contact_limit_permille"] / told["contact_permille"],
    ]
    return round(speed * min(shares) * SLOWER, 6)


@contextmanager
def _watched(eyes: StateRecorder) -> Iterator[list[float]]:
    """Highest commanded speed of the leading axis inside of the block, rad/s, in the list that it fills."""
    fastest: list[float] = []
    begun_s = time.monotonic()
    yield fastest
    fastest.append(max((sample.commanded_rad_s for sample in eyes.since(begun_s)), default=0.0))


def _arrived(eyes: StateRecorder, target: Sequence[float]) -> None:
    """Waits until the recorder, which may be late on a loaded machine, has seen the arm at its target."""

    def there() -> bool:
        return max(abs(a - b) for a, b in zip(eyes.now().q_rad, target, strict=True)) <= REACHED_RAD

    until(there, f"the arm within {REACHED_RAD * 1e3:.0f} mrad of its target")
