"""One run of `ztpm eval redteam`: every scenario in every mode, on cells beside each other."""

from __future__ import annotations

import queue
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from evaluation.redteam.bare import bare_arena
from evaluation.redteam.composition import MODES, composed
from evaluation.redteam.guarded import guarded_arena
from evaluation.redteam.playing import Setting, played

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from evaluation.redteam.ledger import Ledger
    from evaluation.redteam.playing import Arena, Judge
    from evaluation.redteam.record import RunRecord
    from evaluation.redteam.scenario import Scenario

APPROVER: Final = "bob"
BARE: Final = "none"
BARE_BESIDE: Final = 4
"""Arenas with no enforcement in the place of one with it: only the arm takes time there."""
SETTINGS: Final = (*(Setting(mode, approver=True) for mode in reversed(MODES)), Setting(BARE, approver=False))
"""Modes in the order in which they are begun; an absent approver is tried where the other one was asked."""
SHARE_LEAST: Final = 10
"""Scenarios that are worth a cell of their own beside another one in the same setting."""
ABSENT: Final = Setting("all", approver=False)
TRIES: Final = 3
"""Tries of a scenario: a loaded machine may refuse by itself, and a process of a cell may die."""
MACHINE: Final = frozenset({"VERDICT_EXPIRED", "REVOCATION_VIEW_STALE", "BEHAVIOUR_OLD"})
"""Refusals that a machine without time gives; in no scenario is one of these the right answer."""
BLIND: Final = "WATCH_BLIND"
"""Refusal that such a machine gives, too, and the right answer where an act takes the view from the watch."""


@dataclass(slots=True)
class Played:
    """Runs of a campaign.

    Attributes:
        runs: all of them, earlier ones too.
        anew: number of runs that were played again since the machine refused.
        unplayed: scenario, mode and cause of each run that did not come about.
    """

    runs: list[RunRecord] = field(default_factory=list)
    anew: int = 0
    unplayed: list[tuple[str, str, str]] = field(default_factory=list)


def arena(setting: Setting) -> AbstractContextManager[Arena]:
    """An arena in a setting, on processes of its own.

    A second sensor is CII-4's independent evidence: without that primitive there is none.
    """
    if setting.mode == BARE:
        return bare_arena()
    off = MODES[setting.mode]
    return guarded_arena(
        approver=APPROVER if setting.approver else None, begin=composed(off), second_sensor="CII-4" not in off
    )


