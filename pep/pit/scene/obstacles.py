"""Obstacles of the arm, one by one, before they are paired with bodies: shapes, and the law of each."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from itertools import chain
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from pep.pit.base.pair_columns import (
    BAND,
    DECLARED,
    GROUP,
    HARM_SPEED,
    INTRUSION,
    KIND,
    LIMIT_SPEED,
    SHAPE,
    UNCERTAINTY,
    VIOLATED_BELOW,
    WHOLE,
)
from pep.pit.geometry.solids import FORCE_LIMIT, FORM, Solids, planes_of, solids_of, solids_of_planes
from pep.pit.scene.contact_limits import LIMITS, harm_speed_m_s, limit_speed_m_s
from pep.pit.scene.scene import Capsule, Region

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.robot.robot import Body, Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.scene import Scene, Workspace


class PairKind(StrEnum):
    """Kind of a pair, also the `kind` of its contribution."""

    PERSON = "person"
    FRAGILE = "fragile"
    RIGID = "rigid"
    SELF = "self"
    WORKSPACE = "workspace"
    HARD_ZONE = "zone"
    ZONE = "tiered_zone"
    MEANT = "meant_contact"


VIOLABLE: Final = (
    PairKind.PERSON,
    PairKind.FRAGILE,
    PairKind.RIGID,
    PairKind.SELF,
    PairKind.WORKSPACE,
    PairKind.HARD_ZONE,
)
"""Kinds whose attained clearance below a pair's bound no authority allows."""

KINDS_IN_ORDER: Final = tuple(PairKind)
CODE: Final = {kind: code for code, kind in enumerate(KINDS_IN_ORDER)}
NO_HARM: Final = np.inf  # of an obstacle that is no person: no speed or force harms it in that sense
NEVER: Final = -np.inf  # clearance below which a pair is a violation that cannot be one
AXIS_MET_M: Final = 1e-3  # PHY-6: a body's axis this near to a thing's surface has met it
NOBODY: Final[frozenset[str]] = frozenset()


class _Law(NamedTuple):
    """Numbers of one obstacle: the columns of these names in `Pairs`."""

    uncertainty: float
    harm_speed: float = NO_HARM
    limit_speed: float = NO_HARM
    force_limit: float = NO_HARM
    intrusion: float = 0.0
    band: float = 1.0
    declared: float = 0.0
    violated_below: float = NEVER


LAW_COLUMNS: Final = {
    "uncertainty": UNCERTAINTY,
    "harm_speed": HARM_SPEED,
    "limit_speed": LIMIT_SPEED,
    "force_limit": FORCE_LIMIT,
    "intrusion": INTRUSION,
    "band": BAND,
    "declared": DECLARED,
    "violated_below": VIOLATED_BELOW,
}
_LAWS: Final = list(LAW_COLUMNS.values())
"""Columns of an obstacle's law, in the order of `_Law`."""


@dataclass(frozen=True, slots=True, eq=False)
class Obstacles:
    """Obstacles in a row.

    Attributes:
        names, sources: name and source of each.
        whole: shape, kind and group of each in the kernel's columns; a group is the same number for the same kind and
            name, from 0 in the order in which they come.
        groups: number of groups.
        solids: their shapes, with the numbers of their laws.
    """

    names: list[str]
    sources: list[str]
    whole: NDArray[np.int64]
    groups: int
    solids: Solids

    @staticmethod
    def of(kinds: list[int], names: list[str], sources: list[str], laws: Sequence[_Law], solids: Solids) -> Obstacles:
        """The obstacles of these columns."""
        numbers = solids.numbers.copy()
        numbers[:, _LAWS] = np.fromiter(chain.from_iterable(laws), float).reshape(-1, len(_LAWS))
        groups = groups_of(kinds, names)
        whole = np.zeros((len(kinds), WHOLE), dtype=np.int64)
        whole[:, SHAPE], whole[:, KIND], whole[:, GROUP] = numbers[:, FORM], kinds, groups
        return Obstacles(names, sources, whole, max(groups, default=-1) + 1, Solids(numbers, solids.hull, solids.hulls))


def deepest_m(bodies: Iterable[Body]) -> Floats:
    """Overlap of each body with a thing beyond which nobody can allow it: PHY-6, but for the cell's own limit."""
    axis = [(body, max(body.radius_m - AXIS_MET_M, 0.0)) for body in bodies]
    return np.array([met if body.overhang_m is None else min(body.overhang_m, met) for body, met in axis])


def bound_by_body(violated_below: Floats, deepest: Floats) -> Floats:
    """Clearances below which pairs are violations: no lower than their bodies may overlap a thing."""
    return np.where(violated_below == NEVER, NEVER, np.maximum(violated_below, -deepest))


