"""3D vision: depth by ray casting of the simulated cell, and what stands where, out of the depths alone.

One camera hangs above the table and looks straight down. MuJoCo casts a ray for each of its pixels (`mj_multiRay`,
which needs no graphics library). Detection sees nothing but the depths, and the depths of the empty cell from when it
was calibrated. The arm is left out of the picture: a camera that really hangs there has to filter it by its pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, assert_never

import mujoco
import numpy as np

from capabilities.statements.observation import Box, Capsule, Convex, Sphere

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from capabilities.statements.observation import ObservedObject, ObservedPerson, Shape

    Floats = NDArray[np.float64]

CAMERA_M: Final = (-0.35, 0.0, 2.2)
"""Place of the camera, base frame."""
SPREAD: Final = 0.55
"""Tangent of half the opening angle: 2.4 m of the table's plane are seen."""
PIXELS: Final = 144
"""Rays in a row and in a column: one each 17 mm of the table."""
TABLE_TOP_M: Final = -0.010
"""The embedded cell's survey (ztpm/cell/survey.py)."""
FLOOR_M: Final = -0.82
"""Sole of a standing adult in the base frame (pep/pit/scene/adult_body.py)."""
NEARER_M: Final = 0.015
"""A pixel so much nearer than in the empty cell shows something."""
FARTHEST_M: Final = 10.0
"""Nothing of a cell is farther from its camera."""
LEAST_PIXELS: Final = 4
PERSON_M: Final = 0.45
"""A thing that rises so far above the table is a person."""
PART_M: Final = (0.10, 0.08)
GLASS_M: Final = (0.12, 0.20)
"""Widest footprint and greatest height of a part, and of a glass.

Anything else is a thing, and taken for fragile.
"""
GRID_M: Final = 0.005
"""Sizes are rounded outwards to this."""
SAME_M: Final = 0.10
"""A thing found so near to an earlier one is the same."""


@dataclass(frozen=True, slots=True)
class Found:
    """One thing found: its kind, the box that encloses it (m, base frame), and its name once it is followed."""

    kind: str
    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]
    name: str = ""

    @property
    def middle_m(self) -> tuple[float, float, float]:
        """Middle of the box."""
        x, y, z = ((a + b) / 2 for a, b in zip(self.low_m, self.high_m, strict=True))
        return (x, y, z)


class DepthCamera:
    """The camera above the table, calibrated on the empty cell."""

    def __init__(self) -> None:
        across = (np.arange(PIXELS) + 0.5) / PIXELS * 2 - 1
        u, v = np.meshgrid(across * SPREAD, across * SPREAD, indexing="ij")
        rays = np.stack([u, v, -np.ones_like(u)], axis=-1).reshape(-1, 3)
        self._rays: Floats = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        self._empty = self.capture((), ())

    def capture(self, people: Iterable[ObservedPerson], objects: Iterable[ObservedObject]) -> Floats:
        """Depth of each pixel in m, (PIXELS * PIXELS,); infinite where nothing is hit.

        Args:
            people: that truly are there.
            objects: likewise.
        """
        shapes = [shape for person in people for _, shape in person.regions] + [each.shape for each in objects]
        model = mujoco.MjModel.from_xml_string(_scene(shapes))
        state = mujoco.MjData(model)
        mujoco.mj_forward(model, state)
        count = len(self._rays)
        hit, depth = np.full(count, -1, np.int32), np.zeros(count)
        eye = np.array(CAMERA_M)
        every, static, nobody = None, True, -1  # groups of geoms, geoms that do not move, a body that is left out
        rays = self._rays.ravel()
        mujoco.mj_multiRay(model, state, eye, rays, every, static, nobody, hit, depth, None, count, FARTHEST_M)
        return np.where(hit >= 0, depth, np.inf)

    def detect(self, depth: Floats) -> list[Found]:
        """Things that stand in the cell, by the depths alone."""
        points = np.array(CAMERA_M) + self._rays * np.where(np.isfinite(depth), depth, 0.0)[:, None]
        nearer = (depth < self._empty - NEARER_M).reshape(PIXELS, PIXELS)
        return [_found(points[cluster]) for cluster in _clusters(nearer) if len(cluster) >= LEAST_PIXELS]


class Following:
    """Names of things over time: one that is found where another was keeps its name."""

    def __init__(self) -> None:
        self._known: list[Found] = []

    def named(self, found: Sequence[Found]) -> list[Found]:
        """The things with their names, each once; new ones are numbered."""
        free, told = list(self._known), []
        for each in found:
            near = [old for old in free if old.kind == each.kind and _apart(old, each) <= SAME_M]
            same = min(near, key=lambda old: _apart(old, each), default=None)
            if same is not None:
                free.remove(same)
            told.append((each, same))
        taken = {same.name for _, same in told if same is not None}
        named = []
        for each, same in told:
            name = same.name if same is not None else _new_name(each.kind, taken)
            taken.add(name)
            named.append(Found(each.kind, each.low_m, each.high_m, name))
        self._known = named
        return named


