"""Scene of a motion: the arm's parts and all others at its instants, and where they touch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.redteam.referee.harm import CONTACT_M
from evaluation.redteam.referee.shapes import bounds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from evaluation.redteam.referee.arm import LinkFrames
    from evaluation.redteam.referee.body import Region
    from evaluation.redteam.referee.distances import Distances
    from evaluation.redteam.referee.harm import Harm
    from evaluation.redteam.referee.motion import Instants
    from evaluation.redteam.referee.moving import Moving
    from evaluation.redteam.referee.others import Other
    from evaluation.redteam.referee.shapes import Floats, Numbers, Shape

LOOK_M: Final = 0.3
"""Distance up to which contacts are looked for; where it is more, this much is stepped over (chosen)."""
FAR_M: Final = 10.0
"""The same where the distance itself is asked for: nothing in a cell is farther away (chosen)."""
STRIDES: Final = 64
"""Most instants that are stepped over inside a contact that is known to be harm (chosen)."""


@dataclass(frozen=True, slots=True)
class Member:
    """Part of the arm, or a thing that it holds.

    Attributes:
        name: of the link, `gripper`, or the thing's id.
        link: to which it is fixed.
        moving: shape and poses.
        among: numbers of the instants at which it belongs to the arm.
        fragile: a held thing that is.
        of_arm: no held thing.
    """

    name: str
    link: int
    moving: Moving
    among: Numbers
    fragile: bool = False
    of_arm: bool = True


@dataclass(frozen=True, slots=True)
class Touch:
    """Contact at an instant.

    Attributes:
        at_s: time.
        depth_m: penetration.
        speed_m_s: of the arm's touching point.
        region: of a person's body.
    """

    at_s: float
    depth_m: float
    speed_m_s: float
    region: Region | None


_Gap = tuple[float, "Floats"]


@dataclass(frozen=True, slots=True)
class Scene:
    """Everything at the instants of a motion.

    Attributes:
        at: the instants.
        frames: of the arm's links.
        distances: of shapes.
        base: the arm's base, which never moves.
        members: all parts that move, and held things.
        others: people, things, fixtures and zones.
        drops: harm by things that fell.
    """

    at: Instants
    frames: LinkFrames
    distances: Distances
    base: Member
    members: tuple[Member, ...]
    others: tuple[Other, ...]
    drops: tuple[Harm, ...]

    def speed_m_s(self, member: Member, number: int, point_m: Floats) -> float:
        """Speed of a point of a part at an instant."""
        return self.frames.speed_m_s(number, member.link, point_m, self.at.qd_rad_s[number])

    def touches(self, member: Member, other: Other, *, slower_m_s: float) -> Iterator[Touch]:
        """Contacts in which the part is faster than this; not each instant of a long one."""
        near = self._near(member, other, 0.0)
        if not len(near):
            return
        for shape, region in other.shapes:
            off = member.moving.off_box_m(near, *bounds(shape), other.turn, _among(other, near))
            closer = near[off < 0]
            if len(closer):
                gap = self._gap_to(member, other, shape, LOOK_M)
                yield from self._walk(member, closer, gap, region, slower_m_s)

    def self_touches(self, first: Member, second: Member, *, slower_m_s: float) -> Iterator[Touch]:
        """Contacts of two parts of the arm in which the first is faster than this."""
        near = first.among[first.moving.off_balls_m(first.among, second.moving) < 0]
        if not len(near):
            return

        def gap(number: int) -> _Gap:
            return self.distances.between(_posed(first, number), _posed(second, number), at_most_m=LOOK_M)

        yield from self._walk(first, near, gap, None, slower_m_s)

    def least_m(self, member: Member, other: Other, known_m: float) -> float:
        """Least distance of a part to another over the motion, where it is below the known one, else that one."""
        near = self._near(member, other, known_m)
        for shape, _ in other.shapes:
            off = member.moving.off_box_m(near, *bounds(shape), other.turn, _among(other, near)) if len(near) else near
            order = near[np.argsort(off)]
            ordered = np.sort(off)
            gap = self._gap_to(member, other, shape, FAR_M)
            passed = np.zeros(len(order), dtype=bool)
            for rank, number in enumerate(order):
                if ordered[rank] >= known_m:
                    break
                if passed[rank]:
                    continue
                apart, _ = gap(int(number))
                known_m = min(known_m, apart)
                # as long as nothing has come nearer than by what is too much, there is no less
                way = np.abs(self.at.travelled_m[order] - self.at.travelled_m[number])
                passed |= way < apart - known_m
        return known_m

    def _near(self, member: Member, other: Other, within_m: float) -> Numbers:
        """Numbers of the instants at which a part may be nearer than this to the box around another."""
        among = np.intersect1d(member.among, other.among, assume_unique=True)
        if not len(among):
            return among
        off = member.moving.off_box_m(among, *other.box(), other.turn, _among(other, among))
        return np.asarray(among[off < within_m])

    def _gap_to(self, member: Member, other: Other, shape: Shape, look_m: float) -> Callable[[int], _Gap]:
        def gap(number: int) -> _Gap:
            posed = (shape, other.turn, other.at(number))
            return self.distances.between(_posed(member, number), posed, at_most_m=look_m)

        return gap

    def _walk(
        self, member: Member, near: Numbers, gap: Callable[[int], _Gap], region: Region | None, slower_m_s: float
    ) -> Iterator[Touch]:
        """Contacts among these instants.

        Between two instants nothing comes nearer than what was travelled in between, so that a distance says how many
        of them need no look.
        """
        travelled = self.at.travelled_m
        rank, stride = 0, 1
        while rank < len(near):
            number = int(near[rank])
            apart, point = gap(number)
            if apart > -CONTACT_M:
                free = np.searchsorted(travelled, travelled[number] + apart + CONTACT_M)
                rank, stride = max(rank + 1, int(np.searchsorted(near, free))), 1
                continue
            speed = self.speed_m_s(member, number, point)
            if speed > slower_m_s:
                yield Touch(float(self.at.at_s[number]), -apart, speed, region)
                stride = min(2 * stride, STRIDES)
            rank += stride


def _posed(member: Member, number: int) -> tuple[Shape, Floats, Floats]:
    return member.moving.shape, member.moving.turn[number], member.moving.place[number]


def _among(other: Other, numbers: Numbers) -> Floats:
    return other.place if other.place.ndim == 1 else np.asarray(other.place[numbers])
