"""Trajectory of the cell's tools on its way: servo targets written in time, and the arm seen to follow them.

Targets are points of the very curve that was assessed. What a late writer leaves out is not caught up with: the
trajectory waits for it, so the arm is never sent faster than it was assessed. An arm that is not within the tube about
the targets of the last moments is stopped.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from pep.pit.search.trajectory_pieces import HOLD_RAD, LAG_S
from pep.rtde.command import command_values as v
from pep.rtde.motion.governed_move import ARRIVED_RAD
from pep.rtde.motion.motion_follower import Over
from pep.watch.watch import MotionOutcome
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.base.ports import Clock
    from pep.pit.base.motion import Floats
    from pep.pit.path.timed_curve import TimedCurve
    from pep.rtde.command.command_values import Command
    from pep.rtde.robot.state_receiver import JointState

PERIOD_S: Final = 0.004
"""Time between two targets: two cycles of the controller (docs/physics.md, PHY-65)."""
LATE_S: Final = 0.006
"""Most of the trajectory's time that one target may be farther than the one before."""
LOOKAHEAD_S: Final = 0.03
"""U12: the servo's least lookahead, by which it follows most closely."""
GAIN: Final = 2000.0
"""U12: the servo's greatest gain, likewise."""
SEEN_S: Final = 0.15
"""Greatest age of the target that a state of the arm shows, its way here included."""
BESIDE_RAD: Final = 5e-3
"""Allowance beside the assessed tube: the arm's own error of following, which every motion is granted."""
SETTLES_MS: Final = 1_000
"""Longest time from the last target until the arm stands there."""


class ServoPort(Protocol):
    """Line to the arm that servo targets are written on."""

    def follow(self, command: Command) -> bool:
        """True once the next target is written; False where the stream has ended."""
        ...


def target(q_rad: Floats) -> v.ServoJ:
    """The servo target at these joint angles."""
    a, b, c, d, e, f = q_rad.tolist()
    return v.ServoJ((a, b, c, d, e, f), PERIOD_S, LOOKAHEAD_S, GAIN)


class TargetWriter:
    """Writer of the targets after the first. On an event loop.

    Attributes:
        told_s: time of the trajectory's newest target.
        broken: whether one was not taken.
    """

    def __init__(self, curve: TimedCurve, lines: ServoPort, now_s: Callable[[], float]) -> None:
        self._curve, self._lines, self._now_s = curve, lines, now_s
        self.told_s = 0.0
        self.broken = False

    @property
    def done(self) -> bool:
        """True once the last target is written."""
        return self.told_s >= self._curve.duration_s

    async def write(self) -> None:
        """Writes each target in its time, to the last. However it ends before that, it is broken."""
        try:
            await self._write()
        finally:
            self.broken = not self.done

    async def _write(self) -> None:
        last_s = due_s = self._now_s()
        while not self.done:
            due_s = max(due_s + PERIOD_S, self._now_s())
            await asyncio.sleep(due_s - self._now_s())
            now_s = self._now_s()
            next_s = min(self.told_s + min(now_s - last_s, LATE_S), self._curve.duration_s)
            last_s = now_s
            if not self._lines.follow(target(self._curve.at(next_s)[0])):
                return
            self.told_s = next_s


class TrajectoryProgress:
    """Progress along a trajectory: the arm is within its tube, and in the end stands at the last point.

    Args:
        curve: of the trajectory.
        writer: of its targets, on another thread.
        clock: the monotonic one counts.
    """

    stands = True

    def __init__(self, curve: TimedCurve, writer: TargetWriter, clock: Clock) -> None:
        self._curve, self._writer, self._clock = curve, writer, clock
        self._tube = 0.5 * np.abs(curve.a).max(axis=0) * LAG_S**2 + HOLD_RAD + BESIDE_RAD
        self._written_ms: int | None = None

    def look(self, state: JointState) -> Over | None:
        """End as reached, once the arm stands at the last point; as failed, where it does not follow."""
        q = np.array(state.q_rad)
        low, high = self._targets(self._writer.told_s)
        off = np.maximum(low - self._tube - q, q - high - self._tube)
        if off.max() > 0:
            joint = int(off.argmax())
            return Over(MotionOutcome.ROBOT_FAILED, Reason.EFFECT_FAILED, f"joint {joint} has left the tube")
        if self._writer.broken:
            return Over(MotionOutcome.ROBOT_FAILED, Reason.EFFECT_FAILED, "a target was not taken")
        if not self._writer.done:
            return None
        if state.still and np.abs(q - self._curve.q[-1]).max() <= ARRIVED_RAD:
            return Over(MotionOutcome.REACHED, Reason.VERDICT_EXPIRED)  # its servo is ended, wherever it was
        now_ms = self._clock.monotonic_ms()
        self._written_ms = now_ms if self._written_ms is None else self._written_ms
        late = now_ms - self._written_ms > SETTLES_MS
        return Over(MotionOutcome.ROBOT_FAILED, Reason.EFFECT_FAILED, "too slow") if late else None

    def _targets(self, told_s: float) -> tuple[Floats, Floats]:
        """Least and greatest angle of each joint among the targets that a state may show."""
        since_s = told_s - SEEN_S
        inside = (self._curve.t > since_s) & (self._curve.t < told_s)
        rows = np.array([self._curve.at(since_s)[0], *self._curve.q[inside], self._curve.at(told_s)[0]])
        return rows.min(axis=0), rows.max(axis=0)
