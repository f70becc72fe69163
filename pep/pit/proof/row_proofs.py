"""Rows of a proof: per pair the fewest intervals whose bounds prove the answer (PHY-31 to PHY-33)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pep.pit.base.errors import ProofError
from pep.pit.base.tier import TIE
from pep.pit.path.course import Course
from pep.pit.path.straight_path import GRID
from pep.pit.scene.obstacles import VIOLABLE, PairKind
from pep.pit.search.certify import ROWS_MOST, VIOLATION_RESOLUTION_M
from pep.pit.search.meant_contact import gentle_rows
from pep.pit.search.start_violations import RETREAT_CUT

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.assessment.assessment import RowsCertificate
    from pep.pit.base.motion import Floats, Profile
    from pep.pit.base.travel import Stopping
    from pep.pit.path.path import Leaves
    from pep.pit.path.straight_path import Path
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.pairs import Pairs

ALL_BUT_ON_IT: Final = 1e-6  # rad: error of Newton's method beside a line, with much room
CLEARLY: Final = 1e-3  # of an index: far more than that can count
DIGITS: Final = "0123456789abcdefghijklmn"  # PHY-32: of an interval's depth
DEEPEST: Final = len(DIGITS) - 1
"""Halvings of the whole way: a narrower interval has no exact middle.

They are more than the search makes, which takes clearance and speed at the same place (PHY-9): where the arm comes to
rest just short of an obstacle, its plainer rows here follow it farther.
"""


@dataclass(frozen=True, slots=True)
class Claimed:
    """Claim that the rows have to prove: index, violations, and the search's own rows."""

    index: float
    violations: tuple[str, ...]
    rows: RowsCertificate


@dataclass(frozen=True, slots=True)
class Proven:
    """Members `cover`, `retreating`, `meant` and `met` of a proof, and every place of the way that they need."""

    members: dict[str, Any]
    places: set[int]


def order_of(robot: Robot, pairs: Pairs) -> list[int]:
    """Order of our pairs in the certificate: pairs of the arm itself by names, others as ours."""
    own = np.flatnonzero(pairs.kind == pairs.code_of(PairKind.SELF)).tolist()
    names = [(inner.name, robot.bodies[body].name) for body, inner in robot.self_pairs]
    ours = list(range(len(pairs)))
    if own:
        ours[own[0] : own[-1] + 1] = [own[k] for k in sorted(range(len(own)), key=names.__getitem__)]
    return ours


