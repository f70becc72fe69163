"""Which stop ends what, and how hard: none is weaker than the cell's stop model, whoever asks for it."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Final, assert_never

from pep.rtde.command.command_values import End, ServoStop, SpeedStop, StopJ, StopKind, StopL

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pep.rtde.command.command_values import Stop

JOINT_DECELERATION_LIMIT_RAD_S2: Final = 40.0
TOOL_DECELERATION_LIMIT_M_S2: Final = 150.0
"""ur_rtde, rtde_control_interface.h: it sends no stop that asks for more than these."""
TOOL_STOP_DEFAULT: Final = 10.0
"""ur_rtde: default of stopL and servoStop in m/s2, and of speedStop in m/s2 or rad/s2, as the speed was given."""
LEVER_M: Final = 1.0
"""A tool this far from the leading axis: 0.65 m of a stretched UR3e with its gripper (U8, G1), rounded up."""


def _between(least: float, asked: float, most: float) -> float:
    """`asked`, but a stop that can be sent: what is no number, or too weak, is `least`; what is too hard is `most`."""
    return min(asked, most) if asked > least else least


def joint_stop(asked: float, deceleration_rad_s2: float) -> float:
    """Deceleration of a stop in joint space, rad/s2 of the leading axis: as asked for, or the cell's."""
    return _between(deceleration_rad_s2, asked, JOINT_DECELERATION_LIMIT_RAD_S2)


def tool_stop(asked: float, deceleration_rad_s2: float) -> float:
    """Deceleration of a stop in tool space, m/s2: at least the cell's at a lever of 1 m, and ur_rtde's default."""
    return _between(max(TOOL_STOP_DEFAULT, deceleration_rad_s2 * LEVER_M), asked, TOOL_DECELERATION_LIMIT_M_S2)


def raised(stop: Stop, deceleration_rad_s2: float) -> Stop:
    """The stop as it is sent. What has no deceleration brakes as the control script has it."""
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
"""What goes on after its command has been cleared, by command id, and the stop that ends it, still to be raised."""

STREAMS: Final = frozenset(mode for mode, stop in MODES.items() if stop in (_SPEED, _SERVO))
"""Those that move the arm in a thread of the control script, until the stop of their mode."""

STOPS: Final[Mapping[int, Stop]] = MappingProxyType(
    {
        15: _SPEED,
        16: _SERVO,
        33: StopL(0.0, asynchronous=False),
        34: StopJ(0.0, asynchronous=False),
        **{what.value: End(what) for what in StopKind},
    }
)
"""Every stop by its id, for one that is badly said; still to be raised."""


def ended_by(stop: Stop, modes: set[int]) -> set[int]:
    """Those of `modes` that a stop ends. `StopJ` and `StopL` end moves alone."""
    if isinstance(stop, End) and stop.what in (StopKind.PROGRAM, StopKind.PROTECTIVE_STOP):
        return set(modes)
    return {
        mode for mode in modes if type(MODES[mode]) is type(stop) and (not isinstance(stop, End) or MODES[mode] == stop)
    }


def of_stream(stop: Stop, modes: set[int]) -> Stop | None:
    """A stop of the arm as it ends the stream that goes on, still to be raised; None where there are two kinds of them.

    Any other would meet the thread that moves the arm: the arm would go on, or the controller end a program in which
    two threads do.
    """
    ends = {MODES[mode] for mode in modes & STREAMS}
    if isinstance(stop, End) or not ends:
        return stop
    if len(ends) > 1:
        return None
    return stop if ended_by(stop, modes & STREAMS) else ends.pop()