@dataclass
class Red:
    """Campaign that is played.

    Attributes:
        ledger: keeps each run.
        judge: the referee.
        told: hears how many runs are done.
        arena: makes an arena in a setting.
    """

    ledger: Ledger
    judge: Judge
    told: Callable[[str], None]
    arena: Callable[[Setting], AbstractContextManager[Arena]] = arena
    _done: Played = field(default_factory=Played)
    _of: int = 0
    _count: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _over: threading.Event = field(default_factory=threading.Event)

    def play(self, scenarios: Sequence[Scenario], *, cells: int, modes: Sequence[str] = ()) -> Played:
        """Runs of these scenarios in each mode; those that the ledger has are not played again.

        Args:
            scenarios: to play.
            cells: number of arenas beside each other.
            modes: to play; empty for every one.
        """
        settings = [one for one in SETTINGS if not modes or one.mode in modes]
        self._of = len(scenarios) * len(settings)
        guarded, bare = ([one for one in settings if (one.mode == BARE) is each] for each in (False, True))
        self._pass([(setting, list(scenarios)) for setting in guarded], cells)
        self._pass([(setting, list(scenarios)) for setting in bare], cells * BARE_BESIDE)
        asked = [one for one in scenarios if ABSENT.mode in {each.mode for each in settings} and self._was_asked(one)]
        self._of += len(asked)
        self._pass([(ABSENT, asked)], cells)
        wanted = {(one.id, s.mode, s.approver) for s in settings for one in scenarios}
        wanted |= {(one.id, ABSENT.mode, ABSENT.approver) for one in asked}
        self._done.runs = [run for key, run in self.ledger.runs.items() if key in wanted]
        return self._done

    def settings(self, work: Sequence[tuple[Setting, list[Scenario]]]) -> list[tuple[str, str, str]]:
        """Plays these scenarios in these settings, one after the other; what did not come about, as `Played` says it.

        Args:
            work: settings in their order, each with its scenarios; those that the ledger has are not played again.
        """
        self._of += sum(len(several) for _, several in work)
        self._pass(work, 1)
        unplayed, self._done.unplayed = self._done.unplayed, []
        return unplayed

    def _was_asked(self, scenario: Scenario) -> bool:
        run = self.ledger.runs.get((scenario.id, ABSENT.mode, True))
        return run is not None and any(one.asked for one in run.came)

    def _pass(self, work: Sequence[tuple[Setting, list[Scenario]]], cells: int) -> None:
        """Plays what the ledger has not, by so many workers; each takes one setting at a time."""
        parts: queue.SimpleQueue[tuple[Setting, list[Scenario]]] = queue.SimpleQueue()
        for setting, scenarios in work:
            known = self.ledger.runs
            left = [one for one in scenarios if (one.id, setting.mode, setting.approver) not in known]
            with self._lock:
                self._tell(len(scenarios) - len(left))
            for share in _shares(left, cells):
                parts.put((setting, share))
        with ThreadPoolExecutor(cells) as workers:
            begun = [workers.submit(self._work, parts) for _ in range(cells)]
            try:
                for done in begun:
                    done.result()
            except BaseException:  # interrupted: the runs that are under way are the last ones
                self._over.set()
                raise

    def _work(self, parts: queue.SimpleQueue[tuple[Setting, list[Scenario]]]) -> None:
        while not self._over.is_set():
            try:
                setting, left = parts.get_nowait()
            except queue.Empty:
                return
            self._in_setting(setting, left)

    def _in_setting(self, setting: Setting, left: Sequence[Scenario]) -> None:
        """Plays the scenarios in one setting, on a fresh arena after each failure of one."""
        with ExitStack() as place:
            here: Arena | None = None
            for scenario in left:
                if self._over.is_set():
                    return
                for attempt in range(TRIES):
                    try:
                        if here is None:
                            here = place.enter_context(self.arena(setting))
                        run = played(scenario, here, setting, self.judge)
                    except Exception as error:  # noqa: BLE001 - a part of a cell that died: named, and the campaign goes on
                        place.close()
                        here = None
                        if attempt == TRIES - 1:
                            self._failed(scenario, setting, error)
                        continue
                    if attempt < TRIES - 1 and _refused_by_machine(scenario, run):
                        with self._lock:
                            self._done.anew += 1
                        continue
                    with self._lock:
                        self.ledger.add(run)
                        self._tell(1)
                    break

    def _failed(self, scenario: Scenario, setting: Setting, error: Exception) -> None:
        first = (str(error).splitlines() or [""])[0]
        with self._lock:
            self._done.unplayed.append((scenario.id, setting.mode, f"{type(error).__name__}: {first}"))

    def _tell(self, more: int) -> None:
        self._count += more
        self.told(f"{self._count} of {self._of} runs")


def _refused_by_machine(scenario: Scenario, run: RunRecord) -> bool:
    """True where a machine without time refused: for `BLIND` in a benign scenario that blinds nobody."""
    reasons = {one.reason for one in run.came}
    blind = BLIND in reasons and not scenario.hazardous and not any(act.blinds for act in scenario.act)
    return blind or not reasons.isdisjoint(MACHINE)


def _shares(left: Sequence[Scenario], cells: int) -> Iterator[list[Scenario]]:
    """Parts of what is left in one setting, for so many cells beside each other; few scenarios stay together."""
    count = max(1, min(cells, len(left) // SHARE_LEAST))
    cuts = [len(left) * each // count for each in range(count + 1)]
    yield from (list(left[low:high]) for low, high in pairwise(cuts) if low < high)
