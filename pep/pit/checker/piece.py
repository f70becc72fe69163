"""Piece of a line: bounds of the joints' derivatives that prove themselves on all of it (PHY-17).

J q' = V, so J q'' = -J' q'. With G the inverse of J in the middle m and r half the piece: if |q''| <= a on the piece,
then |q'| <= |q'(m)| + r a, J stays within r |J'(m)| and a term of the second order of itself, and so |q''| is bounded
again. A bound that is not below its own consequence holds, for at its first place of failure it would hold already. The
same bounds q''', without that step: its consequence is linear in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.pit.checker.arm import GRID
from pep.pit.checker.stance import times

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit.checker.stance import CheckerStance, Matrix, Six
    from pep.pit.checker.twist import CheckerTwist

UP: Final = 1 + 1e-10  # far above float64 rounding of these sums
OFF: Final = (
    1e-10  # m and rad: farthest that the tool at a recorded node may be from the line; ten roundings of Newton's
)
BEND_OF_LOG: Final = 0.6  # the inverse left Jacobian of the logarithm differs from 1 by less than 0.6 angle up to 1 rad
ANGLE_MOST: Final = 1.0  # rad: as far as that holds
ONES: Final = (1.0,) * 6  # one for each joint


@dataclass(frozen=True, slots=True)
class Lever:
    """Bounds on the change of the tool's Jacobian, from the reach of the tool point about each joint's axis.

    Each gives a pair: of the linear part, m, and of the angular, rad.
    """

    reach: Six

    def first(self, w: Sequence[float], v: Sequence[float]) -> tuple[float, float]:
        """Bound of |sum_k J_k' v_k|, for joint rates of at most w."""
        s = t = linear = angular = 0.0
        for reach, rate, weight in zip(self.reach, w, v, strict=True):
            inner, before = s, t
            s, t = s + rate, t + weight
            linear += reach * (s * t - inner * before)
            angular += weight * inner
        return linear, angular

    def second(self, w: Sequence[float], a: Sequence[float], v: Sequence[float]) -> tuple[float, float]:
        """Bound of |sum_k J_k'' v_k|, for rates of at most w that change by at most a."""
        linear, angular = self.first(a, v)
        s = t = 0.0
        for reach, rate, weight in zip(self.reach, w, v, strict=True):
            inner, before = s, t
            s, t = s + rate, t + weight
            linear += reach * (s * s * t - inner * inner * before)
            angular += weight * inner * inner
        return linear, angular


class Piece:
    """Values in the middle of a piece, and the bounds that follow for all of it.

    Attributes:
        low, high: its ends, in 1 / GRID; `r` half its length.
        middle: the arm in its middle.
        dq, ddq: the joints' derivatives there.
    """

    def __init__(self, lever: Lever, twist: CheckerTwist, middle: CheckerStance, low: int, high: int) -> None:
        """Computes the derivatives in the middle."""
        self.low, self.high, self.r = low, high, 0.5 * (high - low) / GRID
        self.middle, self._lever = middle, lever
        self.dq = middle.rates(twist.rate)
        bend = middle.bend(self.dq)
        self.ddq = tuple(-x for x in times(middle.inverse, times(bend, self.dq)))
        columns = list(zip(*bend, strict=True))
        mixed = [times(middle.inverse, column) for column in columns]
        self._mixed: Matrix = tuple(tuple(map(abs, row)) for row in zip(*mixed, strict=True))  # |G J'|
        self._slip = tuple(2 * OFF * sum(map(abs, row)) for row in middle.inverse)

    def rates(self, a: Sequence[float]) -> Six:
        """Bound of |q'| on the piece, for |q''| of at most a."""
        return tuple((abs(rate) + self.r * more) * UP for rate, more in zip(self.dq, a, strict=True))

    def follows(self, a: Sequence[float]) -> Six:
        """Bound of |q''| that follows from the bound a."""
        w = self.rates(a)
        one, two = self._lever.second(w, a, w), self._lever.first(w, a)
        change = self._gained((one[0] + two[0], one[1] + two[1]))
        off = self._off(w, a, a)
        return tuple(
            (abs(bent) + self.r * x + y) * UP for bent, x, y in zip(self.ddq, change, off, strict=True)
        )  # of J' q', then of J

    def follows_third(self, a: Sequence[float], b: Sequence[float]) -> Six:
        """Bound of |q'''| that follows from the bound b, where a bounds |q''|."""
        w = self.rates(a)
        one, two = self._lever.second(w, a, w), self._lever.first(w, a)
        constant = self._gained((one[0] + 2 * two[0], one[1] + 2 * two[1]))
        return tuple((x + y) * UP for x, y in zip(constant, self._off(w, a, b), strict=True))

    def _gained(self, pair: tuple[float, float]) -> Six:
        return tuple(g * pair[0] + h * pair[1] for g, h in self.middle.gain)

    def _off(self, w: Sequence[float], a: Sequence[float], x: Sequence[float]) -> Six:
        """Bound of |G (J - J(m))| x."""
        second = self._gained(self._lever.second(w, a, x))
        half = 0.5 * self.r * self.r
        return tuple(self.r * m + half * s for m, s in zip(times(self._mixed, x), second, strict=True))

    def near(self, node: int, a: Sequence[float]) -> tuple[Six, Six]:
        """Joint angles of the path at this place of the piece, and the bound of their error."""
        off = (node - self.low) / GRID - self.r
        half = 0.5 * off * off
        at = tuple(q + off * rate for q, rate in zip(self.middle.q, self.dq, strict=True))
        return at, tuple(half * most * UP + slip for most, slip in zip(a, self._slip, strict=True))


def contraction(lever: Lever, node: CheckerStance, within: Sequence[float]) -> float:
    """Factor by which Newton's map from `node` shrinks distances nearby.

    Below 1, a single point within twice `within` of it solves a pose.

    Both points are at most `within` from a third one, joint by joint.
    """
    wide = [2 * most for most in within]
    angle = sum(wide)
    if not angle <= ANGLE_MOST:
        return 1.0
    linear, angular = lever.first(wide, ONES)
    angular += BEND_OF_LOG * angle * len(wide)
    return max(g * linear + h * angular for g, h in node.gain)
