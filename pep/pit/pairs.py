"""Every pair of a robot body and something it must mind, as arrays: geometry, and the law of the pair's index."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache
from itertools import chain
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from pep.pit.contact import LIMITS, harm_speed_m_s, limit_speed_m_s
from pep.pit.kinematics import layout
from pep.pit.model import PAYLOAD
from pep.pit.scene import Capsule, Region
from pep.pit.solids import planes_of, solids_of, solids_of_planes
from pep.pit.tier import meant_index, person_index, thing_index, zone_index

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pep.pit.cell import CellParameters
    from pep.pit.clearance import Cores
    from pep.pit.motion import Floats
    from pep.pit.robot import Robot
    from pep.pit.scene import Scene, Shape
    from pep.pit.separation import Stopping
    from pep.pit.solids import Solids


class Kind(StrEnum):
    """What a pair is about; also the `kind` of its contribution."""

    PERSON = "person"
    FRAGILE = "fragile"
    RIGID = "rigid"
    SELF = "self"
    WORKSPACE = "workspace"
    HARD_ZONE = "zone"
    ZONE = "tiered_zone"
    MEANT = "meant_contact"


VIOLABLE: Final = (Kind.PERSON, Kind.SELF, Kind.WORKSPACE, Kind.HARD_ZONE)
"""Kinds whose attained negative clearance is denied whatever is authorised."""

KINDS_IN_ORDER: Final = tuple(Kind)
_CODE: Final = {kind: code for code, kind in enumerate(KINDS_IN_ORDER)}
SCENES_KEPT: Final = 4  # with people where they are seen and where they may have come meanwhile
NO_HARM: Final = np.inf  # of what is no person: no speed or force harms it in that sense
NEVER: Final = -np.inf  # clearance below which a pair is a violation that cannot be one


class _Column(NamedTuple):
    """One obstacle before it is paired with bodies."""

    kind: int
    name: str
    law: _Law
    source: str = ""
    touched_by: frozenset[str] = frozenset()


class _Law(NamedTuple):
    """The numbers of one obstacle: the columns of these names in `Pairs`."""

    uncertainty: float
    harm_speed: float = NO_HARM
    limit_speed: float = NO_HARM
    force_limit: float = NO_HARM
    intrusion: float = 0.0
    band: float = 1.0
    declared: float = 0.0
    violated_below: float = NEVER


@dataclass(frozen=True, slots=True)
class Pairs:
    """Row k: body `body[k]` against an obstacle at rest in that body's reference frame.

    Attributes:
        body: index into the robot's bodies.
        cores: the obstacle's core.
        radius: the obstacle's radius, metre; `radii` adds the body's.
        kind: index into `Kind`.
        harm_speed: from which a blow is likely to harm, m/s; limit_speed: at which one reaches the region's limit, m/s;
            force_limit: of a clamped region, N; infinite for what is no person.
        intrusion: reach of an unseen limb, m; band: of things, m; declared: tier of a zone.
        uncertainty: taken off the clearance before the law is asked, metre.
        violated_below: attained clearance (uncertainty not taken off) below which the pair is a violation; -inf where
            it cannot be.
        names: of the obstacle, row by row.
        sources: who says that the obstacle is there: a sensor, or "" for the cell file and the arm itself.
        group: the same number for rows of the same kind and name.
        touchable: declared by the cell and granted by the token: may be touched, once the touch is proven gentle.
        contact_speed: fastest that a meant contact may be, m/s.
    """

    body: NDArray[np.intp]
    cores: Cores
    radius: Floats
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
    names: tuple[str, ...]
    sources: tuple[str, ...]
    group: NDArray[np.intp]
    touchable: NDArray[np.bool_]
    contact_speed: float
    warn_band: float
    penetration_band: float

    def __len__(self) -> int:
        """How many pairs."""
        return len(self.body)

    @property
    def groups(self) -> int:
        """How many groups."""
        return int(self.group.max(initial=-1)) + 1

    def kind_of(self, row: int) -> Kind:
        """The kind of one pair."""
        return KINDS_IN_ORDER[int(self.kind[row])]

    @staticmethod
    def code_of(kind: Kind) -> int:
        """The number that stands for `kind` in `kind`'s array."""
        return _CODE[kind]

    def meant(self, rows: NDArray[np.intp]) -> Pairs:
        """The same pairs with `rows`, whose touch was proven gentle, under the law of meant contact."""
        if not rows.size:
            return self
        kind = self.kind.copy()
        kind[rows] = _CODE[Kind.MEANT]
        return replace(self, kind=kind, group=_groups(kind.tolist(), self.names))

    def index(self, rows: NDArray[np.intp], clearance: Floats, speed: Floats, stop: Stopping) -> Floats:
        """The index of these pairs at these clearances (m) and surface speeds (m/s)."""
        near = clearance - self.uncertainty[rows]
        kind = self.kind[rows]
        result = thing_index(near, speed, band=self.band[rows], stop=stop)
        person = kind == _CODE[Kind.PERSON]
        if person.any():
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
        meant = kind == _CODE[Kind.MEANT]
        if meant.any():
            result[meant] = meant_index(result[meant], speed[meant], gentle=self.contact_speed)
        zone = kind == _CODE[Kind.ZONE]
        if zone.any():
            which = rows[zone]
            result[zone] = zone_index(
                near[zone], speed[zone], band=self.band[which], declared=self.declared[which], stop=stop
            )
        return result


