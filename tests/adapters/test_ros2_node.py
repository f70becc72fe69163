"""The ROS 2 node as a process before a whole cell, with a stand-in for rclpy."""

import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from capabilities.keys import keys
from pep.base.operations import FOLLOW_TRAJECTORY
from tests.adapters.test_ros2_goal import NAMES
from tests.e2e.test_gateway import House
from ztpm.stage.samples import StateRecorder
from ztpm.stage.stage import LEFT, until
from ztpm_ros2.goal import ResultCode

pytestmark = [pytest.mark.e2e, pytest.mark.campaign, pytest.mark.timeout(120), pytest.mark.clause("LSD-24")]

TOP = Path(__file__).parents[2]
PREFIX = "left_"
PASSPHRASE = "of the node's key"


class RosNode:
    """The node, as `ztpm-ros2` begins it."""

    def __init__(self, house, folder):
        key, token = folder / "mover.key", folder / "mover.token"
        key.write_bytes(keys.to_pem(house.stage.agents["mover"].key, PASSPHRASE.encode()))
        token.write_text(house.stage.tokens["mover"])
        addresses = house.cell.addresses
        parameters = {
            "agent": "mover", "issuer": addresses.issuer, "key_file": str(key), "token_file": str(token),
            "tools": addresses.audience, "gateway": addresses.gateway_host, "prefix": PREFIX,
        }  # fmt: skip
        path = os.pathsep.join(map(str, (TOP / "tests/adapters/ros_stand_in", TOP / "adapters/ros2", TOP)))
        self.process = subprocess.Popen(
            [sys.executable, "-c", "from ztpm_ros2.node import main; main()"],
            env=os.environ | {"PYTHONPATH": path, "ROS_PARAMETERS": json.dumps(parameters), "ZTPM_PASSPHRASE": PASSPHRASE},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        self.heard, self.states = [], 0
        threading.Thread(target=self._hear, daemon=True).start()
        until(lambda: self.of("ready"), "the action")

    def _hear(self):
        for line in self.process.stdout:
            told = json.loads(line)
            if told["kind"] == "joint_states":
                self.states, self.state = self.states + 1, told
            else:
                self.heard.append(told)

    def of(self, kind, goal=None):
        return [each for each in list(self.heard) if each["kind"] == kind and each.get("goal") == goal]

    def send(self, **asked):
        self.process.stdin.write(json.dumps(asked) + "\n")
        self.process.stdin.flush()

    def ended(self, goal):
        until(lambda: self.of("result", goal), f"the end of goal {goal}")
        (result,), (status,) = self.of("result", goal), self.of("status", goal)
        return ResultCode(result["code"]), status["status"], result["told"]


def swing(start, way, lasts_s, names=NAMES):
    """A goal as MoveIt makes one: a smooth swing of the first joint."""
    s = np.linspace(0, 1, 9)
    made = way * (10 * s**3 - 15 * s**4 + 6 * s**5)
    stamp = {"sec": 0, "nanosec": 0}
    points = [
        {
            "positions": [start[0] + share, *start[1:]], "velocities": [], "accelerations": [], "effort": [],
            "time_from_start": dict(zip(("sec", "nanosec"), divmod(round(at * 1e9), 10**9), strict=True)),
        }
        for share, at in zip(made.tolist(), (lasts_s * s).tolist(), strict=True)
    ]  # fmt: skip
    message = {"header": {"stamp": stamp}, "joint_names": [PREFIX + name for name in names], "points": points}
    return {"trajectory": message, "path_tolerance": [], "goal_tolerance": []}


def test_goals_move_the_arm_as_the_gateway_permits(tmp_path):
    house = House(tmp_path)
    eyes = StateRecorder(house.cell.addresses.host)
    try:
        house.agent("mover", FOLLOW_TRAJECTORY)
        node = RosNode(house, tmp_path)
        until(lambda: node.states > 20, "joint states")
        assert node.state["name"] == [f"{PREFIX}{name}" for name in NAMES]
        assert node.state["position"] == pytest.approx(LEFT, abs=2e-3)

        node.send(goal=1, request=swing(LEFT, 0.4, 2.0))
        ended = node.ended(1)
        assert ended == (ResultCode.SUCCESSFUL, "succeeded", ""), ended
        there = (LEFT[0] + 0.4, *LEFT[1:])
        assert eyes.now().q_rad == pytest.approx(there, abs=2e-3)
        told = node.of("feedback", 1)
        assert LEFT[0] < told[len(told) // 2]["actual"][0] < there[0]

        node.send(goal=2, request=swing(LEFT, 0.4, 2.0))
        code, status, words = node.ended(2)
        assert (code, status, words.split(":")[0]) == (ResultCode.INVALID_GOAL, "aborted", "OUT_OF_RANGE")
        node.send(goal=3, request=swing(there, 0.4, 2.0, names=NAMES[:5]))
        assert node.ended(3)[:2] == (ResultCode.INVALID_JOINTS, "aborted")
        assert eyes.now().q_rad == pytest.approx(there, abs=2e-3)

        node.send(goal=4, request=swing(there, -0.8, 4.0))
        until(lambda: eyes.now().q_rad[0] < there[0] - 0.1, "a motion")
        node.send(cancel=4)
        assert node.ended(4)[:2] == (ResultCode.SUCCESSFUL, "canceled")
        until(lambda: eyes.now().still, "standstill")
        assert there[0] - 0.7 < eyes.now().q_rad[0] < there[0]

        node.process.stdin.close()
        assert node.process.wait(10) == 0
    finally:
        eyes.close()
        house.stage.close()
        house.cell.stop()
