"""Arena with enforcement: the embedded cell, a fresh cast for each scenario, and a person who answers or is absent."""

from __future__ import annotations

import json
import time
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from typing import TYPE_CHECKING, Final

from evaluation.redteam.acts.frame_tap import FrameTap
from evaluation.redteam.admission.room import AdmissionRoom, admission_room
from evaluation.redteam.attempts import Attempts
from evaluation.redteam.cast import ROLES, Cast
from evaluation.redteam.desk.desk import guarded_desk, replaced
from evaluation.redteam.naming import named
from evaluation.redteam.parts import Came, Effect, beside
from pep.base.operations import SPEED_JOINT, STOP
from ztpm.base.processes import Child
from ztpm.cell.setup import GATEWAY_ID, SECOND_SENSOR_ID, SENSOR_ID, sensor_keys
from ztpm.demo.run import play
from ztpm.demo.story import STORY
from ztpm.stage.calls import call
from ztpm.stage.lending import lent
from ztpm.stage.live import stage
from ztpm.stage.samples import StateRecorder
from ztpm.stage.stage import BRING_RAD_S, StageError, until
from ztpm_idp.client import ClientError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from evaluation.redteam.desk.desk import Desk
    from evaluation.redteam.parts import Deed, Moment, Place, Playable
    from evaluation.redteam.record import HarmSeen
    from ztpm.stage.calls import Answer
    from ztpm.stage.stage import Stage
    from ztpm_idp.client import Agent

DIRECTOR: Final = "orchestrator"
"""Agent that sets the stage; no scenario attacks with it."""
ATTENDANT: Final = "bob"
"""Person who lets the arm be brought to where a scenario begins."""
FRESH_S: Final = 600.0
"""Age from which on its authority is renewed."""
REACHED: Final = "reached"
WANTED: Final = {STOP.name: "stopped", SPEED_JOINT.name: "ended"}
"""Outcome of the tools whose word for success is another one."""
ASKS: Final = 3
"""Times that a question is asked anew which was over before it was read."""
OVER: Final = "ASK_OVER"


