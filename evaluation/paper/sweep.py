"""The paper's sweep as ten motions, its three scenes, and the highest speed that each scene allows."""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from msgspec import structs

from capabilities.statements import observation as wire
from pep.pit import Assessment, CellParameters, MoveJ, Robot, assess, surveyed
from pep.pit.scene.observation import scene_observed
from ursim.sensor.sensor_scene import Seen
from ztpm.cell import survey
from ztpm.stage.scene import PERSON_AXIS_M, front, person, under_the_path
from ztpm.stage.stage import ACCELERATION_RAD_S2, pose

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from capabilities.statements.cell import Cell
    from pep.pit.base.motion import Joints
    from pep.pit.scene.scene import Scene
    from policies.words.parameters import Parameters

HALF_RAD: Final = 1.5
"""The sweep goes from -1.5 to 1.5 rad of the base joint, through the front."""
MOVES: Final = 10
"""Ten motions of 0.3 rad: the paper's prompt asks for incremental joint movements, and tells no number."""
WAY: Final = tuple(pose(round(-HALF_RAD + 2 * HALF_RAD * n / MOVES, 6)) for n in range(MOVES + 1))
"""Postures from the beginning of the sweep to its end, rad."""
AGE_S: Final = 0.15
"""Age of the view with which a bound is computed: nothing younger counts as younger (`WatchAges`)."""
GRID_RAD_S: Final = 0.001
"""A bound is a whole number of these."""
LENT_RAD_S: Final = 1.05
"""Highest joint speed of the scope that is lent, so of any bound; ur_rtde's own default of moveJ."""
PEOPLE: Final = {"C2": (person("person-1", *front(PERSON_AXIS_M)),)}
OBJECTS: Final = {"C1": (under_the_path(),)}


def without_zones(stated: Cell) -> Cell:
    """Embedded cell without its zones: the paper's sweep leads through the fixture's."""
    return structs.replace(stated, zones=())


@dataclass(frozen=True, slots=True)
class Bound:
    """Highest speeds at which all ten motions of a sweep are permitted in a scene, rad/s.

    Attributes:
        alone: without a person's approval, or None where no speed is.
        approved: with an approval of each motion that needs one.
    """

    alone: float | None
    approved: float | None


class Sweep:
    """Physics of the sweep on the embedded cell, as the gateway computes them.

    Args:
        parameters: of the policies that decide.
    """

    def __init__(self, parameters: Parameters) -> None:
        stated = survey.embedded(
            audience="https://cell.invalid/mcp", author="nobody", sensor="eye", at=int(time.time())
        )
        self._cell: CellParameters = surveyed(without_zones(stated), CellParameters())
        self._robot = Robot.load("ur3e", tool=self._cell.tool)
        self._parameters = parameters

    def index(self, condition: str, speed_rad_s: float) -> float:
        """Highest index of the ten motions at a speed."""
        return max(each.index for each in self.assessed(condition, speed_rad_s, WAY))

    def index_at_once(self, condition: str, speed_rad_s: float) -> float:
        """Index of the whole sweep as one motion, which is long enough to reach its speed."""
        return max(each.index for each in self.assessed(condition, speed_rad_s, (WAY[0], WAY[-1])))

    def bound(self, condition: str) -> Bound:
        """Highest speeds of a condition."""
        return Bound(self._highest(condition, self._needs_nobody), self._highest(condition, self._approvable))

    def _highest(self, condition: str, allowed: Callable[[Assessment], bool]) -> float | None:
        """Highest speed of the grid at which every motion is allowed, by halving: impact grows with speed."""
        low, high = 0, round(LENT_RAD_S / GRID_RAD_S) + 1
        while high - low > 1:
            middle = (low + high) // 2
            if all(map(allowed, self.assessed(condition, middle * GRID_RAD_S, WAY))):
                low = middle
            else:
                high = middle
        return round(low * GRID_RAD_S, 3) if low else None

    @staticmethod
    def _needs_nobody(of: Assessment) -> bool:
        return of.tier <= 2 and not of.violations

    def _approvable(self, of: Assessment) -> bool:
        limits = self._parameters
        slow = of.tcp_speed_m_s * 1e6 <= limits.approved_tcp_speed_um_s
        soft = of.contact_ratio * 1e3 <= limits.approved_contact_permille
        return not of.violations and (of.tier <= 2 or (of.tier == 3 and slow and soft))

    def assessed(self, condition: str, speed_rad_s: float, way: Sequence[Sequence[float]]) -> list[Assessment]:
        """Impact of each motion between the postures of a way.

        Raises:
            PhysicsError: there is no answer for one.
        """
        scene = self._scene(condition)
        answers = [
            assess(
                self._robot,
                scene,
                MoveJ(_joints(start), _joints(target), speed_rad_s, ACCELERATION_RAD_S2),
                self._cell,
                perception_age_s=AGE_S,
                touch=frozenset(),
                seed=b"paper",
            )
            for start, target in pairwise(way)
        ]
        wrong = [answer for answer in answers if not isinstance(answer, Assessment)]
        if wrong:
            raise PhysicsError(f"{condition} at {speed_rad_s} rad/s: {wrong[0]}")
        return [answer for answer in answers if isinstance(answer, Assessment)]

    def _scene(self, condition: str) -> Scene:
        told = {"people": list(PEOPLE.get(condition, ())), "objects": list(OBJECTS.get(condition, ()))}
        _, people, objects = Seen.nothing().told(told, now_s=0.0).at(0.0)
        frame = wire.Observation("eye", "0" * 32, 0, 0, "0" * 64, complete=True, people=people, objects=objects)
        return scene_observed([frame], self._cell, complete=True)


def _joints(posture: Sequence[float]) -> Joints:
    a, b, c, d, e, f = posture
    return a, b, c, d, e, f


class PhysicsError(RuntimeError):
    """A motion of the sweep that physics has no answer for."""
