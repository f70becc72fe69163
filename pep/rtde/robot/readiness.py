"""`Readiness` port: assumptions of a command about the robot, read from our own connections without waiting."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Final, Protocol

from capabilities.values.units import Unit
from pep.base.errors import ConfigError, PepFault, RobotError
from pep.rtde.command.limits import OFFSET_M, OFFSET_RAD
from policies.evidence.evidence import RobotReading
from policies.primitives.tools import NO_CONTROLLER

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pep.rtde.robot.dashboard import RemoteControl
    from pep.rtde.robot.state_receiver import Package, StateReceiver

PLAYING: Final = 2  # RTDE runtime_state
UNDEFINED = 11  # RTDE safety_mode of a robot that says nothing
OWN_POSE_M: Final = 0.0003
"""Largest distance of the tool's place by model and by controller for equal kinematics (PHY-41).

Of four arms each is farther from every other one, and from nominal, in 94 of 100 poses, and each motion asks again.
"""


class RunningProgram(Protocol):
    """Program that the controller runs."""

    def undisturbed(self) -> bool:
        """True where it is the control script that we sent, as far as that can be known."""
        ...

    def close(self) -> None:
        """Ends the observation."""
        ...


class RobotReadiness:
    """Robot's state against the model and the committed state.

    Args:
        state: of the robot.
        remote: of the robot.
        program: the program that the controller runs.
        commanding: whether the control connection stands; while it does, the controller lends its registers to nobody
            else.
        tool_position: tool centre point by the model, in the base frame (m), at six joint angles (rad).
        tcp_m: of the model's tool, in the flange frame; it is not turned against it.
        pose_m: allowed distance of the controller's tool centre point from the model's.
        expected_payload_g: tool and held part by the committed state; for a part that nobody can name, all that the arm
            may carry.
    """

    def __init__(
        self,
        *,
        state: StateReceiver,
        remote: RemoteControl,
        program: RunningProgram,
        commanding: Callable[[], bool],
        tool_position: Callable[[Sequence[float]], Sequence[float]],
        tcp_m: Sequence[float],
        pose_m: float,
        expected_payload_g: Callable[[], int],
    ) -> None:
        self._state = state
        self._remote = remote
        self._program = program
        self._commanding = commanding
        self._tool_position = tool_position
        self._tcp_m = tuple(tcp_m)
        self._pose_m = pose_m
        self._expected_payload_g = expected_payload_g

    def reading(self) -> RobotReading:
        """State now; a missing report reads as unknown. Never raises, never waits."""
        remote, expected = self._remote.state(), self._expected_payload_g()
        package = self._state.current()
        if package is None or package.state is None:
            return RobotReading(NO_CONTROLLER, UNDEFINED, remote, False, 0, expected, False)  # noqa: FBT003 - by position
        return RobotReading(
            robot_mode=package.state.robot_mode,
            safety_mode=package.state.safety_mode,
            remote_control=remote,
            exclusive=package.runtime_state == PLAYING and self._program.undisturbed() and self._commanding(),
            payload_g=round(package.payload_kg * Unit.GRAM.per_si),
            expected_payload_g=expected,
            frames_match=self.equipped(package) and self._in_place(package),
        )

    def close(self) -> None:
        """Ends the connections but that of the state."""
        for part in (self._remote, self._program):
            part.close()

    def confirmed(self, *, within_s: float) -> bool:
        """True where the controller has the tool at the model's place, once it has taken our tool.

        Waits for that.

        Args:
            within_s: longest wait, s.

        Raises:
            RobotError: `ROBOT_STALLED` when the controller says nothing for so long.
            ConfigError: `CONFIG_INVALID` when it has said of another tool all the while.
        """
        until_s = time.monotonic() + within_s
        while True:
            try:
                package = self._state.next()
                if self.equipped(package):
                    return self._in_place(package)
            except RobotError:
                if time.monotonic() >= until_s:
                    raise
            if time.monotonic() >= until_s:
                raise ConfigError(PepFault.CONFIG_INVALID, "the controller has another tool than the model")

    def equipped(self, package: Package) -> bool:
        """True where the controller has our tool."""
        offset_m, offset_rad = package.tcp_offset[:3], package.tcp_offset[3:]
        return math.dist(offset_m, self._tcp_m) <= OFFSET_M and math.hypot(*offset_rad) <= OFFSET_RAD

    def _in_place(self, package: Package) -> bool:
        state = package.state
        if state is None:
            return False
        return math.dist(package.tool_pose[:3], self._tool_position(state.q_rad)) <= self._pose_m
