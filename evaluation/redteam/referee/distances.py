"""Signed distances of two shapes by MuJoCo."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Final, assert_never

import numpy as np

from evaluation.harness.absent import package
from evaluation.redteam.referee.shapes import Ball, Block, Hull, Rod

if TYPE_CHECKING:
    from collections.abc import Iterable

    from evaluation.redteam.referee.shapes import Floats, Shape, Vector

_ALONG: Final = 1e-9  # shorter is no direction


class Distances:
    """Distances among any shapes, by poses that are told with each question.

    MuJoCo has one geom for each hull, compiled once, and one of each other form on either side of a question, whose
    size is set as it is asked.

    Args:
        hulls: that will be asked about; others are compiled when they are.

    Raises:
        AbsentError: without MuJoCo.
    """

    def __init__(self, hulls: Iterable[Hull]) -> None:
        self._mj, _ = package("mujoco", "mujoco")
        kinds = self._mj.mjtGeom
        self._types = {Ball: kinds.mjGEOM_SPHERE, Block: kinds.mjGEOM_BOX, Rod: kinds.mjGEOM_CAPSULE}
        self._spec = self._mj.MjSpec()
        for side in (0, 1):
            for form in self._types:
                self._spec.worldbody.add_geom(
                    name=f"{form.__name__}{side}", type=self._types[form], size=[1.0, 1.0, 1.0]
                )
        self._hulls: dict[tuple[int, Hull], str] = {}
        self._names: dict[tuple[int, int], str] = {}
        self._told: list[Hull] = []
        for hull in hulls:
            self._names[0, id(hull)] = self._names[1, id(hull)] = self._add(0, hull)
        self._kept = dict(self._names)
        self._compile()

    def _add(self, side: int, hull: Hull) -> str:
        name = self._hulls.get((side, hull))
        if name is None:
            self._hulls[side, hull] = name = f"hull{len(self._hulls)}"
            self._spec.add_mesh(name=name, uservert=np.array(hull.points_m).ravel())
            self._spec.worldbody.add_geom(name=name, type=self._mj.mjtGeom.mjGEOM_MESH, meshname=name)
        return name

    def _compile(self) -> None:
        mj = self._mj
        self._model = model = self._spec.compile()
        self._state = mj.MjData(model)
        self._places, self._turns, self._sizes = self._state.geom_xpos, self._state.geom_xmat, model.geom_size
        self._points = np.zeros(6)
        self._numbers = {model.geom(number).name: number for number in range(model.ngeom)}
        self._offsets: dict[str, tuple[Floats, Floats]] = {}
        for name, number in self._numbers.items():
            turn = np.zeros(9)
            mj.mju_quat2Mat(turn, model.geom_quat[number])
            self._offsets[name] = (model.geom_pos[number].copy(), turn.reshape(3, 3))

    def compile_for(self, hulls: Iterable[Hull]) -> None:
        """Makes ready for questions about these hulls, beside those that were told first."""
        before = len(self._hulls)
        self._told = list(hulls)
        self._names = dict(self._kept)
        for hull in self._told:
            for side in (0, 1):
                self._names[side, id(hull)] = self._add(side, hull)
        if len(self._hulls) != before:
            self._compile()

    def between(
        self, first: tuple[Shape, Floats, Floats], second: tuple[Shape, Floats, Floats], *, at_most_m: float
    ) -> tuple[float, Floats]:
        """Signed distance, negative where they penetrate each other, and the nearest or deepest point of the first.

        Args:
            first: shape, rotation and place of one.
            second: the same of the other.
            at_most_m: answer where they are farther apart; the point is then of no meaning.
        """
        grown, ends = 0.0, []
        for side, (shape, turn, place) in enumerate((first, second)):
            number, radius = self._pose(side, shape, turn, place)
            ends.append(number)
            grown += radius
        apart = self._mj.mj_geomDistance(self._model, self._state, *ends, at_most_m + grown, self._points)
        return apart - grown, self._points[:3]

    def _pose(self, side: int, shape: Shape, turn: Floats, place: Floats) -> tuple[int, float]:
        grown, size = 0.0, None
        match shape:
            case Hull(_, grown):
                name = self._names[side, id(shape)]
                offset, own = self._offsets[name]
                place, turn = place + turn @ offset, turn @ own
            case Ball(radius):
                name, size = f"Ball{side}", (radius, 0.0, 0.0)
            case Block(half):
                name, size = f"Block{side}", half
            case Rod(arrow, radius):
                length, own = _upright(arrow)
                name, size = f"Rod{side}", (radius, length, 0.0)
                turn = turn @ own
            case _:
                assert_never(shape)
        number = self._numbers[name]
        if size is not None:
            self._sizes[number] = size
        self._places[number] = place
        self._turns[number] = turn.reshape(9)
        return number, grown


@lru_cache(maxsize=64)
def _upright(arrow: Vector) -> tuple[float, Floats]:
    """Length of an arrow, and a rotation that turns z onto it."""
    along = np.array(arrow)
    length = float(np.linalg.norm(along))
    if length <= _ALONG:
        return length, np.eye(3)
    along = along / length
    across = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    across = across / np.linalg.norm(across)
    return length, np.stack([across, np.cross(along, across), along], axis=1)