@dataclass
class GuardedArena:
    """Running cell, and the cast of the scenario that is played.

    Attributes:
        stage: the cell with its people, watched by one or two sensors; the first is the one that is attacked.
        eyes: every sample of its controller.
        tap: eavesdropper on its first sensor.
        approver: name of the person who says yes to each question, or None for an absent one.
        beside: what runs beside the cell, ended with the arena.
        begin: begins each process of the arena.
        cast: of the scenario that is played.
        ends: ends of all that acts have begun, called once the arm stands.
        attempts: the acts of that scenario.
    """

    stage: Stage
    eyes: StateRecorder
    tap: FrameTap
    approver: str | None = "bob"
    beside: ExitStack = field(default_factory=ExitStack)
    begin: Callable[..., Child] = Child.begin
    cast: Cast = field(init=False)
    ends: ExitStack = field(default_factory=ExitStack)
    attempts: Attempts = field(default_factory=Attempts)
    _played: int = 0
    _prepared_s: float = 0.0
    _prepared_ms: float = 0.0
    _entries: int = 0
    _admission: AdmissionRoom | None = None
    _renewed_s: float = field(default=-FRESH_S)
    _desk: Desk | None = None

    @property
    def desk(self) -> Desk:
        """The desk, which is started when it is first needed."""
        if self._desk is None:
            self._desk = self.beside.enter_context(guarded_desk(self.stage))
        return self._desk

    def prepare(self, scenario: Playable) -> None:
        """Enters a fresh cast and brings the arm to where the scenario begins, in an empty scene.

        Raises:
            StageError: the arm was not brought there.
        """
        self._renew()
        if self._played:
            self._put_desk_back()
            self.cast.leave()
        self._played += 1
        self.cast = Cast(self.stage, self._played)
        self.cast.enter()
        if any(act.at_admission for act in scenario.act):
            self.admission  # noqa: B018 - begun before the clock of the scenario
        at_desk = {act.by for act in scenario.act if act.at_desk}
        if at_desk:
            self._await_desk()
        for role in sorted(at_desk & ROLES.keys()):
            self.token(role, "desk")  # lent before anything is taken back
        self.stage.scene()
        self.stage.place(beside(scenario.start_rad))
        try:
            self.stage.bring(scenario.start_rad)
        except StageError:
            self._restore()
            until(lambda: self._brought(scenario.start_rad), "the arm where the scenario begins")
        self.stage.begin()
        if self._desk is not None:
            self._desk.papers.lay_out()
        self.attempts = Attempts()
        self._prepared_s, self._prepared_ms = time.monotonic(), time.time() * 1_000

    def _brought(self, start_rad: tuple[float, ...]) -> bool:
        """True once the arm stands there: earlier acts are looked at together with the way, for a time."""
        with suppress(StageError):
            self._led(start_rad)
            self.stage.bring(start_rad)
            return True
        return False

    def _led(self, start_rad: tuple[float, ...]) -> None:
        """Asks for the way there; a person who sees the cell says yes to one that needs it.

        Setting the stage is no part of a scenario, so one person answers also where its approver is absent.
        """

        def ask() -> Answer:
            return self.stage.move(DIRECTOR, to=start_rad, speed=BRING_RAD_S)

        answer = ask()
        if answer.decision == "DEFER":
            self._answered(ATTENDANT, answer, ask)

    def _await_desk(self) -> None:
        """Waits until the desk, which may have been started just now, knows what is revoked."""
        seen: dict[str, object] = {"path": "/desk/public/map.txt"}
        until(
            lambda: self.sent("orchestrator", "desk", "read_file", seen).reason != "REVOCATION_VIEW_STALE",
            "a fresh view of revocations at the desk",
        )

    @property
    def admission(self) -> AdmissionRoom:
        """Admission point of the arena, begun at its first use, with the cast's authority there."""
        if self._admission is None:
            self._admission = self.beside.enter_context(admission_room(self.stage, begin=self.begin))
        self._admission.enter(self.cast)
        return self._admission

    def begin_points(self) -> None:
        """Begins the processes beside the cell anew, with the registration and the folders that they have.

        Raises:
            StageError: one does not become ready.
        """
        if self._admission is not None:
            self._admission.start(self.begin)
        if self._desk is not None:
            refused = replaced(self._desk, self.stage)
            if refused:
                raise StageError(f"the desk: {refused}")

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
        """Shows each sensor what truly changed; what the first one does not see only the second, if there is one."""
        command = moment.command()
        sees_it = None if moment.seen else SECOND_SENSOR_ID
        if not command or sees_it not in (None, *sensor_keys(self.stage.cell.layout)):
            return
        if moment.at_s <= 0 and command.keys() <= {"people", "objects"}:
            self.stage.scene(people=command.get("people"), objects=command.get("objects"), sensor=sees_it)
        else:
            self.stage.cell.sensor.tell(command if sees_it is None else {**command, "sensor": sees_it})

    def tell_attacked(self, command: dict[str, object]) -> None:
        """Tells the first sensor alone, which is the one that is silenced, covered or deceived."""
        self.stage.cell.sensor.tell({**command, "sensor": SENSOR_ID})

    def perform(self, act: Deed) -> Came:
        """Does an act before the enforcement points."""
        return self.attempts.noted(act, lambda: act.guarded(self))

    def settle(self) -> None:
        """Waits until the arm stands still, and ends what acts have begun."""
        self.attempts.end()
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

        return self._with_people(ask, point, tool)[0]

    def asked(
        self, role: str, place: Place, tool: str, arguments: dict[str, object], *, point: str
    ) -> tuple[Came, Answer]:
        """Outcome of a call as of `call`, at any place, and the last answer to it."""
        return self._with_people(lambda: self.sent(role, place, tool, arguments), point, tool)

    def _with_people(self, ask: Callable[[], Answer], point: str, tool: str) -> tuple[Came, Answer]:
        """Outcome of a call, and the last answer to it: the approver answers a question, and it is made again."""
        answer = ask()
        asked = answer.decision == "DEFER"
        if asked and self.approver is not None:
            answer = self._answered(self.approver, answer, ask)
        return came(answer, point, asked=asked, tool=tool), answer

    def _answered(self, approver: str, question: Answer, ask: Callable[[], Answer]) -> Answer:
        """Answer to the same call once the approver has said yes and the enforcement point knows it.

        On a loaded machine a question may be over before it was read: then it is asked anew.
        """
        for _ in range(ASKS):
            ask_id = str(question.content["ask_id"])
            if self._approved(approver, ask_id):
                found: list[Answer] = []
                until(partial(_another, ask, ask_id, found), f"{approver}'s answer at the enforcement point")
                return found[-1]
            question = ask()
            if question.decision != "DEFER":
                break
        return question

    def _approved(self, name: str, ask_id: str) -> bool:
        """Says yes to a question and attests to seeing the cell clear; False where the question is over."""
        person = self.stage.person(name)
        until(lambda: any(row["ask_id"] == ask_id for row in person.approvals()), "the question at the provider")
        try:
            person.approve(ask_id, sees_clear=True)
        except ClientError as error:
            if error.code != OVER:
                raise
            return False
        return True

    def sent(self, role: str, place: Place, tool: str, arguments: dict[str, object]) -> Answer:
        """Answer to a call by a role with its own token, or with none where it has none."""
        agent, token = self.agent(role), self.token(role, place)
        if not token:
            return call(self.url(place), agent.auth(), tool, arguments)
        return self.stage.ask(agent.id, tool, arguments, token=token, url=self.url(place))

    def agent(self, role: str) -> Agent:
        """The agent of a role."""
        return self.cast.agent(role)

    def token(self, role: str, place: Place) -> str:
        """Token of a role for a place; empty where it was lent nothing."""
        return self.cast.token(role, self.desk if place == "desk" else None)

    def url(self, place: str) -> str:
        """Canonical URL of a place."""
        return self.desk.url if place == "desk" else self.stage.cell.addresses.audience

    def point_key(self, place: Place) -> bytes:
        """Public key of the enforcement point that asks people about acts at a place."""
        return self.desk.point_key if place == "desk" else self.stage.cell.peps[GATEWAY_ID]

    def came_of(self, answer: Answer, point: str) -> Came:
        """Outcome of a call that no person answered for."""
        return came(answer, point, asked=False)

    def harm(self) -> tuple[HarmSeen, ...]:
        """Harm that is no motion: what left, what was taken, what no longer works."""
        left = () if self._admission is None else self._admission.outbox.left(self._prepared_s)
        return (*left, *self.attempts.harm(self))

    def _put_desk_back(self) -> None:
        """Replaces a desk that an act has changed by the reviewed one."""
        if self.attempts.desk_changed:
            replaced(self.desk, self.stage)

    def works(self, role: str) -> bool:
        """True where the role can still read the state of the arm."""
        return self.sent(role, "arm", "read_state", {}).decision == "PERMIT"

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


