"""Every pair of a robot body and something it must mind, as arrays: geometry, and the law of the pair's index."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final, assert_never

import numpy as np

from pep.pit.clearance import Cores
from pep.pit.contact import LIMITS, harm_speed_m_s
from pep.pit.scene import Box, Capsule, Sphere
from pep.pit.tier import person_index, thing_index, zone_index

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.cell import CellParameters
    from pep.pit.motion import Floats
    from pep.pit.robot import Robot
    from pep.pit.scene import Scene, Shape
    from pep.pit.separation import Stopping


class Kind(StrEnum):
    """What a pair is about; also the `kind` of its contribution."""

    PERSON = "person"
    FRAGILE = "fragile"
    RIGID = "rigid"
    SELF = "self"
    WORKSPACE = "workspace"
    HARD_ZONE = "zone"
    ZONE = "tiered_zone"


VIOLABLE: Final = (Kind.PERSON, Kind.SELF, Kind.WORKSPACE, Kind.HARD_ZONE)
"""Kinds whose attained negative clearance is denied whatever is authorised."""

_KINDS: Final = tuple(Kind)
_CODE: Final = {kind: code for code, kind in enumerate(_KINDS)}
NO_HARM: Final = np.inf  # of what is no person: no speed or force harms it in that sense


@dataclass(frozen=True, slots=True)
class _Column:
    """One obstacle before it is paired with bodies."""

    kind: Kind
    name: str
    shape: Shape
    uncertainty_m: float
    harm_speed: float = NO_HARM
    force_limit: float = NO_HARM
    intrusion: float = 0.0
    band: float = 1.0
    declared: float = 0.0


@dataclass(frozen=True, slots=True)
class Pairs:
    """Row k: body `body[k]` against an obstacle at rest in that body's reference frame.

    Attributes:
        body: index into the robot's bodies.
        cores: the obstacle's core.
        radius: the obstacle's radius, metre; `radii` adds the body's.
        kind: index into `Kind`.
        harm_speed: from which a blow is likely to harm, m/s; force_limit: of a clamped region, N; infinite for what is
            no person.
        intrusion: reach of an unseen limb, m; band: of things, m; declared: tier of a zone.
        uncertainty: taken off the clearance before the law is asked, metre.
        violated_below: attained clearance (uncertainty not taken off) below which the pair is a violation; -inf where
            it cannot be.
        names: of the obstacle, row by row.
        group: the same number for rows of the same kind and name.
    """

    body: NDArray[np.intp]
    cores: Cores
    radius: Floats
    radii: Floats
    kind: NDArray[np.intp]
    uncertainty: Floats
    harm_speed: Floats
    force_limit: Floats
    intrusion: Floats
    band: Floats
    declared: Floats
    violated_below: Floats
    names: tuple[str, ...]
    group: NDArray[np.intp]
    warn_band: float
    penetration_band: float

    def __len__(self) -> int:
        """How many pairs."""
        return len(self.body)

    def kind_of(self, row: int) -> Kind:
        """The kind of one pair."""
        return _KINDS[int(self.kind[row])]

    @staticmethod
    def code_of(kind: Kind) -> int:
        """The number that stands for `kind` in `kind`'s array."""
        return _CODE[kind]

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
        zone = kind == _CODE[Kind.ZONE]
        if zone.any():
            which = rows[zone]
            result[zone] = zone_index(
                near[zone], speed[zone], band=self.band[which], declared=self.declared[which], stop=stop
            )
        return result


def pairs_of(robot: Robot, scene: Scene, cell: CellParameters, *, grown_m: float) -> Pairs:
    """All pairs that a motion of this robot in this scene must mind.

    Args:
        robot: the arm and its tool.
        scene: what is around it.
        cell: bands, uncertainties and limits.
        grown_m: how much farther than seen people may be, because the view is old.
    """
    columns = _columns(robot, scene, cell, grown_m)
    moving = np.arange(robot.world_bodies)
    body = [np.tile(moving, len(columns))]
    rows: list[_Column] = [column for column in columns for _ in moving]
    planes = _planes(scene)
    own = [
        _Column(
            Kind.SELF, capsule.name, Capsule(capsule.a_m, capsule.b_m, capsule.radius_m), 0.0, band=cell.rigid_band_m
        )
        for _, capsule in robot.self_pairs
    ]
    rows += own
    body.append(np.array([index for index, _ in robot.self_pairs], dtype=np.intp))
    cores, radius = _cores(rows)
    if planes:
        body.append(np.tile(moving, len(planes)))
        cores, radius = _with_planes(cores, radius, planes, len(moving))
        anywhere = Sphere((0, 0, 0), 1)  # the faces carry their own geometry
        face = _Column(Kind.WORKSPACE, "workspace", anywhere, cell.robot_uncertainty_m, band=cell.rigid_band_m)
        rows += [face] * (len(planes) * len(moving))
    bodies = np.concatenate(body)
    body_radius = np.array([b.radius_m for b in robot.bodies])
    kind = np.array([_CODE[row.kind] for row in rows], dtype=np.intp)
    below = np.where(np.isin(kind, [_CODE[k] for k in VIOLABLE]), 0.0, -np.inf)
    below = np.where(kind == _CODE[Kind.SELF], -cell.self_overlap_m, below)
    return Pairs(
        body=bodies,
        cores=cores,
        radius=radius,
        radii=radius + body_radius[bodies],
        kind=kind,
        uncertainty=np.array([row.uncertainty_m for row in rows]),
        harm_speed=np.array([row.harm_speed for row in rows]),
        force_limit=np.array([row.force_limit for row in rows]),
        intrusion=np.array([row.intrusion for row in rows]),
        band=np.array([row.band for row in rows]),
        declared=np.array([row.declared for row in rows]),
        violated_below=below,
        names=tuple(row.name for row in rows),
        group=_groups(rows),
        warn_band=cell.warn_band_m,
        penetration_band=cell.penetration_band_m,
    )


