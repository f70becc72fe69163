"""The check itself: from bytes to a verdict, step by step. No step searches; every number is recomputed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

from pep.pit.checker.arm import GRID, Sweep
from pep.pit.checker.laws import HIGHEST, MOVING, RETREAT, SAME, Laws, carried_kg, ratio_index, tier_of
from pep.pit.checker.motion import STILL_RAD, Run, Timing, run_of
from pep.pit.checker.question import VIOLABLE, Cell, View, cell_of, obstacles_of, scene_of, view_of
from pep.pit.checker.robot import Robot, robot_of
from pep.pit.checker.rows import PAIRS_MOST, Pair, attained, clearance, pairs_of
from pep.pit.checker.text import BYTES_MOST, canonical, exact, listed, parsed, sha256, table, whole, word
from pep.pit.checker.verdict import Code, Refusal, Refused, Verified, need

VERSION: Final = "ztpm-pit-proof/1"
DEPTHS: Final = {digit: GRID >> depth for depth, digit in enumerate("0123456789abcdefghijklmn")}
"""Width of an interval by the digit of its depth; the narrowest still has an exact middle."""
ROWS_MOST: Final = 200_000  # of one document; bounds the work
INDEX_SLACK: Final = 1e-6  # two roundings (1e-15 m) of a bound, divided by the shortest travel (1e-9 m) that has a band
VIOLATION_SLACK_M: Final = 1e-4  # PHY-9: a path that grazes to within this without touching is no violation
CUT_MOST: Final = 128  # equal intervals on which speeds are bounded; more gain nothing
RETREAT_CUT: Final = 128  # PHY-6: equal intervals on which a retreat is shown never to come nearer
NO_PROOF: Final[dict[str, Any]] = {"cover": [], "cut": 1, "retreating": [], "meant": [], "met": []}
TORQUE_MOST: Final = 1e6  # a ratio larger than this is none


def verify(text: bytes) -> Verified | Refused:
    """Whether this proof document proves what it claims. Never raises.

    Args:
        text: a document as `pep.pit.proof.document` writes it.
    """
    try:
        return _verified(text)
    except Refusal as refusal:
        return refusal.verdict
    except Exception as error:  # noqa: BLE001 - whatever breaks in here verifies nothing
        return Refused(Code.CHECKER_FAILED, type(error).__name__)


@dataclass(frozen=True, slots=True)
class _Question:
    robot: Robot
    cell: Cell
    view: View
    run: Run
    scene: dict[str, Any]
    touch: frozenset[str]


@dataclass(frozen=True, slots=True)
class _Answer:
    index: float
    violations: list[str]
    torque: float


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
    claim = table(top["answer"], "answer", ("index", "tier", "violations", "torque", "model", "scene"))
    for name in ("model", "scene"):
        spelt = word(asked[name], f"question.{name}").encode()
        need(claim[name] == sha256(spelt), Code.DIGEST_WRONG, f"answer.{name}")
    question = _question(asked)
    # 3. What is claimed: the tier is that of the index.
    answer = _Answer(
        index=exact(claim["index"], "answer.index", low=0, high=HIGHEST),
        violations=_rising(
            [word(each, "answer.violations") for each in _short(claim["violations"])], "answer.violations"
        ),
        torque=exact(claim["torque"], "answer.torque", low=0, high=TORQUE_MOST),
    )
    tier = whole(claim["tier"], "answer.tier", low=0, high=4)
    need(tier == tier_of(answer.index), Code.TIER_WRONG, "answer.tier")
    # 4. The proof.
    proof = table(top["proof"], "proof", ("cover", "cut", "retreating", "meant", "met"))
    return Verified(
        index=answer.index,
        tier=tier,
        rows=_proven(question, answer, proof),
        question=sha256(canonical(asked)),
        model=claim["model"],
        scene=claim["scene"],
    )


def _spelling(value: Any) -> bytes:
    try:
        return canonical(value)
    except (ValueError, RecursionError) as error:
        raise Refusal(Code.NOT_CANONICAL, "document") from error


def _short(value: Any) -> list[Any]:
    return listed(value, "answer.violations", least=0, most=len(VIOLABLE) + 1)  # and joint_limit


def _rising(items: list[Any], place: str) -> list[Any]:
    """The items, when each is more than the one before: a set's one spelling."""
    need(all(a < b for a, b in pairwise(items)), Code.MEMBER_WRONG, place)
    return items


def _question(asked: dict[str, Any]) -> _Question:
    robot, cell = robot_of(asked["model"]), cell_of(asked["cell"])
    scene, complete = scene_of(asked["scene"])
    place = "question.touch"
    touch = _rising([word(each, place) for each in listed(asked["touch"], place, least=0, most=PAIRS_MOST)], place)
    view = view_of(asked["age_s"], cell, complete=complete)
    return _Question(robot, cell, view, run_of(asked["motion"], cell), scene, frozenset(touch))


