"""The arm's kinematics, limits and masses, read from the robot's data file."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from ursim.motion.spatial import (
    Frame,
    Rotation,
    Triple,
    add,
    chain,
    compose,
    cross,
    from_rpy,
    rotate,
    to_vector,
    transpose,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

AXES: Final = 6
GRAVITY_M_S2: Final = 9.80665  # standard acceleration of free fall, CGPM 1901
ROBOTS: Final = Path(__file__).parents[2] / "pep" / "pit" / "robots"
UR3E: Final = ROBOTS / "ur3e.toml"

Joints: TypeAlias = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Body:
    """Link, or load of the tool: mass [kg], centre of mass [m], inertia about it [kg m2].

    The inertia has URScript's order: Ixx, Iyy, Izz, Ixy, Ixz, Iyz.
    """

    mass_kg: float
    com_m: Triple
    inertia_kg_m2: Sequence[float]


@dataclass(frozen=True, slots=True)
class Joint:
    """One revolute joint: its place in its parent's frame, its limits, and its link."""

    offset_m: Triple
    rpy_rad: Triple
    turn: Rotation
    position_limit_rad: float
    speed_limit_rad_s: float
    torque_limit_nm: float
    body: Body


@dataclass(frozen=True, slots=True)
class Arm:
    """Six revolute joints about their local z, the last frame being the tool flange."""

    joints: tuple[Joint, ...]
    acceleration_limit_rad_s2: float
    payload_limit_kg: float

    @classmethod
    def load(cls, file: Path = UR3E) -> Arm:
        """The arm that the data file describes."""
        with file.open("rb") as source:
            told = tomllib.load(source)
        joints = tuple(
            Joint(
                offset_m=_triple(one["offset_m"]),
                rpy_rad=_triple(one["rpy_rad"]),
                turn=from_rpy(*_triple(one["rpy_rad"])),
                position_limit_rad=float(one["position_limit_rad"]),
                speed_limit_rad_s=float(one["speed_limit_rad_s"]),
                torque_limit_nm=float(one["torque_limit_nm"]),
                body=Body(float(one["mass_kg"]), _triple(one["com_m"]), _inertia(one)),
            )
            for one in told["joints"]
        )
        if len(joints) != AXES:
            raise ValueError(f"{file.name} describes {len(joints)} joints, not {AXES}")
        return cls(joints, float(told["acceleration_limit_rad_s2"]), float(told["payload_limit_kg"]))

    def frames(self, q: Sequence[float]) -> list[Frame]:
        """The six link frames in the base frame, the flange last."""
        position: Triple = (0.0, 0.0, 0.0)
        rotation: Rotation = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
        found: list[Frame] = []
        for joint, angle in zip(self.joints, q, strict=True):
            position = add(position, rotate(rotation, joint.offset_m))
            c, s = math.cos(angle), math.sin(angle)
            rotation = compose(compose(rotation, joint.turn), (c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0))
            found.append((position, rotation))
        return found

    def tool(self, q: Sequence[float], tcp: Frame) -> Frame:
        """The tool centre point in the base frame."""
        return chain(self.frames(q)[-1], tcp)

    @staticmethod
    def columns(frames: Sequence[Frame], tcp: Frame) -> list[tuple[float, ...]]:
        """The geometric Jacobian at the tool centre point, one column (m, rad) per joint."""
        point = chain(frames[-1], tcp)[0]
        found: list[tuple[float, ...]] = []
        for origin, r in frames:
            axis = (r[2], r[5], r[8])
            arm = (point[0] - origin[0], point[1] - origin[1], point[2] - origin[2])
            found.append((*cross(axis, arm), *axis))
        return found

    def twist(self, frames: Sequence[Frame], qd: Sequence[float], tcp: Frame) -> tuple[float, ...]:
        """Speed of the tool centre point: m/s, then rad/s."""
        columns = self.columns(frames, tcp)
        return tuple(sum(column[i] * speed for column, speed in zip(columns, qd, strict=True)) for i in range(6))

    def reach(self, target: Frame, near: Sequence[float], tcp: Frame, *, tolerance: float = 1e-10) -> Joints | None:
        """Joint angles [rad] that bring the tool to `target`, found from `near`, or None when none is found from there.

        Damped Newton steps; the answer lies inside the joint limits and meets position [m] and rotation [rad] within
        `tolerance`.
        """
        q = list(near)
        for _ in range(80):
            frames = self.frames(q)
            away = miss(target, chain(frames[-1], tcp))
            if max(map(abs, away)) <= tolerance:
                return self._within_limits(q)
            step = damped(self.columns(frames, tcp), away, damping=1e-4)
            longest = max(map(abs, step))
            scale = min(1.0, 0.5 / longest) if longest > 0.0 else 1.0  # half a radian a step keeps the branch of `near`
            q = [a + scale * b for a, b in zip(q, step, strict=True)]
        return None

    def _within_limits(self, q: Sequence[float]) -> Joints | None:
        found: list[float] = []
        for angle, joint in zip(q, self.joints, strict=True):
            limit = joint.position_limit_rad
            wrapped = angle if -limit <= angle <= limit else math.remainder(angle, math.tau)
            if not -limit <= wrapped <= limit:
                return None
            found.append(wrapped)
        return tuple(found)

    def inside(self, q: Sequence[float]) -> bool:
        """True where every angle lies in its joint's limits; an angle that is no number does not."""
        return all(
            -joint.position_limit_rad <= angle <= joint.position_limit_rad
            for joint, angle in zip(self.joints, q, strict=True)
        )

    @property
    def dh(self) -> tuple[Joints, Joints, Joints]:
        """Denavit-Hartenberg a [m], d [m] and alpha [rad], as the primary interface reports them."""
        o = [joint.offset_m for joint in self.joints]
        a = (o[1][0], o[2][0], o[3][0], o[4][0], o[5][0], 0.0)
        d = (o[0][2], o[1][2], o[2][2], o[3][2], -o[4][1], o[5][1])
        half = math.pi / 2
        return a, d, (half, 0.0, 0.0, half, -half, 0.0)