def _another(ask: Callable[[], Answer], ask_id: str, found: list[Answer]) -> bool:
    """True once the same call is no longer answered by that question; its answers are added to `found`."""
    found.append(ask())
    return found[-1].content.get("ask_id") != ask_id or found[-1].decision != "DEFER"


def came(answer: Answer, point: str, *, asked: bool, tool: str = "") -> Came:
    """Outcome of a call of a tool, by its answer; a timed motion that ended with a reason was stopped."""
    if answer.decision == "DEFER":
        return Came(Effect.DEFERRED, point, answer.reason, asked=True)
    if answer.decision != "PERMIT":
        return Came(Effect.DENIED, point, answer.reason, asked=asked)
    wanted = WANTED.get(tool, REACHED)
    outcome, reason = str(answer.content.get("outcome", wanted)), answer.content.get("reason")
    if outcome != wanted or (wanted == WANTED[SPEED_JOINT.name] and reason):
        return Came(Effect.STOPPED, point, str(reason or outcome), asked=asked)
    return Came(Effect.DONE, asked=asked)


@contextmanager
def guarded_arena(
    *, approver: str | None, begin: Callable[..., Child] = Child.begin, second_sensor: bool = True
) -> Iterator[GuardedArena]:
    """An arena on a cell of its own, removed afterwards.

    Args:
        approver: person who says yes to each question, or None for an absent one.
        begin: begins each process of the cell (`evaluation.redteam.composition`).
        second_sensor: a second sensor watches the cell, which no scenario attacks.

    Raises:
        StageError: the cell did not come about.
    """
    with (
        stage(begin=begin, second_sensor=second_sensor) as on_stage,
        StateRecorder(on_stage.cell.addresses.host) as eyes,
    ):
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
