"""Ports of a gate that commands a robot; a gate before other tools has none of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pep.base.ports import MotionSlot, Physics
    from pep.world.sequence import Sequence


@dataclass(frozen=True, slots=True)
class RobotPorts:
    """Ports of one robot.

    Attributes:
        slot: one motion at a time.
        sequence: its recent acts.
        physics: runtime impact.
    """

    slot: MotionSlot
    sequence: Sequence
    physics: Physics
