"""Cell whose composition changes: only the processes that the change concerns are begun anew, as copies."""

from __future__ import annotations

from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from evaluation.coverage.cells import off_in
from evaluation.harness import copies
from evaluation.redteam.composition import composed
from evaluation.redteam.guarded import guarded_arena
from evaluation.redteam.taken_out.rows import GATEWAY, POINT, PROVIDER, TOOLS, concerning
from ztpm.cell.cell import Cell
from ztpm.stage.samples import StateRecorder
from ztpm.stage.stage import until

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from evaluation.redteam.guarded import GuardedArena
    from evaluation.redteam.playing import Arena, Setting
    from ztpm.base.processes import Child

START: Final[Mapping[str, Callable[[Cell], None]]] = {
    PROVIDER: Cell.start_idp,
    GATEWAY: Cell.start_gateway,
    TOOLS: Cell.start_tools,
}
"""Starter of each process of a cell in which there are checks, in the order in which they are begun."""


@dataclass
class Theatre:
    """One cell, opened for the first composition and changed for each later one.

    Nobody answers questions in it: what is deferred does not happen. One sensor watches it, and may be deceived: what
    detects, prevents or contains without a true view is shown there, too.

    Attributes:
        begin: begins a process.
    """

    begin: Callable[..., Child] = copies.begin
    _off: frozenset[str] = frozenset()
    _place: ExitStack = field(default_factory=ExitStack)
    _arena: GuardedArena | None = None

    @contextmanager
    def arena(self, setting: Setting) -> Iterator[Arena]:
        """The arena in a composition.

        It is on a fresh cell where it was asked for the same composition before, which has then failed.

        Args:
            setting: its mode is the name of a composition.
        """
        off = off_in(setting.mode)
        if self._arena is None or off == self._off:
            self.close()
            self._off = off
            self._arena = self._place.enter_context(self._cell())
        else:
            try:
                self._change(self._arena, off)
            except BaseException:
                self.close()
                raise
        yield self._arena

    def close(self) -> None:
        """Ends the cell."""
        self._arena = None
        self._place.close()

    def _cell(self) -> AbstractContextManager[GuardedArena]:
        return guarded_arena(approver=None, begin=self._begin, second_sensor=False)

    def _begin(self, name: str, module: str, *arguments: str, **options: Any) -> Child:
        return composed(self._off, self.begin)(name, module, *arguments, **options)

    def _change(self, arena: GuardedArena, off: frozenset[str]) -> None:
        """Runs every process of the arena in another composition. Its arm stands still meanwhile."""
        changed = [name for name in START if concerning(name, off) != concerning(name, self._off)]
        points = concerning(POINT, off) != concerning(POINT, self._off)
        self._off = off
        if changed:
            self._restart(arena, changed)
        if points:
            arena.begin_points()

    def _restart(self, arena: GuardedArena, changed: Sequence[str]) -> None:
        """Runs these processes of the cell anew."""
        stage = arena.stage
        stage.close()
        stage.eyes = None
        arena.eyes.close()
        with stage.cell.beside():
            for name in changed:
                START[name](stage.cell)
        arena.eyes = StateRecorder(stage.cell.addresses.host)
        until(lambda: stage.perception() == "fresh", "a fresh view")
