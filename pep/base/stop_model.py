"""The numbers of the one stop model, for everybody who stops the arm or computes with its stop.

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
"""An arm that still moves then is stopped by the dashboard too: pi rad/s at 8 rad/s2 takes 0.4 s, and 0.06 s to begin.

A cell with a weaker stop model may get both stops; the second does no harm."""
SAFE_MODES: Final = (1, 2)  # safety_mode NORMAL and REDUCED; any other has stopped the arm by itself
STREAM_SPEED_RAD_S: Final = 1.0
"""Ours: no axis of a stream of joint speeds is faster, so that its stop always ends inside the dead man's patience."""
PATIENCE_S: Final = 0.3
"""Ours: fifteen sends of a stream; a host that stalls for longer is not fit to drive one."""


def patience_s(stop_deceleration_rad_s2: float) -> float:
    """How long a stream of joint speeds goes on by itself when nobody sends any more: then the controller stops it.

    The controller's watchdog hears nothing during a stop either, so it has to outlast the longest one.

    Args:
        stop_deceleration_rad_s2: of every stop, of the leading axis.
    """
    return max(PATIENCE_S, 2 * STOP_DELAY_S + STREAM_SPEED_RAD_S / stop_deceleration_rad_s2)