def miss(target: Frame, reached: Frame) -> tuple[float, ...]:
    """The way from `reached` to `target`: m, then a rotation vector."""
    (x, y, z), rotation = reached
    turn = to_vector(compose(target[1], transpose(rotation)))
    return (target[0][0] - x, target[0][1] - y, target[0][2] - z, *turn)


def damped(columns: Sequence[Sequence[float]], wanted: Sequence[float], *, damping: float) -> Joints:
    """Joint step x with J x nearest to `wanted`, damped where J is singular.

    It is Jt (J Jt + damping^2 I)^-1 wanted.
    """
    n = 6
    rows = [[sum(c[i] * c[k] for c in columns) for k in range(n)] + [wanted[i]] for i in range(n)]
    for i in range(n):
        rows[i][i] += damping * damping
    for i in range(n):  # Gauss with row exchange; the matrix is positive definite, so a pivot is always found
        pivot = max(range(i, n), key=lambda k: abs(rows[k][i]))
        rows[i], rows[pivot] = rows[pivot], rows[i]
        lead = rows[i][i]
        for k in range(i + 1, n):
            factor = rows[k][i] / lead
            if factor:
                rows[k] = [a - factor * b for a, b in zip(rows[k], rows[i], strict=True)]
    y = [0.0] * n
    for i in reversed(range(n)):
        y[i] = (rows[i][n] - sum(rows[i][k] * y[k] for k in range(i + 1, n))) / rows[i][i]
    return tuple(sum(column[i] * y[i] for i in range(n)) for column in columns)


def _inertia(told: Mapping[str, Any]) -> tuple[float, ...]:
    """Moments xx, yy, zz, and products xy, xz, yz."""
    return (*_triple(told["inertia_kg_m2"]), *_triple(told.get("inertia_products_kg_m2", (0.0, 0.0, 0.0))))


def _triple(told: Sequence[float]) -> Triple:
    x, y, z = told
    return (float(x), float(y), float(z))
