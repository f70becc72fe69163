"""Way of a tool that goes on until a contact, as far as it is granted and may touch.

Nothing rests on the controller's detection of a contact: what is assessed is all of the way to where the arm is stopped
without any ([PHY-60]).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base.errors import MotionError, UnprovenError
from pep.pit.base.motion import SpeedL
from pep.pit.path.straight_path import GRID
from pep.pit.scene.pairs import pairs_of
from pep.pit.search.start_violations import departure
from pep.pit.search.stream_course import speed_drive
from pep.pit.search.timed_course import TimedCourse

if TYPE_CHECKING:
    from pep.pit.base.motion import Joints, Pose
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.pairs import Pairs
    from pep.pit.scene.scene import Scene

STOPL_M_S2: Final = 3.0  # the control script of ur_rtde 1.6.5 stops so at a contact
BACK_M_S2: Final = 1.2  # and then goes back to it at the default of movel
BACK_S: Final = 0.05  # ours: so long ago the contact may have begun when it is noticed
PLACES: Final = 64  # of a way at which what may be touched is looked at
DEPTH_KEPT_M: Final = 0.004  # of the depth of a gentle contact: what the arm does between two places, and in a stop
STOP_KEPT_S: Final = 0.02  # ours: how long a slow tool takes to stop
LEAST_S: Final = 0.02  # ours: less is no motion
SHORTER: Final = (1.0, 0.5, 0.25, 0.125)  # ours
"""Shares of a way at which it is tried, where the arm cannot follow all of it."""


def contact_speed(start: Joints, twist: Pose, acceleration_m_s2: float, distance_m: float) -> SpeedL:
    """Held tool speed of a motion until a contact, for its whole way.

    The arm goes back to the contact by itself: no faster than `twist` made as fast as that, since it is a short way.

    Args:
        start: joint angles, rad.
        twist: commanded velocity of the tool point, m/s, which must not turn.
        acceleration_m_s2: commanded.
        distance_m: that the tool may go.

    Raises:
        MotionError: `OUT_OF_RANGE`, the tool turns or stands.
    """
    speed = math.hypot(*twist[:3])
    if any(twist[3:]) or not speed > 0:
        raise MotionError("OUT_OF_RANGE", "a tool that turns or stands, until a contact")
    back = math.sqrt(BACK_M_S2 * (speed * speed / (2 * STOPL_M_S2) + speed * BACK_S))
    faster = max(1.0, back / speed)
    x, y, z = (faster * part for part in twist[:3])
    return SpeedL(start, (x, y, z, 0.0, 0.0, 0.0), faster * acceleration_m_s2, distance_m / (faster * speed))


def until_contact(
    robot: Robot,
    motion: SpeedL,
    scene: Scene | None,
    cell: CellParameters,
    *,
    touch: frozenset[str],
    speed_m_s: float,
    patience_s: float,
) -> tuple[SpeedL, float]:
    """The motion, as far as the arm can follow and a touch is gentle.

    With it the time, s, after which the tool is to be stopped.

    Args:
        robot: the arm.
        motion: of `contact_speed`.
        scene: the newest valid view, or None.
        cell: its parameters.
        touch: names of objects that the token grants to touch.
        speed_m_s: commanded.
        patience_s: for which the arm may go on after it is to be stopped.

    Raises:
        UnprovenError: not even an eighth of the way can be followed.
        MotionError: `OUT_OF_RANGE`, it is too near to what it may touch for its speed, or begins in a violation.
    """
    fastest, after_s = math.hypot(*motion.twist[:3]), cell.stop_delay_s + STOP_KEPT_S
    for share in SHORTER:
        tried = replace(motion, duration_s=share * motion.duration_s)
        try:
            drive = speed_drive(robot, tried, cell, check_time=_at_any_time)
        except UnprovenError:
            continue
        if isinstance(drive, TimedCourse):
            pairs = pairs_of(robot, cell.surveyed if scene is None else scene, cell, grown_m=0.0, touch=touch)
            if departure(drive.course, pairs, cell, slow=True).retreating.size:
                raise MotionError("OUT_OF_RANGE", "out of a violation, into which it would go back from a contact")
            way = fastest * min(tried.duration_s, _touching_s(drive, pairs, cell))
            held_s, duration_s = way / speed_m_s - patience_s - after_s, way / fastest - after_s
            if not min(held_s, duration_s) >= LEAST_S:
                raise MotionError("OUT_OF_RANGE", "too near to what it may touch for its speed, or a way too short")
            return replace(motion, duration_s=duration_s), held_s
    raise UnprovenError("singular")


def _touching_s(drive: TimedCourse, pairs: Pairs, cell: CellParameters) -> float:
    """Seconds at full speed to where something that may be touched is touched deep; infinite where nothing is."""
    rows = np.flatnonzero(pairs.touchable)
    if not rows.size:
        return math.inf
    deep = -(cell.contact_depth_m - DEPTH_KEPT_M)
    until = round(drive.line_until * GRID)
    for key in np.linspace(0, until, PLACES + 1).astype(np.int64).tolist():
        if float(drive.course.clearance_at(pairs, key, rows).min()) <= deep:
            return float(key / GRID * drive.profile.way_rad)
    return math.inf


def _at_any_time() -> None:
    """The time is looked at when the answer is computed."""
