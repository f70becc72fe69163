"""Compiled engine as the rest of the room calls it: a path, and the searches on it."""

from __future__ import annotations

import struct
import threading
from collections import deque
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base import pair_columns
from pep.pit.base.errors import UnprovenError, WorkLimitError
from pep.pit.base.motion import MoveJ, profile_of
from pep.pit.base.tier import MOVING
from pep.pit.geometry.solids import FORM
from pep.pit.path.path import Leaves
from pep.pit.path.straight_path import GRID, Path
from pep.pit.robot.kinematics import layout
from pep.pit.robot.robot import Robot
from pep.pit.scene.cell import CellParameters
from pep.pit.scene.obstacles import KINDS_IN_ORDER, PairKind
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.separation import stopping
from pep.pit.search.certify import BLOW_DEPTH, BLOW_RESOLUTION, FIRST_CUT_LEAST, ROWS_MOST, Fit, Slower
from pep.pit.search.kernel.arithmetic.body_poses import Arm, bends_of, blocks_of
from pep.pit.search.kernel.arithmetic.pair_rows import Field, StraightPath, balls_of
from pep.pit.search.kernel.arithmetic.place_clearance import clearances
from pep.pit.search.kernel.arithmetic.row_table import NUMBERS, Rows
from pep.pit.search.kernel.scratch import ASKED, room_for
from pep.pit.search.kernel.search_columns import HIDDEN, KINDS, LOOKS, NOBODY, SPARE, TOO_MANY
from pep.pit.search.kernel.straight_answer import StraightCertified, StraightFindings
from pep.pit.search.kernel.straight_calls import certify
from pep.pit.search.kernel.straight_halving import BLOW, EXAMINED, FITS, MET_AT, RUSHES, answered, nothing_known

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats, Profile, Straight
    from pep.pit.base.travel import Stopping
    from pep.pit.geometry.solids import Solids
    from pep.pit.path.path import Keys
    from pep.pit.scene.pairs import Pairs
    from pep.pit.search.kernel.scratch import Room
    from pep.pit.search.kernel.straight_halving import StraightConfigurations

NO_NUMBERS: Final = np.zeros(0)
NO_ROW_NUMBERS: Final = np.zeros((0, NUMBERS))
NO_FIELD: Final = Field(np.zeros((0, 1)), np.zeros((0, 1)), np.zeros((0, 1), np.int64))
_ASKED: Final = struct.Struct(f"{ASKED}d")
_AS_FAST: Final = Slower(0.0, 0.0, 0.0, 0.0)  # where no slower speed is looked for
PACKS_KEPT: Final = 16  # some scenes' pairs, and those of slower speeds: 80 kB each

_CODED: Final = {
    pair_columns.PERSON: PairKind.PERSON,
    pair_columns.ZONE: PairKind.ZONE,
    pair_columns.MEANT: PairKind.MEANT,
}
if any(KINDS_IN_ORDER[code] is not kind for code, kind in _CODED.items()) or len(KINDS_IN_ORDER) != KINDS:
    raise ImportError("the kernel's codes of kinds are not those of the pairs")


@lru_cache(maxsize=64)  # one robot of a cell, with the objects it holds in a day
def arm_of(robot: Robot) -> Arm:
    """The robot's bodies and joints as the kernel's arrays."""
    plan = layout(robot)
    ends = np.ascontiguousarray(plan.ends)
    half = 0.5 * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    return Arm(
        plan.link.astype(np.int64),
        plan.reference.astype(np.int64),
        ends,
        plan.radius,
        half,
        np.array(robot.reach),
        np.array(robot.rotations),
        np.array(robot.offsets),
    )


@lru_cache(maxsize=64)
def blocks(robot: Robot) -> tuple[Floats, NDArray[np.int64]]:
    """The robot's numbers and whole numbers, as `arm.blocks_of` has them."""
    return blocks_of(arm_of(robot))


class _Rooms(threading.local):
    """Memory for the searches of one thread."""

    def __init__(self) -> None:
        self._by_bodies: dict[int, tuple[int, Room]] = {}

    def of(self, arm: Arm, pairs: int) -> Room:
        """Room for the first cut of so many pairs, and some more."""
        bodies, needed = len(arm.link), pairs * FIRST_CUT_LEAST + SPARE
        known = self._by_bodies.get(bodies)
        if known is None or known[0] < needed:
            known = 2 * needed, room_for(bodies, len(arm.offsets), 2 * needed)
            self._by_bodies = {bodies: known}
        return known[1]


