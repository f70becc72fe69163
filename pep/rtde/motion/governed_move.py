"""Move under a governor: its least speed, and the speed slider put back once the arm stands."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.rtde.robot.newest_state import SILENCE_MS
from pep.rtde.robot.state_receiver import STILL_RAD_S
from pep.watch.governor import Governor

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.base.ports import Clock
    from pep.rtde.robot.newest_state import NewestState
    from pep.watch.governor import Pacing, Slider

ARRIVED_RAD: Final = 1e-3
"""A joint this near to its target has arrived; the controller holds about a tenth of it."""
FASTER_THAN_STILL: Final = 2.0
"""A slowed arm goes at least this many times as fast as one that counts as standing."""
PUT_BACK_MS: Final = 500
"""Longest wait for the slider to be seen at its old place; it takes two packages of the controller."""
PAUSE_S: Final = 0.004
"""Pause between two looks at the slider: two packages of the controller."""


@dataclass(frozen=True, slots=True)
class SpeedControl:
    """Means to slow a motion down.

    Attributes:
        slider: of the controller.
        pacing: of the cell.
    """

    slider: Slider
    pacing: Pacing

    def governor(self, arm: NewestState, *, least: float, clock: Clock) -> Governor:
        """Governor of a motion that is about to begin; below the fraction `least` of its speed it is stopped."""
        now = clock.monotonic_ms()
        return Governor(self.slider, pacing=self.pacing, least=least, speeds=arm.speeds, now_ms=now)


def least_fraction(speed_rad_s: float, acceleration_rad_s2: float) -> float:
    """Least fraction of its speed at which a move differs from standstill all the way to its target.

    While it brakes it counts as standing once it is slower than `STILL_RAD_S`; by then it has to have arrived.
    """
    return max(
        FASTER_THAN_STILL * STILL_RAD_S / speed_rad_s,
        STILL_RAD_S / math.sqrt(2 * acceleration_rad_s2 * ARRIVED_RAD),
    )


def put_back(governor: Governor, arm: NewestState, *, clock: Clock, pause: Callable[[float], None]) -> None:
    """Puts the speed slider back where it was, unless the robot is silent or its arm may still move."""
    arm.look()
    if arm.silent_ms > SILENCE_MS or not arm.state.still:
        return
    now = clock.monotonic_ms()
    until_ms = now + PUT_BACK_MS
    governor.end(now_ms=now)
    while not governor.put_back(arm.speeds, now_ms=now) and now < until_ms:
        pause(PAUSE_S)
        arm.look()
        now = clock.monotonic_ms()
