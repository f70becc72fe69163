"""One question of the benchmark of physics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pep.pit import CellParameters, Motion, Robot, Scene, ServoJ, SpeedJ


@dataclass(frozen=True, slots=True, eq=False)
class Question:
    """One motion in one scene.

    Attributes:
        robot: the arm.
        scene: the scene around it.
        motion: the motion to assess.
        cell: parameters.
        step: of a stream, all that may follow of which is the motion; else None.
    """

    robot: Robot
    scene: Scene
    motion: Motion
    cell: CellParameters
    step: ServoJ | SpeedJ | None = None
