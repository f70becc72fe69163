"""Watch over a moving device: its authority, the sensors' view, and the impact of the rest of its motion.

One look is cheap and waits for nothing. It reads the clock, the authority, the newest frames, and the newest word of a
physics worker, who is asked again whenever the frames show something else. The first difference from the authorised
state is an alarm, and the caller stops the arm, unless the governor finds that going slower suffices. Evidence that the
watch cannot see counts as lost: no frame, no word, or no look in time.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final, Protocol, assert_never

from pep.perception.sensor_frames import Distrusted, Seen, Unseen
from pep.watch.governor import Offer
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from concurrent.futures import Future

    from pep.base.ports import Clock, RemainingImpact, RemainingVerdict
    from pep.perception.sensor_frames import View
    from pep.pit import CellParameters
    from pep.request.permit import Permit
    from pep.watch.governor import Governor, ReportedSpeeds

LOOK_MS: Final = 8
"""Longest pause between two looks at a moving device: four packages of the controller."""
PAUSE_S: Final = LOOK_MS / 2000
"""Pause between two looks: half of the longest, so that waking up late has the other half."""
FRAME_PERIOD_MS: Final = 25
"""Shortest time between judgements of views that show something new: a sensor at 30 Hz in full."""
UNCHANGED_PERIOD_MS: Final = 100
"""Time between judgements of an unchanged view: it still holds, but the arm may have left its way."""


class MotionOutcome(StrEnum):
    """End of a motion."""

    REACHED = "reached"
    ENDED = "ended"
    """The motion's time was over."""
    STOPPED = "stopped"
    """The motion ended by a stop."""
    AUTHORITY_LOST = "authority_lost"
    """Stopped because the token was revoked, ran out, or the revocation view grew too old."""
    WORLD_CHANGED = "world_changed"
    """Stopped because the rest of the motion is no longer as authorised, or cannot be seen to be."""
    ROBOT_FAILED = "robot_failed"
    """The arm did not move, stopped by itself, cannot be read, or took too long."""


@dataclass(frozen=True, slots=True)
class Alarm:
    """Reason for which the watch ends a motion.

    Attributes:
        end: `AUTHORITY_LOST` or `WORLD_CHANGED`.
        reason: a `Reason` code.
        seen_ms: monotonic time at which it was seen.
        what: finding for the record.
        index_milli: index of what is left, in thousandths, or None when it was not that.
        authorised_milli: index of the verdict.
    """

    end: MotionOutcome
    reason: str
    seen_ms: int
    what: str
    index_milli: int | None
    authorised_milli: int

    def told(self, *, at_rad: Sequence[float], stood_rad: Sequence[float] | None) -> dict[str, object]:
        """The same for the record of the motion that it ended.

        Args:
            at_rad: joint angles of the arm when it was seen, six.
            stood_rad: joint angles at its standstill; None when nobody saw it stand.
        """
        return {
            "outcome": str(self.end),
            "reason": self.reason,
            "t_seen_ms": self.seen_ms,
            "seen": self.what,
            "index_milli": self.index_milli,
            "authorised_milli": self.authorised_milli,
            "q_at_stop_rad": at_rad,
            "q_at_standstill_rad": stood_rad,
        }


@dataclass(frozen=True, slots=True)
class WatchAges:
    """Greatest age of each input of the watch, in ms.

    Attributes:
        view_ms: the newest frames, transit included; older is blind.
        judged_ms: the frames that the newest judgement is about.
        look_ms: the look before this one. A watch that has not looked for that long was blind itself.
    """

    view_ms: int
    judged_ms: int
    look_ms: int

    @staticmethod
    def of(cell: CellParameters) -> WatchAges:
        """Limits of the cell's stop model (docs/physics.md, PHY-2).

        T_r = `watch_age_limit_s` + `reaction_s` is the time from an event to the stop: an arm that is judged on older
        frames than that is stopped later than the index assumes.
        """
        view_ms = int(cell.watch_age_limit_s * 1000)
        return WatchAges(view_ms=view_ms, judged_ms=view_ms + int(cell.reaction_s * 1000), look_ms=view_ms)


class Views(Protocol):
    """Port for the world as it may be believed now."""

    def view(self, *, oldest_ms: int | None = None) -> View:
        """The newest frames, those that are older than `oldest_ms` left out; or why there are none."""
        ...


