"""Compilation of all code behind a question about physics, before any question is timed.

The first time on a machine it takes a minute, from then on a second. Until it is done nobody answers.
"""

from __future__ import annotations

import gc
import threading
import time
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.robot.robot import Robot
from pep.pit.scene.cell import CellParameters
from pep.pit.scene.pairs import pairs_of
from pep.pit.search.engine import chosen
from pep.pit.search.kernel import compiled_path
from pep.pit.search.kernel.arithmetic.compilation import ENTRIES
from pep.pit.search.kernel.step_arrays import ready_of
from pep.pit.search.kernel.step_bound import settle
from pep.pit.search.kernel.step_envelope import JOINTS, SERVO, STEP
from pep.pit.second import compiled_sight

if TYPE_CHECKING:
    from collections.abc import Callable

TOLD_EACH_S: Final = 1.0  # ours: how often progress is told
MANY: Final = 1_000_000  # objects, ours: so many come of compiling; of reading, a tenth. Looking once takes a second


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of the compilation: so many functions of all, after so many seconds."""

    done: int
    functions: int
    seconds: float

    def __str__(self) -> str:
        """One line for people."""
        return f"compiling the physics kernel: {self.done} of {self.functions} functions, {self.seconds:.0f} s"


@cache
def compile_all() -> None:
    """Compiles every function of the kernel, or reads earlier compilations.

    All that stands afterwards is left out of the collector's looks, until `gc.unfreeze`: the compiler and the kernel
    stay as long as the process, and each full look at them would hold up all of it, an arm's watch too. Garbage is
    collected before. A process whose collector is off keeps it as it is.
    """
    collects = gc.isenabled()
    gc.disable()  # looking through all that a compiler makes takes longer and longer
    try:
        compiled_path.compile_all()
        if gc.get_count()[0] > MANY:
            gc.collect()
        chosen()
        compiled_sight.compile_all()
        robot, cell = Robot.load("ur3e"), CellParameters()
        pairs = pairs_of(robot, cell.surveyed, cell, grown_m=0.0)
        settle(ready_of(robot, pairs, cell, sighted_s=0.0), SERVO, np.zeros((STEP, JOINTS)), 0.0, 0.0)
        if collects:
            gc.collect()
            gc.freeze()
    finally:
        if collects:
            gc.enable()


def compile_telling(tell: Callable[[Progress], None], *, clock: Callable[[], float] = time.monotonic) -> None:
    """Compiles as `compile_all` does, and tells the progress every `TOLD_EACH_S` seconds.

    Args:
        tell: called from another thread; never once everything is compiled.
        clock: monotonic seconds.
    """
    began, over = clock(), threading.Event()

    def watch() -> None:
        while not over.wait(TOLD_EACH_S):
            tell(Progress(sum(bool(each.signatures) for each in ENTRIES), len(ENTRIES), clock() - began))

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    try:
        compile_all()
    finally:
        over.set()
        watching.join()
