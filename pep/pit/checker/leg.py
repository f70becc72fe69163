"""Proof of one leg: floors, retreats with their reasons, and every row of every pair (PHY-32, PHY-33)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

from pep.pit.checker.arm import GRID
from pep.pit.checker.laws import MOVING, RETREAT, SAME, Laws, carried_kg, ratio_index
from pep.pit.checker.question import VIOLABLE, obstacles_of
from pep.pit.checker.rows import PAIRS_MOST, Pair, attained, clearance, met_at, pairs_of
from pep.pit.checker.text import listed, whole
from pep.pit.checker.verdict import Code, Refusal, need

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit.checker.arm import CheckerRoute
    from pep.pit.checker.motion import Timing
    from pep.pit.checker.question import Cell, CheckerView
    from pep.pit.checker.robot import CheckerBody, CheckerRobot

DEPTHS: Final = {digit: GRID >> depth for depth, digit in enumerate("0123456789abcdefghijklmn")}
"""Width of an interval by the digit of its depth; the narrowest still has an exact middle."""
ROWS_MOST: Final = 200_000  # of one document; bounds the work
INDEX_SLACK: Final = 1e-6  # two roundings (1e-15 m) of a bound, divided by the shortest travel (1e-9 m) that has a band
VIOLATION_SLACK_M: Final = 1e-4  # PHY-9: a path that grazes to within this without touching is no violation
RETREAT_CUT: Final = 128  # PHY-6: equal intervals on which a retreat is shown never to come nearer


@dataclass(frozen=True, slots=True)
class CheckerQuestion:
    """Question of a proof, without the motion."""

    robot: CheckerRobot
    cell: Cell
    view: CheckerView
    scene: dict[str, Any]
    touch: frozenset[str]


@dataclass(frozen=True, slots=True)
class CheckerAnswer:
    """Claim about one leg."""

    index: float
    violations: list[str]


@dataclass(frozen=True, slots=True)
class CheckerLeg:
    """Leg that has a way.

    Attributes:
        way: path of the joints.
        timing: its timing.
        cuts: intervals that tile it, on which speeds of the whole way are bounded.
        ratios: joint speeds, accelerations and torques by their limits.
        tool_speed: commanded for the tool point, m/s; 0 when none is.
        peak: speed of the fastest joint, rad/s.
        returning: it comes back from beyond a joint limit.
    """

    way: CheckerRoute
    timing: Timing
    cuts: Sequence[tuple[int, int]]
    ratios: dict[str, float]
    peak: float
    tool_speed: float = 0.0
    returning: bool = False


def proven(asked: CheckerQuestion, leg: CheckerLeg, answer: CheckerAnswer, proof: dict[str, Any]) -> int:
    """Number of recomputed rows; each holds, and together they prove the leg's answer.

    Args:
        asked: robot, cell, view and scene.
        leg: its way and its timing.
        answer: the claimed answer.
        proof: its `cover`, `retreating`, `meant` and `met`.

    Raises:
        Refusal: something does not hold.
    """
    robot, cell, way = asked.robot, asked.cell, leg.way
    # 1. Floors: any motion, the view, a retreat, and the demands on the arm itself.
    speeds = CheckerSpeedBounds(way, leg.timing, leg.cuts)
    pairs = pairs_of(robot, obstacles_of(asked.scene, cell, asked.view, asked.touch), cell)
    retreating, meant = (_numbers(proof[name], f"proof.{name}", len(pairs)) for name in ("retreating", "meant"))
    retreats = bool(leg.returning or retreating)
    floor = max(MOVING, asked.view.floor, RETREAT if retreats else 0.0)
    need(floor <= answer.index + INDEX_SLACK, Code.FLOOR_EXCEEDS, "answer.index")
    for name, ratio in (leg.ratios | ratios(asked, speeds, leg.tool_speed)).items():
        need(ratio_index(ratio) <= answer.index + INDEX_SLACK, Code.FLOOR_EXCEEDS, name)
    # 2. Pairs left out as a retreat, and joint limits that are come back from: only when slow.
    slow = False
    if retreats:
        slow = leg.peak <= cell.retreat_joint_speed_rad_s * (1 + SAME)
        slow = slow and max(map(speeds.of, robot.moving)) <= cell.retreat_speed_m_s * (1 + SAME)
    need(slow or not retreating, Code.RETREAT_UNPROVEN, "proof.retreating")
    need(len(retreating) * RETREAT_CUT <= ROWS_MOST, Code.TOO_LARGE, "proof.retreating")
    for number in retreating:
        need(_leads_away(way, pairs[number], cell), Code.RETREAT_UNPROVEN, f"pair {number}")
    # 3. Violations: each claimed one is met where the proof says.
    met = _met(proof["met"], way, pairs, retreating)
    expected = met | ({"joint_limit"} if leg.returning and not slow else set())
    need(answer.violations == sorted(expected), Code.VIOLATION_UNFOUNDED, "answer.violations")
    # 4. Every pair's intervals cover the way, and every row holds.
    laws = Laws(robot, cell, asked.view, peak_rad_s=leg.peak)
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
        for high in intervals(cover, f"pair {number}", most=ROWS_MOST):
            near = clearance(way, pair, low, high)
            speed = way.rush(pair.body, low, high) * leg.timing.highest(low / GRID, high / GRID)
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


def rising(items: list[Any], place: str) -> list[Any]:
    """The items, when each is more than the one before, which is a set's one spelling.

    Raises:
        Refusal: they are not.
    """
    need(all(a < b for a, b in pairwise(items)), Code.MEMBER_WRONG, place)
    return items


def _numbers(value: Any, place: str, count: int) -> dict[int, None]:
    """Numbers of pairs, rising, as a dict: asked as a set, and kept in order."""
    items = listed(value, place, least=0, most=count)
    return dict.fromkeys(rising([whole(each, place, low=0, high=count - 1) for each in items], place))


def intervals(cover: Any, place: str, *, most: int) -> list[int]:
    """Ends of a cover's intervals, which tile the path, in parts of it.

    A cover is a text of one digit per interval: its depth d, an interval of 1/2^d of the path at a multiple of that.
    """
    need(type(cover) is str and len(cover) <= most, Code.COVER_WRONG, place)
    ends: list[int] = []
    low = 0
    for digit in cover:
        width = DEPTHS.get(digit, 0)
        need(width > 0 and low % width == 0 and low < GRID, Code.COVER_WRONG, place)
        low += width
        ends.append(low)
    need(low == GRID, Code.COVER_WRONG, place)
    return ends


class CheckerSpeedBounds:
    """Proven bounds on the bodies' speeds over the whole way, m/s."""

    def __init__(self, way: CheckerRoute, timing: Timing, cuts: Sequence[tuple[int, int]]) -> None:
        """Bounds on these intervals, which tile the way."""
        self._way = way
        self._cuts = [(low, high, timing.highest(low / GRID, high / GRID)) for low, high in cuts]

    def of(self, body: CheckerBody) -> float:
        """Bound on the speed of this body."""
        return max(self._way.rush(body, low, high) * rate for low, high, rate in self._cuts)