def groups_of(kinds: Iterable[int], names: Iterable[str]) -> list[int]:
    """Group of each row: the same number for the same kind and name."""
    numbers: dict[tuple[int, str], int] = {}
    return [numbers.setdefault(key, len(numbers)) for key in zip(kinds, names, strict=True)]


def seen_in(robot: Robot, scene: Scene, cell: CellParameters, grown_m: float) -> Obstacles:
    """People, objects and zones of a scene.

    Args:
        robot: the arm and its tool.
        scene: surroundings of the arm.
        cell: bands, uncertainties and limits.
        grown_m: growth of people beyond their seen place, because the view is old.
    """
    kinds: list[int] = []
    names: list[str] = []
    sources: list[str] = []
    laws: list[_Law] = []
    bears = _bears(robot, cell) if scene.people else {}
    for person in scene.people:
        walked_m = grown_m + cell.person_speed_m_s * person.age_s  # PHY-23
        person_z = cell.person_uncertainty_m + cell.robot_uncertainty_m + walked_m
        intrusion = cell.intrusion_tracked_m if person.limbs_tracked else cell.intrusion_untracked_m
        kinds += [CODE[PairKind.PERSON]] * len(person.regions)
        sources += [person.source] * len(person.regions)
        for region, _ in person.regions:
            names.append(f"{person.id}/{region}")
            laws.append(_Law(person_z, *bears[region], intrusion=intrusion, violated_below=0.0))
    known: dict[tuple[str, float], tuple[int, _Law]] = {}  # most things are alike
    for thing in scene.objects:
        alike = thing.kind, thing.uncertainty_m
        if alike not in known:
            known[alike] = _thing(thing.kind, thing.uncertainty_m, cell)
        code, law = known[alike]
        kinds.append(code)
        names.append(thing.id)
        sources.append(thing.source)
        laws.append(law)
    for zone in scene.zones:
        hard = zone.tier is None
        law = _Law(
            cell.robot_uncertainty_m,
            band=cell.rigid_band_m,
            declared=0.0 if zone.tier is None else float(zone.tier),
            violated_below=0.0 if hard else NEVER,
        )
        kinds.append(CODE[PairKind.HARD_ZONE if hard else PairKind.ZONE])
        names.append(zone.id)
        sources.append(zone.source)
        laws.append(law)
    return Obstacles.of(kinds, names, sources, laws, scene.solids)


def _thing(what: str, uncertainty_m: float, cell: CellParameters) -> tuple[int, _Law]:
    kind, band = (PairKind.FRAGILE, cell.fragile_band_m) if what == "fragile" else (PairKind.RIGID, cell.rigid_band_m)
    return CODE[kind], _Law(uncertainty_m + cell.robot_uncertainty_m, band=band, violated_below=-cell.overlap_limit_m)


@lru_cache(maxsize=64)  # one robot of a cell, with the objects it holds in a day
def _bears(robot: Robot, cell: CellParameters) -> dict[Region, tuple[float, float, float]]:
    """Limits that each region bears: the harmful speed, the limit speed, and the force."""
    return {
        region: (harm_speed_m_s(region, robot, cell), limit_speed_m_s(region, robot, cell), LIMITS[region].force_n)
        for region in Region
    }


@lru_cache(maxsize=64)  # likewise
def own_of(robot: Robot, cell: CellParameters) -> tuple[NDArray[np.intp], Obstacles]:
    """Pairs of the arm itself: the moving bodies, and their obstacles at rest in their reference frames."""
    law = _Law(0.0, band=cell.rigid_band_m, violated_below=-cell.overlap_limit_m)
    inner = [capsule for _, capsule in robot.self_pairs]
    solids = solids_of([Capsule(each.a_m, each.b_m, each.radius_m) for each in inner])
    count, names = len(inner), [each.name for each in inner]
    body = np.array([index for index, _ in robot.self_pairs], dtype=np.intp)
    return body, Obstacles.of([CODE[PairKind.SELF]] * count, names, [""] * count, [law] * count, solids)


@lru_cache(maxsize=16)  # a cell has one room
def walls_of(workspace: Workspace | None, cell: CellParameters) -> Obstacles:
    """The faces of the room."""
    planes = planes_of(workspace)
    law = _Law(cell.robot_uncertainty_m, band=cell.rigid_band_m, violated_below=0.0)
    count = len(planes)
    kinds, names = [CODE[PairKind.WORKSPACE]] * count, ["workspace"] * count
    return Obstacles.of(kinds, names, [""] * count, [law] * count, solids_of_planes(planes))
