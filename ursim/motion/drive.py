"""Drive of the arm: one motion at a time, each with an owner or under the brake, ending at rest."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

from ursim.motion.motion import ZERO, Brake, Kinetic, Motion, MotionError, MoveJoints
from ursim.motion.values import ScriptRuntimeError

if TYPE_CHECKING:
    from ursim.motion.arm import Arm, Joints

HISTORY: Final = 2048  # ticks of joint angles remembered for get_actual_joint_positions_history
SLIDER_CHANGE_PER_S: Final = 4.0  # how fast the speed slider takes effect; a step would be an infinite acceleration


class Drive:
    """The arm's state and its one motion under way.

    A motion belongs to the thread that began it. When that thread ends, is killed or its program stops, and nothing
    else takes the arm over within the same tick, the arm brakes at `stop_deceleration_rad_s2`.
    """

    def __init__(self, arm: Arm, q: Joints, *, stop_deceleration_rad_s2: float) -> None:
        self.arm = arm
        self.now = Kinetic(q, ZERO, ZERO)
        self.stop_deceleration_rad_s2 = stop_deceleration_rad_s2
        self.scaling = 1.0
        self.allowed = 1.0  # of the scaling, by the safety limits; it acts at once, the slider by and by
        self._slid = 1.0
        self.slider = 1.0
        self.slider_change_per_s = SLIDER_CHANGE_PER_S
        self.history: deque[Joints] = deque(maxlen=HISTORY)
        self._motion: Motion | None = None
        self._owner: object | None = None
        self._suspended: tuple[Motion, object] | None = None

    @property
    def motion(self) -> Motion | None:
        """Motion that moves the arm now, or None."""
        return self._motion

    @property
    def moving(self) -> bool:
        """True while a motion is under way or an axis still turns."""
        return self._motion is not None or not self.now.at_rest

    def take(self, owner: object, motion: Motion) -> None:
        """`motion` begins; one of the same owner, or one that nobody owns, gives way.

        Raises:
            ScriptRuntimeError: another thread is moving the arm.
        """
        if self._motion is not None and self._owner is not None and self._owner is not owner:
            raise ScriptRuntimeError("another thread is already controlling the robot")
        self._motion, self._owner = motion, owner

    def braking(self, owner: object, deceleration_rad_s2: float) -> Brake:
        """Stop begun by `owner`.

        It is never weaker than a stop that is already under way for want of an owner.
        """
        deceleration = min(deceleration_rad_s2, self.arm.acceleration_limit_rad_s2)
        if self._owner is None and isinstance(self._motion, Brake):
            deceleration = max(deceleration, self._motion.deceleration_rad_s2)
        brake = Brake(self.now, deceleration)
        self.take(owner, brake)
        return brake

    def release(self, owner: object) -> None:
        """`owner` moves nothing any more."""
        if self._owner is owner:
            self._owner = None

    def halt(self) -> None:
        """Brakes the arm; no owner moves it any more."""
        self._owner = None
        self._suspended = None

    def suspend(self) -> None:
        """The arm brakes; `resume` will take the motion up again."""
        if self._motion is not None and self._owner is not None:
            self._suspended = (self._motion, self._owner)
        self._owner = None

    def resume(self) -> None:
        """The suspended motion goes on, planned anew from where the arm stands."""
        if self._suspended is not None:
            self._motion, self._owner = self._suspended
            self._motion.restart(self.now.q)
            self._suspended = None

    def place(self, q: Joints) -> None:
        """Puts the arm elsewhere, at rest, as people push it with its brakes released; a motion is over."""
        self._motion = self._owner = self._suspended = None
        self.now = Kinetic(q, ZERO, ZERO)

    def advance(self, dt_s: float) -> None:
        """One tick.

        Raises:
            MotionError: the motion cannot go on, or is about to run into a joint limit; the arm is already braking.
        """
        self.history.append(self.now.q)
        change = self.slider_change_per_s * dt_s
        self._slid += max(-change, min(change, self.slider - self._slid))
        self.scaling = min(self._slid, self.allowed)
        motion = self._motion
        if motion is None:
            return
        if self._owner is None and (
            not isinstance(motion, Brake) or motion.deceleration_rad_s2 < self.stop_deceleration_rad_s2
        ):
            motion = self._motion = Brake(self.now, self.stop_deceleration_rad_s2)
        try:
            then, done = motion.advance(self.now, dt_s, self.scaling)
            if not isinstance(motion, Brake | MoveJoints):  # those two are planned inside the limits, to their end
                self._check_room(then)
        except MotionError:
            self.suspend()
            self._motion = Brake(self.now, self.stop_deceleration_rad_s2)
            self.now, done = self._motion.advance(self.now, dt_s, 1.0)
            self._finish(done=done)
            raise
        self.now = then
        self._finish(done=done)

    def _finish(self, *, done: bool) -> None:
        if done:
            self._motion = self._owner = None

    def _check_room(self, then: Kinetic) -> None:
        """Braking from `then` would still end inside every joint limit."""
        leading = max(map(abs, then.qd))
        for q, qd, joint in zip(then.q, then.qd, self.arm.joints, strict=True):
            end = q + 0.5 * qd * leading / self.stop_deceleration_rad_s2
            if not -joint.position_limit_rad <= end <= joint.position_limit_rad:
                raise MotionError("a joint limit is near")
