"""The ROS 2 node: a `FollowJointTrajectory` action server and the arm's `joint_states`.

rclpy is imported here alone.
"""

from __future__ import annotations

import asyncio
import os
import sys
import threading
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import rclpy
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rtde_receive import RTDEReceiveInterface
from sensor_msgs.msg import JointState

from capabilities.keys import keys
from ztpm_idp.client import Agent
from ztpm_ros2.follow import Feedback, Follower
from ztpm_ros2.goal import JOINTS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ztpm_idp.client.tools import Tools

ACTION: Final = "scaled_joint_trajectory_controller/follow_joint_trajectory"
"""The name under which the vendor's MoveIt configurations look for the action."""
STATES_HZ: Final = 100.0
SETTINGS: Final = {
    "agent": "",
    "issuer": "",
    "key_file": "",
    "token_file": "",
    "tools": "",
    "gateway": "",
    "prefix": "",
    "patience_s": 60.0,
}
"""Parameters of the node: the agent's name, its provider, its key and token on this machine, the URL of the cell's
tools, the gateway's address as a controller, what stands before the joints' names, how long people may take to answer.
"""


class GuardedArm(Node):
    """Node of one arm. Its parameters are `SETTINGS`; the key's passphrase is in `ZTPM_PASSPHRASE`."""

    def __init__(self) -> None:
        super().__init__("ztpm_arm")
        for name, default in SETTINGS.items():
            self.declare_parameter(name, default)
        self._names = [f"{self._set('prefix')}{joint}_joint" for joint in JOINTS]
        self._receive = RTDEReceiveInterface(self._set("gateway"))
        self._states = self.create_publisher(JointState, "joint_states", 10)
        self.create_timer(1.0 / STATES_HZ, self._publish)
        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_forever, name="follower", daemon=True).start()
        self._follower = asyncio.run_coroutine_threadsafe(self._opened(self._tools()), self._loop).result()
        self._action = ActionServer(
            self,
            FollowJointTrajectory,
            ACTION,
            self._execute,
            cancel_callback=lambda _goal: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )

    def _set(self, name: str) -> Any:
        value = self.get_parameter(name).value
        if value == "" and name != "prefix":
            raise SystemExit(f"SETTING_MISSING: parameter {name}: give it, as README.md shows")
        return value

    def _tools(self) -> Tools:
        passphrase = os.environ.get("ZTPM_PASSPHRASE", "").encode()
        key = keys.from_pem(Path(self._set("key_file")).read_bytes(), passphrase)
        agent = Agent(self._set("agent"), key, self._set("issuer"), b"")
        token = Path(self._set("token_file")).read_text(encoding="utf-8").strip()
        asked = partial(print, "A person must answer:", file=sys.stderr, flush=True)
        return agent.tools(self._set("tools"), token, patience_s=float(self._set("patience_s")), asked=asked)

    async def _opened(self, tools: Tools) -> Follower:
        return Follower(
            await tools.__aenter__(), self._state, self._tell, prefix=self._set("prefix"), now_s=self._now_s
        )

    def _now_s(self) -> float:
        return float(self.get_clock().now().nanoseconds) * 1e-9

    def _state(self) -> tuple[Sequence[float], Sequence[float]]:
        return self._receive.getActualQ(), self._receive.getActualQd()

    def _publish(self) -> None:
        position, velocity = self._state()
        message = JointState(name=self._names, position=position, velocity=velocity)
        message.header.stamp = self.get_clock().now().to_msg()
        self._states.publish(message)

    def _tell(self, goal: Any, told: Feedback) -> None:
        message = FollowJointTrajectory.Feedback(joint_names=self._names)
        message.desired.positions, message.desired.velocities = map(list, told.desired)
        message.actual.positions, message.actual.velocities = map(list, told.actual)
        message.error.positions = [a - b for a, b in zip(told.desired[0], told.actual[0], strict=True)]
        goal.publish_feedback(message)

    def _execute(self, goal: Any) -> Any:
        ended = asyncio.run_coroutine_threadsafe(self._follower.follow(goal), self._loop).result()
        return FollowJointTrajectory.Result(error_code=int(ended.code), error_string=ended.told)


def main() -> None:
    """Runs the node until it is ended."""
    rclpy.init()
    node = GuardedArm()
    executor = MultiThreadedExecutor()
    executor.add_node(node)
    try:
        executor.spin()
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
