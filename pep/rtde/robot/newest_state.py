"""What the robot has said last, as whoever follows a motion hears it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pep.watch.governor import ReportedSpeeds

if TYPE_CHECKING:
    from pep.base.ports import Clock
    from pep.rtde.robot.state_receiver import RobotState

SILENCE_MS: Final = 300
"""A moving arm that says nothing for this long is stopped."""


class NewestState:
    """What the robot has said last, and for how long it has said nothing.

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
        """The newest word is taken in; whether it is from after the command was sent."""
        package = self._newest()
        if package.stamp_s != self._stamp_s and package.state is not None:
            self._stamp_s, self.state, self._heard_ms = package.stamp_s, package.state, self._clock.monotonic_ms()
        return self._stamp_s != self._sent_at

    def sent(self) -> int:
        """What was said up to now is from before the command; the monotonic time in ms."""
        self._sent_at = self._newest().stamp_s
        return self._clock.monotonic_ms()

    @property
    def speeds(self) -> ReportedSpeeds:
        """What it has said of its speed."""
        return ReportedSpeeds(self.state.slider, self.state.scaling, self._heard_ms)

    @property
    def silent_ms(self) -> int:
        """For how many milliseconds nothing new was said."""
        return self._clock.monotonic_ms() - self._heard_ms
