"""The watch's question: of a motion under way, is what remains still inside what was authorised?

Only the way from where the arm measurably is counts, with the rates that the motion's own profile can still have there.
The answer is yes or no with a proof of the yes, found by the same search as `assess` and left as soon as either is
certain; there is no second engine and no search for a slower speed here. Whatever cannot be answered is a fault, and a
watch stops on it.
"""

from __future__ import annotations

import time
import traceback
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, assert_never

import numpy as np

from pep.pit.assessment import milli
from pep.pit.certify import DEPTH, ROWS_MOST, VIOLATION_RESOLUTION_M, first_cut
from pep.pit.clearance import ROUNDING_M
from pep.pit.departure import RETREAT, departure, joint_limits, slow_enough
from pep.pit.engine import chosen
from pep.pit.errors import MotionError, PitError, WorkLimitError
from pep.pit.grip import gripping
from pep.pit.motion import (
    STILL_RAD,
    GripperMove,
    JointPath,
    LinePath,
    MoveJ,
    MoveL,
    OutputSet,
    ServoJ,
    SpeedJ,
    SpeedL,
    profile_of,
)
from pep.pit.oracle import Disagreement
from pep.pit.outputs import output_cause
from pep.pit.pairs import VIOLABLE, pairs_of
from pep.pit.parameters import Demands
from pep.pit.path import GRID
from pep.pit.question import as_run, deadline, refuse_nonsense, six_finite, view_around
from pep.pit.separation import stopping
from pep.pit.tier import HIGHEST, MOVING, TIE
from pep.pit.touching import gentle_rows
from pep.pit.view import view_of
from policies.evidence import ImpactFault

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pep.pit.cell import CellParameters
    from pep.pit.motion import Floats, Joints, Motion, Profile, Run
    from pep.pit.pairs import Pairs
    from pep.pit.path import Leaves
    from pep.pit.robot import Robot
    from pep.pit.route import Route
    from pep.pit.scene import Scene
    from pep.pit.separation import Stopping
    from pep.pit.view import View

PER_MILLI: Final = 1e-3  # index by index_milli
OFF_PATH: Final = "off_path"
MOVES: Final = "motion"
PERCEPTION: Final = "perception"
JOINT_LIMIT: Final = "joint_limit"
RETREATS: Final = "retreat"


@dataclass(frozen=True, slots=True)
class Remaining:
    """Whether what is left of a motion is proven to be inside what was authorised.

    Attributes:
        holds: it is. Anything else must stop the arm.
        index_milli: when it holds, the proven index of what is left; otherwise the index that was met or could not be
            excluded.
        cause: "" when it holds; otherwise the kind of contribution or violation that speaks against it, or "off_path".
    """

    holds: bool
    index_milli: int
    cause: str


def remaining(
    robot: Robot,
    scene: Scene | None,
    move: Motion,
    cell: CellParameters,
    *,
    at_rad: Joints,
    authorised_milli: int,
    perception_age_s: float | None,
    touch: frozenset[str],
    clock: Callable[[], float] = time.monotonic,
) -> Remaining | ImpactFault:
    """Whether the rest of `move` is proven to have at most the authorised index. Never raises.

    Args:
        robot: the arm with its tool and what that holds, as it was when `move` was decided.
        scene: the newest valid view, or None when there is none.
        move: the motion under way, as it was assessed: from its start.
        cell: the cell's parameters.
        at_rad: measured joint angles, rad. Farther than `cell.tracking_tolerance_m` from the path is off the path.
        authorised_milli: index that the decision authorised, 0 to 4000 thousandths.
        perception_age_s: age of the view, or None; enters the reaction time (PHY-2).
        touch: names of objects that the token grants to touch.
        clock: monotonic seconds; the answer comes within `cell.watch_time_limit_s` or is a fault.
    """
    try:
        chosen()  # compiled, where it is the first call of all, before the time is counted
        check_time = deadline(clock, cell.watch_time_limit_s)
        answer = _remaining(
            robot,
            scene,
            move,
            cell,
            at_rad=at_rad,
            authorised_milli=authorised_milli,
            age_s=perception_age_s,
            touch=touch,
            check_time=check_time,
        )
        check_time()  # a late answer is about an arm that is elsewhere by now
        return answer  # noqa: TRY300 - the check above belongs to the answer
    except PitError as error:
        return ImpactFault(error.reason, error.detail)
    except Exception as error:  # noqa: BLE001 - whatever breaks in here must stop the arm, not the watch
        frames = traceback.extract_tb(error.__traceback__)
        return ImpactFault("PHYSICS_FAULT", f"{type(error).__name__} in {frames[-1].name}")


