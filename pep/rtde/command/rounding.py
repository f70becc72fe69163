"""Commands on the grid of requests: programs compute with doubles, decisions with whole numbers of units.

What is asked for is taken to the nearest unit before it is judged, and what was judged is what is written: 1 urad turns
a stretched arm's tool by half a micrometre.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from capabilities.values.units import Unit, nearest
from pep.rtde.command import command_values as v

if TYPE_CHECKING:
    from pep.rtde.command.command_values import Command

_ANGLE, _TURN, _JERK = Unit.MICRORADIAN, Unit.MICRORADIAN_PER_SECOND, Unit.MICRORADIAN_PER_SECOND2
_LENGTH, _SPEED, _RAMP = Unit.MICROMETRE, Unit.MICROMETRE_PER_SECOND, Unit.MICROMETRE_PER_SECOND2


def on_grid(command: Command) -> Command:
    """Command with its numbers rounded to whole units of its request.

    Values of a stream of angles or speeds stay as they are: each is judged with its exact numbers. So does what no
    request stands for, and a number that is not finite.
    """
    match command:
        case v.MoveJ(q, speed, acceleration, _):
            return replace(
                command,
                q_rad=_six(q, _ANGLE, _ANGLE),
                speed_rad_s=nearest(speed, _TURN),
                acceleration_rad_s2=nearest(acceleration, _JERK),
            )
        case v.MoveJIk(pose, speed, acceleration, _):
            return replace(
                command,
                pose_m_rad=_six(pose, _LENGTH, _ANGLE),
                speed_rad_s=nearest(speed, _TURN),
                acceleration_rad_s2=nearest(acceleration, _JERK),
            )
        case v.MoveLFk(q, speed, acceleration, _):
            return replace(
                command,
                q_rad=_six(q, _ANGLE, _ANGLE),
                speed_m_s=nearest(speed, _SPEED),
                acceleration_m_s2=nearest(acceleration, _RAMP),
            )
        case v.MoveL(pose, speed, acceleration, _):
            return replace(
                command,
                pose_m_rad=_six(pose, _LENGTH, _ANGLE),
                speed_m_s=nearest(speed, _SPEED),
                acceleration_m_s2=nearest(acceleration, _RAMP),
            )
        case v.SpeedL(xd, acceleration, time_s):
            return replace(
                command,
                xd_m_s_rad_s=_six(xd, _SPEED, _TURN),
                acceleration_m_s2=nearest(acceleration, _RAMP),
                time_s=nearest(time_s, Unit.MILLISECOND),
            )
        case v.MoveUntilContact(xd, _, acceleration):
            return replace(
                command, xd_m_s_rad_s=_six(xd, _SPEED, _TURN), acceleration_m_s2=nearest(acceleration, _RAMP)
            )
        case v.ForceMode(frame, _, wrench, _, limits):
            return replace(
                command,
                task_frame_m_rad=_six(frame, _LENGTH, _ANGLE),
                wrench_n_nm=_six(wrench, Unit.MILLINEWTON, Unit.MILLINEWTON_METRE),
                limits=_six(limits, _SPEED, _TURN),  # a held axis has a length or an angle, on the same grid
            )
        case v.SetForceDamping(damping):
            return v.SetForceDamping(nearest(damping, Unit.PERMILLE))
        case v.SetForceGain(scaling):
            return v.SetForceGain(nearest(scaling, Unit.PERMILLE))
        case v.SetTcp(pose):
            return replace(command, pose_m_rad=_six(pose, _LENGTH, _ANGLE))
        case v.SetPayload(mass_kg, centre):
            return replace(command, mass_kg=nearest(mass_kg, Unit.GRAM), centre_m=_three(centre, _LENGTH))
        case _:
            return command


def _three(numbers: v.Three, unit: Unit) -> v.Three:
    x, y, z = numbers
    return nearest(x, unit), nearest(y, unit), nearest(z, unit)


def _six(numbers: v.Six, first: Unit, last: Unit) -> v.Six:
    return (*_three(numbers[:3], first), *_three(numbers[3:], last))