def ratios(asked: CheckerQuestion, speeds: CheckerSpeedBounds, tool_speed: float) -> dict[str, float]:
    """PHY-7: what any way asks of the arm by its limits; but joint speeds, accelerations and torques.

    Args:
        asked: robot and cell.
        speeds: of the bodies.
        tool_speed: that is commanded for the tool point, m/s.
    """
    robot, cell = asked.robot, asked.cell
    tcp = speeds.of(robot.tcp)
    always = robot.payload_limit_kg if cell.payload_kg is None else cell.payload_kg
    momentum = always * tcp + sum(mass * speeds.of(body) for body, mass in robot.masses)
    return {
        # A short motion never reaches a forbidden speed, but asking for one is asking to break the limit.
        "tcp_speed": (tool_speed if tool_speed > cell.tcp_speed_limit_m_s * (1 + SAME) else tcp)
        / cell.tcp_speed_limit_m_s,
        "elbow_speed": speeds.of(robot.elbow) / cell.elbow_speed_limit_m_s,
        "momentum": momentum / cell.momentum_limit_kg_m_s,
        "payload": (robot.tool_mass_kg + carried_kg(robot, cell)) / robot.payload_limit_kg,
    }


def _leads_away(way: CheckerRoute, pair: Pair, cell: Cell) -> bool:
    """PHY-6: true for a pair that is violated at the start and then only leads away.

    Its clearance is never less than before, or than the bound once that is reached.
    """
    below = pair.violated_below
    if below is None or not attained(way, pair, 0) < below + SAME:
        return False
    best, step = -math.inf, GRID // RETREAT_CUT
    for low in range(0, GRID, step):
        best = min(below, max(best, attained(way, pair, low)))
        if not clearance(way, pair, low, low + step) >= best - cell.retreat_tolerance_m - SAME:
            return False
    return True


def _met(value: Any, way: CheckerRoute, pairs: list[Pair], retreating: dict[int, None]) -> set[str]:
    """Kinds of the violations that are met where the proof names, at a configuration or between two."""
    place = "proof.met"
    kinds: list[str] = []
    for row in listed(value, place, least=0, most=len(VIOLABLE)):
        number, *ends = listed(row, place, least=1 + way.met_by, most=1 + way.met_by)
        pair = pairs[whole(number, place, low=0, high=len(pairs) - 1)]
        need(number not in retreating, Code.VIOLATION_UNFOUNDED, place)
        low, high = whole(ends[0], place, low=0, high=GRID), whole(ends[-1], place, low=0, high=GRID)
        need(low <= high and (low + high) % 2 == 0, Code.MEMBER_WRONG, place)
        below = pair.violated_below
        # In the middle of the interval, or as far beside it as the arm may be there.
        need(below is not None and met_at(way, pair, low, high) < below + SAME, Code.VIOLATION_UNFOUNDED, place)
        kinds.append(pair.obstacle.kind)
    return set(rising(kinds, place))
