"""What every object with the interface of `rtde_control.RTDEControlInterface` has that stands before the raw one.

Composition, not inheritance: every method is written on purpose, and a name that is not is refused.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any, Final, NoReturn

from pep.rtde.command.stop_rules import JOINT_DECELERATION_LIMIT_RAD_S2

if TYPE_CHECKING:
    from collections.abc import Callable

STOP_PATIENCE_S: Final = 0.02
"""Longest wait of a stop for a command that is just being handed over (a hand-over takes some milliseconds)."""
UNWATCHED_HZ: Final = 1e-6
"""A watchdog of once in twelve days is none; URScript has no word for taking one away."""

READING: Final = (
    "getActualJointPositionsHistory", "getActualToolFlangePose", "getAsyncOperationProgress",
    "getAsyncOperationProgressEx", "getCoriolisAndCentrifugalTorques", "getForwardKinematics", "getFreedriveStatus",
    "getInverseKinematics", "getInverseKinematicsHasSolution", "getJacobian", "getJacobianTimeDerivative",
    "getJointTorques", "getMassMatrix", "getRobotStatus", "getStepTime", "getTCPOffset", "getTargetJointAccelerations",
    "getTargetWaypoint", "isConnected", "isJointsWithinSafetyLimits", "isPoseWithinSafetyLimits", "isProgramRunning",
    "isSteady", "poseTrans", "readContactDetection",
)  # fmt: skip
"""They answer questions. Those that ask over the command register take the lock like a command."""
LOCAL_READING: Final = frozenset(
    {"getAsyncOperationProgress", "getAsyncOperationProgressEx", "getRobotStatus", "isConnected", "isProgramRunning"}
)
"""Answered from the last package, without a command."""
STOPPING: Final = (
    "endFreedriveMode", "endTeachMode", "forceModeStop", "jogStop", "servoStop", "speedStop", "stopJ", "stopL",
    "stopScript", "triggerProtectiveStop",
)  # fmt: skip
"""They end motion and are never subject to a permit."""


class ControlInterface:
    """Questions pass, one at a time; what a subclass does not name is refused.

    Args:
        control: the raw `RTDEControlInterface`; keep no other reference to it.
        stop_deceleration_rad_s2: the cell's stop model, of the leading axis: every stop is at least this hard.

    Raises:
        ValueError: for a deceleration that no stop can have; every stop would fail.
    """

    def __init__(self, control: Any, *, stop_deceleration_rad_s2: float) -> None:
        if not 0.0 < stop_deceleration_rad_s2 <= JOINT_DECELERATION_LIMIT_RAD_S2:
            raise ValueError(f"the stop deceleration must lie in (0, {JOINT_DECELERATION_LIMIT_RAD_S2}] rad/s2")
        self._control = control
        self._deceleration = stop_deceleration_rad_s2
        self._lock = threading.Lock()  # of the raw object, which is not thread-safe

    def _read(self, name: str, arguments: tuple[Any, ...], options: dict[str, Any]) -> Any:
        if name in LOCAL_READING:
            return getattr(self._control, name)(*arguments, **options)
        with self._lock:
            return getattr(self._control, name)(*arguments, **options)

    def _at_once(self, give: Callable[[], Any]) -> Any:
        """A stop: a command that is being handed over is given a moment to end, and never waited for."""
        ended = self._lock.acquire(timeout=STOP_PATIENCE_S)
        try:
            return give()
        finally:
            if ended:
                self._lock.release()

    def __getattr__(self, name: str) -> NoReturn:
        # A method that a later ur_rtde adds is refused until somebody has read what it does.
        raise AttributeError(f"{type(self).__name__} has no {name}")


def _reading(name: str) -> Callable[..., Any]:
    def read(self: ControlInterface, *arguments: Any, **options: Any) -> Any:
        return self._read(name, arguments, options)

    read.__doc__ = f"`{name}` of the control interface."
    return read


for _name in READING:
    setattr(ControlInterface, _name, _reading(_name))