def commands_of(found: Sequence[Found]) -> dict[str, Any]:
    """Things as a sensor is told them (ursim/sensor/sensor.py): people stand upright, other things are boxes."""
    people = [{"id": f.name, "x_m": f.middle_m[0], "y_m": f.middle_m[1]} for f in found if f.kind == "person"]
    objects = [
        {
            "id": each.name,
            "kind": "rigid" if each.kind == "part" else "fragile",
            "shape": {
                "type": "box",
                "center_m": list(each.middle_m),
                "half_m": [(b - a) / 2 for a, b in zip(each.low_m, each.high_m, strict=True)],
            },
        }
        for each in found
        if each.kind != "person"
    ]
    return {"people": people, "objects": objects}


def enclosing(shapes: Sequence[Shape]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Lowest and highest corner of the upright box around some shapes, m."""
    lows, highs = [], []
    for shape in shapes:
        match shape:
            case Sphere():
                middles, reach = [shape.center_um], (shape.radius_um,) * 3
            case Capsule():
                middles, reach = [shape.a_um, shape.b_um], (shape.radius_um,) * 3
            case Box():
                middles, reach = [shape.center_um], shape.half_um
            case Convex():
                middles, reach = list(shape.vertices_um), (shape.radius_um,) * 3
            case _:
                assert_never(shape)
        lows += [np.subtract(middle, reach) for middle in middles]
        highs += [np.add(middle, reach) for middle in middles]
    low, high = np.min(lows, axis=0) / 1e6, np.max(highs, axis=0) / 1e6
    return tuple(map(float, low)), tuple(map(float, high))


def _apart(one: Found, other: Found) -> float:
    return float(np.linalg.norm(np.subtract(one.middle_m[:2], other.middle_m[:2])))


def _new_name(kind: str, taken: set[str]) -> str:
    return next(name for n in range(1, len(taken) + 2) if (name := f"{kind}-{n}") not in taken)


def _found(points: Floats) -> Found:
    top = float(points[:, 2].max())
    if top > TABLE_TOP_M + PERSON_M:
        head = points[points[:, 2] > top - 0.15][:, :2]  # the crown of a head, and no shoulder
        x, y = map(float, (head.min(axis=0) + head.max(axis=0)) / 2)
        return Found("person", (x, y, FLOOR_M), (x, y, top))
    pixel = SPREAD * 2 * (CAMERA_M[2] - top) / PIXELS
    low, high = points[:, :2].min(axis=0) - pixel / 2, points[:, :2].max(axis=0) + pixel / 2
    low, high = np.floor(low / GRID_M) * GRID_M, np.ceil(high / GRID_M) * GRID_M
    wide, tall = float((high - low).max()), top - TABLE_TOP_M
    kind = next((k for k, (w, h) in (("part", PART_M), ("glass", GLASS_M)) if wide <= w and tall <= h), "thing")
    bottom = TABLE_TOP_M + GRID_M  # its sole, so that a thing that stands on the table is not in it
    return Found(
        kind, (float(low[0]), float(low[1]), bottom), (float(high[0]), float(high[1]), max(top, bottom + GRID_M))
    )


def _clusters(mask: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """Indices of the pixels of each connected group, its neighbours on all eight sides."""
    left, groups = set(np.flatnonzero(mask).tolist()), []
    while left:
        stack, group = [left.pop()], []
        while stack:
            place = stack.pop()
            group.append(place)
            row, column = divmod(place, PIXELS)
            for r in range(max(row - 1, 0), min(row + 2, PIXELS)):
                for c in range(max(column - 1, 0), min(column + 2, PIXELS)):
                    if (near := r * PIXELS + c) in left:
                        left.remove(near)
                        stack.append(near)
        groups.append(np.array(sorted(group)))
    return groups


def _scene(shapes: Sequence[Shape]) -> str:
    """MJCF of the cell with these shapes in it."""
    table = "-0.3 0 -0.06"  # its box in the survey: 1 m x 1 m, the top at TABLE_TOP_M
    geoms = [
        f'<geom type="plane" size="4 4 1" pos="0 0 {FLOOR_M}"/>',
        f'<geom type="box" size="0.5 0.5 0.05" pos="{table}"/>',
        *map(_geom, shapes),
    ]
    return f"<mujoco><worldbody>{''.join(geoms)}</worldbody></mujoco>"


def _metres(numbers: Iterable[float]) -> str:
    return " ".join(f"{number / 1e6:.6f}" for number in numbers)


def _geom(shape: Shape) -> str:
    match shape:
        case Sphere():
            return f'<geom type="sphere" size="{shape.radius_um / 1e6}" pos="{_metres(shape.center_um)}"/>'
        case Capsule():
            ends = _metres((*shape.a_um, *shape.b_um))
            return f'<geom type="capsule" size="{shape.radius_um / 1e6}" fromto="{ends}"/>'
        case Box():
            turned = _metres(shape.quaternion_ppm)
            where = f'size="{_metres(shape.half_um)}" pos="{_metres(shape.center_um)}" quat="{turned}"'
            return f'<geom type="box" {where}/>'
        case Convex():
            middle = np.mean(shape.vertices_um, axis=0)
            reach = max(float(np.linalg.norm(np.subtract(v, middle))) for v in shape.vertices_um) + shape.radius_um
            return f'<geom type="sphere" size="{reach / 1e6}" pos="{_metres(middle)}"/>'
        case _:
            assert_never(shape)
