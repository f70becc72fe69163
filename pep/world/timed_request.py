"""Timed trajectory as a request has it, and the trajectory of such a request: integers of units, both ways exact."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from capabilities.values.arguments import Argument
from pep.base.operation_row import MILLION
from pep.base.operations import FOLLOW_TRAJECTORY, JOINTS
from pep.pit import JointTrajectory
from pep.pit.base.errors import MotionError
from pep.pit.base.timed_points import on_grid
from pep.pit.path.timed_curve import curve_of
from pep.request.permit import START_TOLERANCE_RAD
from policies.evidence.model import Request

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capabilities.values.arguments import Value
    from capabilities.values.units import Quantity

UP: Final = 1e-9
"""Relative: what a stated greatest speed is larger than the curve's, so that rounding is not above it."""


def trajectory_of(request: Request) -> JointTrajectory:
    """The trajectory of a request of `ur3e.follow_trajectory`.

    Raises:
        MotionError: `OUT_OF_RANGE`, the joints have not all a value at each time.
    """
    times, *joints = _lists(request)
    points, speeds = joints[:JOINTS], joints[JOINTS:]
    if {len(row) for row in points} != {len(times)} or {len(row) for row in speeds} not in ({0}, {len(times)}):
        raise MotionError(
            "OUT_OF_RANGE", "lists of other lengths: six joint angles at each time, and as many speeds or none"
        )
    return JointTrajectory(_si(times), _rows(points), _rows(speeds))


def _lists(request: Request) -> tuple[tuple[int, ...], ...]:
    """Times, angles of each joint and speeds of each joint, in their units."""
    return tuple(each.value for each in request.values if isinstance(each.value, tuple))  # type: ignore[misc]  # of integers


def _rows(columns: Sequence[tuple[int, ...]]) -> Any:
    """The joints' lists as points, in SI units."""
    return tuple(_si(row) for row in zip(*columns, strict=True))


def _si(row: Any) -> Any:
    return tuple(value / MILLION for value in row)


def refuse_faster(request: Request, motion: JointTrajectory) -> None:
    """Checks that the curve through the points keeps to the greatest speed and acceleration that the request states.

    Raises:
        MotionError: `OUT_OF_RANGE`, with the numbers that it needs.
    """
    curve = curve_of(motion)
    speed, acceleration = (each.value / MILLION for each in request.quantities)
    if not (curve.fastest_rad_s <= speed and curve.hardest_rad_s2 <= acceleration):
        raise MotionError(
            "OUT_OF_RANGE",
            f"it goes at up to {curve.fastest_rad_s:.4f} rad/s and {curve.hardest_rad_s2:.4f} rad/s2; the request says "
            f"{speed} and {acceleration}",
        )


def refuse_elsewhere(motion: JointTrajectory, here: Sequence[float]) -> None:
    """Checks that the first point is where the arm stands, each joint within 2 mrad.

    Raises:
        MotionError: `OUT_OF_RANGE`, with the joint and where the arm stands.
    """
    for at, (first, now) in enumerate(zip(motion.start, here, strict=True)):
        if not abs(first - now) <= START_TOLERANCE_RAD:
            raise MotionError(
                "OUT_OF_RANGE",
                f"point 0: joint {at} at {first:.4f} rad, and the arm stands at {now:.4f}; plan from where it stands",
            )


def end_urad(request: Request) -> tuple[int, ...]:
    """Joint angles of the last point, microradian; () where there is none."""
    return tuple(row[-1] for row in _lists(request)[1 : 1 + JOINTS] if row)


def arguments_of(motion: JointTrajectory) -> dict[str, Any]:
    """Arguments of the tool `follow_trajectory` for this trajectory, with the least speed and acceleration that do."""
    motion = on_grid(motion)
    curve = curve_of(motion)
    return {
        "times_s": list(motion.times_s),
        "positions_rad": [list(point) for point in motion.points],
        "velocities_rad_s": [list(row) for row in motion.speeds],
        "speed_rad_s": _up(curve.fastest_rad_s),
        "acceleration_rad_s2": _up(curve.hardest_rad_s2),
    }


def _up(number: float) -> float:
    return -int(-(number * (1 + UP) * MILLION + 1)) / MILLION


def request_of(motion: JointTrajectory, *, speed: Quantity, acceleration: Quantity, audience: str) -> Request:
    """The request that sends exactly this trajectory, for its digest.

    Args:
        motion: about to be sent.
        speed: greatest one that was decided.
        acceleration: likewise.
        audience: canonical URL of the server that decided.
    """
    nothing: tuple[tuple[float, ...], ...] = ((),) * JOINTS
    speeds = zip(*motion.speeds, strict=True) if motion.speeds else nothing
    columns: tuple[tuple[float, ...], ...] = (motion.times_s, *zip(*motion.points, strict=True), *speeds)
    operation = FOLLOW_TRAJECTORY
    lists: list[Value] = [
        Argument(parameter.name, parameter.kind, tuple(round(each * MILLION) for each in column))  # type: ignore[arg-type]  # of lists
        for parameter, column in zip(operation.parameters, columns, strict=False)
    ]
    return Request("", frozenset(), audience, operation.object, operation.name, (*lists, speed, acceleration), 0.0)
