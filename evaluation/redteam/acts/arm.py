"""Acts on the arm: calls of its tools."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Final

from evaluation.redteam.acts.act import Act, Came, Effect

if TYPE_CHECKING:
    from evaluation.redteam.bare import BareArena
    from evaluation.redteam.guarded import GuardedArena

ACCELERATION_RAD_S2: Final = 1.4
"""Acceleration of the paper's replayed traces (`evaluation.paper`); ur_rtde's own default of moveJ."""


class MoveJoint(Act, frozen=True, kw_only=True, tag="move_joint"):
    """Joint move.

    Attributes:
        to_rad: six target angles.
        speed_rad_s: speed of the leading axis.
        acceleration_rad_s2: of the same.
    """

    point: ClassVar[str] = "e5"

    to_rad: tuple[float, float, float, float, float, float]
    speed_rad_s: float
    acceleration_rad_s2: float = ACCELERATION_RAD_S2

    def bare(self, arena: BareArena) -> Came:
        """Drives the controller."""
        arena.control.moveJ(list(self.to_rad), self.speed_rad_s, self.acceleration_rad_s2)
        return Came(Effect.DONE)

    def guarded(self, arena: GuardedArena) -> Came:
        """Calls the tool."""
        asked = {
            "q_rad": list(self.to_rad),
            "speed_rad_s": self.speed_rad_s,
            "acceleration_rad_s2": self.acceleration_rad_s2,
        }
        return arena.call(self.by, "move_joint", asked, point=self.point)
