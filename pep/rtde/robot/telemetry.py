"""Controller's state of arm, tool and outputs, all of it out of one RTDE package."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.base.errors import PepFault, RobotError
from pep.rtde.robot.connections import RTDE
from pep.rtde.robot.listener import Listener, packages
from pep.rtde.robot.state_receiver import FRESH_S
from pep.rtde.wire.subscription import Subscription

if TYPE_CHECKING:
    import socket

    from pep.rtde.wire.codec import Value

RATE_HZ: Final = 125.0
_NAMES: Final = (
    "actual_q", "actual_TCP_pose", "tcp_offset", "payload", "robot_mode", "safety_mode", "runtime_state",
    "actual_digital_output_bits",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class TelemetrySample:
    """One package.

    Attributes:
        q_rad: actual joint angles.
        tool_pose: of the tool centre point in the base frame: position in m, rotation vector in rad.
        tcp_offset: of the tool centre point in the flange frame, likewise.
        payload_kg: payload in the controller.
        robot_mode, safety_mode, runtime_state: as the controller numbers them.
        output_bits: digital outputs: 0 to 7 standard, 8 to 15 configurable, 16 and 17 at the tool.
        arrived_s: monotonic time of arrival.
    """

    q_rad: tuple[float, ...]
    tool_pose: tuple[float, ...]
    tcp_offset: tuple[float, ...]
    payload_kg: float
    robot_mode: int
    safety_mode: int
    runtime_state: int
    output_bits: int
    arrived_s: float


class Telemetry:
    """Newest package, from a connection of our own.

    Args:
        host: of the controller.
    """

    def __init__(self, host: str) -> None:
        self._newest: TelemetrySample | None = None
        self._came = threading.Condition()
        self._listener = Listener("telemetry", host, RTDE, self._talk)
        self._listener.start()

    def read(self) -> TelemetrySample:
        """The newest package.

        Raises:
            RobotError: `ROBOT_STALLED` when it is older than 100 ms, or there is none.
        """
        newest = self._newest
        if newest is None or time.monotonic() - newest.arrived_s > FRESH_S:
            raise RobotError(PepFault.ROBOT_STALLED, "no package within 100 ms")
        return newest

    def next(self) -> TelemetrySample:
        """Package that arrives after this call has begun, waited for at most 100 ms.

        Raises:
            RobotError: `ROBOT_STALLED`.
        """
        asked_s = time.monotonic()
        with self._came:
            self._came.wait_for(lambda: self._newest is not None and self._newest.arrived_s > asked_s, FRESH_S)
        newest = self._newest
        if newest is None or newest.arrived_s <= asked_s:
            raise RobotError(PepFault.ROBOT_STALLED, "no package within 100 ms")
        return newest

    def close(self) -> None:
        """Ends the connection."""
        self._listener.close()

    def _talk(self, link: socket.socket) -> None:
        for values in packages(link, Subscription(_NAMES, RATE_HZ)):
            self._take(values)

    def _take(self, values: dict[str, Value]) -> None:
        joints, pose, offset = (_vector(values[name]) for name in _NAMES[:3])
        payload = _number(values["payload"])
        if not all(map(math.isfinite, (*joints, *pose, *offset, payload))):
            return  # no package at all: the one before it grows too old
        robot_mode, safety_mode, runtime_state, output_bits = (int(_number(values[name])) for name in _NAMES[4:])
        with self._came:
            self._newest = TelemetrySample(
                q_rad=joints,
                tool_pose=pose,
                tcp_offset=offset,
                payload_kg=payload,
                robot_mode=robot_mode,
                safety_mode=safety_mode,
                runtime_state=runtime_state,
                output_bits=output_bits,
                arrived_s=time.monotonic(),
            )
            self._came.notify_all()


def _vector(value: Value) -> tuple[float, ...]:
    if not isinstance(value, tuple):
        raise RobotError(PepFault.ROBOT_UNREACHABLE, "a vector was promised")
    return tuple(map(float, value))


def _number(value: Value) -> float:
    if isinstance(value, tuple):
        raise RobotError(PepFault.ROBOT_UNREACHABLE, "a number was promised")
    return value
