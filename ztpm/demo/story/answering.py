"""Chapter on people's answers: effects and limits of an approval, and forged ones."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from capabilities.values.scope import Tier
from ztpm.demo.forgeries import ballot, posted_vote
from ztpm.demo.run import Expect, StepObservation, Story
from ztpm.demo.story.lending import outcome
from ztpm.stage.lending import lent
from ztpm.stage.scene import PERSON_AXIS_M, front, person
from ztpm.stage.stage import LEFT, StageError, pose, until

if TYPE_CHECKING:
    from ztpm.stage.calls import Answer
    from ztpm.stage.stage import Stage

ANSWERING: Final = Story("people answer")
DELEGATED: Final = ("delegate",)
NEAR, FAR = pose(-0.2), pose(0.2)
"""A short move past the person, and back."""
SLOWLY_RAD_S: Final = 0.3
"""Speed of approved moves: at 0.4 rad/s a contact would reach a person's limit (PFL)."""
IN_THE_ZONE: Final = pose(-1.4)
"""A target inside the zone that the cell file declares tier 4."""
BEFORE_THE_ZONE_RAD: Final = -0.8
"""The base joint's angle up to which no part of the arm is inside."""
ASKED: Final = ("TIER_NEEDS_APPROVAL", "TIER_SAFETY_CRITICAL", "APPROVAL_USED", "APPROVAL_NOT_USABLE")
"""Reasons behind which an ask stands."""


def beside_a_person(stage: Stage) -> None:
    """Puts the arm at one end of the short move, and a person beside it (C2)."""
    stage.scene()
    stage.bring(NEAR)
    stage.scene(people=[person("person-1", *front(PERSON_AXIS_M))])


def asked(stage: Stage, agent: str, target: tuple[float, ...], speed: float) -> Answer:
    """Deferral of a move that nobody has answered yet."""
    answer = stage.move(agent, to=target, speed=speed)
    if answer.reason == "APPROVAL_TIMEOUT":
        answer = stage.move(agent, to=target, speed=speed)
    if answer.decision != "DEFER" or answer.reason not in ASKED:
        raise StageError(f"not deferred: {answer.decision} {answer.reason}")
    return answer


def approve(stage: Stage, name: str, answer: Answer) -> None:
    """Votes for the ask of that deferral; the provider has the vote."""
    ask_id = str(answer.content["ask_id"])

    def posted() -> bool:
        return any(row["ask_id"] == ask_id for row in stage.person(name).approvals())

    until(posted, "the question at the provider")
    if not stage.person(name).picture(ask_id):
        raise StageError("the question came without a picture of its motion")
    stage.person(name).approve(ask_id)


def retry(stage: Stage, agent: str, target: tuple[float, ...], speed: float, *, waiting: str) -> Answer:
    """Answer to the same call once it is no longer `waiting`.

    Raises:
        StageError: when it stays so.
    """
    found: list[Answer] = []

    def changed() -> bool:
        found[:] = [stage.move(agent, to=target, speed=speed)]
        return found[0].reason != waiting

    until(changed, f"an answer other than {waiting}")
    return found[0]


@ANSWERING.step(
    "approved-moves", Expect("PERMIT", "PERMITTED", 3, moves=True), needs=DELEGATED, prepare=beside_a_person
)
def _approved(stage: Stage) -> StepObservation:
    question = asked(stage, "robotic", FAR, SLOWLY_RAD_S)
    approve(stage, "alice", question)
    answer = retry(stage, "robotic", FAR, SLOWLY_RAD_S, waiting=question.reason)
    told = (
        f"{question.decision} at tier {question.tier}; alice approved exactly this move, "
        f"and the arm made it once ({outcome(answer)})"
    )
    return StepObservation.answer(told, answer, ok=question.tier == 3 and outcome(answer) == "reached")


@ANSWERING.step(
    "approval-used-up", Expect("DEFER", "APPROVAL_USED", 3), needs=("approved-moves",), prepare=beside_a_person
)
def _used_up(stage: Stage) -> StepObservation:
    answer = stage.move("robotic", to=FAR, speed=SLOWLY_RAD_S)
    return StepObservation.answer(
        "the same move a second time: the approval was for one, so people are asked again", answer
    )


@ANSWERING.step(
    "approval-changed-world", Expect("DEFER", "APPROVAL_NOT_USABLE", 3), needs=DELEGATED, prepare=beside_a_person
)
def _changed_world(stage: Stage) -> StepObservation:
    question = asked(stage, "robotic", FAR, 0.28)
    approve(stage, "alice", question)
    x, y = front(PERSON_AXIS_M)
    stage.scene(people=[person("person-1", x, y), person("person-2", x - 0.1, y + 0.45)])
    answer = retry(stage, "robotic", FAR, 0.28, waiting=question.reason)
    told = "alice approved a move beside one person; then a second one entered: the approval is not for this world"
    return StepObservation.answer(told, answer)


