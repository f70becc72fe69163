"""Sequence of a robot's acts: its committed state, and the acts of the last seconds (TEA-6).

One motion at a time: nothing is ever queued here, and a command that is no part of an unfinished one does not get this
far. Three questions remain: whether the arm is still where the last act left it, whether acts undo each other, and
which motion they are together. The acts count for all agents alike: agents that take turns move one arm.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import TYPE_CHECKING, Final

from capabilities.values.scope import Tier
from pep.base.operations import ARM, operation_of, targets_of
from pep.base.ports import Together
from pep.world.motion_history import act_of, joined
from policies.evidence.conduct_readings import SequenceReading
from policies.evidence.evidence import ImpactReading, RobotReading

if TYPE_CHECKING:
    from pep.base.ports import Clock
    from pep.world.motion_history import Act, Angles, Joined
    from policies.evidence.model import Request

WINDOW_MS: Final = 10_000
"""Time for which an act counts. Ours: pick and place takes some seconds each way, and shaking takes less."""
ARRIVED: Final = "reached"
"""The outcome of a motion that ended at its target, as its tool says it."""
MILLI: Final = 1_000
ACTS_KEPT: Final = 256
"""Acts that are remembered at most; more than a robot does within the window."""
SAME_PERMILLE: Final = 50
"""Targets differ by less than this part of the way between two acts when they are the same."""


class Sequence:
    """The acts of one robot, in order. Any thread.

    Args:
        clock: monotonic.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._acts: deque[Act] = deque(maxlen=ACTS_KEPT)
        self._stands_urad: Angles | None = None

    def joined(self, request: Request, *, impact: object) -> Joined | None:
        """The request joined with the acts before it, to be assessed as one; None when it stands alone.

        Args:
            request: the request.
            impact: of the request: where the arm is.
        """
        with self._lock:
            acts = self._recent()
        return joined(request, self._act(request, "", _start(impact)), acts)

    def reading(
        self,
        request: Request,
        *,
        agent: str,
        impact: object,
        robot: object,
        unfinished: bool,
        together: object | None = None,
    ) -> SequenceReading:
        """Reading of the sequence for this request of that agent, as of now.

        Args:
            request: the request.
            agent: agent of the request.
            impact: of the request: where the arm is, and its tier.
            robot: its readiness: what it is known to hold.
            unfinished: whether a motion is under way that the request is no part of.
            together: judgement of the acts that `joined` gave, or None when it gave none. A fault there is no tier.
        """
        seen = impact if isinstance(impact, ImpactReading) else None
        whole_milli = together.index_milli if isinstance(together, Together) else None
        if together is None and seen is not None:
            whole_milli = seen.index_milli
        with self._lock:
            acts = self._recent()
            stands = self._stands_urad
        start = _start(impact)
        drift = max((abs(a - b) for a, b in zip(start, stands or start, strict=False)), default=0)
        index_milli = None if seen is None or whole_milli is None else max(seen.index_milli, whole_milli)
        tier = None
        if seen is not None and index_milli is not None:
            tier = max(seen.tier, Tier(-(-index_milli // MILLI)))
        return SequenceReading(
            unfinished=unfinished,
            tier=tier,
            index_milli=index_milli,
            drift_urad=drift,
            alternations=_alternations((*acts, self._act(request, agent, start))),
            held_known=_held_known(robot),
            acts=sum(act.agent == agent for act in acts),
        )

    def begins(self, request: Request, *, agent: str, impact: object) -> None:
        """Notes that the request is sent: the arm's resting place is not known until it has ended.

        Args:
            request: the request.
            agent: agent of the request.
            impact: of the request: where the arm is.
        """
        operation = operation_of(request.object, request.operation)
        with self._lock:
            self._acts.append(self._act(request, agent, _start(impact)))
            if operation is not None and operation.moves in ARM:
                self._stands_urad = None

    def ended(self, request: Request, *, arrived: bool) -> None:
        """Notes the end of the request's effect; an arm that arrived stands at its target, any other anywhere."""
        numbers = tuple(value for _, _, value in self._act(request, "", ()).values)
        targets = targets_of(operation_of(request.object, request.operation), numbers)
        if arrived and targets:
            with self._lock:
                self._stands_urad = targets[-1]

    def looked(self) -> None:
        """Notes that a caller was told the arm's place: later requests begin there."""
        with self._lock:
            self._stands_urad = None

    def _act(self, request: Request, agent: str, start_urad: Angles) -> Act:
        return act_of(request, agent=agent, at_ms=self._clock.monotonic_ms(), start_urad=start_urad)

    def _recent(self) -> tuple[Act, ...]:
        since = self._clock.monotonic_ms() - WINDOW_MS
        return tuple(act for act in self._acts if act.at_ms >= since)


def _start(impact: object) -> Angles:
    return impact.start_urad if isinstance(impact, ImpactReading) else ()


def _held_known(robot: object) -> bool:
    return isinstance(robot, RobotReading) and robot.expected_payload_g is not None


def _alternations(acts: tuple[Act, ...]) -> int:
    """Number of times that a thing returned to its place of two acts before: the arm, or any other.

    The arm is one thing, for every agent and operation; the legs of a path are acts. A stream of speeds comes back when
    its speeds do.
    """
    places: dict[tuple[str, ...], list[Angles]] = {}
    for act in acts:
        numbers = tuple(value for _, _, value in act.values)
        targets = targets_of(operation_of(*act.operation), numbers)
        places.setdefault(("arm",) if targets else act.operation, []).extend(targets or (numbers,))
    return sum(
        _undoes(before, there, back)
        for each in places.values()
        for before, there, back in zip(each, each[1:], each[2:], strict=False)
    )


def _undoes(before: Angles, there: Angles, back: Angles) -> bool:
    """True where `back` is at `before` again, as measured by the way to `there`; standing still is no way."""
    if len({len(before), len(there), len(back)}) > 1:
        return False
    way = [abs(a - b) for a, b in zip(before, there, strict=True)]
    left = [abs(a - b) for a, b in zip(before, back, strict=True)]
    return max(way, default=0) > 0 and max(left, default=0) * 1_000 <= max(way) * SAME_PERMILLE
