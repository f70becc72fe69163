"""Pairs of robot bodies and obstacles, as arrays: geometry, and the law of each pair's index."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base.pair_columns import BODY, GROUP, KIND, RADII, VIOLATED_BELOW, WHOLE
from pep.pit.base.tier import meant_index, person_index, thing_index, zone_index
from pep.pit.geometry.clearance import NONE
from pep.pit.geometry.solids import RADIUS, SOLID, Solids
from pep.pit.robot.kinematics import layout
from pep.pit.robot.model import PAYLOAD
from pep.pit.scene.obstacles import (
    CODE,
    KINDS_IN_ORDER,
    LAW_COLUMNS,
    NEVER,
    PairKind,
    bound_by_body,
    deepest_m,
    groups_of,
    own_of,
    seen_in,
    walls_of,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.base.travel import Stopping
    from pep.pit.geometry.clearance import Cores
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.scene import Scene, Workspace

SCENES_KEPT: Final = 4  # with people where they are seen and where they may have come meanwhile


@dataclass(frozen=True, slots=True)
class Pairs:
    """Row k: body `body[k]` against an obstacle at rest in that body's reference frame.

    Attributes:
        body: index into the robot's bodies.
        solids: the obstacle's core and radius.
        radii: of obstacle and body together, metre.
        kind: index into `Kind`.
        harm_speed: from which a blow is likely to harm, m/s; limit_speed: at which one reaches the region's limit, m/s;
            force_limit: of a clamped region, N; infinite for what is no person.
        intrusion: reach of an unseen limb, m; band: of things, m; declared: tier of a zone.
        uncertainty: taken off the clearance before the law is asked, metre.
        violated_below: attained clearance (uncertainty not taken off) below which the pair is a violation; -inf where
            it cannot be.
        column: obstacle, an index into `names` and `sources`.
        names: of each obstacle.
        sources: source of the obstacle: a sensor, or "" for the cell file and the arm itself.
        group: the same number for rows of the same kind and name.
        touchable: declared by the cell and granted by the token: may be touched, once the touch is proven gentle.
        contact_speed: fastest that a meant contact may be, m/s.
        whole: whole numbers as the kernel's `Field` has them, beside the numbers of `solids`; None where any of the
            above was replaced, so that theirs are not.
    """

    body: NDArray[np.intp]
    solids: Solids
    radii: Floats
    kind: NDArray[np.intp]
    uncertainty: Floats
    harm_speed: Floats
    limit_speed: Floats
    force_limit: Floats
    intrusion: Floats
    band: Floats
    declared: Floats
    violated_below: Floats
    column: NDArray[np.intp]
    names: tuple[str, ...]
    sources: tuple[str, ...]
    group: NDArray[np.intp]
    touchable: NDArray[np.bool_]
    contact_speed: float
    warn_band: float
    penetration_band: float
    whole: NDArray[np.int64] | None = field(init=False, default=None, repr=False, compare=False)

    def __len__(self) -> int:
        """Number of pairs."""
        return len(self.body)

    @property
    def cores(self) -> Cores:
        """The obstacles' cores."""
        return self.solids.cores

    @property
    def groups(self) -> int:
        """Number of groups."""
        return int(self.group.max(initial=-1)) + 1

    def kind_of(self, row: int) -> PairKind:
        """The kind of one pair."""
        return KINDS_IN_ORDER[int(self.kind[row])]

    def name_of(self, row: int) -> str:
        """The name of one pair's obstacle."""
        return self.names[int(self.column[row])]

    def source_of(self, row: int) -> str:
        """Source of one pair's obstacle."""
        return self.sources[int(self.column[row])]

    @staticmethod
    def code_of(kind: PairKind) -> int:
        """The number that stands for `kind` in `kind`'s array."""
        return CODE[kind]

    def meant(self, rows: NDArray[np.intp]) -> Pairs:
        """The same pairs with `rows`, whose touch was proven gentle, under the law of meant contact."""
        if not rows.size:
            return self
        kind, below = self.kind.copy(), self.violated_below.copy()
        kind[rows], below[rows] = CODE[PairKind.MEANT], NEVER  # PHY-12: its own depth is proven
        return replace(
            self,
            kind=kind,
            violated_below=below,
            group=np.array(groups_of(kind.tolist(), [self.names[k] for k in self.column.tolist()]), dtype=np.intp),
        )

    def index(self, rows: NDArray[np.intp], clearance: Floats, speed: Floats, stop: Stopping) -> Floats:
        """The index of these pairs at these clearances (m) and surface speeds (m/s)."""
        near = clearance - self.uncertainty[rows]
        kind = self.kind[rows]
        result = thing_index(near, speed, band=self.band[rows], stop=stop)
        kinds = set(kind.tolist())
        if CODE[PairKind.PERSON] in kinds:
            person = kind == CODE[PairKind.PERSON]
            who = rows[person]
            result[person] = person_index(
                near[person],
                clearance[person],
                speed[person],
                harm_speed=self.harm_speed[who],
                intrusion=self.intrusion[who],
                warn_band=self.warn_band,
                penetration_band=self.penetration_band,
                stop=stop,
            )
        if CODE[PairKind.MEANT] in kinds:
            meant = kind == CODE[PairKind.MEANT]
            result[meant] = meant_index(result[meant], speed[meant], gentle=self.contact_speed)
        if CODE[PairKind.ZONE] in kinds:
            zone = kind == CODE[PairKind.ZONE]
            which = rows[zone]
            result[zone] = zone_index(
                near[zone], speed[zone], band=self.band[which], declared=self.declared[which], stop=stop
            )
        return result


