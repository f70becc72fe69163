"""Trajectories as planners, spreadsheets and learning programs write them, read strictly.

A `trajectory_msgs/JointTrajectory` (also inside MoveIt's `RobotTrajectory`) as JSON or YAML, rows of a CSV file, and
actions as a LeRobot dataset has them. Joints are found by name and put in the arm's order; what is unknown, missing or
without effect on the arm is refused, with the point or line at which it stands.
"""

from __future__ import annotations

import csv
import io
import math
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from pydantic import Field, TypeAdapter, create_model

from pep.pit.base.motion import JointTrajectory
from pep.pit.base.strict import STRICT
from pep.pit.base.timed_points import JOINTS, on_grid, refuse_many, refuse_untimed
from pep.pit.files.plain_file import FileError, formed

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import PurePath

FORM: Final = "ztpm-trajectory/1"
CSV: Final = ".csv"
TIME: Final = "time_s"
ENDINGS: Final = ("", "_joint", ".pos")
"""Endings after the arm's own name of a joint: none, or those of vendors' ROS descriptions and of LeRobot."""
NANO: Final = 1e-9  # s

_Six = Annotated[tuple[float, ...], Field(min_length=JOINTS, max_length=JOINTS)]
_SixOrNone = Annotated[tuple[float, ...], Field(max_length=JOINTS)]
_Names = Annotated[tuple[str, ...], Field(min_length=1, max_length=2 * JOINTS)]
_Seconds = Annotated[int, Field(ge=0, le=86_400)]
_Nanoseconds = Annotated[int, Field(ge=0, le=999_999_999)]


def _model(name: str, what: str, **members: Any) -> Any:
    return create_model(name, __config__=STRICT, __doc__=what, **members)


_Time: Any = _model("Time", "As ROS 2 spells a duration.", sec=(_Seconds, ...), nanosec=(_Nanoseconds, ...))
_OldTime: Any = _model("OldTime", "As ROS 1 spells a duration.", secs=(_Seconds, ...), nsecs=(_Nanoseconds, ...))
_Header: Any = _model(
    "Header", "Its time must be 0: a trajectory begins at once.", stamp=(_Time | _OldTime, ...), frame_id=(str, ""),
    seq=(int, 0),
)  # fmt: skip
_Point: Any = _model(
    "TrajectoryPoint",
    "Where the joints are at a time. Accelerations are read and not followed: the curve has its own.",
    positions=(_Six, ...),
    velocities=(_SixOrNone, ()),
    accelerations=(_SixOrNone, ()),
    effort=(Annotated[tuple[float, ...], Field(max_length=0)], ()),
    time_from_start=(_Time | _OldTime, ...),
)
_Message: Any = _model(
    "JointTrajectory",
    "A trajectory_msgs/JointTrajectory message.",
    header=(_Header | None, None),
    joint_names=(_Names, ...),
    points=(tuple[_Point, ...], ...),
)
_Nothing: Any = _model(
    "MultiDOFJointTrajectory", "Must be empty: it moves no joint of the arm.",
    header=(_Header | None, None),
    joint_names=(Annotated[tuple[str, ...], Field(max_length=0)], ()),
    points=(Annotated[tuple[str, ...], Field(max_length=0)], ()),
)  # fmt: skip
_Plan: Any = _model(
    "RobotTrajectory",
    "A moveit_msgs/RobotTrajectory message.",
    joint_trajectory=(_Message, ...),
    multi_dof_joint_trajectory=(_Nothing | None, None),
)
_Actions: Any = _model(
    "Actions",
    "Rows of the column `action` of a LeRobot dataset, in rad, one each 1/fps s; the first is where the arm stands.",
    fps=(Annotated[float, Field(gt=0, le=1000)], ...),
    names=(_Names, ...),
    action=(tuple[_Six, ...], ...),
    unit=(Literal["rad"], ...),
)
ADAPTERS: Final[dict[str, TypeAdapter[Any]]] = {
    "joint_trajectory": TypeAdapter(_Plan),
    "joint_names": TypeAdapter(_Message),
    "action": TypeAdapter(_Actions),
}
"""Form of each kind of file, by a member that it alone has."""
ADAPTER: Final[TypeAdapter[Any]] = TypeAdapter(_Plan | _Message | _Actions)
"""Any of them, for the published schema."""


def is_trajectory(value: object) -> bool:
    """True where a file's value is in one of these forms, or means to be."""
    return isinstance(value, dict) and "form" not in value and any(word in value for word in ADAPTERS)


def trajectory_of(value: object, joints: Sequence[str]) -> JointTrajectory:
    """The trajectory that a file's value states.

    Args:
        value: plain.
        joints: the arm's names of its joints, in its order.

    Raises:
        FileError: none of the forms, or joints that are not the arm's; with the place.
        MotionError: points that are no trajectory.
    """
    assert isinstance(value, dict)
    word = next(word for word in ADAPTERS if word in value)
    if word != "action":
        refuse_many(len(_listed(_listed(value, "joint_trajectory") if word == "joint_trajectory" else value, "points")))
    else:
        refuse_many(len(_listed(value, "action")))
    stated = formed(ADAPTERS[word], value, place="trajectory")
    if word == "action":
        order = _order(stated.names, joints, "names")
        times = tuple(number / stated.fps for number in range(len(stated.action)))
        return _checked(times, [_sorted(row, order) for row in stated.action], [])
    return _of_message(stated.joint_trajectory if word == "joint_trajectory" else stated, joints)


