"""Numbers of the one stop model, for all code that stops the arm or computes with its stop.

An arm at w rad/s stands T_s = `STOP_DELAY_S` + w / a after a stop is sent, and goes no further than w * (`STOP_DELAY_S`
+ w / 2a) in between. These are the defaults of a cell's parameters; here, since the simulator must not load physics.
"""

from __future__ import annotations

from typing import Final

STOP_DECELERATION_RAD_S2: Final = 8.0
"""a, of the leading axis. PHY-2: below the CB3 tables (1.7 to 3 times their times)."""
STOP_DELAY_S: Final = 0.06
"""PHY-2: brake delay."""

ESCALATE_MS: Final = 700
"""Time after which the dashboard stops an arm that still moves.

From pi rad/s at 8 rad/s2 a stop takes 0.4 s, and 0.06 s to begin.

A cell with a weaker stop model may get both stops; the second does no harm.
"""
SAFE_MODES: Final = (1, 2)  # safety_mode NORMAL and REDUCED; any other has stopped the arm by itself
STREAM_SPEED_RAD_S: Final = 1.0
"""Ours: highest speed of an axis in a stream of joint speeds.

With it a stop always ends inside the dead man's patience.
"""
PATIENCE_S: Final = 0.3
"""Ours: fifteen sends of a stream; a host that stalls for longer is not fit to drive one."""


def patience_s(stop_deceleration_rad_s2: float) -> float:
    """Time after which the controller stops a stream of joint speeds that nobody sends any more.

    The controller's watchdog hears nothing during a stop either, so it has to outlast the longest one.

    Args:
        stop_deceleration_rad_s2: of every stop, of the leading axis.
    """
    return max(PATIENCE_S, 2 * STOP_DELAY_S + STREAM_SPEED_RAD_S / stop_deceleration_rad_s2)
