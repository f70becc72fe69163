"""State of the robot, over a receive connection of our own, and only while it is current."""

from __future__ import annotations

import math
import socket
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final, Protocol

from pep.base.errors import PepFault, RobotError
from pep.rtde.robot.connections import RTDE
from pep.rtde.robot.listener import CONNECT_S, SILENCE_S, packages
from pep.rtde.wire.messages import WireError
from pep.rtde.wire.subscription import Subscription

FRESH_S: Final = 0.1
"""Longest wait for a new package, fifty of which are due.

A joint state older than 100 ms is none for a move.
"""
POLL_S: Final = 0.001
EVERY_CYCLE: Final = -1.0
"""Frequency for ur_rtde: as often as the controller has something new."""
RATE_HZ: Final = 125.0
"""Frequency of the trial whether the controller sends."""
LOOK_S: Final = 0.5
"""Period of the checks that packages still come."""
CLOSE_S: Final = 5.0
"""Longest wait for another thread's turn."""
NAMES: Final = (
    "timestamp", "actual_q", "actual_qd", "robot_mode", "safety_mode", "target_speed_fraction", "speed_scaling",
)  # fmt: skip
"""Outputs that are read here; ur_rtde would ask for 58."""
STILL_RAD_S: Final = 1e-3
"""All joints slower than this is standstill (1 mrad/s)."""


@dataclass(frozen=True, slots=True)
class JointState:
    """One package of the controller.

    Attributes:
        q_rad, qd_rad_s: actual joint angles and speeds.
        robot_mode, safety_mode: as the controller numbers them.
        slider: position of its speed slider (`target_speed_fraction`); full speed where it is not told.
        scaling: actual fraction of the commanded speed (`speed_scaling`); likewise.
    """

    q_rad: tuple[float, ...]
    qd_rad_s: tuple[float, ...]
    robot_mode: int
    safety_mode: int
    slider: float = 1.0
    scaling: float = 1.0

    @property
    def still(self) -> bool:
        """True where every joint is slower than 1 mrad/s."""
        return all(abs(speed) < STILL_RAD_S for speed in self.qd_rad_s)


@dataclass(frozen=True, slots=True)
class Package:
    """Newest package, at any age.

    Attributes:
        stamp_s: the controller's own time of it; one that does not grow is the same package.
        state: state of the package, or None when it holds no six finite numbers.
    """

    stamp_s: float
    state: JointState | None


class RobotState(Protocol):
    """Port for the robot's state now."""

    def read(self) -> JointState:
        """Package that arrived during the call. Raises `RobotError` when none does."""
        ...

    def newest(self) -> Package:
        """Newest package, without waiting for one."""
        ...


class ReceivedState:
    """`RobotState` over `rtde_receive.RTDEReceiveInterface`, without reconnection of its own.

    Two of them take turns then. None is begun anew while others read it, since it is no lock that keeps these apart,
    and none is disposed of, since that holds the interpreter for half a second.

    Args:
        host: of the controller.

    Raises:
        RobotError: `ROBOT_UNREACHABLE`.
    """

    def __init__(self, host: str) -> None:
        self._host = host
        try:
            self._receive = _received(host)
        except RuntimeError as error:
            raise RobotError(PepFault.ROBOT_UNREACHABLE, host) from error
        self._spare: Any = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._keep, name="state", daemon=True)
        self._thread.start()

    def read(self) -> JointState:
        """Package that arrived during the call.

        Raises:
            RobotError: `ROBOT_STALLED` when none arrives, or one that holds no finite numbers.
        """
        before = self._receive.getTimestamp()
        deadline = time.monotonic() + FRESH_S
        while self._receive.getTimestamp() == before:
            if time.monotonic() > deadline:
                raise RobotError(PepFault.ROBOT_STALLED, "no package within 100 ms")
            time.sleep(POLL_S)
        state = _said(self._receive)
        if state is None:
            raise RobotError(PepFault.ROBOT_STALLED, "joint angles that are no six finite numbers")
        return state

    def newest(self) -> Package:
        """Newest package.

        The stamp is read first: a package that comes meanwhile looks older, never younger.
        """
        receive = self._receive
        stamp_s = float(receive.getTimestamp())
        return Package(stamp_s, _said(receive))

    def close(self) -> None:
        """Ends the connection."""
        self._ending.set()
        self._thread.join(CLOSE_S)
        self._receive.disconnect()

    # ---- in the background

    def _keep(self) -> None:
        stamp_s, since_s = math.nan, time.monotonic()
        while not self._ending.wait(LOOK_S):
            now_s, newest_s = time.monotonic(), self._receive.getTimestamp()
            if newest_s != stamp_s:
                stamp_s, since_s = newest_s, now_s
            elif now_s - since_s > SILENCE_S and _speaks(self._host):
                with suppress(RuntimeError):  # gone again: there is a next look
                    self._again()

    def _again(self) -> None:
        """Hands over to the other connection, once packages of its new life come on it."""
        if self._spare is None:
            self._spare = _received(self._host)
        else:
            self._spare.reconnect()
        if not _goes_on(self._spare):
            self._spare.disconnect()
            return
        self._receive, self._spare = self._spare, self._receive
        self._spare.disconnect()


def _received(host: str) -> Any:
    """Connection; raises `RuntimeError` where there is none."""
    from rtde_receive import RTDEReceiveInterface

    return RTDEReceiveInterface(host, EVERY_CYCLE, list(NAMES))


def _said(receive: Any) -> JointState | None:
    q, qd = tuple(receive.getActualQ()), tuple(receive.getActualQd())
    slider, scaling = float(receive.getTargetSpeedFraction()), float(receive.getSpeedScaling())
    if not (len(q) == len(qd) == 6 and all(math.isfinite(number) for number in (*q, *qd, slider, scaling))):
        return None
    robot_mode, safety_mode = int(receive.getRobotMode()), int(receive.getSafetyMode())
    return JointState(q, qd, robot_mode, safety_mode, slider, scaling)


def _goes_on(receive: Any) -> bool:
    """True where its newest package is current: another one follows it, and a third that."""
    until_s = time.monotonic() + SILENCE_S
    stamps = {receive.getTimestamp()}
    while len(stamps) < 3 and time.monotonic() < until_s:
        time.sleep(POLL_S)
        stamps.add(receive.getTimestamp())
    return len(stamps) >= 3


def _speaks(host: str) -> bool:
    """True where the controller sends packages; for a silent one ur_rtde would wait for ever."""
    try:
        with socket.create_connection((host, RTDE), CONNECT_S) as link:
            link.settimeout(SILENCE_S)
            next(packages(link, Subscription(NAMES, RATE_HZ)))
            return True
    except (OSError, WireError):
        return False
