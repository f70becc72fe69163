"""What a leased program has begun, looked at until the arm stands, by our own connection to the robot.

The controller carries it out and the program waits for it; here it is only watched, and stopped.
"""

from __future__ import annotations

import threading
import time
from concurrent.futures import Future
from functools import partial
from typing import TYPE_CHECKING, Final, Protocol, TypeAlias

from pep.base.errors import PepFault
from pep.base.stop_model import ESCALATE_MS, SAFE_MODES
from pep.rtde.motion.stop_ladder import MotionEnd, Stop
from pep.rtde.robot.newest_state import SILENCE_MS
from pep.watch.watch import PAUSE_S, MotionOutcome
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.base.ports import Clock
    from pep.request.permit import Permit
    from pep.rtde.judge.stream_values import LeasedStream
    from pep.rtde.robot.judge_port import Stopper
    from pep.rtde.robot.newest_state import NewestState
    from pep.rtde.robot.state_receiver import JointState, Package
    from pep.watch.watch import Alarm, Watch

BEGINS_MS: Final = 1_000
"""A motion that has not begun by then will not begin."""
RESTS_MS: Final = 300
"""An arm that has stood for so long on its way will not go on: between the legs of a path it stands for some cycles."""


Over: TypeAlias = tuple[MotionOutcome, Reason | None]
"""How a motion is over, and why it has to be stopped; None where it is not to be."""


class MotionProgress(Protocol):
    """When what was sent is over."""

    def look(self, state: JointState) -> Over | None:
        """How it is over, the arm being there; None while it goes on."""
        ...

    @property
    def stands(self) -> bool:
        """Whether an arm that stands on its way may stand there for as long as it likes."""
        ...


class TargetProgress:
    """A motion with a place to go to.

    Args:
        arrived: whether the arm is there at these joint angles.
    """

    stands: Final = False

    def __init__(self, arrived: Callable[[tuple[float, ...]], bool]) -> None:
        self._arrived = arrived

    def look(self, state: JointState) -> Over | None:
        """Reached, once it stands there."""
        return (MotionOutcome.REACHED, None) if state.still and self._arrived(state.q_rad) else None


class TimedProgress:
    """A motion that lasts for a time, and is ended by us.

    Args:
        lasts_ms: from now.
        clock: the monotonic one counts.
    """

    stands: Final = True

    def __init__(self, lasts_ms: int, clock: Clock) -> None:
        self._clock = clock
        self._until_ms = clock.monotonic_ms() + lasts_ms

    def look(self, state: JointState) -> Over | None:  # noqa: ARG002 - the port's own form
        """Ended, once the time is over."""
        return (MotionOutcome.ENDED, Reason.VERDICT_EXPIRED) if self._clock.monotonic_ms() >= self._until_ms else None


class StreamProgress:
    """A stream: as long as its values come and are taken.

    Args:
        stream: whose values they are.
        clock: the monotonic one counts.
    """

    stands: Final = True

    def __init__(self, stream: LeasedStream, clock: Clock) -> None:
        self._stream = stream
        self._clock = clock

    def look(self, state: JointState) -> Over | None:
        """Stopped, where a value was not taken; ended, by its time or by its program, which has stopped it then."""
        stream = self._stream
        if stream.lost is not None:
            return MotionOutcome.STOPPED, stream.lost
        if stream.over:
            return MotionOutcome.ENDED, Reason.VERDICT_EXPIRED
        if stream.ended_ms is None:
            return None
        if state.still:
            return MotionOutcome.ENDED, None
        late = self._clock.monotonic_ms() - stream.ended_ms > ESCALATE_MS
        return (MotionOutcome.ENDED, Reason.VERDICT_EXPIRED) if late else None


