"""Motions of one arm, of its tools and of leased programs: begun where they were assessed, followed to their end.

What moves is looked at from a thread of its own: neither the event loop with its callers nor whoever reads the state
can delay a look. An event loop that hangs writes nothing, and the controller's watchdog ends the program.
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
"""A motion that nobody has looked at for this long is stopped by whoever waits for it."""
LOOK_S: Final = 0.05
"""How often that is asked."""


class Hurry(Protocol):
    """A source of frames and feeds that can be told to be quick."""

    def __call__(self, *, moving: bool) -> None:
        """Something moves from now on, or nothing does. Does not wait."""
        ...


class AssessedStarts(Protocol):
    """Starts of what was assessed: `pep.world.world.CellPhysics`."""

    def start_of(self, request_id: str) -> tuple[float, ...] | None:
        """The joint angles from which that request was assessed."""
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

    Attributes:
        state, stopper: as given.
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
    ) -> None:
        self._starts = starts
        self._hurry = hurry
        self.state = state
        self.stopper = stopper
        self._clock = clock
        self._pause = pause
        self._looks = ThreadPoolExecutor(1, "look")
        self._watch = ThreadPoolExecutor(1, "watch", initializer=goes_first)

    async def heard(self) -> NewestState:
        """What the robot has said last, from now on.

        Raises:
            RobotError: it says nothing.
        """
        return await asyncio.get_running_loop().run_in_executor(self._looks, NewestState, self.state, self._clock)

    async def begins(self, permit: Permit) -> NewestState:
        """The same, of an arm that stands where the permitted motion was assessed.

        Raises:
            ActuationRefusedError: it stands elsewhere.
            RobotError: it says nothing.
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
        """How what was sent has ended. Whoever waits for that and goes leaves the arm standing.

        Args:
            courses: of its legs, as of `MotionFollower.follow`.
            arm: as of `MotionFollower`.
            watch: likewise.
            permit: likewise.
            brake: likewise; also told when nobody has looked for too long.
            governor: likewise.
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
        following = asyncio.get_running_loop().run_in_executor(self._watch, follower.follow, courses)
        try:
            while not following.done():
                await asyncio.wait((following,), timeout=LOOK_S)
                if follower.unseen_ms > UNSEEN_MS:
                    brake(Reason.WATCH_LATE)
            return following.result()
        except asyncio.CancelledError:
            follower.leave()
            await finished(following)
            raise
        finally:
            self._hurry(moving=False)

    def close(self) -> None:
        """Nothing is followed any more."""
        for pool in (self._looks, self._watch):
            pool.shutdown(wait=False, cancel_futures=True)


async def finished(ending: asyncio.Future[MotionEnd]) -> None:
    """It has ended, also when the task that asks is being cancelled; how is for somebody else."""
    while not ending.done():
        with contextlib.suppress(asyncio.CancelledError, Exception):
            await asyncio.shield(ending)
    if not ending.cancelled():
        ending.exception()
