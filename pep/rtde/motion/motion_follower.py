"""Follower of a motion: looks at the arm until it stands, and stops it where it has to.

The controller carries the motion of a tool or program out; here it is watched, slowed where that suffices, and
stopped. Time is a port.
"""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from pep.base.errors import PepFault
from pep.base.stop_model import ESCALATE_MS, SAFE_MODES
from pep.rtde.motion.governed_move import put_back
from pep.rtde.motion.standstill import MotionEnd, Standstill
from pep.rtde.robot.newest_state import SILENCE_MS
from pep.watch.governor import FULL
from pep.watch.watch import PAUSE_S, MotionOutcome
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from concurrent.futures import Future

    from pep.base.ports import Clock
    from pep.request.permit import Permit
    from pep.rtde.robot.judge_port import Stopper
    from pep.rtde.robot.newest_state import NewestState
    from pep.rtde.robot.state_receiver import JointState, Package
    from pep.watch.governor import Governor, ReportedSpeeds
    from pep.watch.watch import Alarm

BEGINS_MS: Final = 1_000
"""A motion that has not begun by then will not begin."""
RESTS_MS: Final = 300
"""Longest standstill on the way of a motion; an arm that stands for longer will not go on.

Between the legs of a path the arm stands for some cycles.
"""
SETTLED_MS: Final = 60
"""Ours: rest of an arm at the end of a path.

Between two legs it stands for some cycles of 2 ms, and is not at the end. It is less than a program's next command
waits ([LSD-6]).
"""
SLACK: Final = 1.5
SLACK_MS: Final = 3_000
"""Allowance beyond the computed time of a motion: half of it, and three seconds. Time slowed down counts less."""


class Looking(Protocol):
    """The watch over a motion: `pep.watch.watch.Watch`."""

    def look(self, q_rad: tuple[float, ...], speeds: ReportedSpeeds | None = None) -> Alarm | None:
        """First difference from the authorised state as an alarm, or None."""
        ...


class Over(NamedTuple):
    """The end of a motion, as its progress tells it.

    Attributes:
        outcome: how it is over.
        stop: why it has to be stopped; None where it is not to be.
        detail: why it was cut short, for the caller.
    """

    outcome: MotionOutcome
    stop: Reason | None = None
    detail: str = ""


class MotionProgress(Protocol):
    """Progress of something that was sent."""

    def look(self, state: JointState) -> Over | None:
        """End of the motion, as this state of the arm shows it; None while it goes on."""
        ...

    @property
    def stands(self) -> bool:
        """True where the arm may stand on its way for any time."""
        ...


class TargetProgress:
    """A motion with a place to go to.

    Args:
        arrived: whether the arm is there at these joint angles.
        late: whether it has taken too long; asked once a look.
    """

    stands: Final = False

    def __init__(self, arrived: Callable[[tuple[float, ...]], bool], late: Callable[[], bool] = lambda: False) -> None:
        self._arrived = arrived
        self._late = late

    def look(self, state: JointState) -> Over | None:
        """End as reached, once the arm stands at its target; as failed, once it is late."""
        if state.still and self._arrived(state.q_rad):
            return Over(MotionOutcome.REACHED)
        return Over(MotionOutcome.ROBOT_FAILED, Reason.EFFECT_FAILED, "too slow") if self._late() else None


class ContactProgress:
    """A motion until a contact: over once its command is carried out and the arm stands, or after its time.

    Args:
        timed: its time, after which it is stopped.
        carried_out: whether the control script is through with it.
    """

    stands: Final = True

    def __init__(self, timed: TimedProgress, carried_out: Callable[[], bool]) -> None:
        self._timed = timed
        self._carried_out = carried_out

    def look(self, state: JointState) -> Over | None:
        """End as reached where the arm stands at a contact, else that of its time."""
        if state.still and self._carried_out():
            return Over(MotionOutcome.REACHED)
        return self._timed.look(state)