def _remaining(
    robot: Robot,
    scene: Scene | None,
    move: Motion,
    cell: CellParameters,
    *,
    at_rad: Joints,
    authorised_milli: int,
    age_s: float | None,
    touch: frozenset[str],
    check_time: Callable[[], None],
) -> Remaining | ImpactFault:
    refuse_nonsense(robot, move, cell, touch)
    six_finite(at_rad)
    if not (type(authorised_milli) is int and 0 <= authorised_milli <= milli(HIGHEST)):
        raise MotionError("PARAMETERS_WRONG", "an authorised index that is none")
    match move:
        case MoveJ() | SpeedJ():
            run = as_run(move, cell)
            rest = Rest(robot, run, cell, at_rad=at_rad, authorised_milli=authorised_milli, check_time=check_time)
            return rest.answer(scene, age_s, touch)
        case MoveL() | SpeedL() | ServoJ() | JointPath() | LinePath():
            from pep.pit.drive_rest import rests_of  # here, since it builds on this module

            rests = rests_of(
                robot,
                move,
                cell,
                at_rad=at_rad,
                authorised_milli=authorised_milli,
                age_s=age_s or 0.0,
                check_time=check_time,
            )
            return rests.answer(scene, age_s, touch)
        case GripperMove():
            if not strays_m(robot, np.array(at_rad) - np.array(move.q)) <= cell.tracking_tolerance_m:
                return Remaining(holds=False, index_milli=milli(HIGHEST), cause=OFF_PATH)
            return _grip(robot, view_of(scene, age_s, cell), move, cell, authorised_milli)
        case OutputSet():
            told = output_cause(move, cell)
            return against(authorised_milli, told.index_milli, told.kind)
        case _:
            assert_never(move)


def against(authorised_milli: int, index_milli: int, cause: str) -> Remaining:
    """Whether that index is inside what was authorised, and what speaks against it otherwise."""
    holds = index_milli <= authorised_milli
    return Remaining(holds, index_milli, "" if holds else cause)


def strays_m(robot: Robot, error_rad: Floats) -> float:
    """Bound on how far joint angles that are off by this much carry any part of the robot."""
    return float((robot.reach @ np.abs(error_rad)).max())


def _grip(
    robot: Robot, view: View, move: GripperMove, cell: CellParameters, authorised_milli: int
) -> Remaining | ImpactFault:
    """A gripper move is short: all of it is asked again, at the arm's rest."""
    grip = gripping(robot, view, move, cell)
    if isinstance(grip, Disagreement):
        return ImpactFault("ENGINES_DISAGREE", grip.what)
    worst = grip.causes[0]
    if view.floor > worst.index:
        return against(authorised_milli, milli(view.floor), PERCEPTION)
    return against(authorised_milli, milli(worst.index), worst.kind)


