"""The gripper's held object, as committed: the gripper tells that there is one, the sensors' last view which.

From the moment a grip has ended on something until a later one ends on nothing, the arm is assessed as an arm with that
part in its fingers. No call ever names the held object.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from pep.pit import gripped, unknown_part

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pep.pit import CellParameters, GrippedObject, Robot
    from pep.pit.base.motion import Joints
    from pep.pit.scene.scene import Thing


class CommittedGrip:
    """The arm with its held object. Any thread.

    Args:
        robot: the arm with its tool and empty fingers.
        cell: known parts that may be carried, and the constant load.
    """

    def __init__(self, robot: Robot, cell: CellParameters) -> None:
        self._empty = robot
        self._cell = cell
        self._lock = threading.Lock()
        self._now = robot

    @property
    def robot(self) -> Robot:
        """The arm to compute with now, held object included."""
        with self._lock:
            return self._now

    @property
    def held(self) -> GrippedObject | None:
        """The held object, or None."""
        return self.robot.held

    def closed_on(self, q_rad: Joints, objects: Iterable[Thing]) -> None:
        """Commits a grip on the one object seen between the fingers, else on an unknown part.

        Args:
            q_rad: measured joint angles.
            objects: objects seen by sensors, in the base frame; no surveyed ones.
        """
        self._hold(gripped(self._empty, q_rad, objects, self._cell) or unknown_part(self._empty, self._cell))

    def closed_on_unknown(self) -> None:
        """Commits a grip on an unknown part."""
        self._hold(unknown_part(self._empty, self._cell))

    def _hold(self, held: GrippedObject) -> None:
        with self._lock:
            self._now = self._empty.holding(held)

    def released(self) -> None:
        """Commits empty fingers: the object stands where the sensors show it."""
        with self._lock:
            self._now = self._empty

    @property
    def carried_kg(self) -> float:
        """Mass of tool and held object; with an unknown part, the whole payload of the robot."""
        robot = self.robot
        part = robot.held
        part_kg = self._cell.payload_kg if part is None else part.mass_kg
        return robot.model.payload_limit_kg if part_kg is None else robot.tool.mass_kg + part_kg

    @property
    def centre_m(self) -> tuple[float, float, float]:
        """Centre of all that mass in the flange frame: the tool's own, the part's in the middle of its shape."""
        robot = self.robot
        own, tool_kg = robot.tool.com_m, robot.tool.mass_kg
        where = robot.tool.tcp_m if robot.held is None else robot.held.center_m
        part_kg = self.carried_kg - tool_kg
        x, y, z = ((tool_kg * a + part_kg * b) / self.carried_kg for a, b in zip(own, where, strict=True))
        return x, y, z
