"""The compiled engine: the one that answers the dear questions of a straight joint motion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from pep.pit.search.kernel import compiled_course
from pep.pit.search.kernel import compiled_limits as demands
from pep.pit.search.kernel.compiled_path import CompiledPath, compile_all

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit.base.motion import Straight
    from pep.pit.path.straight_path import Path
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.search.certify import Certified, Fit
    from pep.pit.search.kernel.compiled_limits import Demands


@dataclass(frozen=True, slots=True)
class Engine:
    """The dear questions of a straight joint motion, answered in one way.

    Attributes:
        name: in every assessment and record.
        path: a path of one robot.
        certify: the proven index of pairs on a path, as `CompiledPath.certify`.
        fits: whether an index is proven of rows, as `CompiledPath.fits`.
        blow_ratio: the worst blow, as `CompiledPath.blow_ratio`.
        demands: what a move on such a path demands of the arm.
        slows: whether `certify` also answers at what speed the index of the pairs is a tier lower, when asked.
    """

    name: str
    path: Callable[[Robot, Straight], Path]
    certify: Callable[..., Certified]
    fits: Callable[..., Fit]
    blow_ratio: Callable[..., float]
    demands: Callable[[Path, CellParameters], Demands]
    slows: bool = False


@cache
def chosen() -> Engine:
    """The engine. The first call compiles it, or reads what was compiled before."""
    compile_all()
    demands.compile_all()
    compiled_course.compile_all()  # for `pep.pit.search.course_engine`: ready for one is ready for the other
    path = CompiledPath
    return Engine("numba-1", path, path.certify, path.fits, path.blow_ratio, demands.Demands, slows=True)