class ProofRows:
    """The coarsest rows that prove an answer: begins with the whole way, and halves insufficient rows."""

    def __init__(
        self, way: Path | Course, profile: Profile, stop: Stopping, pairs: Pairs, *, cell: CellParameters, slack: float
    ) -> None:
        """Makes rows of which nothing is examined yet.

        Args:
            way: path of the joints.
            profile: its timing.
            stop: the stop of the motion.
            pairs: as the assessment had them, but for what is meant to be touched.
            cell: its parameters.
            slack: by how much a row's index may be above the answer's.
        """
        self.way, self.profile, self.cell, self.stop, self.slack = way, profile, cell, stop, slack
        gentle = gentle_rows(way, pairs, profile, cell, check_time=lambda: None)
        self.meant = np.zeros(len(pairs), dtype=bool)
        self.meant[gentle] = True
        self.pairs = pairs.meant(gentle)

    def proof(self, answer: Claimed, asked: NDArray[np.bool_]) -> Proven:
        """Rows that prove this answer of the asked pairs.

        Raises:
            ProofError: a row that cannot be proven to the answer's index.
        """
        place = {pair: at for at, pair in enumerate(order_of(self.way.robot, self.pairs))}
        covers = [""] * len(self.pairs)
        needed: set[int] = set()
        for pair, intervals in self._covers(np.flatnonzero(asked), answer).items():
            covers[place[pair]] = "".join(digit for _, digit in intervals)
            needed.update(_places(intervals))
        retreating = np.flatnonzero(~asked)
        if retreating.size:
            needed.update(range(0, GRID + 1, GRID // RETREAT_CUT // 2))
        met = self._met(answer, asked, place)
        needed.update(key for _, low, high in met for key in (low, (low + high) // 2, high))
        return Proven(
            {
                "cover": covers,
                "retreating": sorted(place[pair] for pair in retreating.tolist()),
                "meant": sorted(place[pair] for pair in np.flatnonzero(self.meant).tolist()),
                "met": met,
            },
            needed,
        )

    def _covers(self, rows: NDArray[np.intp], answer: Claimed) -> dict[int, list[tuple[int, str]]]:
        """Intervals of each pair from the way's start to its end: the start and the depth's digit of each."""
        found: dict[int, list[tuple[int, str]]] = {pair: [] for pair in rows.tolist()}
        zero = np.zeros(len(rows), dtype=np.int64)
        leaves = self.way.examine(self.pairs, zero, zero + GRID, rows)
        examined = 0
        for depth in range(DEEPEST + 1):
            examined += len(leaves)
            if examined > ROWS_MOST or not self._may_suffice(leaves, answer):
                break
            enough = self._suffices(leaves, answer)
            done = leaves.take(enough)
            for low, pair in zip(done.low.tolist(), done.pair.tolist(), strict=True):
                found[pair].append((low, DIGITS[depth]))
            if enough.all():
                return {pair: sorted(each) for pair, each in found.items()}
            leaves = self.way.halve(self.pairs, leaves.take(~enough))
        raise ProofError("PHYSICS_FAULT", "a row that does not prove the answer's index")

    def _may_suffice(self, leaves: Leaves, answer: Claimed) -> bool:
        """True where no middle attains more than the claim; else nothing could be proven.

        Beside a course that strays the arm need not be where a shorter interval puts it, so such a course always
        passes.
        """
        margin = TIE
        if isinstance(self.way, Course):
            if self.way.cells.stray.max() > ALL_BUT_ON_IT:
                return True
            margin = CLEARLY
        speed: Floats = leaves.rush_mid * self.profile.rate(leaves.mid / GRID)
        attained = self.pairs.index(leaves.pair, leaves.clear_mid_m, speed, self.stop)
        return not bool((attained > answer.index + margin).any())

    def _suffices(self, leaves: Leaves, answer: Claimed) -> NDArray[np.bool_]:
        """Rows that prove the index, exclude a violation that was not met, and prove a meant contact gentle."""
        pair = leaves.pair
        rate = self.profile.highest_rate(leaves.low / GRID, leaves.high / GRID)
        speed: Floats = leaves.rush * rate
        enough = self.pairs.index(pair, leaves.clear_m, speed, self.stop) <= answer.index + max(self.slack, TIE)
        excluded = [self.pairs.code_of(kind) for kind in VIOLABLE if str(kind) not in answer.violations]
        open_kind = np.isin(self.pairs.kind[pair], excluded)
        enough &= ~open_kind | (leaves.clear_m >= self.pairs.violated_below[pair] - VIOLATION_RESOLUTION_M)
        cell = self.cell
        slow = (speed <= cell.contact_speed_m_s) & (leaves.clear_m >= -cell.contact_depth_m)
        enough &= ~self.meant[pair] | slow | (leaves.clear_m >= cell.contact_near_m)
        return np.asarray(enough)

    def _met(self, answer: Claimed, asked: NDArray[np.bool_], place: dict[int, int]) -> list[list[int]]:
        """Place of a pair, per violated kind in order of names, with the interval in whose middle it is met.

        A violation that the search met lies in the middle of an interval that the rows of its answer halve, or at an
        end of one of them.
        """
        rows = answer.rows
        met: list[list[int]] = []
        for kind in sorted(k for k in VIOLABLE if str(k) in answer.violations):
            mine = (self.pairs.kind[rows.pair] == self.pairs.code_of(kind)) & asked[rows.pair]
            low, high, pair = rows.low[mine], rows.high[mine], rows.pair[mine]
            found = (0, 0, 0, 0.0)
            for _ in range(DEEPEST + 1):
                leaves = self.way.examine(self.pairs, low, high, pair)
                depth = leaves.clear_mid_m - self.pairs.violated_below[leaves.pair]
                deepest = int(depth.argmin())
                if depth[deepest] < found[3]:
                    found = int(pair[deepest]), int(low[deepest]), int(high[deepest]), float(depth[deepest])
                    break
                low, high, pair = _parents(low, high, pair)
            if found[3] >= 0:
                found = self._met_at_an_end(rows.low[mine], rows.high[mine], np.unique(rows.pair[mine]))
            if found[3] >= 0:
                raise ProofError("PHYSICS_FAULT", f"no configuration shows the violation {kind}")
            met.append([place[found[0]], *found[1:3]])
        return met

    def _met_at_an_end(
        self, low: NDArray[np.int64], high: NDArray[np.int64], pairs: NDArray[np.intp]
    ) -> tuple[int, int, int, float]:
        """Deepest of these pairs at the intervals' ends.

        (pair, place, place, depth below its bound in metre).
        """
        best = (int(pairs[0]), 0, 0, 0.0)
        for key in np.unique(np.concatenate([low, high])).tolist():
            depth = self.way.clearance_at(self.pairs, key, pairs) - self.pairs.violated_below[pairs]
            deepest = int(depth.argmin())
            if depth[deepest] < best[3]:
                best = (int(pairs[deepest]), key, key, float(depth[deepest]))
        return best


def _places(intervals: list[tuple[int, str]]) -> set[int]:
    """Ends and middles of the intervals."""
    found = {GRID}
    for low, digit in intervals:
        found |= {low, low + (GRID >> DIGITS.index(digit)) // 2}
    return found


def _parents(
    low: NDArray[np.int64], high: NDArray[np.int64], pair: NDArray[np.intp]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.intp]]:
    """Parents of these intervals, each once; the whole way is its own."""
    width = np.minimum(2 * (high - low), GRID)
    start = low // width * width
    rows = np.unique(np.stack([start, start + width, pair]), axis=1)
    return rows[0], rows[1], rows[2].astype(np.intp)
