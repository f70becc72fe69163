"""Check of a proof: from bytes to a verdict, step by step. No step searches; every number is recomputed."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, assert_never

from pep.pit.checker.arm import GRID, Sweep
from pep.pit.checker.curved_motion import RECORD, CheckerTimedCourse, FixedAnswer
from pep.pit.checker.held_motion import held_speed, servo_target
from pep.pit.checker.laws import HIGHEST, SAME, tier_of
from pep.pit.checker.leg import CheckerAnswer, CheckerLeg, CheckerQuestion, intervals, proven, rising
from pep.pit.checker.motion import (
    LEGS_MOST,
    STILL_RAD,
    CheckerHeldSpeed,
    CheckerLine,
    CheckerRun,
    CheckerServo,
    CheckerTimedPiece,
    Timing,
    motion_of,
)
from pep.pit.checker.question import VIOLABLE, cell_of, latest_of, obstacles_of, scene_of, view_of
from pep.pit.checker.robot import robot_of
from pep.pit.checker.rows import PAIRS_MOST, attained, pairs_of
from pep.pit.checker.text import BYTES_MOST, canonical, exact, listed, parsed, sha256, table, whole, word
from pep.pit.checker.timed_piece import pieces, timed_piece
from pep.pit.checker.torque import NO_RATES, TorquePlace, torque_ratio
from pep.pit.checker.trace_pieces import PLACE
from pep.pit.checker.traced_line import followed_line
from pep.pit.checker.verdict import Code, Refusal, Unverified, Verified, need

if TYPE_CHECKING:
    from pep.pit.checker.motion import CheckerMotion, Curved
    from pep.pit.checker.robot import CheckerRobot
    from pep.pit.checker.stance import Six

VERSION: Final = "ztpm-pit-proof/4"
CUT_MOST: Final = 1024  # intervals on which speeds of the whole path are bounded; bounds the work
RADIANS_PER_CUT: Final = 0.5  # PHY-7: summed way of all joints per two places where torque is asked
TORQUES_LEAST: Final = 16  # PHY-7: intervals between places where torque is asked
TORQUES_MOST: Final = 128  # likewise
NO_ROWS: Final[dict[str, Any]] = {"cover": [], "retreating": [], "meant": [], "met": []}
NO_PROOF: Final[dict[str, Any]] = NO_ROWS | {"cut": "0"}
BEYOND_LIMIT: Final = CheckerAnswer(HIGHEST, ["joint_limit"])
WORDS_MOST: Final = len(VIOLABLE) + 1  # of violations: and joint_limit


def verify(text: bytes) -> Verified | Unverified:
    """Verdict on a proof document: verified when it proves its claims. Never raises.

    Args:
        text: a document as `pep.pit.proof.proof_document.document` writes it.
    """
    try:
        return _verified(text)
    except Refusal as refusal:
        return refusal.verdict
    except Exception as error:  # noqa: BLE001 - any failure in here verifies nothing
        return Unverified(Code.CHECKER_FAILED, type(error).__name__)


def _verified(text: bytes) -> Verified:
    # 1. The bytes: bounded, JSON, in its one spelling, whole.
    need(type(text) is bytes, Code.NOT_JSON, "document")
    need(len(text) <= BYTES_MOST, Code.TOO_LARGE, "document")
    top = parsed(text, "document", floats=False)
    need(type(top) is dict and top.get("v") == VERSION, Code.VERSION_UNKNOWN, "v")
    need(_spelling(top) == text, Code.NOT_CANONICAL, "document")
    top = table(top, "document", ("v", "question", "answer", "proof", "digest"))
    sealed = canonical({name: value for name, value in top.items() if name != "digest"})
    need(top["digest"] == sha256(sealed), Code.DIGEST_WRONG, "digest")
    # 2. What was asked, and of which robot and scene.
    asked = table(top["question"], "question", ("model", "scene", "cell", "age_s", "touch", "motion"))
    claim = table(top["answer"], "answer", ("index", "tier", "violations", "model", "scene"))
    for name in ("model", "scene"):
        spelt = word(asked[name], f"question.{name}").encode()
        need(claim[name] == sha256(spelt), Code.DIGEST_WRONG, f"answer.{name}")
    question = _question(asked)
    motion = motion_of(asked["motion"], question.cell)
    # 3. What is claimed: the tier is that of the index.
    answer = _answer(claim, "answer")
    tier = whole(claim["tier"], "answer.tier", low=0, high=4)
    need(tier == tier_of(answer.index), Code.TIER_WRONG, "answer.tier")
    # 4. The proof.
    return Verified(
        index=answer.index,
        tier=tier,
        rows=_legs_proven(question, motion, answer, top["proof"]),
        question=sha256(canonical(asked)),
        model=claim["model"],
        scene=claim["scene"],
    )


def _spelling(value: Any) -> bytes:
    try:
        return canonical(value)
    except (ValueError, RecursionError) as error:
        raise Refusal(Code.NOT_CANONICAL, "document") from error


def _answer(claim: dict[str, Any], place: str) -> CheckerAnswer:
    words = listed(claim["violations"], f"{place}.violations", least=0, most=WORDS_MOST)
    return CheckerAnswer(
        index=exact(claim["index"], f"{place}.index", low=0, high=HIGHEST),
        violations=rising([word(each, f"{place}.violations") for each in words], f"{place}.violations"),
    )


def _question(asked: dict[str, Any]) -> CheckerQuestion:
    robot, cell = robot_of(asked["model"]), cell_of(asked["cell"])
    scene, complete = scene_of(asked["scene"])
    place = "question.touch"
    touch = rising([word(each, place) for each in listed(asked["touch"], place, least=0, most=PAIRS_MOST)], place)
    view = view_of(asked["age_s"], cell, complete=complete, late_s=latest_of(scene))
    return CheckerQuestion(robot, cell, view, scene, frozenset(touch))


def _legs_proven(asked: CheckerQuestion, motion: CheckerMotion, answer: CheckerAnswer, proof: Any) -> int:
    """Number of recomputed rows; each leg's proof holds, and the answer is that of the worst leg."""
    start = motion.start
    if not motion.path:
        return _leg_proven(asked, start, motion.legs[0], answer, proof)[0]
    place = "proof.legs"
    parts = table(proof, "proof", ("legs",) if motion.timed is None else ("legs", "until_s"))
    legs = listed(parts["legs"], place, least=1, most=LEGS_MOST)
    if motion.timed is not None:
        motion = replace(motion, legs=pieces(asked.robot, motion.timed, parts["until_s"]))
        need(len(legs) == len(motion.legs), Code.LEGS_WRONG, place)
    need(len(legs) <= len(motion.legs), Code.LEGS_WRONG, place)
    claims: list[CheckerAnswer] = []
    rows = 0
    for number, (leg, value) in enumerate(zip(motion.legs, legs, strict=False)):
        row = table(value, place, ("answer", "proof"))
        claim = _answer(table(row["answer"], f"{place}.answer", ("index", "violations")), f"{place}.answer")
        count, end = _leg_proven(asked, start, leg, claim, row["proof"])
        claims.append(claim)
        rows += count
        # What comes after a leg that goes beyond a joint's limit is not looked at.
        last = number == len(legs) - 1
        whole = motion.timed is None or exact(parts["until_s"][-1], place, low=0) == motion.timed.times[-1]
        need(last if end is None else not last or (whole and len(legs) == len(motion.legs)), Code.LEGS_WRONG, place)
        start = start if end is None else end
    worst = CheckerAnswer(
        max(claim.index for claim in claims),
        sorted({each for claim in claims for each in claim.violations}),
    )
    need(answer == worst, Code.LEGS_WRONG, "answer")
    return rows