class SettledProgress:
    """A path: reached once the arm has moved, and rests for so long where it ends.

    A path may lead back to its beginning, or over its end and on.

    Args:
        progress: of a motion to the path's end.
        clock: the monotonic one counts.
    """

    stands: Final = False

    def __init__(self, progress: MotionProgress, clock: Clock) -> None:
        self._progress = progress
        self._clock = clock
        self._moved = False
        self._since_ms: int | None = None

    def look(self, state: JointState) -> Over | None:
        """End as of the motion, once the arm has rested there for `SETTLED_MS`."""
        now_ms = self._clock.monotonic_ms()
        self._moved = self._moved or not state.still
        over = self._progress.look(state)
        if over is None or over.outcome is not MotionOutcome.REACHED:
            self._since_ms = None
            return over
        if not self._moved:
            return None
        self._since_ms = now_ms if self._since_ms is None else self._since_ms
        return over if now_ms - self._since_ms >= SETTLED_MS else None


class TimeLimit:
    """The time that a motion may take, counted at the speed that was ordered of it.

    Args:
        lasts_ms: computed, at full speed.
        governor: of its speed; None at full speed.
        clock: the monotonic one counts.
    """

    def __init__(self, lasts_ms: float, governor: Governor | None, clock: Clock) -> None:
        self._left_ms = lasts_ms * SLACK + SLACK_MS
        self._governor = governor
        self._clock = clock
        self._looked_ms = clock.monotonic_ms()

    def late(self) -> bool:
        """True once the time is over; each call counts the time since the one before."""
        now_ms = self._clock.monotonic_ms()
        self._left_ms -= (now_ms - self._looked_ms) * (FULL if self._governor is None else self._governor.ordered)
        self._looked_ms = now_ms
        return self._left_ms < 0


class TimedProgress:
    """A motion that lasts for a time, and is ended by us. Another thread may prolong it.

    Args:
        until_ms: monotonic time of its end.
        clock: the monotonic one counts.
    """

    stands: Final = True

    def __init__(self, until_ms: int, clock: Clock) -> None:
        self._clock = clock
        self._until_ms = until_ms
        self._over = False
        self._lock = threading.Lock()

    def prolong(self, until_ms: int) -> bool:
        """Prolongs the motion to that monotonic time at least; False where its end has been told."""
        with self._lock:
            self._until_ms = max(self._until_ms, until_ms)
            return not self._over

    def look(self, state: JointState) -> Over | None:  # noqa: ARG002 - the port's own form
        """End, once the time is over."""
        with self._lock:
            self._over = self._over or self._clock.monotonic_ms() >= self._until_ms
            return Over(MotionOutcome.ENDED, Reason.VERDICT_EXPIRED) if self._over else None


class HandOver:
    """The next leg of a path on its way to the controller.

    Args:
        taken: whether the controller has it.
        stopped: whether a stop keeps it from being sent, which the follower sees.
    """

    stands: Final = True

    def __init__(self, taken: Future[bool], stopped: Callable[[], bool]) -> None:
        self._taken = taken
        self._stopped = stopped

    def look(self, state: JointState) -> Over | None:  # noqa: ARG002 - the port's own form
        """End as reached, once the leg is taken; as failed, where it was not and no stop is the cause."""
        if not self._taken.done():
            return None
        if self._taken.result():
            return Over(MotionOutcome.REACHED)
        failed = Over(MotionOutcome.ROBOT_FAILED, Reason.EFFECT_FAILED, "a leg was not taken")
        return None if self._stopped() else failed


