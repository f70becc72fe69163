"""Measurement of a stop from samples of the controller, and its comparison with the one stop model."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from pep.base.stop_model import STOP_DECELERATION_RAD_S2, STOP_DELAY_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ztpm.stage.samples import Sample

HARDER: Final = 2.0
"""Ratio of a stop's braking to the motion's own ramp, at least.

8 rad/s2 against at most 1.4, so 2.8 divides.
"""
BAR_S: Final = 0.150
"""From the end of authority to commanded deceleration (DESIGN section 8, stop times)."""
SAMPLE_S: Final = 0.002
"""Resolution of the controller: a time read from samples may be this much too long."""


@dataclass(frozen=True, slots=True)
class Stopped:
    """One stop.

    Attributes:
        reaction_s: t1 - t0, from the event to the first sample with commanded deceleration.
        braking_s: t2 - t1, from there until all joints are under 1 mrad/s, by the controller's clock.
        speed_rad_s: highest commanded speed of the leading axis from t0 to t1.
        braking_rad: travel of the leading axis from t1.
        travel_rad: travel of the leading axis from t0.
    """

    reaction_s: float
    braking_s: float
    speed_rad_s: float
    braking_rad: float
    travel_rad: float

    @property
    def within_model(self) -> bool:
        """True where time and travel from t1 are inside the stop model.

        T_s = 0.06 s + w/a, and w (0.06 s + w/2a).
        """
        return (
            self.braking_s <= STOP_DELAY_S + self.speed_rad_s / STOP_DECELERATION_RAD_S2 + SAMPLE_S
            and self.braking_rad <= model_rad(self.speed_rad_s)
        )

    @property
    def within_bar(self) -> bool:
        """True where the travel from t0 is inside the model with 150 ms of reaction before it."""
        return self.travel_rad <= self.speed_rad_s * BAR_S + model_rad(self.speed_rad_s)


def model_rad(speed_rad_s: float) -> float:
    """Longest travel of a stop from that speed of the leading axis, rad."""
    return speed_rad_s * (STOP_DELAY_S + speed_rad_s / (2 * STOP_DECELERATION_RAD_S2))


def read_stop(samples: Sequence[Sample], *, at_s: float, acceleration_rad_s2: float) -> Stopped | None:
    """Stop in these samples, or None when the motion ended by itself or had ended before.

    Args:
        samples: of the whole motion, in order, up to standstill.
        at_s: t0, CLOCK_MONOTONIC.
        acceleration_rad_s2: of the motion's own ramp.
    """
    first = next((i for i, s in enumerate(samples) if s.arrived_s >= at_s), None)
    if not first or samples[first - 1].still:
        return None
    braking = _braking(samples, first, acceleration_rad_s2)
    if braking is None:
        return None
    end = next((i for i in range(braking, len(samples)) if samples[i].still), None)
    if end is None:
        return None
    lead = max(range(6), key=lambda joint: abs(samples[braking - 1].target_qd_rad_s[joint]))

    def way(begin: int) -> float:
        return abs(samples[end].q_rad[lead] - samples[begin].q_rad[lead])

    return Stopped(
        reaction_s=samples[braking].arrived_s - at_s,
        braking_s=samples[end].stamp_s - samples[braking].stamp_s,
        speed_rad_s=max(s.commanded_rad_s for s in samples[first - 1 : braking + 1]),
        # The sample before is where it still went as commanded: no travel is left out.
        braking_rad=way(braking - 1),
        travel_rad=way(first - 1),
    )


def _braking(samples: Sequence[Sample], first: int, acceleration_rad_s2: float) -> int | None:
    """First sample from `first` on whose commanded speed falls faster than by the motion's own ramp."""
    for i, (before, now) in enumerate(pairwise(samples[first - 1 :]), start=first):
        passed_s = now.stamp_s - before.stamp_s
        if before.commanded_rad_s - now.commanded_rad_s > HARDER * acceleration_rad_s2 * passed_s:
            return i
    return None
