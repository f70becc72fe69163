"""What a call of ur_rtde's control interface says, as the command that it would be on the wire, and back.

A call is written into the registers that ur_rtde would write, and read from there by the fields that read every
client: a parameter has one meaning and one limit, whichever way it comes. Nothing here knows a robot.
"""

from __future__ import annotations

import operator
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Final, TypeAlias, cast

from pep.rtde.command import command_values as v
from pep.rtde.command.command_table import ROWS, decode, row_of
from pep.rtde.command.fields import Fixed, Flag, Flags, FrameNumber, Number, Numbers, Vector, Whole
from pep.rtde.command.register_image import Image
from pep.rtde.script.move_path import PathBlock, PathMove
from pep.rtde.wire.recipes import INT, Profile
from pep.rtde.wire.refusal import Refused
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.rtde.command.command_values import Command
    from pep.rtde.command.fields import Field
    from pep.rtde.script.move_path import Waypoint
    from pep.rtde.wire.codec import Value

Call: TypeAlias = tuple[str, list[Any]]
"""A method's name and its arguments."""

_BLANK: Final = Image.blank(Profile.of(0, control=True, io=False))
_UNUSED: Final = (0.0, 0.0)
"""Speed and acceleration of servoJ and servoL: sent, and not used by the control script."""
WAYPOINT: Final = 9
"""Numbers of a waypoint in a list: its target, speed, acceleration and blend."""


def command_of(number: int, *values: Any) -> Command | Refused:
    """The command of a call.

    Args:
        number: its id, of one that has no choice between ids.
        values: its parameters, in the order of the command's own, in ur_rtde's units.

    Returns:
        Refused as `pep.rtde.command.command_table.decode` does, and as `PARAMETERS_WRONG` for a vector of another
        length or a choice that there is not.

    Raises:
        TypeError: for what is no number, as ur_rtde itself does.
    """
    row = ROWS[number]
    written: dict[str, Value] = {INT[0]: number}
    said = [field for field in row.fields if not isinstance(field, Fixed)]
    for field, value in zip(said, values, strict=True):
        try:
            written |= field.write(_typed(field, value), 0)
        except ValueError:
            return Refused(Reason.PARAMETERS_WRONG, row.name, number)
    image = _BLANK.merge(written)
    return image if isinstance(image, Refused) else decode(image)


def _typed(field: Field, value: Any) -> object:
    match field:
        case Number():
            return float(value)
        case Numbers() | Vector():
            return tuple(float(item) for item in value)
        case Whole():
            return operator.index(value)
        case Flag():
            return bool(value)
        case Flags():
            return tuple(_flag(operator.index(item)) for item in value)
        case FrameNumber():
            return v.JogFrame(int(value))
        case _:
            return value


def _flag(number: int) -> bool:
    if number not in (0, 1):
        raise ValueError(number)
    return number == 1


def call_of(command: Command) -> Call:
    """The call that says a command; of a path, without it."""
    values = [_plain(getattr(command, each.name)) for each in fields(cast("Any", command))]
    if isinstance(command, v.Read | v.End):
        values.clear()
    if isinstance(command, v.ServoJ | v.ServoL):
        values[1:1] = _UNUSED
    return row_of(command).name, values


def _plain(value: Any) -> Any:
    match value:
        case tuple():
            return [int(item) if isinstance(item, bool) else item for item in value]
        case v.JogFrame():
            return value.value
        case _:
            return value


def waypoints_of(path: Any) -> tuple[Waypoint, ...] | Refused:
    """Where a path goes, as its text in the control script says: with six significant digits.

    Args:
        path: `rtde_control.Path`.

    Returns:
        Refused as `pep.rtde.script.move_path.PathBlock` does.
    """
    block = PathBlock()
    for line in path.toScriptCode().encode("ascii", "replace").splitlines():
        refused = block.line(line)
        if refused is not None:
            return refused
    return tuple(block.waypoints)


def path_of(move: PathMove, waypoints: Sequence[Sequence[float]]) -> Any:
    """The `rtde_control.Path` that `moveJ` or `moveL` makes of a list; None for one that is no list of waypoints."""
    from rtde_control import Path

    if not all(len(waypoint) == WAYPOINT for waypoint in waypoints):
        return None
    path = Path()
    rows = [[float(number) for number in waypoint] for waypoint in waypoints]
    (path.appendMovejPath if move is PathMove.MOVEJ else path.appendMovelPath)(rows)
    return path


def rebuilt(waypoints: Sequence[Waypoint]) -> Any:
    """A `rtde_control.Path` of exactly these waypoints, which nobody else holds."""
    from rtde_control import Path, PathEntry

    moves = {
        PathMove.MOVEJ: PathEntry.eMoveType.MoveJ,
        PathMove.MOVEL: PathEntry.eMoveType.MoveL,
        PathMove.MOVEP: PathEntry.eMoveType.MoveP,
    }
    path = Path()
    for each in waypoints:
        kind = PathEntry.ePositionType
        numbers = [*each.target, each.speed, each.acceleration, each.blend_m]
        path.addEntry(
            PathEntry(moves[each.move], kind.PositionTcpPose if each.is_pose else kind.PositionJoints, numbers)
        )
    return path