@ANSWERING.step(
    "agent-approval-refused",
    Expect("DENY", "NOT_PERMITTED", recorded=False, ledger="vote-refused", attack=True),
    needs=DELEGATED,
    prepare=beside_a_person,
)
def _agent_votes(stage: Stage) -> StepObservation:
    question = asked(stage, "robotic", FAR, 0.26)
    ask_id = str(question.content["ask_id"])
    until(lambda: any(row["ask_id"] == ask_id for row in stage.person("alice").approvals()), "the question")
    started = time.perf_counter()
    own = posted_vote(stage, "robotic", ask_id, ballot(stage, "robotic", ask_id, approver="robotic"))
    latency = (time.perf_counter() - started) * 1e3
    forged = posted_vote(stage, "robotic", ask_id, ballot(stage, "robotic", ask_id, approver="alice"))
    after = stage.move("robotic", to=FAR, speed=0.26)
    told = f"the agent voted for itself, then in alice's name: {own.status} {own.code}, {forged.status} {forged.code}"
    ok = {own.status, forged.status} <= {400, 401, 403} and after.decision == "DEFER"
    return StepObservation(told, "DENY" if own.status >= 400 else "PERMIT", own.code, None, latency, ok=ok)


def maintainer(stage: Stage) -> None:
    """Agent with an attesting platform and authority up to tier 4; the arm stands ready."""
    stage.scene()
    if "maintainer" not in stage.agents:
        stage.new_agent("maintainer", sponsor="alice", role="actuator").attest()
        scope = lent(stage, ceiling=Tier.SAFETY_CRITICAL)
        issued = stage.person("alice").issue(stage.agents["maintainer"], scope, purpose="service inside the fence")
        stage.tokens["maintainer"] = issued.token
    stage.bring(LEFT)


@ANSWERING.step(
    "zone-denied", Expect("DENY", "TIER_SAFETY_CRITICAL", 4, attack=True), needs=DELEGATED, prepare=maintainer
)
def _zone(stage: Stage) -> StepObservation:
    answer = stage.move("maintainer", to=IN_THE_ZONE, speed=1.0)
    told = "into the zone that the signed cell file declares tier 4: nobody opened it, so nobody is even asked"
    return StepObservation.answer(told, answer, ok="ask_id" not in answer.content)


def opened(stage: Stage) -> None:
    """Agent as of `maintainer`, with an opening by carol for the operation, once."""
    maintainer(stage)
    open_once(stage)


def open_once(stage: Stage) -> None:
    """Opens one safety-critical move of the maintainer, by carol."""
    stage.person("carol").open_tier_4(
        audience=stage.cell.addresses.audience, agent="maintainer", object="ur3e", operation="move_joint",
        reason="service", lifetime_s=300,
    )  # fmt: skip


@ANSWERING.step("one-of-two-refused", Expect("DEFER", "TIER_SAFETY_CRITICAL", 4), needs=DELEGATED, prepare=opened)
def _one_of_two(stage: Stage) -> StepObservation:
    question = deferred_once_open(stage, 0.9)
    approve(stage, "alice", question)
    known: list[Answer] = []

    def voted() -> bool:
        known[:] = [stage.move("maintainer", to=IN_THE_ZONE, speed=0.9)]
        return stage.approvers_known() == ["alice"]

    until(voted, "alice's vote in the PEP's evidence")
    told = "carol opened it and alice approved: one of two different people, and the arm stands"
    return StepObservation.answer(told, known[0])


def out_of_the_zone(stage: Stage) -> None:
    """Moves the arm out of the zone again: the way out is as dangerous, so two people approve it, too."""
    if stage.joints[0] > BEFORE_THE_ZONE_RAD:
        return
    open_once(stage)
    until(lambda: stage.move("maintainer", to=LEFT, speed=1.0).decision == "DEFER", "the opening at the PEP")
    question = asked(stage, "maintainer", LEFT, 1.0)
    for name in ("alice", "carol"):
        approve(stage, name, question)
    retry(stage, "maintainer", LEFT, 1.0, waiting=question.reason)


def deferred_once_open(stage: Stage, speed: float) -> Answer:
    """Deferral of a tier 4 move, once the PEP knows of the opening."""
    until(lambda: stage.move("maintainer", to=IN_THE_ZONE, speed=speed).decision == "DEFER", "the opening at the PEP")
    return asked(stage, "maintainer", IN_THE_ZONE, speed)


@ANSWERING.step(
    "dual-authorised", Expect("PERMIT", "PERMITTED", 4, moves=True), needs=("one-of-two-refused",), prepare=maintainer
)
def _dual(stage: Stage) -> StepObservation:
    question = deferred_once_open(stage, 1.0)
    for name in ("alice", "carol"):
        approve(stage, name, question)
    answer = retry(stage, "maintainer", IN_THE_ZONE, 1.0, waiting=question.reason)
    told = (
        "opened beforehand, approved by the sponsor and by carol, who is not: "
        f"the arm moved into the zone ({outcome(answer)})"
    )
    return StepObservation.answer(told, answer, ok=outcome(answer) == "reached")
