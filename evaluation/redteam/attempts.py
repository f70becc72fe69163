"""Acts of a scenario as they were attempted, and the harm without motion that they have truly done."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from evaluation.redteam.parts import Effect
from evaluation.redteam.record import HarmSeen

if TYPE_CHECKING:
    from collections.abc import Callable

    from evaluation.redteam.parts import Came, Deed
    from ztpm.stage.calls import Exchange


@dataclass(frozen=True, slots=True)
class Begun:
    """Act that was begun, its times by the monotonic clock, and whether it got through."""

    act: Deed
    from_s: float
    to_s: float
    through: bool = False


@dataclass
class Attempts:
    """Attempts of one scenario.

    Attributes:
        begun: acts in the order in which they were begun.
        sent: requests that went over the wire, by the name of their act.
        since_s: monotonic time of the beginning.
        halted_s: monotonic time of a person's stop.
        desk_changed: an act has replaced the desk's process.
    """

    begun: list[Begun] = field(default_factory=list)
    sent: dict[str, Exchange] = field(default_factory=dict)
    since_s: float = field(default_factory=time.monotonic)
    halted_s: float = 0.0
    desk_changed: bool = False
    _over: threading.Event = field(default_factory=threading.Event)
    _going_on: list[threading.Thread] = field(default_factory=list)

    def go_on(self, once: Callable[[], object]) -> None:
        """Does something again and again, beside the acts, until `end`."""

        def again() -> None:
            while not self._over.is_set():
                with suppress(Exception):  # an attacker that is refused tries once more
                    once()

        self._going_on.append(threading.Thread(target=again, daemon=True))
        self._going_on[-1].start()

    def end(self) -> None:
        """Ends what goes on."""
        self._over.set()
        for each in self._going_on:
            each.join()

    def noted(self, act: Deed, done: Callable[[], Came]) -> Came:
        """Outcome of an act that is done; its times and whether it got through are kept."""
        began_s, came = time.monotonic(), None
        try:
            came = done()
            return came
        finally:
            through = came is not None and came.effect is Effect.DONE
            self.begun.append(Begun(act, began_s, time.monotonic(), through))

    def came_about(self, name: str) -> bool:
        """True where an act of that name got through."""
        return any(one.through and one.act.name == name for one in self.begun)

    def harm(self, arena: Any) -> tuple[HarmSeen, ...]:
        """Harm of the acts that were begun, by what truly happened."""
        found = []
        first_s = self.begun[0].from_s if self.begun else self.since_s
        for one in self.begun:
            what = one.act.did(arena, one)
            if what:
                found.append(HarmSeen(one.act.harms, round(one.to_s - first_s, 3), what))
        return tuple(found)