def _columns(robot: Robot, scene: Scene, cell: CellParameters, grown_m: float) -> list[_Column]:
    columns: list[_Column] = []
    person_z = cell.person_uncertainty_m + cell.robot_uncertainty_m + grown_m
    for person in scene.people:
        intrusion = cell.intrusion_tracked_m if person.limbs_tracked else cell.intrusion_untracked_m
        for region, shape in person.regions:
            harm = harm_speed_m_s(region, robot, cell)
            force = LIMITS[region].force_n
            columns.append(_Column(Kind.PERSON, f"{person.id}/{region}", shape, person_z, harm, force, intrusion))
    for thing in scene.objects:
        kind, band = (Kind.FRAGILE, cell.fragile_band_m) if thing.kind == "fragile" else (Kind.RIGID, cell.rigid_band_m)
        uncertainty = thing.uncertainty_m + cell.robot_uncertainty_m
        columns.append(_Column(kind, thing.id, thing.shape, uncertainty, band=band))
    for zone in scene.zones:
        kind = Kind.HARD_ZONE if zone.tier is None else Kind.ZONE
        declared = 0.0 if zone.tier is None else float(zone.tier)
        columns.append(
            _Column(kind, zone.id, zone.shape, cell.robot_uncertainty_m, band=cell.rigid_band_m, declared=declared)
        )
    return columns


def _cores(rows: list[_Column]) -> tuple[Cores, Floats]:
    n = len(rows)
    is_box = np.zeros(n, dtype=bool)
    a, b, half, radius = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n)
    axes = np.tile(np.eye(3), (n, 1, 1))
    last: Shape | None = None
    for k, row in enumerate(rows):
        if row.shape is last:  # rows of one obstacle stand together
            is_box[k], a[k], b[k], half[k], axes[k], radius[k] = (
                is_box[k - 1], a[k - 1], b[k - 1], half[k - 1], axes[k - 1], radius[k - 1],
            )  # fmt: skip
            continue
        last = row.shape
        match row.shape:
            case Capsule(start, end, r):
                a[k], b[k], radius[k] = start, end, r
            case Sphere(center, r):
                a[k], b[k], radius[k] = center, center, r
            case Box(center, extent, quaternion):
                is_box[k] = True
                a[k], b[k], half[k], axes[k] = center, center, extent, rotation_of(quaternion)
            case _:
                assert_never(row.shape)
    return Cores(~is_box, is_box, a, b, axes, half, np.zeros(n)), radius


def _groups(rows: list[_Column]) -> NDArray[np.intp]:
    numbers: dict[tuple[Kind, str], int] = {}
    return np.array([numbers.setdefault((row.kind, row.name), len(numbers)) for row in rows], dtype=np.intp)


def rotation_of(quaternion: tuple[float, float, float, float]) -> Floats:
    """Rotation matrix of a quaternion (w, x, y, z), which is normalised first."""
    w, x, y, z = np.array(quaternion) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _planes(scene: Scene) -> list[tuple[tuple[float, float, float], float]]:
    """The workspace's six faces: (outward normal, offset)."""
    if scene.workspace is None:
        return []
    faces: list[tuple[tuple[float, float, float], float]] = []
    for axis in range(3):
        unit = [0.0, 0.0, 0.0]
        unit[axis] = 1.0
        faces.append(((unit[0], unit[1], unit[2]), scene.workspace.high_m[axis]))
        faces.append(((-unit[0], -unit[1], -unit[2]), -scene.workspace.low_m[axis]))
    return faces


def _with_planes(
    cores: Cores, radius: Floats, planes: list[tuple[tuple[float, float, float], float]], each: int
) -> tuple[Cores, Floats]:
    n = each * len(planes)
    normal = np.repeat(np.array([p[0] for p in planes]), each, axis=0)
    offset = np.repeat(np.array([p[1] for p in planes]), each)

    def more(first: Any, second: Any) -> Any:
        return np.concatenate([first, second])

    joined = Cores(
        more(cores.is_segment, np.zeros(n, dtype=bool)),
        more(cores.is_box, np.zeros(n, dtype=bool)),
        more(cores.a, normal),
        more(cores.b, normal),
        more(cores.axes, np.tile(np.eye(3), (n, 1, 1))),
        more(cores.half, np.zeros((n, 3))),
        more(cores.offset, offset),
    )
    return joined, more(radius, np.zeros(n))
