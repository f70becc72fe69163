"""Path that ur_rtde puts into its control script: two lines for each waypoint, in a grammar without any choice.

A number is written as C++ writes it, with six significant digits. Only that form is taken, so a waypoint has one text
and the text one waypoint.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Final

from capabilities.values.units import Unit, nearest
from pep.rtde.command.fields import BLEND, JOINT_ACCELERATION, JOINT_SPEED, TOOL_ACCELERATION, TOOL_SPEED
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pep.rtde.command.command_values import Six

MAX_WAYPOINTS: Final = 256
"""Ours: as many as a request holds (`pep.base.operations.WAYPOINTS_MOST`)."""
MAX_LINE: Final = 160
"""Bytes of a line without its end; the longest that ur_rtde can write has 139."""


class PathMove(StrEnum):
    """Way to a waypoint."""

    MOVEJ = "movej"
    """Straight in joint space: rad/s and rad/s2 of the leading axis."""
    MOVEL = "movel"
    """Straight in tool space: m/s and m/s2."""
    MOVEP = "movep"
    """Straight in tool space at constant speed: m/s and m/s2."""


@dataclass(frozen=True, slots=True)
class Waypoint:
    """One waypoint of a path.

    Attributes:
        move: way to the waypoint.
        is_pose: whether the target is a pose, else joint angles.
        target: x, y, z [m] and a rotation vector [rad], or six angles [rad].
        speed: in the unit of the move.
        acceleration: in the unit of the move.
        blend_m: radius inside which the next waypoint may begin; 0 is a stop.
    """

    move: PathMove
    is_pose: bool
    target: Six
    speed: float
    acceleration: float
    blend_m: float


_NUMBER: Final = r"(-?(?:[0-9][0-9.]{0,10}(?:e[-+][0-9]{2,3})?|nan|inf))"
_SIGNAL: Final = re.compile(rb"\tsignal_async_progress\((0|[1-9][0-9]{0,4})\)")
_MOVE: Final = re.compile(
    (r"\t(move[jlp])\((p?)\[" + ",".join([_NUMBER] * 6) + rf"\],a={_NUMBER},v={_NUMBER},r={_NUMBER}\)").encode()
)


class PathBlock:
    """Reader of a path, line by line."""

    def __init__(self) -> None:
        self.waypoints: list[Waypoint] = []
        self._announced = False

    @property
    def complete(self) -> bool:
        """True where the path may end here: each announced waypoint has come."""
        return not self._announced

    def line(self, line: bytes) -> InputRefusal | None:
        """Takes the next line, without its end; refused when ur_rtde would not write it, or we do not take it."""
        place = f"waypoint {len(self.waypoints)}"
        if not self._announced:
            found = _SIGNAL.fullmatch(line)
            if found is None or int(found[1]) != len(self.waypoints):
                return InputRefusal(Reason.BODY_MALFORMED, place)
            if len(self.waypoints) == MAX_WAYPOINTS:
                return InputRefusal(Reason.BODY_TOO_LARGE, place)
            self._announced = True
            return None
        waypoint = _waypoint(line, place)
        if isinstance(waypoint, InputRefusal):
            return waypoint
        self.waypoints.append(waypoint)
        self._announced = False
        return None


def _waypoint(line: bytes, place: str) -> Waypoint | InputRefusal:
    found = _MOVE.fullmatch(line)
    if found is None:
        return InputRefusal(Reason.BODY_MALFORMED, place)
    verb, pose, *texts = (group.decode("ascii") for group in found.groups())
    numbers = []
    for text in texts:
        try:
            number = float(text)
        except ValueError:
            return InputRefusal(Reason.BODY_MALFORMED, place)
        if not math.isfinite(number):
            return InputRefusal(Reason.NOT_FINITE, place)
        if _written(number) != text:
            return InputRefusal(Reason.BODY_MALFORMED, place)
        numbers.append(number)
    x, y, z, rx, ry, rz, acceleration, speed, blend_m = numbers
    move = PathMove(verb)
    joint = move is PathMove.MOVEJ
    for value, span in (
        (speed, JOINT_SPEED if joint else TOOL_SPEED),
        (acceleration, JOINT_ACCELERATION if joint else TOOL_ACCELERATION),
        (blend_m, BLEND),
    ):
        if not span.low <= value <= span.high:
            return InputRefusal(Reason.ROBOT_LIMIT, place)
    return Waypoint(move, bool(pose), (x, y, z, rx, ry, rz), speed, acceleration, blend_m)


def path_on_grid(path: Iterable[Waypoint]) -> tuple[Waypoint, ...]:
    """Waypoints with their numbers rounded to whole units of a request."""
    return tuple(map(_rounded, path))


def _rounded(point: Waypoint) -> Waypoint:
    speed, ramp = (
        (Unit.MICRORADIAN_PER_SECOND, Unit.MICRORADIAN_PER_SECOND2)
        if point.move is PathMove.MOVEJ
        else (Unit.MICROMETRE_PER_SECOND, Unit.MICROMETRE_PER_SECOND2)
    )
    x, y, z = (nearest(number, Unit.MICROMETRE if point.is_pose else Unit.MICRORADIAN) for number in point.target[:3])
    rx, ry, rz = (nearest(number, Unit.MICRORADIAN) for number in point.target[3:])
    return replace(
        point,
        target=(x, y, z, rx, ry, rz),
        speed=nearest(point.speed, speed),
        acceleration=nearest(point.acceleration, ramp),
        blend_m=nearest(point.blend_m, Unit.MICROMETRE),
    )


def render_path(path: Iterable[Waypoint]) -> bytes:
    """Lines of a path, each with its end."""
    lines = []
    for index, point in enumerate(path):
        target = ",".join(map(_written, point.target))
        lines.append(f"\tsignal_async_progress({index})\n")
        lines.append(
            f"\t{point.move}({'p' if point.is_pose else ''}[{target}],a={_written(point.acceleration)},"
            f"v={_written(point.speed)},r={_written(point.blend_m)})\n"
        )
    return "".join(lines).encode("ascii")


def _written(number: float) -> str:
    return f"{number:g}"
