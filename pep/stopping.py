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
