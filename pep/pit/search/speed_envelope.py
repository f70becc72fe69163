"""Streams of joint speeds as one joint move that is never slower, for assessment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pep.base.stop_model import patience_s
from pep.pit.base.motion import MoveJ

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit.base.motion import Joints, SpeedJ
    from pep.pit.scene.cell import CellParameters

TOLERANCE_RAD_S: Final = 0.02  # ours
"""Distance of an arm's measured speeds from a stream's; a hundredth of any limit of ours."""


def moves_with(stream: SpeedJ, qd_rad_s: Sequence[float]) -> bool:
    """True where an arm at these joint speeds takes up the stream's speed: at a share of it.

    Each joint by itself between nothing and what is asked is not enough: such an arm leaves the stream's line.
    """
    asked = max(stream.qd_rad_s, key=abs)
    moving = qd_rad_s[stream.qd_rad_s.index(asked)]
    share = min(1.0, max(0.0, moving / asked)) if asked else 0.0
    return all(
        abs(now - share * speed) <= TOLERANCE_RAD_S for now, speed in zip(qd_rad_s, stream.qd_rad_s, strict=True)
    )


def stream_envelope(stream: SpeedJ, cell: CellParameters, *, under_way: bool) -> MoveJ:
    """Joint move that goes everywhere a stream of joint speeds may go, and nowhere slower.

    A stream runs for its duration, for the controller's patience when nobody ends it, and through its stop. It begins
    at rest, or is under way already; the move then starts as far back as it needs to be as fast here. `SpeedJ` alone is
    no such bound: it begins at rest, and nobody fails to end it.

    Args:
        stream: from where the arm is now.
        cell: its stop model.
        under_way: whether the arm `moves_with` it already.
    """
    leading = max(map(abs, stream.qd_rad_s))
    if leading == 0.0:
        return MoveJ(stream.start, stream.start, 1.0, 1.0)
    stop = cell.stop_deceleration_rad_s2
    # The move brakes as it began: the harder of both is the faster at every point.
    ramp = max(stream.acceleration_rad_s2, stop)
    ahead_s = stream.duration_s + patience_s(stop) + cell.stop_delay_s + leading / (2 * stop)
    behind_s = leading / (2 * ramp) if under_way else 0.0

    def along(for_s: float) -> Joints:
        a, b, c, d, e, f = (q + for_s * qd for q, qd in zip(stream.start, stream.qd_rad_s, strict=True))
        return a, b, c, d, e, f

    return MoveJ(along(-behind_s), along(ahead_s), leading, ramp)
