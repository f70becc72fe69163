"""Newest state of the robot for the follower of a motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pep.watch.governor import ReportedSpeeds

if TYPE_CHECKING:
    from pep.base.ports import Clock
    from pep.rtde.robot.state_receiver import RobotState

SILENCE_MS: Final = 300
"""Silence after which a moving arm is stopped."""


class NewestState:
    """Newest state of the robot, and the length of its silence.

    Raises:
        RobotError: it says nothing to begin with.
    """

    def __init__(self, state: RobotState, clock: Clock) -> None:
        self._newest = state.newest
        self._clock = clock
        self.state = state.read()
        self._heard_ms = clock.monotonic_ms()
        self._stamp_s: float | None = None
        self._sent_at: float | None = None

    def look(self) -> bool:
        """Takes in the newest state; true where it is from after the command was sent."""
        package = self._newest()
        if package.stamp_s != self._stamp_s and package.state is not None:
            self._stamp_s, self.state, self._heard_ms = package.stamp_s, package.state, self._clock.monotonic_ms()
        return self._stamp_s != self._sent_at

    def sent(self) -> int:
        """Marks earlier states as from before the command; the monotonic time in ms."""
        self._sent_at = self._newest().stamp_s
        return self._clock.monotonic_ms()

    @property
    def speeds(self) -> ReportedSpeeds:
        """Reported speeds of the robot."""
        return ReportedSpeeds(self.state.slider, self.state.scaling, self._heard_ms)

    @property
    def silent_ms(self) -> int:
        """Milliseconds without a new state."""
        return self._clock.monotonic_ms() - self._heard_ms
