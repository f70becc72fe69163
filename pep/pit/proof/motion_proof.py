"""A motion of the arm as a proof spells it: its form and its numbers, each exact (PHY-30)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias, assert_never

from pep.pit.base.motion import JointPath, JointTrajectory, LinePath, MoveJ, MoveL, ServoJ, SpeedJ, SpeedL

if TYPE_CHECKING:
    from collections.abc import Iterable

Moving: TypeAlias = MoveJ | SpeedJ | MoveL | SpeedL | ServoJ | JointPath | LinePath | JointTrajectory
"""Motions of the whole arm."""


def hex_of(number: float) -> str:
    """The exact spelling of a number."""
    return float(number).hex()


def hexed(numbers: Iterable[float]) -> list[str]:
    """The exact spelling of each number."""
    return [hex_of(number) for number in numbers]


def motion_text(motion: Moving) -> dict[str, Any]:
    """The motion's form and its numbers."""
    match motion:
        case MoveJ(start, target, speed, acceleration):
            return {
                "form": "move_j",
                "start": hexed(start),
                "target": hexed(target),
                "speed_rad_s": hex_of(speed),
                "acceleration_rad_s2": hex_of(acceleration),
            }
        case SpeedJ(start, speeds, acceleration, duration):
            return {
                "form": "speed_j",
                "start": hexed(start),
                "qd_rad_s": hexed(speeds),
                "acceleration_rad_s2": hex_of(acceleration),
                "duration_s": hex_of(duration),
            }
        case MoveL(start, target, speed, acceleration, stated):
            return {
                "form": "move_l",
                "start": hexed(start),
                "target": hexed(target),
                "speed_m_s": hex_of(speed),
                "acceleration_m_s2": hex_of(acceleration),
                "stated_start": None if stated is None else hexed(stated),
            }
        case SpeedL(start, twist, acceleration, duration):
            return {
                "form": "speed_l",
                "start": hexed(start),
                "twist": hexed(twist),
                "acceleration_m_s2": hex_of(acceleration),
                "duration_s": hex_of(duration),
            }
        case ServoJ(start, speeds, target, period, lookahead):
            return {
                "form": "servo_j",
                "start": hexed(start),
                "qd_rad_s": hexed(speeds),
                "target": hexed(target),
                "period_s": hex_of(period),
                "lookahead_s": hex_of(lookahead),
            }
        case JointPath(start, joint_legs):
            return {
                "form": "joint_path",
                "start": hexed(start),
                "legs": [
                    {
                        "target": hexed(leg.target),
                        "speed_rad_s": hex_of(leg.speed_rad_s),
                        "acceleration_rad_s2": hex_of(leg.acceleration_rad_s2),
                    }
                    for leg in joint_legs
                ],
            }
        case LinePath(start, line_legs):
            return {
                "form": "line_path",
                "start": hexed(start),
                "legs": [
                    {
                        "target": hexed(leg.target),
                        "speed_m_s": hex_of(leg.speed_m_s),
                        "acceleration_m_s2": hex_of(leg.acceleration_m_s2),
                    }
                    for leg in line_legs
                ],
            }
        case JointTrajectory(times, points, rates):
            return {
                "form": "joint_trajectory",
                "times_s": hexed(times),
                "points": [hexed(point) for point in points],
                "speeds": [hexed(row) for row in rates],
            }
        case _:
            assert_never(motion)
