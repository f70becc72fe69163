"""Motions that a force or a hand leads, and the surfaces that the tool may press on.

The vendor publishes no model of its force mode. Here the tool goes along and about each compliant axis at a speed that
grows with the force that is missing, up to the axis' limit; all other axes hold still.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from ursim.motion.arm import damped
from ursim.motion.motion import ZERO, Kinetic, capped, towards
from ursim.motion.spatial import Frame, Triple, add, chain

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from ursim.motion.arm import Arm, Joints

YIELD_M_S_N: Final = 0.005  # ours: 10 N that nothing resists make 50 mm/s
YIELD_RAD_S_NM: Final = 0.5  # ours: 1 Nm, 0.5 rad/s
DAMPING: Final = 0.025  # URScript manual, force_mode_set_damping: the default
TOUCH_N: Final = 5.0  # ours: force from which the tool touches; 0.25 mm of that workpiece
STIFFNESS_N_M: Final = 20_000.0  # ours: a workpiece on rubber; 10 N press it in by half a millimetre


@dataclass(frozen=True, slots=True)
class Surface:
    """Half of space that is filled, with an elastic face.

    Attributes:
        point_m: on the face, in the base frame.
        normal: of length 1, out of what is filled.
        stiffness_n_m: force by depth.
    """

    point_m: Triple
    normal: Triple
    stiffness_n_m: float = STIFFNESS_N_M

    def push(self, point_m: Triple) -> Triple:
        """Force on a tool at that point, N."""
        depth = sum(n * (p - x) for n, p, x in zip(self.normal, self.point_m, point_m, strict=True))
        x, y, z = (max(0.0, depth) * self.stiffness_n_m * n for n in self.normal)
        return x, y, z


class ForceTool:
    """Towards the forces of a wrench along the compliant axes of a task frame. Never complete by itself.

    Args:
        arm: the kinematics.
        tcp: tool centre point in the flange frame.
        felt: force on a tool at a point, N.
    """

    def __init__(self, arm: Arm, tcp: Frame, felt: Callable[[Triple], Triple]) -> None:
        self._arm, self._tcp, self._felt = arm, tcp, felt
        self.frame: Frame | None = None
        self.compliant: Sequence[bool] = (False,) * len(ZERO)
        self.wrench: Sequence[float] = ZERO
        self.limits: Sequence[float] = ZERO
        self.part = 1.0

    def restart(self, q: Joints) -> None:
        """Does nothing: no way is planned ahead."""

    def advance(self, now: Kinetic, dt_s: float, scaling: float) -> tuple[Kinetic, bool]:
        """One sample on."""
        del scaling
        frames = self._arm.frames(now.q)
        assert self.frame is not None
        r, force = self.frame[1], self._felt(chain(frames[-1], self._tcp)[0])
        line, turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        for axis in range(3):
            along = (r[axis], r[3 + axis], r[6 + axis])
            felt = sum(a * f for a, f in zip(along, force, strict=True))
            line = add(line, _times(along, self._speed(axis, YIELD_M_S_N * (self.wrench[axis] + felt))))
            turn = add(turn, _times(along, self._speed(3 + axis, YIELD_RAD_S_NM * self.wrench[3 + axis])))
        wanted = capped(self._arm, damped(self._arm.columns(frames, self._tcp), (*line, *turn), damping=1e-3))
        return towards(now, wanted, self._arm.acceleration_limit_rad_s2, dt_s), False

    def _speed(self, axis: int, asked: float) -> float:
        limit = self.limits[axis]
        return max(-limit, min(limit, self.part * asked)) if self.compliant[axis] else 0.0


class HandLed:
    """The arm as a hand pushes it, along the free axes of the base. Never complete by itself.

    Args:
        arm: the kinematics.
        tcp: tool centre point in the flange frame.
        free: for each axis whether the tool may go along or about it.
        pushed: joint speeds of the hand now, rad/s.
    """

    def __init__(self, arm: Arm, tcp: Frame, free: Sequence[bool], pushed: Callable[[], Joints]) -> None:
        self._arm, self._tcp, self._free, self._pushed = arm, tcp, free, pushed

    def restart(self, q: Joints) -> None:
        """Does nothing: no way is planned ahead."""

    def advance(self, now: Kinetic, dt_s: float, scaling: float) -> tuple[Kinetic, bool]:
        """One sample on."""
        del scaling
        wanted = self._pushed()
        if not all(self._free):
            frames = self._arm.frames(now.q)
            twist = self._arm.twist(frames, wanted, self._tcp)
            kept = [each if free else 0.0 for each, free in zip(twist, self._free, strict=True)]
            wanted = damped(self._arm.columns(frames, self._tcp), kept, damping=1e-3)
        return towards(now, capped(self._arm, wanted), self._arm.acceleration_limit_rad_s2, dt_s), False


def wrench_at(surfaces: Sequence[Surface], point_m: Triple) -> Triple:
    """Force of all surfaces on a tool at that point, N."""
    force: Triple = (0.0, 0.0, 0.0)
    for surface in surfaces:
        force = add(force, surface.push(point_m))
    return force


def _times(a: Triple, factor: float) -> Triple:
    return a[0] * factor, a[1] * factor, a[2] * factor
