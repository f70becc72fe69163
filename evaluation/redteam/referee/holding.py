"""Things that the arm holds: how they move with it, and when it lets them fall."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from evaluation.redteam.referee.arm import FLANGE
from evaluation.redteam.referee.harm import DROP_M, OPENED_MM, Harm, HarmKind
from evaluation.redteam.referee.moving import Moving
from evaluation.redteam.referee.shapes import outline

if TYPE_CHECKING:
    from collections.abc import Iterator

    from evaluation.redteam.referee.arm import LinkFrames
    from evaluation.redteam.referee.cell import CellTruth
    from evaluation.redteam.referee.motion import Instants
    from evaluation.redteam.referee.shapes import Floats, Numbers, Shape
    from evaluation.redteam.referee.world import Stay, TrueWorld


@dataclass(frozen=True, slots=True)
class Held:
    """A thing in the gripper.

    Attributes:
        id: of it.
        fragile: it is.
        moving: the thing with its poses; only those of `among` count.
        among: numbers of the instants at which it is held.
    """

    id: str
    fragile: bool
    moving: Moving
    among: Numbers


@dataclass(frozen=True, slots=True)
class Holding:
    """All that the arm holds during a motion.

    Attributes:
        held: things with their motion.
        resting: the same after they were let go, where they came to lie.
        drops: those that fell.
    """

    held: tuple[Held, ...]
    resting: tuple[Stay, ...]
    drops: tuple[Harm, ...]


def holding(world: TrueWorld, frames: LinkFrames, at: Instants, cell: CellTruth) -> Holding:
    """Things that the arm holds, and lets go.

    A held thing keeps its pose towards the flange. It is let go when the finger tips open by more than `OPENED_MM`
    beyond their opening at the beginning of the grip, and falls where nothing carries it within `DROP_M` below.
    """
    held, resting, drops = [], [], []
    for stay in world.stays:
        among = np.flatnonzero((at.at_s >= stay.from_s) & (at.at_s < stay.to_s))
        if not stay.held or stay.shape is None or not len(among):
            continue
        first = among[0]
        flange_turn, flange_place = frames.turn[:, FLANGE], frames.place[:, FLANGE]
        turn = np.einsum("nij,jk->nik", flange_turn, flange_turn[first].T)
        grip = flange_turn[first].T @ (np.array(stay.start_m) - flange_place[first])
        place = flange_place + np.einsum("nij,j->ni", flange_turn, grip)
        opened = np.flatnonzero(at.opening_m[among] > at.opening_m[first] + OPENED_MM / 1e3)
        if len(opened):
            let_go = int(among[opened[0]])
            among = among[: opened[0]]
            low_m = _low_m(stay.shape, turn[let_go], place[let_go])
            carried_m = max(
                _carriers_m(world, cell, place[let_go], low_m, letting=stay.id, at_s=float(at.at_s[let_go]))
            )
            fall_m = low_m - carried_m
            x, y, z = place[let_go].tolist()
            here = (x, y, z - max(fall_m, 0.0))
            resting.append(
                replace(stay, from_s=float(at.at_s[let_go]), start_m=here, end_m=here, speed_m_s=0.0, held=False)
            )
            if fall_m > DROP_M:
                drops.append(Harm(HarmKind.DROP, float(at.at_s[let_go]), stay.id, "gripper", fall_m * 1e3, 0.0))
        moving = Moving.of(stay.shape, turn, place, pieces=1)
        held.append(Held(stay.id, stay.kind == "fragile", moving, among))
    return Holding(tuple(held), tuple(resting), tuple(drops))


def grip_reach_m(world: TrueWorld, frames: LinkFrames, times_s: Floats) -> float:
    """Farthest that any point of a held thing is from the flange, by frames at these times."""
    farthest = 0.0
    for stay in world.stays:
        if stay.held and stay.shape is not None:
            number = min(int(np.searchsorted(times_s, stay.from_s)), len(times_s) - 1)
            points, radius = outline(stay.shape)
            off = points + np.array(stay.start_m) - frames.place[number, FLANGE]
            farthest = max(farthest, float(np.linalg.norm(off, axis=1).max()) + radius)
    return farthest


def _low_m(shape: Shape, turn: Floats, place: Floats) -> float:
    points, radius = outline(shape)
    return float((points @ turn.T + place)[:, 2].min()) - radius


def _carriers_m(
    world: TrueWorld, cell: CellTruth, place: Floats, low_m: float, *, letting: str, at_s: float
) -> Iterator[float]:
    """Heights of all that is below a thing: the floor, fixtures and other things."""
    yield cell.floor_z_m
    standing = [(one.shape, np.array(one.center_m)) for one in cell.fixtures.values()]
    standing += [
        (stay.shape, np.array(stay.place(at_s)))
        for stay in world.stays
        if stay.shape is not None and not stay.held and stay.from_s <= at_s < stay.to_s and stay.id != letting
    ]
    for shape, center in standing:
        points, radius = outline(shape)
        low, high = (points + center).min(axis=0) - radius, (points + center).max(axis=0) + radius
        if (low[:2] <= place[:2]).all() and (place[:2] <= high[:2]).all() and high[2] <= low_m + DROP_M:
            yield float(high[2])
