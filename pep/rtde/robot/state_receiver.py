"""State of the robot: one receive connection of the enforcement point's own, its only truth about the arm."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol

from pep.base.errors import PepFault, RobotError
from pep.base.thread_priority import goes_first
from pep.rtde.robot.connections import RTDE
from pep.rtde.robot.listener import CONNECT_S, Listener, packages
from pep.rtde.wire.subscription import Subscription

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable

    from pep.base.ports import Clock
    from pep.rtde.wire.messages import ControlVersion
    from pep.rtde.wire.recipes import Offset

RATE_HZ: Final = 500.0
FRESH_MS: Final = 100
"""Age beyond which a package is no state of the robot, and longest wait for a new one.

Fifty are due in that time.
"""
SURE_MS: Final = 40
"""Age beyond which a package excuses no stop, and lets no speed slider pass unjudged; twenty are due."""
STILL_RAD_S: Final = 1e-3
"""All joints slower than this is standstill (1 mrad/s)."""
OFFSETS: Final[tuple[Offset, ...]] = (0, 24)
NAMES: Final = (
    "timestamp", "actual_q", "actual_qd", "robot_mode", "safety_mode", "target_speed_fraction", "speed_scaling",
    "actual_TCP_pose", "tcp_offset", "payload", "runtime_state", "actual_digital_output_bits",
    *(f"{way}_int_register_{offset}" for offset in OFFSETS for way in ("input", "output")),
)  # fmt: skip
"""Outputs of the controller that a package has."""


@dataclass(frozen=True, slots=True)
class JointState:
    """Motion of the arm.

    Attributes:
        q_rad, qd_rad_s: actual joint angles and speeds.
        robot_mode, safety_mode: as the controller numbers them.
        slider: position of its speed slider (`target_speed_fraction`).
        scaling: actual fraction of the commanded speed (`speed_scaling`).
    """

    q_rad: tuple[float, ...]
    qd_rad_s: tuple[float, ...]
    robot_mode: int
    safety_mode: int
    slider: float = 1.0
    scaling: float = 1.0

    @property
    def speed_rad_s(self) -> float:
        """Speed of the fastest joint."""
        return max(map(abs, self.qd_rad_s))

    @property
    def still(self) -> bool:
        """True where every joint is slower than 1 mrad/s."""
        return self.speed_rad_s < STILL_RAD_S


@dataclass(frozen=True, slots=True)
class Package:
    """One package of the controller.

    Attributes:
        stamp_s: the controller's own time of it.
        arrived_ms: monotonic time of arrival.
        state: motion of the arm, or None where a number of the package is not finite.
        tool_pose: of the tool centre point in the base frame: position in m, rotation vector in rad.
        tcp_offset: of the tool centre point in the flange frame, likewise.
        payload_kg: payload in the controller.
        runtime_state: as the controller numbers it.
        output_bits: digital outputs: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool.
        registers: by offset, the command register as the controller has it and the word of the control script.
    """

    stamp_s: float
    arrived_ms: int
    state: JointState | None
    tool_pose: tuple[float, ...]
    tcp_offset: tuple[float, ...]
    payload_kg: float
    runtime_state: int
    output_bits: int
    registers: dict[Offset, tuple[int, int]]

    @property
    def speed_rad_s(self) -> float:
        """Speed of the fastest joint; infinite where it is not told."""
        return math.inf if self.state is None else self.state.speed_rad_s

    @property
    def still(self) -> bool:
        """True where the arm is told to stand."""
        return self.speed_rad_s < STILL_RAD_S


class RobotState(Protocol):
    """Port for the robot's state now."""

    def read(self) -> JointState:
        """State out of a package that arrived during the call. Raises `RobotError` when none does."""
        ...

    def newest(self) -> Package:
        """Newest package, at any age, without waiting for one."""
        ...


class StateReceiver:
    """`RobotState` on a thread that goes first; the connection comes back by itself when it is lost.

    Args:
        host: of the controller.
        clock: the monotonic one counts.

    Attributes:
        told: is given each package, on the receiver's thread.
        version: of the controller's software.

    Raises:
        RobotError: `ROBOT_UNREACHABLE` when no package comes within 2 s.
    """

    def __init__(self, host: str, clock: Clock) -> None:
        self.told: Callable[[Package], None] | None = None
        self.version: ControlVersion | None = None
        self._clock = clock
        self._came = threading.Condition()
        self._number = 0
        self._listener = Listener("state", host, RTDE, self._talk)
        self._listener.start()
        try:
            self._newest = self._after(0, CONNECT_S)
        except RobotError as error:
            self.close()
            raise RobotError(PepFault.ROBOT_UNREACHABLE, f"{host}, port {RTDE}") from error

    def newest(self) -> Package:
        """See `RobotState.newest`."""
        return self._newest

    @property
    def silent_ms(self) -> int:
        """Milliseconds since the newest package."""
        return self._clock.monotonic_ms() - self._newest.arrived_ms

    def current(self, within_ms: int = FRESH_MS) -> Package | None:
        """Newest package, or None where that is older than `within_ms`."""
        return self._newest if self.silent_ms <= within_ms else None

    def next(self) -> Package:
        """Package that arrives after this call has begun.

        Raises:
            RobotError: `ROBOT_STALLED` when none arrives within 100 ms.
        """
        return self._after(self._number, FRESH_MS / 1000)

    def read(self) -> JointState:
        """See `RobotState.read`.

        Raises:
            RobotError: `ROBOT_STALLED` when none arrives within 100 ms, or one whose numbers are not finite.
        """
        state = self.next().state
        if state is None:
            raise RobotError(PepFault.ROBOT_STALLED, "numbers that are not finite")
        return state

    def close(self) -> None:
        """Ends the connection."""
        self._listener.close()

    def _after(self, number: int, limit_s: float) -> Package:
        with self._came:
            if not self._came.wait_for(lambda: self._number > number, limit_s):
                raise RobotError(PepFault.ROBOT_STALLED, f"no package within {limit_s * 1000:.0f} ms")
            return self._newest

    def _talk(self, link: socket.socket) -> None:
        goes_first()
        subscription = Subscription(NAMES, RATE_HZ)
        for values in packages(link, subscription):
            package = _package(values, self._clock.monotonic_ms())
            with self._came:
                self._newest, self.version = package, subscription.version
                self._number += 1
                self._came.notify_all()
            told = self.told
            if told is not None:
                told(package)


def _package(values: dict[str, Any], arrived_ms: int) -> Package:
    q, qd, pose, offset = (values[name] for name in ("actual_q", "actual_qd", "actual_TCP_pose", "tcp_offset"))
    slider, scaling, payload = values["target_speed_fraction"], values["speed_scaling"], values["payload"]
    state = None
    if all(map(math.isfinite, (*q, *qd, *pose, *offset, slider, scaling, payload))):
        state = JointState(q, qd, values["robot_mode"], values["safety_mode"], slider, scaling)
    return Package(
        stamp_s=values["timestamp"],
        arrived_ms=arrived_ms,
        state=state,
        tool_pose=pose,
        tcp_offset=offset,
        payload_kg=payload,
        runtime_state=values["runtime_state"],
        output_bits=values["actual_digital_output_bits"],
        registers={
            offset: (values[f"input_int_register_{offset}"], values[f"output_int_register_{offset}"])
            for offset in OFFSETS
        },
    )
