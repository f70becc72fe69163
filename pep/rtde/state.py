"""What the robot says about itself, over a receive connection of our own, and only when it is saying it now."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any, Final, Protocol

from pep.errors import PepFault, RobotError

FRESH_S: Final = 0.1
"""Longest wait for a new package, fifty of which are due: a joint state older than 100 ms is none for a move."""
POLL_S: Final = 0.001
EVERY_CYCLE: Final = -1.0
"""ur_rtde: as often as the controller has something new."""
NAMES: Final = (
    "timestamp", "actual_q", "actual_qd", "robot_mode", "safety_mode", "target_speed_fraction", "speed_scaling",
)  # fmt: skip
"""The outputs that are read here; ur_rtde would ask for 58."""
STILL_RAD_S: Final = 1e-3
"""All joints slower than this is standstill (1 mrad/s)."""


@dataclass(frozen=True, slots=True)
class JointState:
    """One package of the controller.

    Attributes:
        q_rad, qd_rad_s: actual joint angles and speeds.
        robot_mode, safety_mode: as the controller numbers them.
        slider: where its speed slider stands (`target_speed_fraction`); full speed where nothing is said.
        scaling: how fast it goes of what was commanded (`speed_scaling`); likewise.
    """

    q_rad: tuple[float, ...]
    qd_rad_s: tuple[float, ...]
    robot_mode: int
    safety_mode: int
    slider: float = 1.0
    scaling: float = 1.0

    @property
    def still(self) -> bool:
        """Whether every joint is slower than 1 mrad/s."""
        return all(abs(speed) < STILL_RAD_S for speed in self.qd_rad_s)


@dataclass(frozen=True, slots=True)
class Package:
    """The newest package, whenever it came.

    Attributes:
        stamp_s: the controller's own time of it; one that does not grow is the same package.
        state: what it says, or None when it holds no six finite numbers.
    """

    stamp_s: float
    state: JointState | None


class RobotState(Protocol):
    """The robot's state now."""

    def read(self) -> JointState:
        """A package that arrived during the call. Raises `RobotError` when none does."""
        ...

    def newest(self) -> Package:
        """The newest package, without waiting for one."""
        ...


class ReceivedState:
    """`RobotState` over `rtde_receive.RTDEReceiveInterface`.

    Args:
        host: of the controller.
    """

    def __init__(self, host: str) -> None:
        from rtde_receive import RTDEReceiveInterface

        self._host = host
        try:
            self._receive: Any = RTDEReceiveInterface(host, EVERY_CYCLE, list(NAMES))
        except RuntimeError as error:
            raise RobotError(PepFault.ROBOT_UNREACHABLE, host) from error

    def read(self) -> JointState:
        """A package that arrived during the call.

        Raises:
            RobotError: `ROBOT_STALLED` when none arrives, or one that holds no finite numbers.
        """
        before = self._receive.getTimestamp()
        deadline = time.monotonic() + FRESH_S
        while self._receive.getTimestamp() == before:
            if time.monotonic() > deadline:
                raise RobotError(PepFault.ROBOT_STALLED, "no package within 100 ms")
            time.sleep(POLL_S)
        state = self._said()
        if state is None:
            raise RobotError(PepFault.ROBOT_STALLED, "joint angles that are no six finite numbers")
        return state

    def newest(self) -> Package:
        """The newest package. The stamp is read first: a package that comes meanwhile looks older, never younger."""
        stamp_s = float(self._receive.getTimestamp())
        return Package(stamp_s, self._said())

    def _said(self) -> JointState | None:
        q, qd = tuple(self._receive.getActualQ()), tuple(self._receive.getActualQd())
        slider, scaling = float(self._receive.getTargetSpeedFraction()), float(self._receive.getSpeedScaling())
        if not (len(q) == len(qd) == 6 and all(math.isfinite(number) for number in (*q, *qd, slider, scaling))):
            return None
        robot_mode, safety_mode = int(self._receive.getRobotMode()), int(self._receive.getSafetyMode())
        return JointState(q, qd, robot_mode, safety_mode, slider, scaling)

    def close(self) -> None:
        """The connection has ended."""
        self._receive.disconnect()