class _Last(threading.local):
    """Pairs that one thread asked for last.

    A scene is asked about again and again until the next one is seen.
    """

    def __init__(self) -> None:
        self._kept: deque[tuple[tuple[object, ...], Pairs]] = deque(maxlen=SCENES_KEPT)

    def of(self, robot: Robot, scene: Scene, cell: CellParameters, grown_m: float, touch: frozenset[str]) -> Pairs:
        """Pairs as of `pairs_of`."""
        for (of_robot, of_scene, of_cell, of_grown_m, of_touch), pairs in self._kept:
            same = of_robot is robot and of_scene is scene and of_cell is cell
            if same and of_grown_m == grown_m and of_touch == touch:
                return pairs
        pairs = _paired(robot, scene, cell, grown_m, touch)
        self._kept.appendleft(((robot, scene, cell, grown_m, touch), pairs))
        return pairs


_LAST: Final = _Last()


def pairs_of(
    robot: Robot, scene: Scene, cell: CellParameters, *, grown_m: float, touch: frozenset[str] = frozenset()
) -> Pairs:
    """All pairs that count for a motion of this robot in this scene.

    Args:
        robot: the arm and its tool.
        scene: surroundings of the arm.
        cell: bands, uncertainties and limits.
        grown_m: growth of people beyond their seen place, because the view is old.
        touch: names of objects that the token grants to touch; none makes every contact an accident.
    """
    return _LAST.of(robot, scene, cell, grown_m, touch)


def _paired(robot: Robot, scene: Scene, cell: CellParameters, grown_m: float, touch: frozenset[str]) -> Pairs:
    things, count = seen_in(robot, scene, cell, grown_m), robot.world_bodies
    fixed = _fixed(robot, cell, scene.workspace, len(things.names))
    moved, rows = len(things.names) * count, len(fixed.column)
    numbers, whole = np.empty((rows, SOLID)), np.empty((rows, WHOLE), dtype=np.int64)
    by_body = numbers[:moved].reshape(-1, count, SOLID)
    by_body[:] = things.solids.numbers[:, None]
    by_body[:, :, RADII] = by_body[:, :, RADIUS] + fixed.radius
    by_body[:, :, VIOLATED_BELOW] = bound_by_body(by_body[:, :, VIOLATED_BELOW], fixed.deepest)
    numbers[moved:] = fixed.numbers
    kinds = whole[:moved].reshape(-1, count, WHOLE)
    kinds[:] = things.whole[:, None]
    kinds[:, :, BODY] = np.arange(count)
    whole[moved:] = fixed.whole
    whole[moved:, GROUP] += things.groups  # no kind is found among both
    hull = np.full(rows, NONE, dtype=np.intp)
    if things.solids.hulls:
        hull[:moved] = np.repeat(things.solids.hull, count)
    pairs = Pairs(
        body=fixed.body,
        solids=Solids(numbers, hull, things.solids.hulls),
        radii=numbers[:, RADII],
        kind=whole[:, KIND],
        **{name: numbers[:, at] for name, at in LAW_COLUMNS.items()},
        column=fixed.column,
        names=(*things.names, *fixed.names),
        sources=(*things.sources, *fixed.sources),
        group=whole[:, GROUP],
        touchable=_touchable(robot, scene, cell, touch, rows),
        contact_speed=cell.contact_speed_m_s,
        warn_band=cell.warn_band_m,
        penetration_band=cell.penetration_band_m,
    )
    object.__setattr__(pairs, "whole", whole)
    return pairs