class _Last(threading.local):
    """The pairs that one thread asked for last: a scene is asked about again and again until the next one is seen."""

    def __init__(self) -> None:
        self._kept: deque[tuple[tuple[object, ...], Pairs]] = deque(maxlen=SCENES_KEPT)

    def of(self, robot: Robot, scene: Scene, cell: CellParameters, grown_m: float, touch: frozenset[str]) -> Pairs:
        """As `pairs_of`."""
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
    """All pairs that a motion of this robot in this scene must mind.

    Args:
        robot: the arm and its tool.
        scene: what is around it.
        cell: bands, uncertainties and limits.
        grown_m: how much farther than seen people may be, because the view is old.
        touch: names of objects that the token grants to touch; none makes every contact an accident.
    """
    return _LAST.of(robot, scene, cell, grown_m, touch)


def _paired(robot: Robot, scene: Scene, cell: CellParameters, grown_m: float, touch: frozenset[str]) -> Pairs:
    things, shapes = _columns(robot, scene, cell, grown_m, touch), _shapes(scene)
    inner, planes = _own(robot), planes_of(scene)
    face = _Law(cell.robot_uncertainty_m, band=cell.rigid_band_m, violated_below=0.0)
    columns = [*things, *_own_columns(robot, cell), *[_Column(_CODE[Kind.WORKSPACE], "workspace", face)] * len(planes)]
    rows = _rows(robot, len(things), len(planes))
    solids = solids_of(shapes).and_then(inner.solids, solids_of_planes(planes)).take(rows.column)
    numbers = np.fromiter(chain.from_iterable([each.law for each in columns]), float).reshape(-1, len(_Law._fields))
    laws = numbers.T.take(rows.column, axis=1)
    kinds, names = [each.kind for each in columns], [each.name for each in columns]
    sources = [each.source for each in columns]
    return Pairs(
        body=rows.body,
        cores=solids.cores,
        radius=solids.radius,
        radii=solids.radius + rows.radius,
        kind=np.array(kinds, dtype=np.intp)[rows.column],
        **dict(zip(_Law._fields, laws, strict=True)),
        names=tuple(map(names.__getitem__, rows.order)),
        sources=tuple(map(sources.__getitem__, rows.order)),
        group=_groups(kinds, names)[rows.column],
        touchable=_touchable(robot, things, len(rows.column)),
        contact_speed=cell.contact_speed_m_s,
        warn_band=cell.warn_band_m,
        penetration_band=cell.penetration_band_m,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Which obstacle and which body each row is of.

    One row per thing and moving body, then the arm's own pairs, then one per face of the room and moving body.

    Attributes:
        column, body: of each row, the obstacle's and the body's index.
        order: `column` as whole numbers.
        radius: of each row's body, metre.
    """

    column: NDArray[np.intp]
    order: tuple[int, ...]
    body: NDArray[np.intp]
    radius: Floats


@lru_cache(maxsize=16)  # people come and go: a handful of numbers in a cell
def _rows(robot: Robot, things: int, planes: int) -> _Rows:
    moving, inner = np.arange(robot.world_bodies), _own(robot)
    times = np.array([len(moving)] * things + [1] * len(inner.names) + [len(moving)] * planes, dtype=np.intp)
    column = np.repeat(np.arange(len(times)), times)
    body = np.concatenate([np.tile(moving, things), inner.body, np.tile(moving, planes)])
    for array in (column, body):
        array.setflags(write=False)
    return _Rows(column, tuple(column.tolist()), body, layout(robot).radius[body])


@dataclass(frozen=True, slots=True, eq=False)
class _Own:
    """The arm's own pairs: the moving bodies, and what they must stay apart from, at rest in their reference frames."""

    body: NDArray[np.intp]
    solids: Solids
    names: tuple[str, ...]


@lru_cache(maxsize=64)  # one robot of a cell, with what it holds in a day
def _own(robot: Robot) -> _Own:
    shapes = [Capsule(capsule.a_m, capsule.b_m, capsule.radius_m) for _, capsule in robot.self_pairs]
    body = np.array([index for index, _ in robot.self_pairs], dtype=np.intp)
    return _Own(body, solids_of(shapes), tuple(capsule.name for _, capsule in robot.self_pairs))


@lru_cache(maxsize=64)  # likewise
def _own_columns(robot: Robot, cell: CellParameters) -> tuple[_Column, ...]:
    law = _Law(0.0, band=cell.rigid_band_m, violated_below=-cell.self_overlap_m)
    return tuple(_Column(_CODE[Kind.SELF], name, law) for name in _own(robot).names)


def _touchable(robot: Robot, things: list[_Column], count: int) -> NDArray[np.bool_]:
    """Which pairs the cell declares and the token grants to touch: rows of things, body by body, stand first."""
    touchable = np.zeros(count, dtype=bool)
    if any(thing.touched_by for thing in things):
        parts = [_part(robot, body.name) for body in robot.bodies[: robot.world_bodies]]
        rows = [part in thing.touched_by for thing in things for part in parts]
        touchable[: len(rows)] = rows
    return touchable


def _part(robot: Robot, body: str) -> str:
    """What the cell calls the part of the robot that a body belongs to, as far as it may touch anything."""
    if body == PAYLOAD:
        return "payload"
    return "tool" if any(body == capsule.name for capsule in robot.tool.capsules) else ""


def _shapes(scene: Scene) -> list[Shape]:
    """Of people, objects and zones: the order of `_columns`."""
    return [*(shape for person in scene.people for _, shape in person.regions), *scene.solid_shapes]


def _columns(robot: Robot, scene: Scene, cell: CellParameters, grown_m: float, touch: frozenset[str]) -> list[_Column]:
    columns: list[_Column] = []
    bears = _bears(robot, cell) if scene.people else {}
    for person in scene.people:
        walked_m = grown_m + cell.person_speed_m_s * person.age_s  # PHY-23
        person_z = cell.person_uncertainty_m + cell.robot_uncertainty_m + walked_m
        intrusion = cell.intrusion_tracked_m if person.limbs_tracked else cell.intrusion_untracked_m
        for region, _ in person.regions:
            law = _Law(person_z, *bears[region], intrusion=intrusion, violated_below=0.0)
            columns.append(_Column(_CODE[Kind.PERSON], f"{person.id}/{region}", law, person.source))
    for thing in scene.objects:
        kind, band = (Kind.FRAGILE, cell.fragile_band_m) if thing.kind == "fragile" else (Kind.RIGID, cell.rigid_band_m)
        by = frozenset(c.by for c in cell.contacts if c.object == thing.id and thing.id in touch)
        law = _Law(thing.uncertainty_m + cell.robot_uncertainty_m, band=band)
        columns.append(_Column(_CODE[kind], thing.id, law, thing.source, by))
    for zone in scene.zones:
        hard = zone.tier is None
        law = _Law(
            cell.robot_uncertainty_m,
            band=cell.rigid_band_m,
            declared=0.0 if zone.tier is None else float(zone.tier),
            violated_below=0.0 if hard else NEVER,
        )
        columns.append(_Column(_CODE[Kind.HARD_ZONE if hard else Kind.ZONE], zone.id, law, zone.source))
    return columns


@lru_cache(maxsize=64)  # one robot of a cell, with what it holds in a day
def _bears(robot: Robot, cell: CellParameters) -> dict[Region, tuple[float, float, float]]:
    """What each region bears: the speed that harms it, the one that reaches its limit, and its force."""
    return {
        region: (harm_speed_m_s(region, robot, cell), limit_speed_m_s(region, robot, cell), LIMITS[region].force_n)
        for region in Region
    }


def _groups(kinds: Sequence[int], names: Sequence[str]) -> NDArray[np.intp]:
    numbers: dict[tuple[int, str], int] = {}
    keys = zip(kinds, names, strict=True)
    return np.array([numbers.setdefault(key, len(numbers)) for key in keys], dtype=np.intp)
