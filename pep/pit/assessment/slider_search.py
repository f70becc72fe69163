"""Highest setting of the speed slider at which the rest of a motion stays inside the authorised index.

Slowing down takes time. So a lower speed suffices only when the arm's way meanwhile at the present speed is inside,
too, up to the place where it could still be stopped if it did not slow down. Each speed is proven with the same search
as the answer itself, never interpolated.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from pep.pit.assessment.straight_remaining import FULL, JOINT_LIMIT, OFF_PATH, PERCEPTION, Pace, Remaining
from pep.pit.base.errors import WorkLimitError

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit.assessment.straight_remaining import RemainingMotion
    from pep.pit.scene.cell import CellParameters

TINY: Final = 1e-9  # of a step: rounding of a quotient
PLACES: Final = 9  # of a decimal fraction: far finer than any slider, and a whole number of steps again
WHATEVER_THE_SPEED: Final = frozenset({JOINT_LIMIT, OFF_PATH, PERCEPTION})
"""Causes against a motion at any speed."""


def paced(left: RemainingMotion, cell: CellParameters, running: float, *, spare: Callable[[], None]) -> Remaining:
    """Answer at the arm's present speed, with the highest speed at which it would hold.

    Args:
        left: prepared.
        cell: the slider's numbers.
        running: highest fraction of the commanded speed that the arm can have before it is told another one.
        spare: raises `WorkLimitError` once there is no time left to look for more: the best proven so far is told.
    """
    now = left.at(running)
    # A caller that waits for a no is about to stop the arm: the search from here on may not cost much.
    left.check_time = spare
    if now.holds:
        return replace(now, pace=_higher(left, cell, Pace(running, now.index_milli)))
    if now.cause in WHATEVER_THE_SPEED:
        return now
    return replace(now, pace=_lower(left, cell, running))


def steps(cell: CellParameters, *, above: float, below: float) -> list[float]:
    """Settings of the slider strictly between the two, none slower than the least useful one."""
    whole = round(FULL / cell.slider_step)
    settings = (round(k * cell.slider_step, PLACES) for k in range(1, whole + 1))
    return [each for each in settings if max(above, cell.slowest_fraction - TINY) < each < below - TINY]


def _higher(left: RemainingMotion, cell: CellParameters, found: Pace) -> Pace:
    """Highest speed at or above the one that is proven to hold."""
    if not found.fraction < FULL - TINY:
        return found
    faster = [*steps(cell, above=found.fraction + TINY, below=FULL), FULL]
    return _highest(left, faster, found)


def _lower(left: RemainingMotion, cell: CellParameters, running: float) -> Pace | None:
    """Highest speed below `running` to which the arm may slow down, or None when it has to stop."""
    slower = steps(cell, above=0.0, below=running)
    try:
        near = left.near(running, cell.slowing_s(running) + cell.reaction_s)
    except WorkLimitError:
        return None
    if not near.holds or not slower:
        return None
    found = _proven(left, slower[0])
    if found is None:
        return None
    found = _highest(left, slower[1:], found)
    return replace(found, index_milli=max(found.index_milli, near.index_milli))


def _highest(left: RemainingMotion, fractions: list[float], found: Pace) -> Pace:
    """Highest of these fractions that holds, by bisection from the top.

    A fraction that fails does so at each higher one (PHY-13). Where that is not so, a lower one is told; the told one
    is always proven.
    """
    low, high = 0, len(fractions)
    while low < high:
        # The top first: most often no person is near any more.
        middle = high - 1 if high == len(fractions) else (low + high) // 2
        better = _proven(left, fractions[middle])
        if better is None:
            high = middle
        else:
            found, low = better, middle + 1
    return found


def _proven(left: RemainingMotion, fraction: float) -> Pace | None:
    """This speed, when all of the rest is proven to hold at it in time."""
    try:
        answer = left.at(fraction)
    except WorkLimitError:
        return None
    return Pace(fraction, answer.index_milli) if answer.holds else None
