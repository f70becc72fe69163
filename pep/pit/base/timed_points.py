"""Checks of a timed trajectory's points that hold for every arm."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, Final

from pep.base.operation_row import MILLION
from pep.pit.base.errors import MotionError
from pep.pit.base.motion import JointTrajectory

JOINTS: Final = 6  # of a UR arm
POINTS_LEAST: Final = 2  # where it begins and where it ends
POINTS_MOST: Final = 256  # PHY-64: as many as a list of a request may have
DURATION_MOST_S: Final = 120.0  # PHY-64: ours; a longer trajectory is several
CLOSEST_S: Final = 0.001  # PHY-64: ours, between two points: half a cycle of the controller
GRAIN: Final = 1 - 1e-9  # of a time: rounding of a difference
STILL_RAD_S: Final = 1e-6  # one unit of the wire (urad/s)


def on_grid(motion: JointTrajectory) -> JointTrajectory:
    """The trajectory in whole millionths of its units, as a request has it.

    What has no such form stays as it is.
    """

    def rounded(row: tuple[float, ...]) -> Any:
        return tuple(round(each * MILLION) / MILLION if math.isfinite(each) else each for each in row)

    return JointTrajectory(
        rounded(motion.times_s), tuple(map(rounded, motion.points)), tuple(map(rounded, motion.speeds))
    )


def refuse_many(count: int) -> None:
    """Checks that there are no more points than a trajectory may have.

    Raises:
        MotionError: `OUT_OF_RANGE`.
    """
    if count > POINTS_MOST:
        raise MotionError(
            "OUT_OF_RANGE", f"point {POINTS_MOST}: at most {POINTS_MOST} points; leave some out, or cut it in two"
        )


def refuse_untimed(motion: JointTrajectory) -> None:
    """Checks that there are some points, not too many, each later than the one before, from rest to rest.

    Raises:
        MotionError: otherwise, naming the point, and what would do.
    """
    times, points, speeds = motion.times_s, motion.points, motion.speeds
    if not (len(points) >= POINTS_LEAST and len(times) == len(points) and len(speeds) in (0, len(points))):
        raise MotionError(
            "PARAMETERS_WRONG", "two points or more are needed, each with a time, and all or none with speeds"
        )
    refuse_many(len(points))
    for number, row in enumerate((*points, *speeds)):
        if len(row) != JOINTS:
            raise MotionError("PARAMETERS_WRONG", f"point {number % len(points)}: six joint angles are needed")
        if not all(math.isfinite(each) for each in row):
            raise MotionError("NOT_FINITE", f"point {number % len(points)}: an angle or a speed")
    for number, time in enumerate(times):
        if not math.isfinite(time):
            raise MotionError("NOT_FINITE", f"point {number}: its time")
    if times[0] != 0:
        raise MotionError("OUT_OF_RANGE", "point 0: it is at time 0, and is where the arm stands")
    for number, (before, after) in enumerate(pairwise(times), 1):
        if not after - before >= CLOSEST_S * GRAIN:
            raise MotionError(
                "OUT_OF_RANGE", f"point {number}: at {after} s, not {CLOSEST_S} s or more after the one before"
            )
    if not times[-1] <= DURATION_MOST_S:
        raise MotionError("OUT_OF_RANGE", f"point {len(points) - 1}: at {times[-1]} s; at most {DURATION_MOST_S} s")
    for number in (0, -1) if speeds else ():
        if not max(map(abs, speeds[number])) <= STILL_RAD_S:
            raise MotionError(
                "OUT_OF_RANGE", f"point {number % len(points)}: a trajectory begins and ends at rest, with speeds 0"
            )