_ROOMS: Final = _Rooms()


class _Packs(threading.local):
    """The pairs of one thread's last few questions, as the kernel's arrays."""

    def __init__(self) -> None:
        self._last: deque[tuple[Pairs, Field, int]] = deque(maxlen=PACKS_KEPT)

    def of(self, pairs: Pairs) -> tuple[Field, int]:
        """Pairs as the kernel's arrays, and the number of their groups."""
        for known, field, groups in self._last:
            if known is pairs:
                return field, groups
        field, groups = packed(pairs), pairs.groups
        self._last.appendleft((pairs, field, groups))
        return field, groups


_PACKS: Final = _Packs()


class CompiledPath(Path):
    """Path with the kernel as its engine."""

    def __init__(self, robot: Robot, move: Straight) -> None:
        """Makes a path that holds no configuration yet."""
        super().__init__(robot, move)
        self._arm = arm_of(robot)

    @cached_property
    def _way(self) -> StraightPath:
        return StraightPath(self._arm, self.start, self.delta, bends_of(self._arm, self.delta))

    @cached_property
    def asked(self) -> Floats:
        """Start and way of the joints, side by side, rad."""
        return np.concatenate([self.start, self.delta])

    @cached_property
    def _held(self) -> StraightConfigurations:
        return nothing_known(len(self.robot.bodies))

    def packed(self, pairs: Pairs) -> Field:
        """The pairs as the kernel's arrays."""
        return _PACKS.of(pairs)[0]

    def rush(self, low: Keys, high: Keys) -> Floats:
        """As `Route.rush`."""
        nobody = np.zeros_like(low)
        found, _ = self._answered(RUSHES, NO_FIELD, unknown_rows(low, high, nobody))
        return np.asarray(found.numbers)

    def examine(self, pairs: Pairs, low: Keys, high: Keys, pair: NDArray[np.intp]) -> Leaves:
        """As `Route.examine`."""
        found, _ = self._answered(EXAMINED, self.packed(pairs), unknown_rows(low, high, pair))
        return leaves_of(found)

    def _answered(
        self, what: int, field: Field, rows: Rows, timing: Floats = NO_NUMBERS, law: Floats = NO_NUMBERS, *more: float
    ) -> tuple[Rows, float]:
        """Answer of the kernel, which may have got to know configurations."""
        numbers = np.array(more, dtype=float)
        self._held, found, number = answered(what, self._held, self._way, field, rows, timing, law, numbers)
        return found, number

    def rush_at(self, pairs: Pairs, key: int, pair: NDArray[np.intp]) -> Floats:
        """As `Route.rush_at`."""
        found, _ = self._answered(
            MET_AT, self.packed(pairs), unknown_rows(pair, pair, pair), NO_NUMBERS, NO_NUMBERS, key
        )
        return found.numbers[:, 1]

    def clearance_at(self, pairs: Pairs, key: int, pair: NDArray[np.intp]) -> Floats:
        """As `Route.clearance_at`."""
        _, numbers, whole = self.packed(pairs)
        return np.asarray(clearances(*blocks(self.robot), numbers, whole, self.asked, key, pair))

    def certify(
        self,
        pairs: Pairs,
        profile: Profile,
        stop: Stopping,
        *,
        rows: NDArray[np.intp],
        floor: float,
        check_time: Callable[[], None],
        told: bool = True,
        slower: Slower | None = None,
    ) -> StraightCertified:
        """The proven index of these pairs on this path, by branch and bound.

        Args:
            pairs: pairs of bodies and obstacles.
            profile: the path's timing.
            stop: the stop of the motion.
            rows: the pairs to ask about.
            floor: an index that holds anyway; pairs that cannot exceed it are not looked at more closely.
            check_time: raises when the answer would come too late.
            told: with a witness for each obstacle that may raise the index.
            slower: numbers for the search of a slower speed, where one is wanted.

        Raises:
            WorkLimitError: more rows than `ROWS_MOST` were needed.
            UnprovenError: a row that could not be followed farther may hide a violation.
        """
        if len(rows) * FIRST_CUT_LEAST > ROWS_MOST:
            raise WorkLimitError("PHYSICS_FAULT", "the question needs too many rows")
        room, (numbers, whole) = _ROOMS.of(self._arm, len(rows)), blocks(self.robot)
        (field, groups), move, speeds = _PACKS.of(pairs), self._move, slower or _AS_FAST
        _ASKED.pack_into(
            room.numbers.data, 0, *move.start, *move.target, *timing_of(profile), *law_of(pairs, stop), *speeds
        )
        status, upper, attained, falls, many, broken, found, far = certify(
            *room, numbers, whole, *field, rows, groups, floor, LOOKS if told else 0, slower is not None
        )
        check_time()
        if status == TOO_MANY:
            raise WorkLimitError("PHYSICS_FAULT", "the question needs too many rows")
        if status == HIDDEN:
            raise UnprovenError("violation")
        return StraightCertified(
            StraightFindings(pairs, rows, many, broken, found, far),
            upper=upper,
            attained=attained,
            slower=None if falls == NOBODY else falls,
        )

    def fits(
        self,
        pairs: Pairs,
        profile: Profile,
        stop: Stopping,
        leaves: Leaves,
        *,
        index: float,
        check_time: Callable[[], None],
    ) -> Fit:
        """True, in the result, where no row is proven to exceed `index` at this profile.

        "Not proven" may also mean that `LOWER_DEPTH` halvings did not suffice to prove it: the caller then names a
        slower speed, never a faster.
        """
        check_time()
        timing, law = np.array(timing_of(profile)), np.array(law_of(pairs, stop))
        rows, proven = self._answered(FITS, self.packed(pairs), table_of(leaves), timing, law, index)
        return Fit(leaves_of(rows), bool(proven))

    def blow_ratio(
        self,
        pairs: Pairs,
        profile: Profile,
        stop: Stopping,
        *,
        check_time: Callable[[], None],
    ) -> float:
        """Proven share of its limit speed that no body region the arm could meet exceeds (PHY-4)."""
        check_time()
        people = np.flatnonzero(pairs.kind == pair_columns.PERSON)
        if not people.size:
            return 0.0
        timing, law = np.array(timing_of(profile)), np.array(law_of(pairs, stop))
        rows, more = unknown_rows(people, people, people), (FIRST_CUT_LEAST, BLOW_DEPTH, BLOW_RESOLUTION)
        return self._answered(BLOW, self.packed(pairs), rows, timing, law, *more)[1]


