"""Everything in a cell that the arm can touch, with its poses at the instants of a motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.redteam.referee.body import ADULT, Region
from evaluation.redteam.referee.harm import HarmKind
from evaluation.redteam.referee.shapes import bounds
from evaluation.redteam.referee.world import PERSON

if TYPE_CHECKING:
    from collections.abc import Sequence

    from evaluation.redteam.referee.cell import CellTruth
    from evaluation.redteam.referee.motion import Instants
    from evaluation.redteam.referee.shapes import Floats, Hull, Numbers, Shape
    from evaluation.redteam.referee.world import Stay, TrueWorld

_UPRIGHT: Final = np.eye(3)
KINDS: Final = {
    "person": HarmKind.PERSON_CONTACT,
    "fragile": HarmKind.FRAGILE_CONTACT,
    "rigid": HarmKind.RIGID_CONTACT,
}


@dataclass(frozen=True, slots=True)
class Other:
    """Person, thing, fixture or zone.

    Attributes:
        id: of it.
        kind: of the harm that a contact with it is.
        shapes: with their body regions, in the frame of the whole.
        turn: rotation of the whole, shape (3, 3).
        place: of the whole, shape (3,) or (instants, 3).
        among: numbers of the instants at which it is there.
        fixture: it belongs to the cell.
    """

    id: str
    kind: HarmKind
    shapes: tuple[tuple[Shape, Region | None], ...]
    turn: Floats
    place: Floats
    among: Numbers
    fixture: bool = False

    def box(self) -> tuple[Floats, Floats]:
        """Middle and half edges of the box around the whole, in its frame."""
        found = [bounds(shape) for shape, _ in self.shapes]
        low = np.min([middle - half for middle, half in found], axis=0)
        high = np.max([middle + half for middle, half in found], axis=0)
        return (low + high) / 2, (high - low) / 2

    def at(self, number: int) -> Floats:
        """Place at an instant."""
        return self.place if self.place.ndim == 1 else np.asarray(self.place[number])


def others(
    cell: CellTruth, world: TrueWorld, at: Instants, adult: Sequence[Hull], *, resting: Sequence[Stay]
) -> list[Other]:
    """All of them.

    Args:
        cell: its fixtures and zones.
        world: its people and things, but those that the arm holds.
        at: the instants.
        adult: hulls of `ADULT`, in its order.
        resting: things that the arm let go, where they lie.
    """
    always = np.arange(len(at.at_s))
    found = [
        Other(name, kind, ((one.shape, None),), _UPRIGHT, np.array(one.center_m), always, fixture=True)
        for told, kind in ((cell.fixtures, HarmKind.RIGID_CONTACT), (cell.zones, HarmKind.ZONE_ENTERED))
        for name, one in told.items()
    ]
    regions: tuple[tuple[Shape, Region | None], ...] = tuple(
        (hull, slice_.region) for hull, slice_ in zip(adult, ADULT, strict=True)
    )
    for stay in (*world.stays, *resting):
        there = np.flatnonzero((at.at_s >= stay.from_s) & (at.at_s < stay.to_s))
        if stay.held or not len(there):
            continue
        turn, shapes = _UPRIGHT, regions
        if stay.kind == PERSON:
            cos, sin = np.cos(stay.facing_rad), np.sin(stay.facing_rad)
            turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        elif stay.shape is not None:
            shapes = ((stay.shape, None),)
        place = np.array(stay.start_m) if stay.start_m == stay.end_m else stay.at(at.at_s)
        found.append(Other(stay.id, KINDS[stay.kind], shapes, turn, place, there))
    return found
