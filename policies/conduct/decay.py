"""Exponential decay in integers: the same on every machine, and never rising again by rounding.

Time is cut into `TICKS` ticks for each half-life, on a grid that starts at the epoch, so that decaying in two steps is
decaying once: 21 s each for a half-life of one day. The factor of a tick is 2**(-1/TICKS), from integer square roots.
"""

from __future__ import annotations

from itertools import accumulate, repeat
from math import isqrt
from typing import Final

TICKS: Final = 4_096
"""Ticks of one half-life: 64 coarse steps of 64 fine ones."""
_BITS: Final = 62
_ONE: Final = 1 << _BITS


def _root(times: int) -> int:
    """2**(-1/2**times), in units of 2**-62: as many square roots of one half."""
    found = _ONE >> 1
    for _ in range(times):
        found = isqrt(found << _BITS)
    return found


def _powers(base: int) -> tuple[int, ...]:
    """The first 64 powers of `base`, the zeroth first."""
    return tuple(accumulate(repeat(base, 63), lambda product, factor: product * factor >> _BITS, initial=_ONE))


_COARSE: Final = _powers(_root(6))
_FINE: Final = _powers(_root(12))


def ticks_between(since: int, until: int, *, half_life_s: int) -> int:
    """Ticks from one instant to another, seconds since the epoch; 0 when `until` is not later."""
    return max(0, until * TICKS // half_life_s - since * TICKS // half_life_s)


def decayed(amount: int, ticks: int) -> int:
    """Rest of `amount` after as many ticks, rounded down; never more than after fewer."""
    halves, rest = divmod(ticks, TICKS)
    factor = _COARSE[rest >> 6] * _FINE[rest & 63] >> _BITS
    return amount * factor >> (_BITS + halves)