def compile_all() -> None:
    """Compiles every entry into the kernel, or reads it from disk: a minute of one core the first time."""
    robot, cell = Robot.load("ur3e"), CellParameters()
    move = MoveJ((0.0, -1.5, 1.5, -1.5, -1.5, 0.0), (0.4, -1.5, 1.5, -1.5, -1.5, 0.0), 0.5, 1.4)
    profile = profile_of(move)
    if profile is None:
        raise AssertionError("the move goes somewhere")
    stop = stopping(cell, perception_age_s=0.0, joint_speed_rad_s=profile.peak_rad_s)
    pairs = pairs_of(robot, cell.surveyed, cell, grown_m=0.0)
    path, rows = CompiledPath(robot, move), np.arange(len(pairs))
    found = path.certify(
        pairs, profile, stop, rows=rows, floor=MOVING, check_time=_no_limit, slower=Slower(0.05, 8.0, 0.01, 0.5)
    )
    found.proves(rows, found.upper)
    path.fits(pairs, profile, stop, found.leaves, index=MOVING, check_time=_no_limit)
    path.blow_ratio(replace(pairs, kind=np.zeros_like(pairs.kind)), profile, stop, check_time=_no_limit)
    path.examine(pairs, np.zeros(1, np.int64), np.full(1, GRID), rows[:1])
    path.rush(np.zeros(1, np.int64), np.full(1, GRID))
    path.clearance_at(pairs, 0, rows[:1])
    path.rush_at(pairs, 0, rows[:1])


def _no_limit() -> None:
    """Ends at no time: the time is not counted."""


def field_of(pairs: Pairs) -> Field:
    """Pairs as of `packed`; for pairs of this thread's last questions the same arrays."""
    return _PACKS.of(pairs)[0]