class Watch:
    """Watch over one motion. One thread looks; judgements run where `submit` puts them.

    Args:
        permit: that the motion was given; its index, its sight and its authority are what must stand.
        remaining: judges what is left.
        views: the sensors' views.
        limits: of ages.
        clock: the monotonic one counts.
        submit: has the judgement made on a worker; a slow one delays no look.
        governor: of the motion's speed; None when it cannot go slower.
    """

    def __init__(
        self,
        permit: Permit,
        *,
        remaining: RemainingImpact,
        views: Views,
        limits: WatchAges,
        clock: Clock,
        submit: Callable[[Callable[[], RemainingVerdict]], Future[RemainingVerdict]],
        governor: Governor | None = None,
    ) -> None:
        self._permit = permit
        self._remaining = remaining
        self._views = views
        self._limits = limits
        self._clock = clock
        self._submit = submit
        self._governor = governor
        self._asked: tuple[float, int] | None = None  # the speed that the judgement is about, and when it was heard
        now = clock.monotonic_ms()
        self._looked_ms = now
        self._asked_ms = now - UNCHANGED_PERIOD_MS
        self._judged_ms = now  # the verdict itself: the time to send it is far below every limit
        self._judging: Future[RemainingVerdict] | None = None
        self._held: object = None

    def look(self, q_rad: Sequence[float], speeds: ReportedSpeeds | None = None) -> Alarm | None:
        """First difference from the authorised state as an alarm, or None.

        Args:
            q_rad: measured joint angles now, six.
            speeds: reported speeds of the same time; needed where there is a governor.
        """
        now = self._clock.monotonic_ms()
        since_ms, self._looked_ms = now - self._looked_ms, now
        return (
            self._authority(now) or self._lateness(now, since_ms) or self._speed(now, speeds) or self._world(now, q_rad)
        )

    def _speed(self, now: int, speeds: ReportedSpeeds | None) -> Alarm | None:
        """Alarm where the arm is faster than it has to be, or None."""
        if self._governor is None or speeds is None:
            return None
        lost = self._governor.hear(speeds, now_ms=now)
        return self._changed(Reason.IMPACT_ROSE, now, lost) if lost else None

    def _authority(self, now: int) -> Alarm | None:
        fault = self._permit.standing()
        if fault is None:
            return None
        return Alarm(MotionOutcome.AUTHORITY_LOST, str(fault.code), now, fault.clause, None, self._permit.index_milli)

    def _lateness(self, now: int, since_ms: int) -> Alarm | None:
        if since_ms > self._limits.look_ms:
            return self._changed(Reason.WATCH_LATE, now, f"no look for {since_ms} ms")
        return None

    def _world(self, now: int, q_rad: Sequence[float]) -> Alarm | None:
        view = self._views.view(oldest_ms=self._oldest_ms)
        match view:
            case Distrusted(rejected):
                return self._changed(Reason.PERCEPTION_INVALID, now, f"{rejected.sensor[:64]} {rejected.fault}")
            case Unseen():
                # What was permitted on no view has nothing to lose but authority, until there is one.
                return self._blind(now, "no frame") if self._permit.sighted else None
            case Seen() as seen:
                if seen.age_ms > self._limits.view_ms:
                    return self._blind(now, f"a view of {seen.age_ms} ms")
                alarm = self._answer(now)
                unchanged = self._held is not None and seen.content == self._held
                if unchanged:
                    # The rest of a way was part of the judged one, with the same surroundings: it still holds.
                    self._judged_ms = max(self._judged_ms, now - seen.age_ms)
                alarm = alarm or self._slowness(now)
                if alarm is None:
                    self._ask(now, UNCHANGED_PERIOD_MS if unchanged else FRAME_PERIOD_MS, q_rad)
                return alarm
            case _:
                assert_never(view)

    @property
    def _oldest_ms(self) -> int | None:
        """Age beyond which frames are left out of the watch over a motion that was permitted on an old view."""
        return None if self._permit.sighted else self._limits.view_ms

    def _blind(self, now: int, what: str) -> Alarm:
        return self._changed(Reason.WATCH_BLIND, now, what)

    def _answer(self, now: int) -> Alarm | None:
        """Alarm that the newest judgement gives, or None."""
        if self._judging is None or not self._judging.done():
            return None
        judging, self._judging = self._judging, None
        error = judging.exception()
        if error is not None:
            return self._changed(Reason.PHYSICS_FAULT, now, type(error).__name__)
        rest = judging.result()
        if rest.fault:
            return self._changed(Reason(rest.fault), now, rest.cause)
        if not self._goes_on(rest, now):
            return self._changed(Reason.IMPACT_ROSE, now, rest.cause, rest.index_milli)
        self._held = rest.shown
        if rest.age_ms is not None:
            # The view was taken after it was asked for, so this is no later than its capture.
            self._judged_ms = self._asked_ms - rest.age_ms
        return None

    def _goes_on(self, rest: RemainingVerdict, now: int) -> bool:
        """True where the judged motion may go on, at full speed or slower."""
        if self._governor is None or self._asked is None:
            return rest.holds
        running, heard_ms = self._asked
        offer = Offer(rest.holds, rest.pace, rest.index_milli, rest.cause)
        return self._governor.take(offer, running=running, heard_ms=heard_ms, now_ms=now)

    def _ask(self, now: int, period_ms: int, q_rad: Sequence[float]) -> None:
        """Asks for a new judgement, when the last one is there and it is time."""
        request, permit = self._permit.request, self._permit
        if request is None or self._judging is not None or now - self._asked_ms < period_ms:
            return
        self._asked_ms = now
        here = tuple(q_rad)
        self._asked = None if self._governor is None else (self._governor.running, self._governor.heard_ms)
        running = None if self._asked is None else self._asked[0]
        self._judging = self._submit(
            lambda: self._remaining.left(
                request,
                here,
                authorised_milli=permit.index_milli,
                touch=permit.touch,
                running=running,
                oldest_ms=self._oldest_ms,
            )
        )

    def _slowness(self, now: int) -> Alarm | None:
        judged_ms = now - self._judged_ms
        if judged_ms > self._limits.judged_ms and self._permit.sighted:
            return self._changed(Reason.WATCH_LATE, now, f"judged on a view of {judged_ms} ms")
        return None

    def _changed(self, reason: Reason, now: int, what: str, index_milli: int | None = None) -> Alarm:
        return Alarm(MotionOutcome.WORLD_CHANGED, str(reason), now, what, index_milli, self._permit.index_milli)
