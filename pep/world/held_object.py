"""The gripper's held object, as committed: the gripper tells that there is one, the sensors' last view which.

From the moment a grip has ended on something until a later one ends on nothing, the arm is assessed as an arm with that
part in its fingers. No call names the held object while the gripper tells of one. A program whose gripper nobody asks
may say by `setPayload` which part of the cell it holds, and by the tool's own weight that it holds none ([LSD-13]).
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from pep.pit import declared_part, gripped, unknown_part

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pep.pit import CellParameters, GrippedObject, Robot
    from pep.pit.base.motion import Joints
    from pep.pit.scene.cell import Part
    from pep.pit.scene.scene import Thing


@dataclass(frozen=True, slots=True)
class DeclaredLoad:
    """Load that the cell declares, and a program may say that it has: the tool, alone or with one part.

    Attributes:
        object: the part's id in the scene; "" for the tool alone.
        mass_kg: of both.
        centre_m: of that mass, in the flange frame.
    """

    object: str
    mass_kg: float
    centre_m: tuple[float, float, float]


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
        self._told = False  # the gripper has said what is held

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

    def _hold(self, held: GrippedObject, *, told: bool = True) -> None:
        with self._lock:
            self._now, self._told = self._empty.holding(held), told

    def released(self) -> None:
        """Commits empty fingers: the object stands where the sensors show it."""
        with self._lock:
            self._now, self._told = self._empty, False

    @property
    def loads(self) -> tuple[DeclaredLoad, ...]:
        """Loads that a program may say it has; none while the gripper tells of a held object."""
        with self._lock:
            told = self._told
        return () if told or self._cell.payload_kg is None else self._loads

    @cached_property
    def _loads(self) -> tuple[DeclaredLoad, ...]:
        # An edge counts for more: of two that weigh the same it is the one that is taken.
        known = sorted(self._cell.parts, key=lambda part: part.blunt)
        arms = [(part.object, self._empty.holding(self._declared(part))) for part in known]
        return tuple(
            DeclaredLoad(name, _carried_kg(arm, self._cell), _centre_m(arm, self._cell))
            for name, arm in [("", self._empty), *arms]
        )

    def _declared(self, part: Part) -> GrippedObject:
        return declared_part(self._empty, self._cell, part)

    def declared(self, load: DeclaredLoad) -> None:
        """Commits what a program says, as one of `loads`; nothing where the gripper has told otherwise meanwhile."""
        if load not in self.loads:
            return
        part = next((each for each in self._cell.parts if each.object == load.object), None)
        if part is None:
            self.released()
        else:
            self._hold(self._declared(part), told=False)

    @property
    def carried_kg(self) -> float:
        """Mass of tool and held object; with an unknown part, the whole payload of the robot."""
        return _carried_kg(self.robot, self._cell)

    @property
    def centre_m(self) -> tuple[float, float, float]:
        """Centre of all that mass in the flange frame: the tool's own, the part's in the middle of its shape."""
        return _centre_m(self.robot, self._cell)


def _carried_kg(robot: Robot, cell: CellParameters) -> float:
    part = robot.held
    part_kg = cell.payload_kg if part is None else part.mass_kg
    return robot.model.payload_limit_kg if part_kg is None else robot.tool.mass_kg + part_kg


def _centre_m(robot: Robot, cell: CellParameters) -> tuple[float, float, float]:
    own, tool_kg, carried_kg = robot.tool.com_m, robot.tool.mass_kg, _carried_kg(robot, cell)
    where = robot.tool.tcp_m if robot.held is None else robot.held.center_m
    x, y, z = ((tool_kg * a + (carried_kg - tool_kg) * b) / carried_kg for a, b in zip(own, where, strict=True))
    return x, y, z