def _leg_proven(
    asked: CheckerQuestion, start: Six, motion: CheckerRun | Curved, answer: CheckerAnswer, value: Any
) -> tuple[int, Six | None]:
    """Number of recomputed rows, and the end of the leg; None when it goes beyond a joint's limit."""
    if isinstance(motion, CheckerRun):
        return _straight_proven(asked, motion, answer, value), motion.target
    proof = table(value, "proof", (*NO_ROWS, "course"))
    row = table(proof["course"], PLACE, RECORD)
    drive = _drive(asked, start, motion, row)
    if isinstance(drive, FixedAnswer):
        wanted = BEYOND_LIMIT if drive.moves else _standing(asked, start)
        need(answer == wanted, Code.ANSWER_WRONG, "answer")
        need({name: proof[name] for name in NO_ROWS} == NO_ROWS, Code.ANSWER_WRONG, "proof")
        return 0, None if drive.moves else start
    return proven(asked, _driven(asked, drive), answer, proof), drive.end


def _drive(asked: CheckerQuestion, start: Six, motion: Curved, row: dict[str, Any]) -> CheckerTimedCourse | FixedAnswer:
    match motion:
        case CheckerLine():
            return followed_line(asked.robot, start, motion, row)
        case CheckerHeldSpeed():
            return held_speed(asked.robot, asked.cell, start, motion, row)
        case CheckerServo():
            return servo_target(asked.robot, asked.cell, start, motion, row, view=asked.view)
        case CheckerTimedPiece():
            return timed_piece(asked.robot, asked.cell, motion, row)
        case _:
            assert_never(motion)