@dataclass(frozen=True, slots=True, eq=False)
class _Fixed:
    """Part of the rows that does not depend on the things of a scene, for one number of them.

    One row per thing and moving body, then the arm's own pairs, then one per face of the room and moving body.

    Attributes:
        column, body: of each row, the obstacle's and the body's index.
        radius: of each moving body, metre.
        deepest: overlap of each with a thing beyond which it is a violation, metre.
        numbers, whole: of the rows behind those of things; their groups are counted from 0.
        names, sources: of the obstacles there.
    """

    column: NDArray[np.intp]
    body: NDArray[np.intp]
    radius: Floats
    deepest: Floats
    numbers: Floats
    whole: NDArray[np.int64]
    names: tuple[str, ...]
    sources: tuple[str, ...]


@lru_cache(maxsize=16)  # people come and go: a handful of numbers in a cell
def _fixed(robot: Robot, cell: CellParameters, workspace: Workspace | None, things: int) -> _Fixed:
    moving, (own, inner), walls = np.arange(robot.world_bodies), own_of(robot, cell), walls_of(workspace, cell)
    faces = len(walls.names)
    times = np.array([len(moving)] * things + [1] * len(own) + [len(moving)] * faces, dtype=np.intp)
    column, radius = np.repeat(np.arange(len(times)), times), layout(robot).radius
    body = np.concatenate([np.tile(moving, things), own, np.tile(moving, faces)])
    behind = slice(things * len(moving), None)
    of = column[behind] - things
    numbers = np.concatenate([inner.solids.numbers, walls.solids.numbers])[of]
    numbers[:, RADII] = numbers[:, RADIUS] + radius[body[behind]]
    whole = np.concatenate([inner.whole, walls.whole])
    whole[len(inner.names) :, GROUP] += inner.groups
    whole = whole[of]
    whole[:, BODY] = body[behind]
    found = _Fixed(
        column,
        body,
        radius[moving],
        deepest_m(robot.bodies[: len(moving)]),
        numbers,
        whole,
        (*inner.names, *walls.names),
        (*inner.sources, *walls.sources),
    )
    for array in (found.column, found.body, found.radius, found.deepest, found.numbers, found.whole):
        array.setflags(write=False)
    return found


def _touchable(
    robot: Robot, scene: Scene, cell: CellParameters, touch: frozenset[str], count: int
) -> NDArray[np.bool_]:
    """True for pairs that the cell declares and the token grants to touch.

    Rows of objects stand behind those of people.
    """
    touchable = np.zeros(count, dtype=bool)
    granted = [contact for contact in cell.contacts if contact.object in touch]
    if not granted:
        return touchable
    parts = [_part(robot, body.name) for body in robot.bodies[: robot.world_bodies]]
    at = sum(len(person.regions) for person in scene.people) * len(parts)
    for thing in scene.objects:
        by = {contact.by for contact in granted if contact.object == thing.id}
        touchable[at : at + len(parts)] = [part in by for part in parts]
        at += len(parts)
    return touchable


def _part(robot: Robot, body: str) -> str:
    """Part of the robot that a body belongs to, in the cell's words, "" where it may touch nothing."""
    if body == PAYLOAD:
        return "payload"
    return "tool" if any(body == capsule.name for capsule in robot.tool.capsules) else ""
