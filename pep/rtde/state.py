"""What the robot says about itself, over a receive connection of our own, and only when it is saying it now."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from pep.errors import PepFault, RobotError
from pep.rtde.packages import Packages, number, vector

if TYPE_CHECKING:
    from pep.rtde.codec import Value

FRESH_S: Final = 0.1
"""Longest wait for a new package, fifty of which are due: a joint state older than 100 ms is none for a move."""
BEGINS_S: Final = 2.0
"""Longest wait for the first one."""
RATE_HZ: Final = 500.0
"""As often as an e-Series controller has something new."""
NAMES: Final = (
    "timestamp", "actual_q", "actual_qd", "robot_mode", "safety_mode", "target_speed_fraction", "speed_scaling",
)  # fmt: skip
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
    """`RobotState` over a connection of our own, which comes back by itself when it is lost. From any thread.

    Args:
        host: of the controller.

    Raises:
        RobotError: `ROBOT_UNREACHABLE` when it has said nothing within `BEGINS_S`.
    """

    def __init__(self, host: str) -> None:
        self._packages = Packages("state", host, NAMES, RATE_HZ, read=package_of)
        if self._packages.newest is None and self._packages.next(within_s=BEGINS_S) is None:
            self.close()
            raise RobotError(PepFault.ROBOT_UNREACHABLE, host)

    def read(self) -> JointState:
        """A package that arrived during the call.

        Raises:
            RobotError: `ROBOT_STALLED` when none arrives, or one that holds no finite numbers.
        """
        package = self._packages.next(within_s=FRESH_S)
        if package is None:
            raise RobotError(PepFault.ROBOT_STALLED, "no package within 100 ms")
        if package.state is None:
            raise RobotError(PepFault.ROBOT_STALLED, "joint angles that are no six finite numbers")
        return package.state

    def newest(self) -> Package:
        """The newest package, however old: its reader sees that its stamp does not change."""
        newest = self._packages.newest
        assert newest is not None
        return newest

    def close(self) -> None:
        """The connection has ended."""
        self._packages.close()


def package_of(values: dict[str, Value], arrived_s: float) -> Package:  # noqa: ARG001 - `Packages` says it to each
    """What a package of `NAMES` says.

    Raises:
        WireError: a value of another form than the controller's tables promise.
    """
    stamp, slider, scaling = (number(values[name]) for name in ("timestamp", "target_speed_fraction", "speed_scaling"))
    q, qd = vector(values["actual_q"]), vector(values["actual_qd"])
    if not all(map(math.isfinite, (*q, *qd, slider, scaling))):
        return Package(stamp, None)
    robot_mode, safety_mode = int(number(values["robot_mode"])), int(number(values["safety_mode"]))
    return Package(stamp, JointState(q, qd, robot_mode, safety_mode, slider, scaling))