def _straight_proven(asked: CheckerQuestion, run: CheckerRun, answer: CheckerAnswer, value: Any) -> int:
    robot = asked.robot
    proof = table(value, "proof", (*NO_PROOF,))
    # A way that is none, and a way through a joint limit, have one answer each and no rows.
    broken, returning = _joint_limits(run, robot)
    still = not max(abs(way) for way in run.ways) > STILL_RAD
    if still or broken:
        wanted = _standing(asked, run.start) if still else BEYOND_LIMIT
        need(answer == wanted, Code.ANSWER_WRONG, "answer")
        need(proof == NO_PROOF, Code.ANSWER_WRONG, "proof")
        return 0
    timing = Timing.of(run)
    ratios = _straight_ratios(robot, run, timing) | {"torque": _straight_torque(asked, run, timing)}
    leg = CheckerLeg(
        way=Sweep(robot, run),
        timing=timing,
        cuts=list(pairwise((0, *intervals(proof["cut"], "proof.cut", most=CUT_MOST)))),
        ratios=ratios,
        peak=timing.peak,
        returning=returning,
    )
    return proven(asked, leg, answer, proof)


def _standing(asked: CheckerQuestion, start: Six) -> CheckerAnswer:
    """The answer of an arm that stays where it stands: no index, unless what is there must not be."""
    robot, still = asked.robot, CheckerRun(start, start, 1.0, 1.0, 1.0)
    way = Sweep(robot, still)
    pairs = pairs_of(robot, obstacles_of(asked.scene, asked.cell, asked.view, asked.touch), asked.cell)
    met = {p.obstacle.kind for p in pairs if p.violated_below is not None and attained(way, p, 0) < p.violated_below}
    return CheckerAnswer(HIGHEST if met else 0.0, sorted(met))


def _straight_ratios(robot: CheckerRobot, run: CheckerRun, timing: Timing) -> dict[str, float]:
    way = max(map(abs, run.ways))
    shares = [abs(each) / way / limit for each, limit in zip(run.ways, robot.speed_limits, strict=True)]
    wanted = max(shares) * run.speed
    return {
        # A short motion never reaches a forbidden speed, but asking for one is asking to break the limit.
        "joint_speed": wanted if wanted > 1 + SAME else max(shares) * timing.peak,
        "acceleration": run.acceleration / robot.acceleration_limit,
    }


def _straight_torque(asked: CheckerQuestion, run: CheckerRun, timing: Timing) -> float:
    """At the ends of equal intervals, more of them for a longer way (PHY-7)."""
    count, wanted, ways = TORQUES_LEAST, 2 * sum(map(abs, run.ways)) / RADIANS_PER_CUT, run.ways
    while count < min(wanted, TORQUES_MOST):
        count *= 2
    way = max(map(abs, ways))
    shares = [n / count for n in range(count + 1)]
    places = [
        TorquePlace(
            tuple(q + s * on for q, on in zip(run.start, ways, strict=True)), ways, NO_RATES, timing.highest(s, s)
        )
        for s in shares
    ]
    return torque_ratio(asked.robot, asked.cell, places, forward=run.acceleration / way, backward=run.braking / way)


def _driven(asked: CheckerQuestion, drive: CheckerTimedCourse) -> CheckerLeg:
    """Leg on a course: joint speeds are proven piece by piece, the rest is sampled in the middles (PHY-11)."""
    robot, timing = asked.robot, drive.timing
    fast = accelerated = peak = 0.0
    places: list[TorquePlace] = []
    for piece in drive.course.bounds:
        rate = drive.timing.highest(piece.low / GRID, piece.high / GRID)
        rows = zip(piece.first, piece.hurry, piece.dq, piece.ddq, robot.speed_limits, strict=True)
        for most, hurry, first, second, limit in rows:
            speed = (most + hurry) * rate
            peak, fast = max(peak, speed), max(fast, speed / limit)
            accelerated = max(accelerated, abs(first) * max(drive.push) + abs(second) * rate * rate)
        middle = (piece.low + piece.high) // 2
        there = timing.highest(middle / GRID, middle / GRID)
        places.append(TorquePlace(tuple(drive.course.angles(middle)), piece.dq, piece.ddq, there))
    forward, backward = drive.push
    torque = torque_ratio(robot, asked.cell, places, forward=forward, backward=backward)
    return CheckerLeg(
        way=drive.course,
        timing=drive.timing,
        cuts=[(piece.low, piece.high) for piece in drive.course.bounds],
        ratios={"joint_speed": fast, "acceleration": accelerated / robot.acceleration_limit, "torque": torque},
        peak=peak,
        tool_speed=drive.tool_speed,
    )


def _joint_limits(run: CheckerRun, robot: CheckerRobot) -> tuple[bool, bool]:
    """(broken, returning): the run goes beyond a joint limit or to the other one; it comes back from one."""
    broken = returning = False
    for start, target, (low, high) in zip(run.start, run.target, robot.ranges, strict=True):
        before, after = (max(low - q, q - high, 0.0) for q in (start, target))
        crossed = before > 0 and after > 0 and (start > high) != (target > high)
        returning = returning or before > 0
        broken = broken or not after <= before or crossed
    return broken, returning