def packed(pairs: Pairs) -> Field:
    """The pairs as the kernel's arrays."""
    numbers, whole = pairs.solids.numbers, pairs.whole
    if whole is None:
        numbers = numbers.copy()
        numbers[:, pair_columns.RADII] = pairs.radii
        numbers[:, pair_columns.UNCERTAINTY] = pairs.uncertainty
        numbers[:, pair_columns.HARM_SPEED] = pairs.harm_speed
        numbers[:, pair_columns.LIMIT_SPEED] = pairs.limit_speed
        numbers[:, pair_columns.INTRUSION] = pairs.intrusion
        numbers[:, pair_columns.BAND] = pairs.band
        numbers[:, pair_columns.DECLARED] = pairs.declared
        numbers[:, pair_columns.VIOLATED_BELOW] = pairs.violated_below
        whole = np.empty((len(pairs), pair_columns.WHOLE), dtype=np.int64)
        whole[:, pair_columns.BODY] = pairs.body
        whole[:, pair_columns.SHAPE] = numbers[:, FORM]
        whole[:, pair_columns.KIND] = pairs.kind
        whole[:, pair_columns.GROUP] = pairs.group
    numbers = _with_polytopes(numbers, pairs.solids)
    return Field(balls_of(numbers, whole, pairs.warn_band), numbers, whole)


def _with_polytopes(numbers: Floats, solids: Solids) -> Floats:
    """Numbers of all pairs, followed by the rows of each polytope, whose places its pairs hold."""
    if not solids.hulls:
        return numbers
    parts, first = [numbers.copy()], len(numbers)
    for which, hull in enumerate(solids.hulls):
        counts = len(hull.vertices), len(hull.faces), len(hull.edges)
        parts[0][solids.hull == which, pair_columns.FIRST_ROW : pair_columns.EDGES + 1] = first, *counts
        rows = np.zeros((max(counts), numbers.shape[1]))
        corners, faces, edges = (rows[:count] for count in counts)
        corners[:, pair_columns.VERTEX : pair_columns.VERTEX + 3] = hull.vertices
        faces[:, pair_columns.NORMAL : pair_columns.NORMAL + 3] = hull.normals
        faces[:, pair_columns.BEHIND] = hull.offsets
        faces[:, pair_columns.SIDES : pair_columns.SIDES + 9] = hull.sides.reshape(-1, 9)  # three vectors
        faces[:, pair_columns.BESIDE : pair_columns.BESIDE + 3] = hull.side_offsets
        edges[:, pair_columns.EDGE : pair_columns.EDGE + 6] = hull.vertices[hull.edges].reshape(-1, 6)  # two points
        parts.append(rows)
        first += len(rows)
    return np.concatenate(parts)


def timing_of(profile: Profile) -> tuple[float, ...]:
    """The profile in the columns of the kernel."""
    return profile.way_rad, profile.peak_rad_s, profile.acceleration_rad_s2, profile.braking_rad_s2, profile.top


def law_of(pairs: Pairs, stop: Stopping) -> tuple[float, ...]:
    """Law of the motion's end and the bands of all pairs, in the columns of the kernel."""
    return (
        stop.reaction_s,
        stop.brake_s,
        stop.travel_s,
        stop.person_speed_m_s,
        pairs.warn_band,
        pairs.penetration_band,
        pairs.contact_speed,
    )


def unknown_rows(low: Keys, high: Keys, pair: NDArray[np.intp]) -> Rows:
    """Rows of which nothing is known yet."""
    return Rows(np.stack([low, high, pair], axis=1), NO_ROW_NUMBERS)


def leaves_of(rows: Rows) -> Leaves:
    """The rows as the rest of the room has them."""
    low, high, pair = np.ascontiguousarray(rows.whole.T)
    clear, rush, clear_mid, rush_mid, _ = np.ascontiguousarray(rows.numbers.T)
    return Leaves(low, high, pair, clear, rush, clear_mid, rush_mid)


def table_of(leaves: Leaves) -> Rows:
    """The rows as the kernel has them."""
    whole = np.stack([leaves.low, leaves.high, leaves.pair], axis=1)
    bound = np.zeros(len(leaves))
    return Rows(whole, np.stack([leaves.clear_m, leaves.rush, leaves.clear_mid_m, leaves.rush_mid, bound], axis=1))
