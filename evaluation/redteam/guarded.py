"""Arena with enforcement: the embedded cell, a fresh cast for each scenario, and a person who answers or is absent."""

from __future__ import annotations

import json
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from typing import TYPE_CHECKING, Final

from evaluation.redteam.acts.act import Came, Effect
from evaluation.redteam.acts.frame_tap import FrameTap
from evaluation.redteam.admission.room import AdmissionRoom, admission_room
from evaluation.redteam.cast import Cast
from evaluation.redteam.naming import named
from ztpm.base.processes import Child
from ztpm.demo.run import play
from ztpm.demo.story import STORY
from ztpm.stage.lending import lent
from ztpm.stage.live import stage
from ztpm.stage.samples import StateRecorder
from ztpm.stage.stage import StageError, until
from ztpm_idp.client import ClientError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from evaluation.redteam.acts.act import Act
    from evaluation.redteam.record import HarmSeen
    from evaluation.redteam.scenario import Moment, Scenario
    from ztpm.stage.calls import Answer
    from ztpm.stage.stage import Stage

DIRECTOR: Final = "orchestrator"
"""Agent that sets the stage; no scenario attacks with it."""
FRESH_S: Final = 600.0
"""Age from which on its authority is renewed."""
REACHED: Final = "reached"
ASKS: Final = 3
"""Times that a question is asked anew which was over before it was read."""
OVER: Final = "ASK_OVER"


@dataclass
class GuardedArena:
    """Running cell, and the cast of the scenario that is played.

    Attributes:
        stage: the cell with its people.
        eyes: every sample of its controller.
        tap: eavesdropper on its sensor.
        approver: name of the person who says yes to each question, or None for an absent one.
        beside: what runs beside the cell, ended with the arena.
        begin: begins each process of the arena.
        cast: of the scenario that is played.
        ends: ends of all that acts have begun, called once the arm stands.
    """

    stage: Stage
    eyes: StateRecorder
    tap: FrameTap
    approver: str | None = "bob"
    beside: ExitStack = field(default_factory=ExitStack)
    begin: Callable[..., Child] = Child.begin
    cast: Cast = field(init=False)
    ends: ExitStack = field(default_factory=ExitStack)
    _played: int = 0
    _prepared_s: float = 0.0
    _prepared_ms: float = 0.0
    _entries: int = 0
    _admission: AdmissionRoom | None = None
    _renewed_s: float = field(default=-FRESH_S)

    def prepare(self, scenario: Scenario) -> None:
        """Enters a fresh cast and brings the arm to where the scenario begins, in an empty scene.

        Raises:
            StageError: the arm was not brought there.
        """
        self._renew()
        self._played += 1
        self.cast = Cast(self.stage, self._played)
        self.cast.enter()
        if any(act.at_admission for act in scenario.act):
            self.admission  # noqa: B018 - begun before the clock of the scenario
        self.stage.scene()
        try:
            self.stage.bring(scenario.start_rad)
        except StageError:
            self._restore()
            self.stage.bring(scenario.start_rad)
        self.stage.begin()
        self._prepared_s, self._prepared_ms = time.monotonic(), time.time() * 1_000

    @property
    def admission(self) -> AdmissionRoom:
        """Admission point of the arena, begun at its first use, with the cast's authority there."""
        if self._admission is None:
            self._admission = self.beside.enter_context(admission_room(self.stage, begin=self.begin))
        self._admission.enter(self.cast)
        return self._admission

    def _restore(self) -> None:
        """Restores the director: after many scenarios it deviates from a planner's baseline."""
        self.stage.person("carol").restore_agent(DIRECTOR, "it sets the stage", relearn=True)
        self._renewed_s = -FRESH_S
        self._renew()

    def _renew(self) -> None:
        """Authority of the director, fresh enough for the next scenario."""
        if time.monotonic() - self._renewed_s < FRESH_S:
            return
        director = self.stage.agents[DIRECTOR]
        director.attest()
        issued = self.stage.person("alice").issue(director, lent(self.stage), purpose="set the stage")
        self.stage.tokens[DIRECTOR], self._renewed_s = issued.token, time.monotonic()

    def show(self, moment: Moment) -> None:
        """Shows the registered sensor what truly changed, if it sees it."""
        command = moment.command()
        if not moment.seen or not command:
            return
        if moment.at_s <= 0 and command.keys() <= {"people", "objects"}:
            self.stage.scene(people=command.get("people"), objects=command.get("objects"))
        else:
            self.stage.cell.sensor.tell(command)

    def perform(self, act: Act) -> Came:
        """Does an act before the enforcement points."""
        return act.guarded(self)

    def settle(self) -> None:
        """Waits until the arm stands still, and ends what acts have begun."""
        until(lambda: self.stage.still, "the arm stands still")
        self.ends.close()

    def call(
        self,
        role: str,
        tool: str,
        arguments: dict[str, object],
        *,
        point: str,
        url: str = "",
        token: str | None = None,
    ) -> Came:
        """Call of a tool by a role with its token; a question is answered as the approver does.

        Args:
            role: of the caller.
            tool: name of the tool.
            arguments: of the call.
            point: enforcement point that decides on it.
            url: of the tools; empty for the arm's.
            token: another than the role's own.
        """
        caller = self.cast.called(role)

        def ask() -> Answer:
            return self.stage.ask(caller, tool, arguments, url=url, token=token)

        answer = ask()
        asked = answer.decision == "DEFER"
        if asked and self.approver is not None:
            answer = self._answered(self.approver, answer, ask)
        return came(answer, point, asked=asked)

    def _answered(self, approver: str, question: Answer, ask: Callable[[], Answer]) -> Answer:
        """Answer to the same call once the approver has said yes and the enforcement point knows it.

        On a loaded machine a question may be over before anybody has read it: then it is asked anew.
        """
        for _ in range(ASKS):
            if self._approved(approver, str(question.content["ask_id"])):
                until(partial(self.stage.answered, question), f"{approver}'s answer at the enforcement point")
                return ask()
            question = ask()
            if question.decision != "DEFER":
                break
        return question

    def _approved(self, name: str, ask_id: str) -> bool:
        """Says yes to a question, and whatever there is to attest with it: that the cell is seen to be clear.

        False where the question is over.
        """
        person = self.stage.person(name)
        until(lambda: any(row["ask_id"] == ask_id for row in person.approvals()), "the question at the provider")
        try:
            person.approve(ask_id, sees_clear=True)
        except ClientError as error:
            if error.code != OVER:
                raise
            return False
        return True

    def harm(self) -> tuple[HarmSeen, ...]:
        """Harm that is no motion: notes that left."""
        return () if self._admission is None else self._admission.outbox.left(self._prepared_s)

    def digest(self) -> str:
        """SHA-256 of what the enforcement points have on record since the scenario was prepared."""
        return sha256(json.dumps(self.stage.journal(), sort_keys=True).encode()).hexdigest()

    def primitives(self) -> Mapping[str, float]:
        """Primitives that any finding on record names since the scenario was prepared."""
        pages = b"".join(self.stage.person("carol").ledger_pages(first=self._entries + 1))
        entries = [entry for entry in map(json.loads, pages.splitlines()) if "kind" in entry]
        self._entries = max((entry["seq"] for entry in entries), default=self._entries)
        since_ms = self._prepared_ms
        own = [entry for entry in entries if entry["kind"] != "pep-record" and entry["at_ms"] >= since_ms]
        return named((*self.stage.journal(), *own))


