"""State of the controller, over a receive connection of the gateway's own: its only truth about the robot."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.rtde.robot.connections import RTDE
from pep.rtde.robot.reconnecting import ReconnectingConnection
from pep.rtde.robot.state_receiver import STILL_RAD_S
from pep.rtde.wire.subscription import Subscription

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.base.ports import Clock
    from pep.rtde.wire.codec import Value
    from pep.rtde.wire.messages import ControlVersion
    from pep.rtde.wire.recipes import Offset

RATE_HZ: Final = 500.0
FRESH_MS: Final = 40
"""Age of a package beyond which it need not hold: twenty packages."""
_NAMES: Final = (
    "actual_qd", "runtime_state", "safety_mode", "target_speed_fraction",
    "input_int_register_0", "output_int_register_0", "input_int_register_24", "output_int_register_24",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Sample:
    """One package.

    Attributes:
        speed_rad_s: of the fastest joint; infinite when the package has no number there.
        runtime_state, safety_mode: as the controller numbers them.
        slider: position of the speed slider.
        registers: by offset, the command register as the controller has it and what the control script says.
        arrived_ms: monotonic time.
    """

    speed_rad_s: float
    runtime_state: int
    safety_mode: int
    slider: float
    registers: dict[Offset, tuple[int, int]]
    arrived_ms: int

    @property
    def still(self) -> bool:
        """True where the arm stands."""
        return self.speed_rad_s < STILL_RAD_S


class StateStream:
    """Newest package. The connection comes back by itself when it is lost.

    Args:
        host: of the controller.
        clock: the monotonic one counts.
        heard: is given each package.
    """

    def __init__(self, host: str, *, clock: Clock, heard: Callable[[Sample], None]) -> None:
        self._clock = clock
        self._tell = heard
        self._robot = ReconnectingConnection(host, RTDE, begin=self._begin, heard=self._heard, lost=lambda: None)
        self._subscription = Subscription(_NAMES, RATE_HZ)
        self._came = asyncio.Event()
        self.newest: Sample | None = None

    async def begin(self) -> None:
        """Listens, or tries to, from now on; returns after the first package."""
        await self._robot.begin()
        await self._came.wait()

    def close(self) -> None:
        """Ends the connection."""
        self._robot.close()

    @property
    def version(self) -> ControlVersion | None:
        """Software of the controller; None before its first word."""
        return self._subscription.version

    def silent_ms(self) -> float:
        """Milliseconds of silence."""
        return math.inf if self.newest is None else self._clock.monotonic_ms() - self.newest.arrived_ms

    def _begin(self) -> bytes:
        self._subscription = Subscription(_NAMES, RATE_HZ)
        return self._subscription.begin()

    def _heard(self, content: bytes) -> None:
        said, packages = self._subscription.feed(content)
        if said:
            self._robot.send(said)
        for values in packages:
            self.newest = _sample(values, self._clock.monotonic_ms())
            self._came.set()
            self._tell(self.newest)


def _sample(values: dict[str, Value], at_ms: int) -> Sample:
    speeds = values["actual_qd"]
    assert isinstance(speeds, tuple)
    fastest = max(map(abs, speeds))
    registers: dict[Offset, tuple[int, int]] = {
        offset: (_whole(values[f"input_int_register_{offset}"]), _whole(values[f"output_int_register_{offset}"]))
        for offset in (0, 24)
    }
    slider = values["target_speed_fraction"]
    assert isinstance(slider, float)
    return Sample(
        speed_rad_s=fastest if all(map(math.isfinite, speeds)) else math.inf,
        runtime_state=_whole(values["runtime_state"]),
        safety_mode=_whole(values["safety_mode"]),
        slider=slider,
        registers=registers,
        arrived_ms=at_ms,
    )


def _whole(value: Value) -> int:
    assert isinstance(value, int)
    return value