class MotionFollower:
    """Follower of one motion. `follow` blocks: on a thread of its own.

    Args:
        arm: newest state, heard since before the motion was sent.
        watch: over the motion.
        permit: of the motion; its record gets the findings of the watch.
        brake: stops the motion, and tells its sender why. Waits for nothing.
        stopper: stops the arm where the brake does not help, and knows of all stops.
        newest: newest package of the robot.
        clock: the monotonic one counts.
        pause: lets so many seconds pass.
        governor: of the speed; its slider is put back in the end.
    """

    def __init__(
        self,
        arm: NewestState,
        watch: Looking,
        permit: Permit,
        *,
        brake: Callable[[Reason], None],
        stopper: Stopper,
        newest: Callable[[], Package],
        clock: Clock,
        pause: Callable[[float], None],
        governor: Governor | None = None,
    ) -> None:
        self._arm = arm
        self._watch = watch
        self._permit = permit
        self._brake = brake
        self._stopper = stopper
        self._newest = newest
        self._clock = clock
        self._pause = pause
        self._governor = governor
        self._gone = threading.Event()
        self._looked_ms: int | None = None

    def leave(self) -> None:
        """Has the arm stopped, since nobody waits for the end any more."""
        self._gone.set()

    @property
    def unseen_ms(self) -> int:
        """Milliseconds since the last look at the motion; 0 before and after it."""
        looked_ms = self._looked_ms
        return 0 if looked_ms is None else self._clock.monotonic_ms() - looked_ms

    def follow(self, courses: Iterable[MotionProgress]) -> MotionEnd:
        """Follows the motion to its end: the arm stands, or is past our stopping it.

        Args:
            courses: progress of its legs, in order; each is asked for once the one before was reached.
        """
        end: MotionEnd | None = None
        try:
            for course in courses:
                end = self._follow(course)
                if end.end is not MotionOutcome.REACHED:
                    break
            assert end is not None
        except BaseException:
            end = None
            self._stopper.stop(Reason.EFFECT_FAILED)
            self._until_stands(Reason.EFFECT_FAILED)  # before it is another's turn, or it may be faster again
            raise
        finally:
            self._looked_ms = None
            self._put_back(end)
        return end if self._governor is None else replace(end, changes=tuple(self._governor.changes))

    def _follow(self, course: MotionProgress) -> MotionEnd:
        arm = self._arm
        moving_ms, moved = self._clock.monotonic_ms(), False
        while True:
            fresh = arm.look()
            now_ms, state = self._clock.monotonic_ms(), arm.state
            self._looked_ms = now_ms
            if not state.still:
                moved, moving_ms = True, now_ms
            alarm = self._watch.look(state.q_rad, arm.speeds)
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
                end = MotionEnd(MotionOutcome.STOPPED, state.q_rad) if over.stop is None else self._stand(over.stop)
                stood = end.end is MotionOutcome.STOPPED
                return MotionEnd(over.outcome, end.q_rad, over.detail) if stood else end
            stopped_ms = self._stopper.stopped_ms
            if fresh and stopped_ms is not None and stopped_ms >= self._permit.since_ms:
                return self._until_still(stopped_ms)
            patience_ms = RESTS_MS if moved else BEGINS_MS
            if not course.stands and now_ms - moving_ms > patience_ms:
                # Whatever the controller still has in mind, it is not begun later behind our back.
                return MotionEnd(MotionOutcome.ROBOT_FAILED, self._stand(Reason.EFFECT_FAILED).q_rad, f"moved {moved}")
            self._pause(PAUSE_S)

    def _until_still(self, since_ms: int) -> MotionEnd:
        """Waits for standstill after a stop from elsewhere, and stops the arm too where that is late."""
        while self._clock.monotonic_ms() - since_ms <= ESCALATE_MS:
            state = self._newest().state
            if state is not None and state.still:
                return MotionEnd(MotionOutcome.STOPPED, state.q_rad)
            self._pause(PAUSE_S)
        return self._stand(Reason.VERDICT_EXPIRED)

    def _stand(self, reason: Reason) -> MotionEnd:
        """Stops the arm; the end tells whether standstill was seen."""
        return self._until_stands(reason, self._brake)

    def _until_stands(self, reason: Reason, brake: Callable[[Reason], None] = lambda _: None) -> MotionEnd:
        self._looked_ms = None
        stop = Standstill(partial(self._stopper.stop, reason), newest=self._newest, clock=self._clock)
        brake(reason)  # it waits for nothing; whether it helps is seen by the arm
        while (end := stop.look()) is None:
            self._pause(PAUSE_S)
        return end

    def _alarmed(self, alarm: Alarm, state: JointState) -> MotionEnd:
        end = self._stand(Reason(alarm.reason))
        stood = end.q_rad if end.end is MotionOutcome.STOPPED else None
        self._permit.watched = alarm.told(at_rad=state.q_rad, stood_rad=stood)
        return MotionEnd(alarm.end, end.q_rad, alarm.reason) if end.end is MotionOutcome.STOPPED else end

    def _put_back(self, end: MotionEnd | None) -> None:
        """Puts the speed slider back where it was, and records every change of the speed."""
        governor = self._governor
        if governor is None or not governor.changes:
            return
        put_back(governor, self._arm, clock=self._clock, pause=self._pause)
        watched = self._permit.watched or {"outcome": str(end.end) if end is not None else None}
        self._permit.watched = {**watched, "speed": [change.told() for change in governor.changes]}