def came(answer: Answer, point: str, *, asked: bool) -> Came:
    """What came of a call, by its answer."""
    if answer.decision == "DEFER":
        return Came(Effect.DEFERRED, point, answer.reason, asked=True)
    if answer.decision != "PERMIT":
        return Came(Effect.DENIED, point, answer.reason, asked=asked)
    outcome = str(answer.content.get("outcome", REACHED))
    if outcome != REACHED:
        return Came(Effect.STOPPED, point, str(answer.content.get("reason") or outcome), asked=asked)
    return Came(Effect.DONE, asked=asked)


@contextmanager
def guarded_arena(*, approver: str | None, begin: Callable[..., Child] = Child.begin) -> Iterator[GuardedArena]:
    """An arena on a cell of its own, removed afterwards.

    Args:
        approver: person who says yes to each question, or None for an absent one.
        begin: begins each process of the cell (`evaluation.redteam.composition`).

    Raises:
        StageError: the cell did not come about.
    """
    with stage(begin=begin) as on_stage, StateRecorder(on_stage.cell.addresses.host) as eyes:
        tap = FrameTap(on_stage.cell)
        for act in STORY.only(frozenset({"delegate"})):
            seen = play(on_stage, act)
            if not seen.ok:
                raise StageError(f"{act.id}: {seen.told}")
        try:
            with ExitStack() as beside:
                yield GuardedArena(on_stage, eyes, tap, approver, beside, begin)
        finally:
            tap.close()
