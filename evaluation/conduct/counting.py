"""Confidence interval of a count, and quantiles of some numbers."""

from __future__ import annotations

from math import exp, lgamma, log
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

SIDE: Final = 0.025
"""Probability beyond each end of an interval of 95 %."""


def interval(count: int, *, side: float = SIDE) -> tuple[float, float]:
    """Means of a Poisson count that make `count` not surprising (Garwood 1936): both ends."""
    lower = 0.0 if count == 0 else _solved(lambda mean: 1 - _below(count - 1, mean), side)
    return lower, _solved(lambda mean: -_below(count, mean), -side)


def _below(count: int, mean: float) -> float:
    """Probability of at most `count` at this mean."""
    if mean <= 0:
        return 1.0
    return sum(exp(k * log(mean) - mean - lgamma(k + 1)) for k in range(count + 1))


def _solved(rising: Callable[[float], float], wanted: float) -> float:
    low, high = 0.0, 1.0
    while rising(high) < wanted:
        high *= 2
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if rising(middle) < wanted else (low, middle)
    return high


def quantile(values: Sequence[int], permille: int) -> int:
    """The least of the values that so many permille of them are not above."""
    ordered = sorted(values)
    return ordered[max(0, -(-len(ordered) * permille // 1000) - 1)]
