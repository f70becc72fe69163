"""A curved path of the joints in numpy: the slow twin of `pep.pit.search.kernel.compiled_course.CompiledCourse`."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from pep.pit.geometry.clearance import core_distance
from pep.pit.path.course import Course
from pep.pit.path.path import Leaves
from pep.pit.path.straight_path import CHORD, GRID
from pep.pit.robot.kinematics import Poses, layout, poses
from tests.model.pit.clearance import interval_clearance
from tests.model.pit.path import Nodes

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pep.pit.base.motion import Floats
    from pep.pit.path.course import Cells
    from pep.pit.path.path import Keys
    from pep.pit.robot.kinematics import Layout
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.pairs import Pairs


@dataclass(frozen=True, slots=True, eq=False)
class CourseBends:
    """Bounds per cell and body, each (cells, bodies): derivatives of its ends and of its spin, and what strays."""

    second: Floats
    third: Floats
    spin_first: Floats
    spin_second: Floats
    stray: Floats
    hurry: Floats
    spin_hurry: Floats


def course_bends(robot: Robot, plan: Layout, cells: Cells) -> CourseBends:
    """Greatest bending of each body away from a chord of the course, or from the course, cell by cell."""
    reach, moved = robot.reach, plan.moved_by

    def sums(rate: Floats) -> tuple[Floats, Floats, Floats]:
        share = rate[:, None] * moved
        outer = np.cumsum(share, axis=2)
        return share, outer, outer - share

    w, s, s_in = sums(cells.first)
    a, sa, sa_in = sums(cells.second)
    b, _, _ = sums(cells.third)
    d, sd, sd_in = sums(cells.stray)
    e, _, _ = sums(cells.hurry)
    second = (reach * (a + s**2 - s_in**2)).sum(axis=2)
    third = (reach * (b + 3 * (s * sa - s_in * sa_in) + s**3 - s_in**3)).sum(axis=2)
    spin_first = (a + w * s_in).sum(axis=2)
    spin_second = (b + 2 * a * s_in + w * (s_in**2 + sa_in)).sum(axis=2)
    stray = (reach * d).sum(axis=2)
    hurry = (reach * (e + s * sd - s_in * sd_in)).sum(axis=2)
    spin_hurry = (e + w * sd_in).sum(axis=2)
    return CourseBends(second, third, spin_first, spin_second, stray, hurry, spin_hurry)


class NumpyCourse(Nodes, Course):
    """A course whose questions numpy answers. Holds every configuration it was asked for."""

    def __init__(self, robot, cells, track):
        super().__init__(robot, cells, track)
        self.layout = layout(robot)
        self._known = {}
        self._q = []
        self._poses = None

    @cached_property
    def bends(self) -> CourseBends:
        """Greatest bending of each body away from a chord of the course, cell by cell."""
        return course_bends(self.robot, self.layout, self.cells)

    @property
    def known(self) -> tuple[Keys, Floats]:
        """Every place that was asked for, (n,), and the configuration there, (n, 6): the nodes of the proof."""
        return np.array(list(self._known), dtype=np.int64), np.array(self._q).reshape(len(self._known), -1)

    def nodes(self, keys: Keys) -> tuple[NDArray[np.intp], Poses]:
        """Index of each key's configuration in the poses, and the poses; what is missing is computed."""
        new = [key for key in dict.fromkeys(keys.tolist()) if key not in self._known]
        if new:
            places = [self.at(key / GRID) for key in new]
            self._q += [q for q, _ in places]
            found = [poses(self.robot, self.layout, q[None], dq) for q, dq in places]
            parts = found if self._poses is None else [self._poses, *found]
            self._poses = Poses(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Poses)))
            first = len(self._known)
            self._known.update((key, first + i) for i, key in enumerate(new))
        if self._poses is None:
            raise ValueError("no configuration was asked for")
        return np.array([self._known[key] for key in keys.tolist()], dtype=np.intp), self._poses

    def _worst(self, low: Keys, high: Keys) -> CourseBends:
        """Per interval the worst of the cells that it meets, each (intervals, bodies)."""
        cells = self.cells
        first = np.searchsorted(cells.high, low, side="right")
        last = np.searchsorted(cells.low, high, side="left")
        spans = list(zip(first.tolist(), last.tolist(), strict=True))
        return CourseBends(
            *(np.stack([getattr(self.bends, f.name)[a:b].max(axis=0) for a, b in spans]) for f in fields(CourseBends))
        )

    def rush(self, low: Keys, high: Keys) -> Floats:
        """Bound on the surface speed per unit of ds/dt of every body on each interval, shape (intervals, bodies)."""
        count = len(low)
        at, known = self.nodes(np.concatenate([low, (low + high) // 2, high]))
        worst = self._worst(low, high)
        h = ((high - low) / GRID)[:, None]
        # Between nodes by the chord lemma, or by the next node, which is at most a quarter away: whichever proves more.
        rise = np.minimum(worst.third * h * h / CHORD, worst.second * h / 4)
        spin_rise = np.minimum(worst.spin_second * h * h / CHORD, worst.spin_first * h / 4)
        speed = known.speed[at].reshape(3, count, -1).max(axis=0) + rise + worst.hurry
        spin = known.spin[at].reshape(3, count, -1).max(axis=0) + spin_rise + worst.spin_hurry
        return np.asarray(speed + self.layout.radius * spin)

    def examine(self, pairs: Pairs, low: Keys, high: Keys, pair: NDArray[np.intp]) -> Leaves:
        """Leaves: the proven values on each row's interval, and the attained ones in its middle or beside it."""
        intervals, row = np.unique(np.stack([low, high]), axis=1, return_inverse=True)
        cut_low, cut_high = intervals[0], intervals[1]
        count = len(cut_low)
        at, known = self.nodes(np.concatenate([cut_low, (cut_low + cut_high) // 2, cut_high]))
        at_mid = at[count : 2 * count]
        worst = self._worst(cut_low, cut_high)
        body = pairs.body[pair]
        cores = pairs.cores.take(pair)
        ends = known.ends[at.reshape(3, count)[:, row], body]
        distance, direction = core_distance(ends[1], cores)
        stray = worst.stray[row, body]
        sag = worst.second[row, body] * ((high - low) / GRID) ** 2 / CHORD + stray
        radii = pairs.radii[pair]
        clear = interval_clearance(ends, direction, cores, radii=radii, sag=sag)
        rush = self.rush(cut_low, cut_high)[row, body]
        speed = known.speed[at_mid[row], body] + worst.hurry[row, body]
        rush_mid = speed + self.layout.radius[body] * (known.spin[at_mid[row], body] + worst.spin_hurry[row, body])
        # What the arm may meet beside the course counts as met: the gap would not close however short the interval.
        near = np.where(cores.is_plane, distance - stray, np.maximum(distance - stray, 0))
        return Leaves(low, high, pair, clear, rush, near - radii, rush_mid)
