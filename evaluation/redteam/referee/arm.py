"""The arm's parts in the base frame: links by the vendor's kinematics and meshes, and a gripper of blocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.redteam.referee.cell import GRIPPER
from evaluation.redteam.referee.moving import Moving
from evaluation.redteam.referee.shapes import Block, Hull, outline
from evaluation.redteam.referee.vendor import LINKS

if TYPE_CHECKING:
    from evaluation.redteam.referee.motion import Instants
    from evaluation.redteam.referee.shapes import Floats, Shape, Vector
    from evaluation.redteam.referee.vendor import VendorArm

FLANGE: Final = 6
"""Number of the last link, whose frame is the flange's."""

# Robotiq 2F-85 with its coupling, in the flange's frame, z away from the arm; the fingers open along x.
_COUPLING_M: Final = 0.0139  # on a UR flange
_BODY_M: Final = (0.085, 0.075, 0.0935)  # body 85 mm wide, 75 mm deep; height by its hull
_KNUCKLES_M: Final = (0.1524, 0.030)  # 152.4 mm over the open fingers; depth by their hull
_KNUCKLES_Z_M: Final = (0.0424, 0.100)  # lower fingers, above the mounting face
_TIP_M: Final = (0.0337, 0.022)  # (152.4 - 85) / 2 mm thick; pads 22 mm wide
_TIP_OPEN_M: Final = 0.1493  # height above the mounting face, open
_TIP_CLOSED_M: Final = 0.1628  # closed: the tips rise
_STROKE_M: Final = 0.085
TIP_M: Final = _COUPLING_M + _TIP_OPEN_M
"""Distance of the ends of open fingers from the flange."""
_BALLS: Final = 4  # chosen: pieces into which a long part is cut for the broad phase

SELF_PAIRS: Final = tuple(
    (inner, outer)
    for inner in range(5)
    for outer in range(inner + 2, 7)
    if (inner, outer) not in {(0, 2), (3, 5), (4, 6)}
)
"""Links that are no neighbours and can touch.

Of those left out, base and upper arm and wrist 1 and wrist 3 never come to touch; the vendor's hulls of forearm and
wrist 2 overlap by up to 3 mm where the arm itself is free (1,500 random poses).
"""


@dataclass(frozen=True, slots=True)
class LinkFrames:
    """LinkFrames of base and links at each instant.

    Attributes:
        turn: rotations, shape (n, 7, 3, 3).
        place: origins, shape (n, 7, 3).
    """

    turn: Floats
    place: Floats

    def speed_m_s(self, index: int, link: int, point_m: Floats, qd_rad_s: Floats) -> float:
        """Speed of a point that is fixed to a link, at an instant."""
        turning = slice(1, link + 1)
        axes = self.turn[index, turning, :, 2]
        levers = point_m - self.place[index, turning]
        return float(np.linalg.norm(qd_rad_s[:link] @ np.cross(axes, levers)))


@dataclass(frozen=True, slots=True)
class Part:
    """Part of the arm.

    Attributes:
        name: of the link, or `gripper`.
        link: 0 for the base to 6 for the last one.
        shape: about its centre.
        center_m: in the frame of the link, with open fingers.
        closing_m: way of the centre from open to closed fingers.
    """

    name: str
    link: int
    shape: Shape
    center_m: Vector = (0.0, 0.0, 0.0)
    closing_m: Vector = (0.0, 0.0, 0.0)


class Arm:
    """UR3e with a gripper.

    Args:
        vendor: kinematics and meshes.
    """

    def __init__(self, vendor: VendorArm) -> None:
        self._vendor = vendor
        hulls = {link: Hull(tuple(map(tuple, vendor.corners_m[link].tolist()))) for link in LINKS}
        self.parts = (*(Part(link, number, hulls[link]) for number, link in enumerate(LINKS)), *_gripper())

    def reach_m(self) -> Floats:
        """Farthest that any point of the arm beyond each joint can be from its axis, shape (6,)."""
        lengths = np.linalg.norm(self._vendor.places_m, axis=1)
        sizes = np.zeros(FLANGE + 1)
        for part in self.parts:
            far = np.abs(np.array(part.center_m)) + np.abs(np.array(part.closing_m))
            points = np.abs(outline(part.shape)[0]) + far
            sizes[part.link] = max(sizes[part.link], float(np.linalg.norm(points, axis=1).max()))
        return np.array(
            [max(lengths[k + 1 : link].sum() + sizes[link] for link in range(k + 1, FLANGE + 1)) for k in range(FLANGE)]
        )

    def frames(self, q_rad: Floats) -> LinkFrames:
        """LinkFrames at these angles, shape (n, 6)."""
        count = len(q_rad)
        turn = np.broadcast_to(np.eye(3), (count, 3, 3))
        place = np.zeros((count, 3))
        turns, places = [turn], [place]
        for joint in range(FLANGE):
            place = place + turn @ self._vendor.places_m[joint]
            cos, sin = np.cos(q_rad[:, joint]), np.sin(q_rad[:, joint])
            spin = np.zeros((count, 3, 3))
            spin[:, 0, 0], spin[:, 0, 1], spin[:, 1, 0], spin[:, 1, 1], spin[:, 2, 2] = cos, -sin, sin, cos, 1.0
            turn = turn @ self._vendor.turns[joint] @ spin
            turns.append(turn)
            places.append(place)
        return LinkFrames(np.stack(turns, axis=1), np.stack(places, axis=1))

    def moving(self, frames: LinkFrames, at: Instants) -> list[tuple[Part, Moving]]:
        """Every part with its poses."""
        closed = 1 - at.opening_m / _STROKE_M
        found = []
        for part in self.parts:
            turn, place = frames.turn[:, part.link], frames.place[:, part.link]
            center = np.array(part.center_m) + closed[:, None] * np.array(part.closing_m)
            if center.any():
                place = place + np.einsum("nij,nj->ni", turn, center)
            found.append((part, Moving.of(part.shape, turn, place, pieces=_BALLS)))
        return found


def _gripper() -> tuple[Part, ...]:
    width, depth, height = _BODY_M
    low, high = _KNUCKLES_Z_M
    thick, pad = _TIP_M
    tip = _TIP_OPEN_M - high
    rises = _TIP_CLOSED_M - _TIP_OPEN_M
    blocks = (
        # the body, with the coupling below it
        (Block((width / 2, depth / 2, (height + _COUPLING_M) / 2)), (0.0, 0.0, (height + _COUPLING_M) / 2), 0.0),
        (
            Block((_KNUCKLES_M[0] / 2, _KNUCKLES_M[1] / 2, (high - low) / 2)),
            (0.0, 0.0, _COUPLING_M + (high + low) / 2),
            0.0,
        ),
        *(
            (
                Block((thick / 2, pad / 2, tip / 2)),
                (side * (_STROKE_M + thick) / 2, 0.0, _COUPLING_M + high + tip / 2),
                -side * _STROKE_M / 2,
            )
            for side in (-1.0, 1.0)
        ),
    )
    return tuple(
        Part(GRIPPER, FLANGE, shape, center, (way, 0.0, rises if way else 0.0)) for shape, center, way in blocks
    )
