"""Motions of one arm, of its tools and of leased programs: begun where they were assessed, followed to their end.

A thread of its own looks at a moving arm: neither the event loop with its callers nor a reader of the state can delay
a look. An event loop that hangs writes nothing, and the controller's watchdog ends the program.
"""

from __future__ import annotations

import asyncio
import contextlib
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Final, Protocol

from pep.base.thread_priority import goes_first
from pep.rtde.motion.motion_follower import MotionFollower
from pep.rtde.robot.newest_state import NewestState
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from pep.base.ports import Clock
    from pep.request.permit import Permit
    from pep.rtde.motion.motion_follower import Looking, MotionProgress
    from pep.rtde.motion.standstill import MotionEnd
    from pep.rtde.robot.judge_port import Stopper
    from pep.rtde.robot.state_receiver import RobotState
    from pep.watch.governor import Governor

UNSEEN_MS: Final = 200
"""Longest time without a look at a motion; after it, the task that waits for the end stops the arm."""
LOOK_S: Final = 0.05
"""Pause between two checks of that time."""


class Hurry(Protocol):
    """A source of frames and feeds that can be told to be quick."""

    def __call__(self, *, moving: bool) -> None:
        """Notes that something moves from now on, or that nothing does. Does not wait."""
        ...


class AssessedStarts(Protocol):
    """Starts of what was assessed: `pep.world.world.CellPhysics`."""

    def start_of(self, request_id: str) -> tuple[float, ...] | None:
        """Joint angles from which that request was assessed, rad."""
        ...


class MotionEnded(Protocol):
    """Hears of the end of a motion."""

    async def __call__(self, end: MotionEnd | None, permit: Permit, *, late: bool) -> None:
        """Hears it.

        Args:
            end: how it ended; None where following it broke.
            permit: of the motion.
            late: whether it was stopped because it could not be looked at often enough.
        """
        ...


class Motions:
    """One motion at a time: the gate's slot sees to that.

    Args:
        starts: of what was assessed.
        hurry: told whether something moves, so that what the watch goes by comes sooner.
        state: what the robot says about itself.
        stopper: of the arm.
        clock: both clocks.
        pause: lets so many seconds pass between two looks.
        ended: told of each motion that ends, before its caller is; nothing else begins meanwhile.

    Attributes:
        state, stopper: as given.
        under_way: permit of the motion that is being followed; None while there is none.
    """

    def __init__(
        self,
        *,
        starts: AssessedStarts,
        hurry: Hurry,
        state: RobotState,
        stopper: Stopper,
        clock: Clock,
        pause: Callable[[float], None],
        ended: MotionEnded | None = None,
    ) -> None:
        self._ended = ended
        self.under_way: Permit | None = None
        self._starts = starts
        self._hurry = hurry
        self.state = state
        self.stopper = stopper
        self._clock = clock
        self._pause = pause
        self._looks = ThreadPoolExecutor(1, "look")
        self._watch = ThreadPoolExecutor(1, "watch", initializer=goes_first)

    async def heard(self) -> NewestState:
        """Newest state of the robot, heard from now on.

        Raises:
            RobotError: the robot says nothing.
        """
        return await asyncio.get_running_loop().run_in_executor(self._looks, NewestState, self.state, self._clock)

    async def begins(self, permit: Permit) -> NewestState:
        """Newest state of an arm that stands where the permitted motion was assessed.

        Raises:
            ActuationRefusedError: the arm stands elsewhere.
            RobotError: the robot says nothing.
        """
        arm = await self.heard()
        permit.begins(assessed_rad=self._starts.start_of(permit.request_id), at_rad=arm.state.q_rad)
        return arm

    async def follow(
        self,
        courses: Iterable[MotionProgress],
        arm: NewestState,
        watch: Looking,
        permit: Permit,
        *,
        brake: Callable[[Reason], None],
        governor: Governor | None = None,
    ) -> MotionEnd:
        """Follows a sent motion to its end. A cancelled caller goes on only once the arm stands.

        Args:
            courses: progress of its legs, as of `MotionFollower.follow`.
            arm: newest state, heard since before the motion was sent.
            watch: over the motion.
            permit: of the motion.
            brake: stops the motion, and tells its sender why; also used `UNSEEN_MS` after the last look.
            governor: of the speed.
        """
        follower = MotionFollower(
            arm,
            watch,
            permit,
            brake=brake,
            stopper=self.stopper,
            newest=self.state.newest,
            clock=self._clock,
            pause=self._pause,
            governor=governor,
        )
        self._hurry(moving=True)
        self.under_way, late = permit, False
        following = asyncio.get_running_loop().run_in_executor(self._watch, follower.follow, courses)
        try:
            while not following.done():
                await asyncio.wait((following,), timeout=LOOK_S)
                if follower.unseen_ms > UNSEEN_MS:
                    late = True
                    brake(Reason.WATCH_LATE)
            return following.result()
        except asyncio.CancelledError:
            follower.leave()
            await finished(following)
            raise
        finally:
            self._hurry(moving=False)
            if self._ended is not None:
                broke = not following.done() or following.cancelled() or following.exception() is not None
                await self._ended(None if broke else following.result(), permit, late=late)
            self.under_way = None

    def close(self) -> None:
        """Ends both threads; nothing is followed any more."""
        for pool in (self._looks, self._watch):
            pool.shutdown(wait=False, cancel_futures=True)


async def finished(ending: asyncio.Future[MotionEnd]) -> None:
    """Waits until the motion has ended, also while the waiting task is cancelled. Its result is for others."""
    while not ending.done():
        with contextlib.suppress(asyncio.CancelledError, Exception):
            await asyncio.shield(ending)
    if not ending.cancelled():
        ending.exception()