def _proven(asked: _Question, answer: _Answer, proof: dict[str, Any]) -> int:
    """How many rows were recomputed; each holds, and together they prove the answer."""
    run, robot, cell = asked.run, asked.robot, asked.cell
    # 1. A way that is none, and a way through a joint limit, have one answer each and no rows.
    broken, returning = _joint_limits(run, robot)
    still = not max(abs(way) for way in run.ways) > STILL_RAD
    if still or broken:
        fixed = (0.0, []) if still else (HIGHEST, ["joint_limit"])
        need((answer.index, answer.violations, answer.torque) == (*fixed, 0.0), Code.ANSWER_WRONG, "answer")
        need(proof == NO_PROOF and type(proof["cut"]) is int, Code.ANSWER_WRONG, "proof")
        return 0
    # 2. What holds anyway: any motion, the view, a retreat, and what the arm itself is asked.
    timing, sweep = Timing(run), Sweep(robot, run)
    speeds = _Speeds(sweep, timing, whole(proof["cut"], "proof.cut", low=1, high=CUT_MOST))
    pairs = pairs_of(robot, obstacles_of(asked.scene, cell, asked.view, asked.touch), cell)
    retreating, meant = (_numbers(proof[name], f"proof.{name}", len(pairs)) for name in ("retreating", "meant"))
    floor = max(MOVING, asked.view.floor, RETREAT if returning or retreating else 0.0, ratio_index(answer.torque))
    need(floor <= answer.index + INDEX_SLACK, Code.FLOOR_EXCEEDS, "answer.index")
    for name, ratio in _ratios(asked, timing, speeds).items():
        need(ratio_index(ratio) <= answer.index + INDEX_SLACK, Code.FLOOR_EXCEEDS, name)
    # 3. Pairs left out as a retreat, and joint limits that are come back from: only when slow.
    slow = False
    if returning or retreating:
        slow = timing.peak <= cell.retreat_joint_speed_rad_s * (1 + SAME)
        slow = slow and max(map(speeds.of, robot.moving)) <= cell.retreat_speed_m_s * (1 + SAME)
    need(slow or not retreating, Code.RETREAT_UNPROVEN, "proof.retreating")
    need(len(retreating) * RETREAT_CUT <= ROWS_MOST, Code.TOO_LARGE, "proof.retreating")
    for number in retreating:
        need(_leads_away(sweep, pairs[number], cell), Code.RETREAT_UNPROVEN, f"pair {number}")
    # 4. Violations: each claimed one is met where the proof says.
    met = _met(proof["met"], sweep, pairs, retreating)
    expected = met | ({"joint_limit"} if returning and not slow else set())
    need(answer.violations == sorted(expected), Code.VIOLATION_UNFOUNDED, "answer.violations")
    # 5. Every pair's intervals cover the path, and every row holds.
    laws = Laws(robot, cell, asked.view, peak_rad_s=timing.peak)
    covers = listed(proof["cover"], "proof.cover", least=0, most=PAIRS_MOST)
    need(len(covers) == len(pairs), Code.COVER_WRONG, "proof.cover")
    for number in meant:
        need(pairs[number].touchable, Code.MEANT_UNPROVEN, f"pair {number}")
    rows = 0
    for number, (pair, cover) in enumerate(zip(pairs, covers, strict=True)):
        if number in retreating:
            need(cover == "", Code.COVER_WRONG, f"pair {number}")
            continue
        is_meant = number in meant
        excluded = None
        if pair.violated_below is not None and pair.obstacle.kind not in met:
            excluded = pair.violated_below - VIOLATION_SLACK_M - SAME
        low = 0
        for high in _intervals(cover, number):
            near = clearance(sweep, pair, low, high)
            speed = sweep.rush(pair.body, low, high) * timing.highest(low / GRID, high / GRID)
            index = laws.index(pair.obstacle, near, speed, meant=is_meant)
            if not (math.isfinite(near) and math.isfinite(speed) and index <= answer.index + INDEX_SLACK):
                raise Refusal(Code.ROW_EXCEEDS, f"pair {number}, from {low}")
            if excluded is not None and not near >= excluded:
                raise Refusal(Code.VIOLATION_HIDDEN, f"pair {number}, from {low}")
            if is_meant and not laws.gentle(near, speed):
                raise Refusal(Code.MEANT_UNPROVEN, f"pair {number}, from {low}")
            low = high
            rows += 1
        need(rows <= ROWS_MOST, Code.TOO_LARGE, "proof.cover")
    return rows


