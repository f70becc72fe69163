"""Which engine decides: the compiled one where numba is installed, else the numpy engine that it is held against."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Final

from pep.pit.path.straight_path import Path
from pep.pit.search.arm_limits import Demands
from pep.pit.search.blow import blow_ratio
from pep.pit.search.certify import certify, fits

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit.base.motion import Straight
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.scene import Scene
    from pep.pit.search.certify import Certified, Fit


@dataclass(frozen=True, slots=True)
class Engine:
    """The dear questions of a straight joint motion, answered in one way.

    Attributes:
        name: in every assessment and record.
        path: a path of one robot.
        certify, fits, blow_ratio: as the functions of these names in `pep.pit.search.certify` and
            `pep.pit.search.blow`.
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


NUMPY: Final = Engine("numpy-1", Path, certify, fits, blow_ratio, Demands)


@cache
def chosen() -> Engine:
    """The engine of this installation. The first call compiles it, or reads what was compiled before."""
    if find_spec("numba") is None:
        return NUMPY
    from pep.pit.search.kernel import compiled_course
    from pep.pit.search.kernel import compiled_limits as demands
    from pep.pit.search.kernel.compiled_path import CompiledPath, compile_all

    compile_all()
    demands.compile_all()
    compiled_course.compile_all()  # chosen by `pep.pit.search.course_engine`: ready for one is ready for the other
    path = CompiledPath
    return Engine("numba-1", path, path.certify, path.fits, path.blow_ratio, demands.CompiledDemands, slows=True)


def chosen_for(scene: Scene | None, cell: CellParameters) -> Engine:
    """The engine for questions about this scene, or without one about the bare cell: polytopes have numpy's alone."""
    solids = (cell.surveyed if scene is None else scene).solids
    return NUMPY if solids.hulls else chosen()