class Rest:
    """What is left of one run, from where the arm is."""

    def __init__(
        self,
        robot: Robot,
        run: Run,
        cell: CellParameters,
        *,
        at_rad: Joints,
        authorised_milli: int,
        check_time: Callable[[], None],
    ) -> None:
        self.robot, self.run, self.cell, self.at_rad = robot, run, cell, at_rad
        self.authorised_milli, self.check_time = authorised_milli, check_time
        self.limit = authorised_milli * PER_MILLI + TIE

    def answer(self, scene: Scene | None, age_s: float | None, touch: frozenset[str]) -> Remaining:
        """The steps, in order."""
        run, cell = self.run, self.cell
        path = chosen().path(self.robot, run)
        # 1. Where on the path the arm is. What lies behind it is done.
        at = np.array(self.at_rad)
        length2 = float(path.delta @ path.delta)
        s = float(np.clip((at - path.start) @ path.delta / length2, 0, 1)) if length2 > STILL_RAD**2 else 0.0
        if not strays_m(self.robot, at - path.q(s)) <= cell.tracking_tolerance_m:
            return Remaining(holds=False, index_milli=milli(HIGHEST), cause=OFF_PATH)
        profile = profile_of(run)
        if profile is None:
            return Remaining(holds=True, index_milli=0, cause="")
        since = int(s * GRID)
        # 2. Joint limits, then what the motion asks of the arm: neither depends on the view.
        limits = joint_limits(self.robot, path.q(s), np.array(run.target))
        if limits.broken:
            return Remaining(holds=False, index_milli=milli(HIGHEST), cause=JOINT_LIMIT)
        demands = Demands(path, cell)
        floors = [(MOVING, MOVES), *((ratio.index, ratio.name) for ratio in demands.ratios(profile))]
        speeds = demands.surface_speed_m_s(profile)
        # 3. The view, without what the arm holds, wherever that was seen to be on the way here.
        lag_m = float(speeds.max()) * (age_s or 0.0)
        view = view_around(self.robot, scene, age_s, self.at_rad, cell, lag_m=lag_m)
        floors.append((view.floor, PERCEPTION))
        bare = pairs_of(self.robot, view.scene, cell, grown_m=view.grown_m, touch=touch)
        pairs = bare.meant(gentle_rows(path, bare, profile, cell, since=since, check_time=self.check_time))
        # 4. What is violated where the arm is, and whether the rest only leads away from it.
        surface = float(speeds[: self.robot.world_bodies].max())
        slow = slow_enough(cell, joint_speed_rad_s=profile.peak_rad_s, speed_m_s=surface)
        here = departure(path, pairs, cell, slow=slow, since=since)
        if limits.retreating and not slow:
            return Remaining(holds=False, index_milli=milli(HIGHEST), cause=JOINT_LIMIT)
        if limits.retreating or here.retreating.size:
            floors.append((RETREAT, RETREATS))
        floor, cause = max(floors)
        if not milli(floor) <= self.authorised_milli:
            return Remaining(holds=False, index_milli=milli(floor), cause=cause)
        # 5. The proof that no pair exceeds what is authorised.
        stop = stopping(cell, perception_age_s=view.stopping_age_s, joint_speed_rad_s=profile.peak_rad_s)
        return self._proof(path, pairs, profile, stop, rows=here.rows, speeds=speeds, since=since, floor=floor)

    def _proof(
        self,
        path: Route,
        pairs: Pairs,
        profile: Profile,
        stop: Stopping,
        *,
        rows: NDArray[np.intp],
        speeds: Floats,
        since: int,
        floor: float,
    ) -> Remaining:
        """The search of `certify` with the answer known beforehand: each row is followed until it is at most that."""
        for key in (since, GRID):
            clearance = path.clearance_at(pairs, key, rows)
            speed = path.rush_at(pairs, key, rows) * profile.rate(np.array(key / GRID))
            met = self._met(pairs, rows, clearance, pairs.index(rows, clearance, speed, stop))
            if met is not None:
                return met
        rows, proven = self._far_enough(path, pairs, stop, rows=rows, speeds=speeds, since=since)
        proven = max(proven, floor)
        if since >= GRID or not rows.size:
            return Remaining(holds=True, index_milli=milli(proven), cause="")
        leaves = first_cut(path, pairs, rows, since=since)
        examined = 0
        for depth in range(DEPTH + 1):
            self.check_time()
            examined += len(leaves)
            if examined > ROWS_MOST:
                raise WorkLimitError("PHYSICS_FAULT", "the question needs too many rows")
            mid = leaves.mid
            ahead = leaves.take(mid >= since)
            attained = pairs.index(ahead.pair, ahead.clear_mid_m, ahead.rush_mid * profile.rate(ahead.mid / GRID), stop)
            met = self._met(pairs, ahead.pair, ahead.clear_mid_m, attained)
            if met is not None:
                return met
            rate = profile.highest_rate(leaves.low / GRID, leaves.high / GRID)
            bound = pairs.index(leaves.pair, leaves.clear_m, leaves.rush * rate, stop)
            over = bound > self.limit
            if depth == DEPTH:
                if over.any():
                    worst = int(bound.argmax())
                    return _not(pairs, int(leaves.pair[worst]), float(bound[worst]))
                return Remaining(holds=True, index_milli=milli(max(proven, float(bound.max()))), cause="")
            unsettled = over | _doubtful(pairs, leaves)
            proven = max(proven, float(bound[~unsettled].max(initial=0)))
            if not unsettled.any():
                return Remaining(holds=True, index_milli=milli(proven), cause="")
            leaves = path.halve(pairs, leaves.take(unsettled), since=since)
        raise AssertionError("the last depth returns")

    def _far_enough(
        self, path: Route, pairs: Pairs, stop: Stopping, *, rows: NDArray[np.intp], speeds: Floats, since: int
    ) -> tuple[NDArray[np.intp], float]:
        """The pairs that one look at the middle of the rest does not settle, and the index proven of the others.

        From there no part goes farther than its levers times the joints' ways, nor faster than on the whole path.
        """
        middle = (since + GRID) // 2
        strays = path.robot.reach @ np.abs(path.delta) * ((GRID - middle) / GRID)
        body = pairs.body[rows]
        clearance = path.clearance_at(pairs, middle, rows) - strays[body] - ROUNDING_M
        bound = pairs.index(rows, clearance, speeds[body], stop)
        settled = (bound <= self.limit) & ~(clearance < pairs.violated_below[rows])
        return rows[~settled], float(bound[settled].max(initial=0))

    def _met(self, pairs: Pairs, rows: NDArray[np.intp], clearance: Floats, index: Floats) -> Remaining | None:
        """What was met there that must not be: a violation, or an index above the authorised one."""
        below = clearance < pairs.violated_below[rows]
        if below.any():
            kind = pairs.kind_of(int(rows[int(np.flatnonzero(below)[0])]))
            return Remaining(holds=False, index_milli=milli(HIGHEST), cause=str(kind))
        worst = int(index.argmax()) if len(index) else -1
        if worst < 0 or index[worst] <= self.limit:
            return None
        return _not(pairs, int(rows[worst]), float(index[worst]))


def _not(pairs: Pairs, pair: int, index: float) -> Remaining:
    """This pair speaks against it."""
    return Remaining(holds=False, index_milli=milli(min(index, HIGHEST)), cause=str(pairs.kind_of(pair)))


def _doubtful(pairs: Pairs, leaves: Leaves) -> NDArray[np.bool_]:
    """Rows that may hide a violation."""
    may = np.isin(pairs.kind[leaves.pair], [pairs.code_of(kind) for kind in VIOLABLE])
    return np.asarray(may & (leaves.clear_m < pairs.violated_below[leaves.pair] - VIOLATION_RESOLUTION_M))