def _numbers(value: Any, place: str, count: int) -> dict[int, None]:
    """Numbers of pairs, rising; a dict, because a set of them is asked often and kept in order."""
    items = listed(value, place, least=0, most=count)
    return dict.fromkeys(_rising([whole(each, place, low=0, high=count - 1) for each in items], place))


def _intervals(cover: Any, number: int) -> list[int]:
    """Ends of a pair's intervals, in parts of the path: from 0 on without a gap or an overlap, to the path's end.

    A cover is a text of one digit per interval: its depth d, an interval of 1/2^d of the path at a multiple of that.
    """
    place = f"pair {number}"
    need(type(cover) is str and len(cover) <= ROWS_MOST, Code.COVER_WRONG, place)
    ends: list[int] = []
    low = 0
    for digit in cover:
        width = DEPTHS.get(digit, 0)
        need(width > 0 and low % width == 0 and low < GRID, Code.COVER_WRONG, place)
        low += width
        ends.append(low)
    need(low == GRID, Code.COVER_WRONG, place)
    return ends


def _joint_limits(run: Run, robot: Robot) -> tuple[bool, bool]:
    """Whether the run breaks a joint limit (farther beyond one, or to the other one), and whether it comes back."""
    broken = returning = False
    for start, target, (low, high) in zip(run.start, run.target, robot.ranges, strict=True):
        before, after = (max(low - q, q - high, 0.0) for q in (start, target))
        crossed = before > 0 and after > 0 and (start > high) != (target > high)
        returning = returning or before > 0
        broken = broken or not after <= before or crossed
    return broken, returning


class _Speeds:
    """Proven bounds on a body's speed over the whole path, m/s."""

    def __init__(self, sweep: Sweep, timing: Timing, cut: int) -> None:
        """Equal intervals, so many of them."""
        need(cut & (cut - 1) == 0, Code.MEMBER_WRONG, "proof.cut")
        step = GRID // cut
        self._sweep = sweep
        self._cuts = [
            (low, low + step, timing.highest(low / GRID, (low + step) / GRID)) for low in range(0, GRID, step)
        ]

    def of(self, body: Any) -> float:
        """Of this one."""
        return max(self._sweep.rush(body, low, high) * rate for low, high, rate in self._cuts)


def _ratios(asked: _Question, timing: Timing, speeds: _Speeds) -> dict[str, float]:
    """PHY-7: what is asked of the arm by its limits; torque apart, which the document states."""
    run, robot, cell = asked.run, asked.robot, asked.cell
    shares = [abs(way) / timing.way / limit for way, limit in zip(run.ways, robot.speed_limits, strict=True)]
    wanted = max(shares) * run.speed
    tcp = speeds.of(robot.tcp)
    always = robot.payload_limit_kg if cell.payload_kg is None else cell.payload_kg
    momentum = always * tcp + sum(mass * speeds.of(body) for body, mass in robot.masses)
    return {
        # A short motion never reaches a forbidden speed, but asking for one is asking to break the limit.
        "joint_speed": wanted if wanted > 1 + SAME else max(shares) * timing.peak,
        "acceleration": run.acceleration / robot.acceleration_limit,
        "tcp_speed": tcp / cell.tcp_speed_limit_m_s,
        "elbow_speed": speeds.of(robot.elbow) / cell.elbow_speed_limit_m_s,
        "momentum": momentum / cell.momentum_limit_kg_m_s,
        "payload": (robot.tool_mass_kg + carried_kg(robot, cell)) / robot.payload_limit_kg,
    }


def _leads_away(sweep: Sweep, pair: Pair, cell: Cell) -> bool:
    """PHY-6: violated where the arm stands, and never nearer than before, or than the bound once that is reached."""
    below = pair.violated_below
    if below is None or not attained(sweep, pair, 0) < below + SAME:
        return False
    best, step = -math.inf, GRID // RETREAT_CUT
    for low in range(0, GRID, step):
        best = min(below, max(best, attained(sweep, pair, low)))
        if not clearance(sweep, pair, low, low + step) >= best - cell.retreat_tolerance_m - SAME:
            return False
    return True


def _met(value: Any, sweep: Sweep, pairs: list[Pair], retreating: dict[int, None]) -> set[str]:
    """Kinds of the violations that are met, each at the configuration that the proof names."""
    place = "proof.met"
    kinds: list[str] = []
    for row in listed(value, place, least=0, most=len(VIOLABLE)):
        number, node = listed(row, place, least=2, most=2)
        pair = pairs[whole(number, place, low=0, high=len(pairs) - 1)]
        need(number not in retreating, Code.VIOLATION_UNFOUNDED, place)
        node = whole(node, place, low=0, high=GRID)
        below = pair.violated_below
        need(below is not None and attained(sweep, pair, node) < below + SAME, Code.VIOLATION_UNFOUNDED, place)
        kinds.append(pair.obstacle.kind)
    return set(_rising(kinds, place))
