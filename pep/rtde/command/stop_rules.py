"""Rules of stops: the mode that each ends, and its deceleration, never below the cell's stop model."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Final, assert_never

from pep.rtde.command.command_values import End, ServoStop, SpeedStop, StopJ, StopKind, StopL

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pep.rtde.command.command_values import Stop

JOINT_DECELERATION_LIMIT_RAD_S2: Final = 40.0
TOOL_DECELERATION_LIMIT_M_S2: Final = 150.0
"""Largest deceleration of a stop by ur_rtde (rtde_control_interface.h)."""
TOOL_STOP_DEFAULT: Final = 10.0
"""Default of ur_rtde for stopL and servoStop in m/s2, and for speedStop in m/s2 or rad/s2, by the speed."""
LEVER_M: Final = 1.0
"""Distance of a tool from the leading axis: 0.65 m of a stretched UR3e with gripper (U8, G1), rounded up."""


def _between(least: float, asked: float, most: float) -> float:
    """Deceleration `asked`, kept between `least` and `most`; NaN counts as too weak."""
    return min(asked, most) if asked > least else least


def joint_stop(asked: float, deceleration_rad_s2: float) -> float:
    """Deceleration of a stop in joint space, rad/s2 of the leading axis: as asked for, or the cell's."""
    return _between(deceleration_rad_s2, asked, JOINT_DECELERATION_LIMIT_RAD_S2)


def tool_stop(asked: float, deceleration_rad_s2: float) -> float:
    """Deceleration of a stop in tool space, m/s2.

    At least the cell's at a lever of 1 m, and ur_rtde's default.
    """
    return _between(max(TOOL_STOP_DEFAULT, deceleration_rad_s2 * LEVER_M), asked, TOOL_DECELERATION_LIMIT_M_S2)


def raised(stop: Stop, deceleration_rad_s2: float) -> Stop:
    """Stop as it is sent. One without a deceleration brakes by the control script's own."""
    match stop:
        case StopJ(asked, asynchronous):
            return StopJ(joint_stop(asked, deceleration_rad_s2), asynchronous)
        case StopL(asked, asynchronous):
            return StopL(tool_stop(asked, deceleration_rad_s2), asynchronous)
        case SpeedStop(asked):
            return SpeedStop(tool_stop(asked, deceleration_rad_s2))
        case ServoStop(asked):
            return ServoStop(tool_stop(asked, deceleration_rad_s2))
        case End():
            return stop
        case _:
            assert_never(stop)


_SPEED, _SERVO = SpeedStop(0.0), ServoStop(0.0)
MODES: Final[Mapping[int, Stop]] = MappingProxyType(
    {
        6: End(StopKind.FORCE_MODE),
        9: _SPEED,
        10: _SPEED,
        11: _SERVO,
        12: _SERVO,
        18: End(StopKind.TEACH_MODE),
        24: _SERVO,
        41: End(StopKind.JOG),
        52: End(StopKind.FREEDRIVE_MODE),
        66: End(StopKind.PROGRAM),
    }
)
"""Modes that outlast their command, by command id, with the stop that ends each, still to be raised."""

STREAMS: Final = frozenset({9, 10, 11, 12, 24, 6, 18, 52})
"""Modes that move the arm, or let it be moved, until their stop; no other one ends them."""

STOPS: Final[Mapping[int, Stop]] = MappingProxyType(
    {
        15: _SPEED,
        16: _SERVO,
        33: StopL(0.0, asynchronous=False),
        34: StopJ(0.0, asynchronous=False),
        **{what.value: End(what) for what in StopKind},
    }
)
"""Every stop by its id, for a malformed one; still to be raised."""


def ended_by(stop: Stop, modes: set[int]) -> set[int]:
    """Modes that a stop ends. `StopJ` and `StopL` end moves alone."""
    if isinstance(stop, End) and stop.what in (StopKind.PROGRAM, StopKind.PROTECTIVE_STOP):
        return set(modes)
    return {
        mode for mode in modes if type(MODES[mode]) is type(stop) and (not isinstance(stop, End) or MODES[mode] == stop)
    }


def of_stream(stop: Stop, modes: set[int]) -> Stop | None:
    """Stop of the arm in the form that ends the running stream, still to be raised; None for two kinds.

    Any other would meet the thread that moves the arm: the arm would go on, or the controller end a program in which
    two threads do.
    """
    ends = {MODES[mode] for mode in modes & STREAMS}
    if isinstance(stop, End) or not ends:
        return stop
    if len(ends) > 1:
        return None
    return stop if ended_by(stop, modes & STREAMS) else ends.pop()