def _listed(value: Any, name: str) -> Any:
    found = value.get(name) if isinstance(value, dict) else None
    return found if isinstance(found, (list, dict)) else ()


def _of_message(stated: Any, joints: Sequence[str]) -> JointTrajectory:
    order = _order(stated.joint_names, joints, "joint_names")
    if stated.header is not None and any(_seconds(stated.header.stamp)):
        raise FileError("OUT_OF_RANGE", "header.stamp", "a trajectory begins at once: 0")
    with_speed = [bool(point.velocities) for point in stated.points]
    for number, point in enumerate(stated.points):
        if with_speed[number] != with_speed[0]:
            raise FileError("PARAMETERS_WRONG", f"point {number}", "velocities at every point, or at none")
        for name in ("velocities", "accelerations"):
            if len(getattr(point, name)) not in (0, JOINTS):
                raise FileError("PARAMETERS_WRONG", f"point {number}", f"{name} of {JOINTS} joints, or none")
    return _checked(
        tuple(whole + NANO * part for whole, part in (_seconds(point.time_from_start) for point in stated.points)),
        [_sorted(point.positions, order) for point in stated.points],
        [_sorted(point.velocities, order) for point in stated.points if point.velocities],
    )


def _seconds(time: Any) -> tuple[int, int]:
    return (time.sec, time.nanosec) if isinstance(time, _Time) else (time.secs, time.nsecs)


def trajectory_of_csv(text: str, name: PurePath, joints: Sequence[str]) -> JointTrajectory:
    """The trajectory that the rows of a CSV file state.

    The header is `time_s` and the joints, `q0` to `q5` or by name; then none of the speeds or all of them, `qd0` to
    `qd5` or `NAME_velocity`.

    Raises:
        FileError: another header, a row of another length, or a number that is none; with the line.
        MotionError: points that are no trajectory.
    """
    rows = csv.reader(io.StringIO(text, newline=""), strict=True)
    place = name.name
    try:
        header = [word.strip() for word in next(rows, [])]
        if header[:1] != [TIME] or len(header) not in (1 + JOINTS, 1 + 2 * JOINTS):
            what = f"the header is {TIME} and {JOINTS} joints, then their speeds or none"
            raise FileError("PARAMETERS_WRONG", f"{place}, line 1", what)
        order = _columns(header[1 : 1 + JOINTS], joints, [f"q{at}" for at in range(JOINTS)], place)
        speeds = [word.removesuffix("_velocity") for word in header[1 + JOINTS :]]
        quick = _columns(speeds, joints, [f"qd{at}" for at in range(JOINTS)], place) if speeds else []
        found: list[list[float]] = []
        for row in rows:
            if not row:
                continue
            refuse_many(len(found) + 1)
            found.append(_numbers(row, len(header), f"{place}, line {rows.line_num}"))
    except csv.Error as error:
        raise FileError("BODY_MALFORMED", f"{place}, line {rows.line_num}", "not CSV") from error
    return _checked(
        tuple(row[0] for row in found),
        [_sorted(row[1 : 1 + JOINTS], order) for row in found],
        [_sorted(row[1 + JOINTS :], quick) for row in found if quick],
    )


def _columns(words: list[str], joints: Sequence[str], short: list[str], place: str) -> list[int]:
    return list(range(JOINTS)) if words == short else _order(words, joints, f"{place}, line 1")


def _numbers(row: list[str], count: int, place: str) -> list[float]:
    if len(row) != count:
        raise FileError("PARAMETERS_WRONG", place, f"{len(row)} values, the header has {count}")
    found: list[float] = []
    for word in row:
        try:
            number = float(word) if word.strip().isascii() and "_" not in word else math.nan
        except ValueError as error:
            raise FileError("NOT_A_NUMBER", place, f"{word[:40]!r} is no number") from error
        if not math.isfinite(number):
            raise FileError("NOT_FINITE", place, f"{word[:40]!r} is no finite number")
        found.append(number)
    return found


def _order(names: Sequence[str], joints: Sequence[str], place: str) -> list[int]:
    """Place of each of the arm's joints among these names."""
    known = {joint + ending: at for at, joint in enumerate(joints) for ending in ENDINGS}
    which = [known.get(name) for name in names]
    if None in which:
        unknown = names[which.index(None)]
        raise FileError("PARAMETERS_WRONG", place, f"no joint {unknown[:60]!r}; the arm has {', '.join(joints)}")
    if sorted(at for at in which if at is not None) != list(range(len(joints))):
        missing = [joint for at, joint in enumerate(joints) if at not in which]
        what = f"without {', '.join(missing)}" if missing else "a joint twice"
        raise FileError("PARAMETERS_WRONG", place, what)
    return [which.index(at) for at in range(len(joints))]


def _sorted(row: Sequence[float], order: list[int]) -> Any:
    return tuple(float(row[at]) for at in order)


def _checked(times: tuple[float, ...], points: list[Any], speeds: list[Any]) -> JointTrajectory:
    """The trajectory in whole millionths of its units, as a request has it: one answer for file and gateway."""
    made = on_grid(JointTrajectory(times, tuple(points), tuple(speeds)))
    refuse_untimed(made)
    return made
