"""Shapes that move: their poses at every instant, and a lower bound of how far two of them are apart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from evaluation.redteam.referee.shapes import bounds

if TYPE_CHECKING:
    from evaluation.redteam.referee.shapes import Floats, Numbers, Shape


@dataclass(frozen=True, slots=True)
class Moving:
    """Shape with its poses at all instants, covered by balls.

    Attributes:
        shape: about its own centre.
        turn: rotations, shape (n, 3, 3).
        place: places of the centre, shape (n, 3).
        centers: of the balls, shape (n, balls, 3).
        radius_m: of each ball.
    """

    shape: Shape
    turn: Floats
    place: Floats
    centers: Floats
    radius_m: float

    @classmethod
    def of(cls, shape: Shape, turn: Floats, place: Floats, *, pieces: int) -> Self:
        """Shape at these poses, in balls: one around each piece of its box, which is cut along the longest edge."""
        middle, half = bounds(shape)
        longest = int(np.argmax(half))
        shares = (2 * np.arange(pieces) + 1) / pieces - 1
        local = np.tile(middle, (pieces, 1))
        local[:, longest] += shares * half[longest]
        piece = half.copy()
        piece[longest] /= pieces
        centers = np.einsum("nij,bj->nbi", turn, local) + place[:, None]
        return cls(shape, turn, place, centers, float(np.linalg.norm(piece)))

    def off_box_m(self, among: Numbers, middle: Floats, half: Floats, turn: Floats, place: Floats) -> Floats:
        """Lower bounds of the distance to a box at the instants with these numbers, shape (n,); below 0 near it.

        Args:
            among: numbers of the instants.
            middle: of the box in its own frame.
            half: of its edges.
            turn: rotation of the box, shape (3, 3) or (n, 3, 3).
            place: of the box's frame, shape (3,) or (n, 3).
        """
        off = self.centers[among] - (place if place.ndim == 1 else place[:, None])
        inside = off @ turn - middle
        outside = np.maximum(np.abs(inside) - half, 0.0)
        return np.asarray(np.sqrt((outside**2).sum(axis=-1)).min(axis=1) - self.radius_m)

    def off_balls_m(self, among: Numbers, other: Moving) -> Floats:
        """Lower bounds of the distance to another moving shape at these instants, shape (n,)."""
        off = self.centers[among][:, :, None] - other.centers[among][:, None]
        return np.asarray(np.sqrt((off**2).sum(axis=-1)).min(axis=(1, 2)) - self.radius_m - other.radius_m)
