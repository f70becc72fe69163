"""One goal at a time, asked of the gateway as one request, with one decision.

The agent's authority is its own: its token is presented and its key signs each call. What is refused moves nothing.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol

from pep.pit.path.timed_curve import curve_of
from pep.world.timed_request import arguments_of
from ztpm_idp.client import ClientError, Deferred, Denied
from ztpm_ros2.goal import GoalError, ResultCode, asked, missed

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

FEEDBACK_S: Final = 0.1
"""Time between two messages of feedback."""
STOPS_S: Final = 2.0
"""Time that a stopped trajectory has to be told as such; it takes a tenth of that."""
TOOL: Final = "follow_trajectory"
REACHED: Final = "reached"

Joints = tuple[float, ...]


class Tools(Protocol):
    """Open connection to the cell's tools, as `ztpm_idp.client.Agent.tools` gives it."""

    async def call(self, tool: str, arguments: dict[str, object] | None = None) -> Any:
        """Result of a permitted call."""
        ...


class GoalHandle(Protocol):
    """Those members of rclpy's `ServerGoalHandle` that are used."""

    request: Any
    is_cancel_requested: bool

    def succeed(self) -> None:
        """Ends the goal as succeeded."""
        ...

    def abort(self) -> None:
        """Ends it as aborted."""
        ...

    def canceled(self) -> None:
        """Ends it as cancelled."""
        ...


@dataclass(frozen=True, slots=True)
class Feedback:
    """Joint angles and speeds that are wanted and measured at a time of the trajectory: s, rad, rad/s."""

    time_s: float
    desired: tuple[Joints, Joints]
    actual: tuple[Joints, Joints]


@dataclass(frozen=True, slots=True)
class Result:
    """Code and words of a result."""

    code: ResultCode
    told: str


class Follower:
    """Follower of trajectories for one arm. On an event loop.

    Args:
        tools: of the cell.
        state: joint angles and speeds of the arm now, rad and rad/s.
        feedback: given each message of feedback, with the goal that it is of.
        prefix: what stands before each joint's name.
        now_s: ROS time, s.
    """

    def __init__(
        self,
        tools: Tools,
        state: Callable[[], tuple[Sequence[float], Sequence[float]]],
        feedback: Callable[[GoalHandle, Feedback], None],
        *,
        prefix: str,
        now_s: Callable[[], float],
    ) -> None:
        self._tools = tools
        self._state = state
        self._feedback = feedback
        self._prefix = prefix
        self._now_s = now_s
        self._busy = False

    async def follow(self, goal: GoalHandle) -> Result:
        """Follows one goal to its end, ends its handle, and tells how it went. A second one meanwhile is refused."""
        if self._busy:
            goal.abort()
            return Result(ResultCode.INVALID_GOAL, "BUSY: another trajectory is being followed")
        self._busy = True
        try:
            return await self._followed(goal)
        except GoalError as error:
            goal.abort()
            return Result(error.code, str(error))
        except Denied as denied:
            goal.abort()
            return Result(ResultCode.INVALID_GOAL, f"{denied.reason}: {denied.remedy or 'nothing has moved'}")
        except Deferred as deferred:
            goal.abort()
            told = f"{deferred.reason}: a person must answer first: {deferred.page}; then send the goal again"
            return Result(ResultCode.INVALID_GOAL, told)
        except ClientError as error:
            goal.abort()
            return Result(ResultCode.INVALID_GOAL, f"{error}; whether the arm moved is not known")
        finally:
            self._busy = False

    async def _followed(self, goal: GoalHandle) -> Result:
        standing = self._state()[0]
        trajectory = asked(goal.request, prefix=self._prefix, standing=standing, now_s=self._now_s())
        curve = curve_of(trajectory)
        call = asyncio.ensure_future(self._tools.call(TOOL, arguments_of(trajectory)))
        began_s: float | None = None
        try:
            while not (await asyncio.wait([call], timeout=FEEDBACK_S))[0]:
                if goal.is_cancel_requested:
                    return await self._cancelled(goal, call)
                actual = self._state()
                if began_s is None and any(abs(speed) > 0.0 for speed in actual[1]):
                    began_s = self._now_s()  # until then it is being decided, or people are asked
                at_s = 0.0 if began_s is None else min(self._now_s() - began_s, curve.duration_s)
                desired = tuple(tuple(row.tolist()) for row in curve.at(at_s))
                self._feedback(goal, Feedback(at_s, desired, (tuple(actual[0]), tuple(actual[1]))))  # type: ignore[arg-type]
            moved = (await call).structured_content
        finally:
            call.cancel()
        return self._ended(goal, moved, trajectory.points[-1])

    async def _cancelled(self, goal: GoalHandle, call: asyncio.Future[Any]) -> Result:
        """Stops the arm; a trajectory that is still being decided, or asked about, is never begun."""
        await self._tools.call("stop")
        await asyncio.wait([call], timeout=STOPS_S)
        goal.canceled()
        return Result(ResultCode.SUCCESSFUL, "cancelled: the arm was stopped")

    def _ended(self, goal: GoalHandle, moved: dict[str, Any], target: Joints) -> Result:
        if moved["outcome"] != REACHED:
            goal.abort()
            told = f"{moved['reason'] or moved['outcome']}: the arm was stopped on its way"
            return Result(ResultCode.PATH_TOLERANCE_VIOLATED, told)
        if off := missed(goal.request, target, moved["q_rad"], prefix=self._prefix):
            goal.abort()
            return Result(ResultCode.GOAL_TOLERANCE_VIOLATED, off)
        goal.succeed()
        return Result(ResultCode.SUCCESSFUL, "")
