"""Chapter on the view of the world, and on the watch and the stop of a moving arm."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from ztpm.demo.forgeries import forged_frame
from ztpm.demo.motion import Motion
from ztpm.demo.run import Expect, StepObservation, Story
from ztpm.demo.story.answering import FAR, approve, asked, beside_a_person, out_of_the_zone, retry
from ztpm.demo.story.lending import outcome, poll_refusal
from ztpm.stage.lending import SLOWER, arm_only, hand_down, hop_id
from ztpm.stage.scene import PERSON_AXIS_M, front, person
from ztpm.stage.stage import LEFT, RIGHT, SPEED_RAD_S, until
from ztpm.stage.stopping import BAR_S, model_rad
from ztpm_idp.ledger_file import Verified
from ztpm_idp.ledger_file import verify as verify_ledger

if TYPE_CHECKING:
    from ztpm.stage.stage import Stage
    from ztpm.stage.stopping import Stopped

MOVING: Final = Story("the world is watched")
DELEGATED: Final = ("delegate",)
ABOVE_TABLE: Final = (0.0, -1.5728, 2.0196, -2.0177, -1.57, 0.0)
ON_TABLE: Final = (0.0, -1.486, 2.164, -2.2488, -1.57, 0.0)
"""Fingers pointing down, 42 mm above the table's top, and on it within the arm's error (rad)."""
DOWN_RAD_S: Final = 0.15
"""Joint speed of the place move: the fingers come down at 31 mm/s, gentler than 0.05 m/s."""
LEASE_S: Final = 2.0
"""The motion lease of the shipped policy set."""
FEED_S: Final = 0.5
"""Age of the newest view when the provider dies, at most: pulled every 0.1 s, with time for answers."""
SLOW_RAD_S: Final = 0.25
"""The sweep lasts 4.8 s at this speed: longer than the lease."""
UNDER_WAY_RAD: Final = 0.05
"""A move that has come this far is under way."""


def at_left(stage: Stage) -> None:
    """Puts the arm at the left end of the sweep, with nobody there."""
    stage.scene()
    out_of_the_zone(stage)
    if stage.joints[2] > ABOVE_TABLE[2] + UNDER_WAY_RAD:
        # It was left on the table: an agent with the touch lifts it.
        stage.move("orchestrator", to=ABOVE_TABLE, speed=DOWN_RAD_S)
    stage.bring(LEFT)


@MOVING.step("stale-world-deferred", Expect("DEFER", "TIER_NEEDS_APPROVAL", 3), needs=DELEGATED, prepare=at_left)
def _stale_world(stage: Stage) -> StepObservation:
    stage.cell.sensor.tell({"pause": True})
    try:
        until(lambda: stage.perception() == "stale", "a view that grew old")
        answer = stage.move("robotic", to=RIGHT)
    finally:
        stage.cell.sensor.tell({"pause": False})
        until(lambda: stage.perception() == "fresh", "a fresh view")
    said = answer.content.get("perception")
    told = f"the sensor fell silent: the view is {said}, and nobody knows who stands there now; people must decide"
    return StepObservation.answer(told, answer, ok=said in {"stale", "missing"})


@MOVING.step(
    "forged-frame-refused", Expect("DENY", "PERCEPTION_INVALID", attack=True), needs=DELEGATED, prepare=at_left
)
def _forged_frame(stage: Stage) -> StepObservation:
    stage.cell.sensor.tell({"pause": True})
    try:
        forged_frame(stage)
        until(lambda: stage.perception() == "invalid", "the forged frame at the PEP")
        answer = stage.move("robotic", to=RIGHT)
    finally:
        stage.cell.sensor.tell({"pause": False})
        until(lambda: stage.perception() == "fresh", "a fresh view")
    told = "a frame of an empty cell in the sensor's name, signed by another key: a fault, which nobody can approve"
    return StepObservation.answer(told, answer, ok=answer.tier is None and "ask_id" not in answer.content)


def above_the_table(stage: Stage) -> None:
    """Puts the fingers above the table, with nobody there."""
    at_left(stage)
    stage.bring(ABOVE_TABLE)


@MOVING.step("place-on-table", Expect("PERMIT", "PERMITTED", 2, moves=True), needs=DELEGATED, prepare=above_the_table)
def _place(stage: Stage) -> StepObservation:
    untouched = stage.move("robotic", to=ON_TABLE, speed=DOWN_RAD_S)
    answer = stage.move("orchestrator", to=ON_TABLE, speed=DOWN_RAD_S)
    told = (
        f"down onto the table: {untouched.decision} at tier {untouched.tier} for an agent that was not lent the touch, "
        f"{answer.decision} at tier {answer.tier} for the one that was ({outcome(answer)})"
    )
    ok = (untouched.decision, untouched.tier, outcome(answer)) == ("DEFER", 3, "reached")
    return StepObservation.answer(told, answer, ok=ok)


@MOVING.step("human-enters-stops", Expect("PERMIT", "PERMITTED", 1, moves=True), needs=DELEGATED, prepare=at_left)
def _walks_in(stage: Stage) -> StepObservation:
    with Motion(stage, "robotic", to=RIGHT, speed=SPEED_RAD_S) as motion:
        motion.under_way(UNDER_WAY_RAD)
        t0 = time.monotonic()
        stage.cell.sensor.tell({"people": [person("person-1", *front(PERSON_AXIS_M))], "objects": []})
        answer = motion.answer()
        stop = motion.stop_after(t0)
    told = f"a person walked in: {figures(stop)}; {outcome(answer)}"
    return StepObservation.answer(
        told, answer, ok=outcome(answer) == "world_changed IMPACT_ROSE" and stop.within_model, stop=stop
    )


def figures(stop: Stopped) -> str:
    """Times and travel of a stop."""
    return (
        f"braking {stop.reaction_s * 1e3:.0f} ms later, standing {stop.braking_s * 1e3:.0f} ms after that, "
        f"{stop.braking_rad * 1e3:.0f} mrad of braking (the model allows {model_rad(stop.speed_rad_s) * 1e3:.0f})"
    )


@MOVING.step("revoke-in-motion", Expect("PERMIT", "PERMITTED", 1, moves=True), needs=DELEGATED, prepare=at_left)
def _revoked_in_motion(stage: Stage) -> StepObservation:
    token = hand_down(stage, "vision", arm_only(speed_high=SLOWER - 2), keep_as="in-motion")
    with Motion(stage, "vision", to=RIGHT, speed=SPEED_RAD_S, token=token) as motion:
        motion.under_way(UNDER_WAY_RAD)
        stage.person("alice").revoke("hop", hop_id(stage, token), reason="demonstration")
        t0 = time.monotonic()
        answer = motion.answer()
        stop = motion.stop_after(t0)
    told = f"alice revoked the hop while the arm moved: {figures(stop)}"
    return StepObservation.answer(
        told, answer, ok=outcome(answer) == "authority_lost REVOKED" and stop.within_model, stop=stop
    )


@MOVING.step("idp-killed-in-motion", Expect("PERMIT", "PERMITTED", 1, moves=True), needs=DELEGATED, prepare=at_left)
def _idp_killed(stage: Stage) -> StepObservation:
    with Motion(stage, "robotic", to=RIGHT, speed=SLOW_RAD_S) as motion:
        motion.under_way(UNDER_WAY_RAD)
        t0 = time.monotonic()
        stage.cell.idp.kill()
        answer = motion.answer()
        stop = motion.stop_after(t0)
    stage.cell.start_idp()
    until(lambda: stage.move("robotic", to=stage.rounded_joints).decision == "PERMIT", "authority back")
    told = f"the identity provider was killed: the arm went on for {stop.reaction_s:.2f} s, until the lease ended"
    in_time = LEASE_S - FEED_S < stop.reaction_s < LEASE_S + BAR_S
    return StepObservation.answer(
        told, answer, ok=outcome(answer) == "authority_lost REVOCATION_VIEW_STALE" and in_time
    )


@MOVING.step("restart-keeps", Expect("PERMIT", "PERMITTED", 3, moves=True), needs=DELEGATED, prepare=beside_a_person)
def _restart(stage: Stage) -> StepObservation:
    target = FAR
    token = hand_down(stage, "vision", arm_only(speed_high=SLOWER - 3), keep_as="restart")
    stage.person("alice").revoke("hop", hop_id(stage, token), reason="demonstration")
    poll_refusal(stage, "vision", token)
    question = asked(stage, "robotic", target, 0.25)
    approve(stage, "alice", question)
    until(lambda: stage.answered(question), "alice's vote on the PEP's record")
    for name in ("tools", "gateway", "idp"):
        stage.cell.children[name].kill()
    with stage.cell.beside():
        stage.cell.start_idp()
        stage.cell.start_enforcement()
    until(lambda: stage.perception() == "fresh", "a fresh view")
    revoked = stage.ask("vision", "read_state", {}, token=token)
    answer = retry(stage, "robotic", target, 0.25, waiting="TIER_NEEDS_APPROVAL")
    ledger = verify_ledger(stage.person("carol").export_ledger().splitlines(), stage.trust)
    told = (
        "provider and both PEPs killed and started again: the revoked hop stays "
        f"{revoked.reason}, alice's vote from before moved the arm once, the ledger verifies"
    )
    ok = revoked.reason == "REVOKED" and isinstance(ledger, Verified)
    return StepObservation.answer(told, answer, ok=ok)
