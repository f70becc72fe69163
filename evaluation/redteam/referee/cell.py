"""Cell as the referee is told of it: fixtures, zones, workspace, and contacts that are meant."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from evaluation.redteam.referee.shapes import Standing

if TYPE_CHECKING:
    from collections.abc import Mapping

    from evaluation.redteam.referee.shapes import Vector

TABLE: Final = Standing.block((-0.8, -0.5, -0.110), (0.2, 0.5, -0.010))
"""Table of the embedded cell, in front of the arm, its top 10 mm below the base."""
GRIPPER: Final = "gripper"


@dataclass(frozen=True, slots=True)
class CellTruth:
    """Fixed parts and rules of a cell.

    Attributes:
        fixtures: rigid things by name.
        zones: places that no part of the arm may enter, by name.
        workspace: lowest and highest corner of the box that no part of the arm may leave, metre, or None.
        meant: pairs of `gripper`, or of a thing that it holds, and a thing or fixture that it may touch slowly.
        floor_z_m: height of the floor that people stand on.
        tool_kg: mass of the gripper.
    """

    fixtures: Mapping[str, Standing] = field(default_factory=lambda: {"table": TABLE})
    zones: Mapping[str, Standing] = field(default_factory=dict)
    workspace: tuple[Vector, Vector] | None = None
    meant: frozenset[tuple[str, str]] = frozenset({(GRIPPER, "table")})
    floor_z_m: float = -0.8
    tool_kg: float = 1.0
