"""Highest sufficient speed of a motion whose commanded one fails."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pep.pit.base.errors import WorkLimitError
from pep.pit.search.certify import SPEED_STEPS

if TYPE_CHECKING:
    from collections.abc import Callable


def highest_speed(falls: Callable[[float], bool], *, slowest: float, fastest: float) -> float | None:
    """Highest speed, to a step of the bisection, that `falls` proves; None when the slowest fails.

    This is advice: when time runs out, the best speed proven so far is named, and the answer itself stands.

    Args:
        falls: whether it is proven of this speed; one that fails does so at any higher one.
        slowest: a slower one is of no use.
        fastest: the commanded speed, which fails.
    """
    if not fastest > slowest:
        return None
    proven: float | None = None
    try:
        if falls(slowest):
            proven = slowest
            for _ in range(SPEED_STEPS):
                middle = 0.5 * (proven + fastest)
                if falls(middle):
                    proven = middle
                else:
                    fastest = middle
    except WorkLimitError:
        return proven
    return proven
