"""One goal after another: what the gateway answers, told in the words of the action."""

import asyncio
from types import SimpleNamespace as Message

import pytest
from tests.adapters.test_ros2_goal import HOME, MOVE, NAMES, goal
from ztpm_ros2.follow import Follower
from ztpm_ros2.goal import ResultCode

from ztpm_idp.client import ClientError, Deferred, Denied

pytestmark = pytest.mark.clause("LSD-24")

END = tuple(MOVE[-1].positions)


class Cell:
    """Tools that answer as told; a stop ends a trajectory that lasts."""

    def __init__(self, answer=None, lasting=False):
        self.answer = answer or {"outcome": "reached", "reason": "", "q_rad": list(END)}
        self.calls, self.stopped, self.lasting = [], asyncio.Event(), lasting

    async def call(self, tool, arguments=None):
        self.calls.append((tool, arguments))
        if tool == "stop":
            self.stopped.set()
            return Message(structured_content={})
        if self.lasting:
            await self.stopped.wait()
            return Message(structured_content={"outcome": "stopped", "reason": "STOPPED", "q_rad": list(HOME)})
        if isinstance(self.answer, Exception):
            raise self.answer
        return Message(structured_content=self.answer)


class Handle:
    """A goal's handle, as rclpy has it."""

    def __init__(self, request, cancel=False):
        self.request, self.is_cancel_requested, self.ends = request, cancel, []

    def succeed(self):
        self.ends.append("succeeded")

    def abort(self):
        self.ends.append("aborted")

    def canceled(self):
        self.ends.append("canceled")


def followed(handle, **options):
    """Result of a goal, the calls that it made, and its feedback."""
    heard = []

    async def run():
        cell = Cell(**options)
        follower = Follower(
            cell, lambda: (HOME, (0.0,) * 6), lambda _, told: heard.append(told), prefix="", now_s=lambda: 0.0
        )
        return await follower.follow(handle), cell.calls

    result, calls = asyncio.run(run())
    assert len(handle.ends) == 1
    return result, calls, heard


def test_a_goal_is_one_call_and_its_end_is_told():
    handle = Handle(goal(MOVE))
    result, calls, _ = followed(handle)
    assert (result.code, handle.ends) == (ResultCode.SUCCESSFUL, ["succeeded"])
    ((tool, arguments),) = calls
    assert tool == "follow_trajectory"
    assert (arguments["times_s"], arguments["positions_rad"]) == ([0.0, 1.5], [list(HOME), list(END)])
    assert arguments["speed_rad_s"] > 0.2


@pytest.mark.parametrize(
    ("answer", "code", "reason"),
    [
        (Denied("NOT_GRANTED", {"remedy": "ask for less"}), ResultCode.INVALID_GOAL, "NOT_GRANTED"),
        (Deferred("APPROVAL_REQUIRED", {"url": "https://a/1"}), ResultCode.INVALID_GOAL, "APPROVAL_REQUIRED"),
        (ClientError("UNREACHABLE", 0, "gone"), ResultCode.INVALID_GOAL, "UNREACHABLE"),
        (
            {"outcome": "world_changed", "reason": "WORLD_CHANGED", "q_rad": list(HOME)},
            ResultCode.PATH_TOLERANCE_VIOLATED,
            "WORLD_CHANGED",
        ),
    ],
)
def test_what_does_not_reach_its_goal_is_aborted_with_the_reason(answer, code, reason):
    handle = Handle(goal(MOVE))
    result, _, _ = followed(handle, answer=answer)
    assert (result.code, handle.ends) == (code, ["aborted"])
    assert result.told.startswith(reason)


def test_an_end_outside_of_the_goals_tolerance():
    handle = Handle(goal(MOVE, end=[(NAMES[0], 0.001)]))
    reached = {"outcome": "reached", "reason": "", "q_rad": [0.29, *END[1:]]}
    result, _, _ = followed(handle, answer=reached)
    assert (result.code, handle.ends) == (ResultCode.GOAL_TOLERANCE_VIOLATED, ["aborted"])


def test_what_is_no_trajectory_asks_nobody():
    handle = Handle(goal(MOVE, NAMES[:5]))
    result, calls, _ = followed(handle)
    assert (result.code, calls, handle.ends) == (ResultCode.INVALID_JOINTS, [], ["aborted"])


def test_a_cancelled_goal_stops_the_arm():
    handle = Handle(goal(MOVE), cancel=True)
    _, calls, _ = followed(handle, lasting=True)
    assert ([tool for tool, _ in calls], handle.ends) == (["follow_trajectory", "stop"], ["canceled"])


def test_feedback_comes_while_it_lasts_and_a_second_goal_is_refused():
    first, second, heard = Handle(goal(MOVE)), Handle(goal(MOVE)), []

    async def run():
        cell = Cell(lasting=True)

        def hear(handle, told):
            assert handle is first
            heard.append(told)
            first.is_cancel_requested = len(heard) == 2

        follower = Follower(cell, lambda: (HOME, (0.1,) * 6), hear, prefix="", now_s=iter(range(100)).__next__)
        running = asyncio.ensure_future(follower.follow(first))
        await asyncio.sleep(0)
        busy = await follower.follow(second)
        return busy, await running

    busy, _ = asyncio.run(run())
    assert (busy.code, busy.told.partition(":")[0], second.ends) == (ResultCode.INVALID_GOAL, "BUSY", ["aborted"])
    assert first.ends == ["canceled"]
    assert heard[0].actual == (HOME, (0.1,) * 6)
    assert heard[-1].desired[0] == pytest.approx(END)  # its second second is after its end