class MotionFollower:
    """Follows one motion. `follow` blocks: on a thread of its own.

    Args:
        arm: heard since before it was sent.
        watch: over it.
        permit: of it; its record is told what the watch saw.
        brake: stops what was forwarded, and tells its program why. Waits for nothing.
        stopper: stops the arm where that does not help, and knows of everybody's stops.
        newest: what the robot says.
        clock: the monotonic one counts.
    """

    def __init__(
        self,
        arm: NewestState,
        watch: Watch,
        permit: Permit,
        *,
        brake: Callable[[Reason], None],
        stopper: Stopper,
        newest: Callable[[], Package],
        clock: Clock,
    ) -> None:
        self._arm = arm
        self._watch = watch
        self._permit = permit
        self._brake = brake
        self._stopper = stopper
        self._newest = newest
        self._clock = clock
        self._gone = threading.Event()

    def leave(self) -> None:
        """Nobody waits for the end any more: the arm is stopped."""
        self._gone.set()

    def follow(self, course: MotionProgress) -> MotionEnd:
        """How the motion has ended; the arm stands, or is past our stopping it.

        Args:
            course: when it is over.
        """
        try:
            return self._follow(course)
        except BaseException:
            self._stopper.stop(Reason.EFFECT_FAILED)
            raise

    def _follow(self, course: MotionProgress) -> MotionEnd:
        arm = self._arm
        moving_ms, moved = self._clock.monotonic_ms(), False
        while True:
            fresh = arm.look()
            now_ms, state = self._clock.monotonic_ms(), arm.state
            if not state.still:
                moved, moving_ms = True, now_ms
            alarm = self._watch.look(state.q_rad)
            if alarm is not None:
                return self._alarmed(alarm, state)
            if self._gone.is_set():
                return self._stand(Reason.VERDICT_EXPIRED)
            if arm.silent_ms > SILENCE_MS:
                self._stand(Reason.EVIDENCE_MISSING)
                return MotionEnd(MotionOutcome.ROBOT_FAILED, (), str(PepFault.ROBOT_STALLED))
            if state.safety_mode not in SAFE_MODES:
                where = self._stand(Reason.ROBOT_SAFETY_STOP).q_rad
                return MotionEnd(MotionOutcome.ROBOT_FAILED, where, f"safety mode {state.safety_mode}")
            # Only what the robot said after it was told to move can say how that went.
            if fresh and (over := course.look(state)) is not None:
                how, why = over
                end = MotionEnd(MotionOutcome.STOPPED, state.q_rad) if why is None else self._stand(why)
                return MotionEnd(how, end.q_rad) if end.end is MotionOutcome.STOPPED else end
            stopped_ms = self._stopper.stopped_ms
            if fresh and stopped_ms is not None and stopped_ms >= self._permit.since_ms:
                return self._until_still(stopped_ms)
            patience_ms = RESTS_MS if moved else BEGINS_MS
            if not course.stands and now_ms - moving_ms > patience_ms:
                # Whatever the controller still has in mind, it is not begun later behind our back.
                return MotionEnd(MotionOutcome.ROBOT_FAILED, self._stand(Reason.EFFECT_FAILED).q_rad, f"moved {moved}")
            time.sleep(PAUSE_S)

    def _until_still(self, since_ms: int) -> MotionEnd:
        """Somebody else has stopped the arm: it stands soon, or we stop it too."""
        while self._clock.monotonic_ms() - since_ms <= ESCALATE_MS:
            state = self._newest().state
            if state is not None and state.still:
                return MotionEnd(MotionOutcome.STOPPED, state.q_rad)
            time.sleep(PAUSE_S)
        return self._stand(Reason.VERDICT_EXPIRED)

    def _stand(self, reason: Reason) -> MotionEnd:
        """The arm stands; or nobody saw it do so."""
        given: Future[None] = Future()
        given.set_result(None)  # a brake waits for nothing; whether it helps is seen by the arm
        stop = Stop(given, partial(self._stopper.stop, reason), newest=self._newest, clock=self._clock)
        self._brake(reason)
        while (end := stop.look()) is None:
            time.sleep(PAUSE_S)
        return end

    def _alarmed(self, alarm: Alarm, state: JointState) -> MotionEnd:
        end = self._stand(Reason(alarm.reason))
        stood = end.q_rad if end.end is MotionOutcome.STOPPED else None
        self._permit.watched = alarm.told(at_rad=state.q_rad, stood_rad=stood)
        return MotionEnd(alarm.end, end.q_rad, alarm.reason) if end.end is MotionOutcome.STOPPED else end
