"""What a command follows: the committed state of one robot, and what each agent did with it just now (TEA-6).

One motion at a time: nothing is ever queued here, and a command that is no part of an unfinished one does not get this
far. What is left to know is whether the arm is still where the last act left it, and whether acts undo each other.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.operations import MOVE_JOINT, SPEED_JOINT
from policies.conduct import SequenceReading
from policies.evidence import ImpactReading, RobotReading

if TYPE_CHECKING:
    from capabilities.units import Unit
    from pep.ports import Clock
    from policies.model import Request

WINDOW_MS: Final = 10_000
"""How long an act counts. Ours: pick and place takes some seconds each way, and shaking takes less."""
ARRIVED: Final = "reached"
"""The outcome of a motion that ended at its target, as its tool says it."""
ACTS_KEPT: Final = 256
"""Acts that are remembered at most; more than a robot does within the window."""
SAME_PERMILLE: Final = 50
"""Two targets are the same when they differ by less than this part of the way between the act and the one before."""

ARM: Final = frozenset({MOVE_JOINT.name, SPEED_JOINT.name})
"""Operations after which the arm stands elsewhere."""


@dataclass(frozen=True, slots=True)
class _Act:
    """Something that was done, or is about to be: by whom, what, where to, and when."""

    agent: str
    operation: tuple[str, str]
    target: tuple[tuple[str, Unit, int], ...]
    at_ms: int


class Sequence:
    """The acts of one robot, in order. Any thread.

    Args:
        clock: monotonic.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._acts: deque[_Act] = deque(maxlen=ACTS_KEPT)
        self._stands_urad: tuple[int, ...] | None = None

    def reading(
        self, request: Request, *, agent: str, impact: object, robot: object, unfinished: bool
    ) -> SequenceReading:
        """What this request of that agent stands in, as of now.

        Args:
            request: what would be done.
            agent: who asks.
            impact: of the request: where the arm is, and its tier.
            robot: its readiness: what it is known to hold.
            unfinished: whether a motion is under way that the request is no part of.
        """
        seen = impact if isinstance(impact, ImpactReading) else None
        with self._lock:
            acts = self._recent(agent)
            stands = self._stands_urad
        start = () if seen is None else seen.start_urad
        drift = max((abs(a - b) for a, b in zip(start, stands or start, strict=False)), default=0)
        return SequenceReading(
            unfinished=unfinished,
            tier=None if seen is None else seen.tier,
            index_milli=None if seen is None else seen.index_milli,
            drift_urad=drift,
            alternations=_alternations((*acts, self._act(request, agent))),
            held_known=_held_known(robot),
            acts=len(acts),
        )

    def begins(self, request: Request, *, agent: str) -> None:
        """The request is sent now: where the arm will stand is not known until it has ended."""
        with self._lock:
            self._acts.append(self._act(request, agent))
            if request.operation in ARM:
                self._stands_urad = None

    def ended(self, request: Request, *, arrived: bool) -> None:
        """The request's effect is over; an arm that arrived stands at its target, any other anywhere."""
        target = tuple(value.value for value in request.values[:6])
        if arrived and request.operation == MOVE_JOINT.name:
            with self._lock:
                self._stands_urad = target

    def looked(self) -> None:
        """Where the arm stands was told to whoever asks next: what is asked from now on begins there."""
        with self._lock:
            self._stands_urad = None

    def _act(self, request: Request, agent: str) -> _Act:
        target = tuple((value.name, value.unit, value.value) for value in request.values)
        return _Act(agent, (request.object, request.operation), target, self._clock.monotonic_ms())

    def _recent(self, agent: str) -> tuple[_Act, ...]:
        since = self._clock.monotonic_ms() - WINDOW_MS
        return tuple(act for act in self._acts if act.agent == agent and act.at_ms >= since)


def _held_known(robot: object) -> bool:
    return isinstance(robot, RobotReading) and robot.expected_payload_g is not None


def _alternations(acts: tuple[_Act, ...]) -> int:
    """How often an act brought a thing back to where it was before the act before it."""
    count = 0
    by_operation: dict[tuple[str, str], list[_Act]] = {}
    for act in acts:
        earlier = by_operation.setdefault(act.operation, [])
        if len(earlier) > 1:
            count += _undoes(earlier[-2], earlier[-1], act)
        earlier.append(act)
    return count


def _undoes(before: _Act, there: _Act, back: _Act) -> bool:
    """Whether `back` is at `before` again, as measured by the way to `there`: none at all is standing still."""
    if len({len(before.target), len(there.target), len(back.target)}) > 1:
        return False
    way = [abs(a[2] - b[2]) for a, b in zip(before.target, there.target, strict=True)]
    left = [abs(a[2] - b[2]) for a, b in zip(before.target, back.target, strict=True)]
    return max(way, default=0) > 0 and max(left, default=0) * 1_000 <= max(way) * SAME_PERMILLE
