"""Motions of the arm, each a plan sampled once a tick; each starts from the real state and ends.

Joint motions and stops run straight in joint space: the leading axis follows a trapezoid, the others keep their ratio
to it, so all axes finish together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from ursim.motion.arm import AXES, damped, miss
from ursim.motion.spatial import Frame, add, chain, compose, from_vector, to_vector, transpose

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ursim.motion.arm import Arm, Joints

ZERO: Joints = (0.0,) * AXES


class MotionError(Exception):
    """A motion the arm cannot make; a controller answers it with a protective stop."""


@dataclass(frozen=True, slots=True)
class Kinetic:
    """Joint state of the arm: rad, rad/s, rad/s2."""

    q: Joints
    qd: Joints
    qdd: Joints

    @property
    def at_rest(self) -> bool:
        """No axis moves."""
        return not any(self.qd)


class Motion(Protocol):
    """A plan under way."""

    def advance(self, now: Kinetic, dt_s: float, scaling: float) -> tuple[Kinetic, bool]:
        """The arm `dt_s` later, and whether the plan is complete. `scaling` in [0, 1] is the speed slider."""
        ...

    def restart(self, q: Joints) -> None:
        """Plans again from rest at `q`, for the same goal."""
        ...


@dataclass(frozen=True, slots=True)
class Trapezoid:
    """Distance over time: up at `acceleration`, along at `speed`, down at `acceleration`; a triangle when it is short.

    Distances, speeds and accelerations are positive and finite, in one unit of length.
    """

    distance: float
    speed: float
    acceleration: float

    @property
    def peak(self) -> float:
        """The highest speed reached."""
        return min(self.speed, math.sqrt(self.distance * self.acceleration))

    @property
    def duration_s(self) -> float:
        """Time from rest to rest."""
        if self.distance <= 0.0:
            return 0.0
        return self.distance / self.peak + self.peak / self.acceleration

    def at(self, t_s: float) -> tuple[float, float, float]:
        """Distance, speed and acceleration after `t_s`."""
        total = self.duration_s
        ramp = self.peak / self.acceleration
        if t_s >= total:
            return self.distance, 0.0, 0.0
        if t_s < ramp:
            return 0.5 * self.acceleration * t_s * t_s, self.acceleration * t_s, self.acceleration
        left = total - t_s
        if left < ramp:
            return self.distance - 0.5 * self.acceleration * left * left, self.acceleration * left, -self.acceleration
        return self.peak * (t_s - 0.5 * ramp), self.peak, 0.0


def _scaled(direction: Sequence[float], factor: float) -> Joints:
    return tuple(factor * each for each in direction)


def _along(start: Sequence[float], direction: Sequence[float], length: float) -> Joints:
    return tuple(a + length * b for a, b in zip(start, direction, strict=True))


class MoveJoints:
    """Straight in joint space to `target`, rest to rest; `target` can be read.

    Args:
        arm: for its speed limits; the whole motion is slowed so that no axis exceeds its own.
        start: joint angles at rest.
        target: joint angles.
        speed_rad_s: of the leading axis.
        acceleration_rad_s2: of the leading axis.
        duration_s: when positive, the time to take instead, as a triangle no faster than the limits.
    """

    def __init__(
        self,
        arm: Arm,
        start: Joints,
        target: Joints,
        *,
        speed_rad_s: float,
        acceleration_rad_s2: float,
        duration_s: float = 0.0,
    ) -> None:
        if not arm.inside(target):
            raise MotionError("the target lies outside the joint limits")
        self._arm = arm
        self.target = target
        self._asked = (speed_rad_s, acceleration_rad_s2, duration_s)
        self.restart(start)

    def restart(self, q: Joints) -> None:
        """Plans again from rest at `q`."""
        speed, acceleration, duration = self._asked
        travel = tuple(b - a for a, b in zip(q, self.target, strict=True))
        leading = max(map(abs, travel))
        direction = _scaled(travel, 1.0 / leading) if leading > 0.0 else ZERO
        if duration > 0.0 and leading > 0.0:
            speed, acceleration = 2.0 * leading / duration, 4.0 * leading / duration**2
        for each, joint in zip(direction, self._arm.joints, strict=True):
            if abs(each) * speed > joint.speed_limit_rad_s:
                speed = joint.speed_limit_rad_s / abs(each)
        acceleration = min(acceleration, self._arm.acceleration_limit_rad_s2)
        self.profile = Trapezoid(leading, speed, acceleration)
        self._start, self._direction, self._t = q, direction, 0.0

    def advance(self, now: Kinetic, dt_s: float, scaling: float) -> tuple[Kinetic, bool]:
        """One sample on; at the end exactly the target."""
        del now
        self._t += dt_s * scaling
        if self._t >= self.profile.duration_s:
            return Kinetic(self.target, ZERO, ZERO), True
        length, speed, acceleration = self.profile.at(self._t)
        direction = self._direction
        qd, qdd = _scaled(direction, speed * scaling), _scaled(direction, acceleration * scaling * scaling)
        return Kinetic(_along(self._start, direction, length), qd, qdd), False


class Brake:
    """Brake to rest along the present joint velocity, the leading axis at a constant deceleration a.

    It takes v^2 / 2a in v / a.
    """

    def __init__(self, now: Kinetic, deceleration_rad_s2: float) -> None:
        self.deceleration_rad_s2 = deceleration_rad_s2
        speed = max(map(abs, now.qd))
        self._direction = _scaled(now.qd, 1.0 / speed) if speed > 0.0 else ZERO
        self._start, self._speed, self._t = now.q, speed, 0.0
        self.duration_s = speed / deceleration_rad_s2

    def restart(self, q: Joints) -> None:
        """Starts again at rest: nothing is left to do."""
        self._start, self._speed, self._direction, self.duration_s = q, 0.0, ZERO, 0.0

    def advance(self, now: Kinetic, dt_s: float, scaling: float) -> tuple[Kinetic, bool]:
        """One sample on; a stop is never scaled."""
        del now, scaling
        self._t += dt_s
        t, a = min(self._t, self.duration_s), self.deceleration_rad_s2
        q = _along(self._start, self._direction, self._speed * t - 0.5 * a * t * t)
        if self._t >= self.duration_s:
            return Kinetic(q, ZERO, ZERO), True
        return Kinetic(q, _scaled(self._direction, self._speed - a * t), _scaled(self._direction, -a)), False


class SpeedJoints:
    """Towards joint speeds [rad/s], the leading change at `acceleration`, and on at them. Never complete by itself."""

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self.target: Joints = ZERO
        self.acceleration_rad_s2 = 1.0

    def aim(self, target: Joints, acceleration_rad_s2: float) -> None:
        """New speeds from now on, each held to its joint's limit."""
        limits = (joint.speed_limit_rad_s for joint in self._arm.joints)
        self.target = tuple(max(-limit, min(limit, each)) for each, limit in zip(target, limits, strict=True))
        self.acceleration_rad_s2 = min(acceleration_rad_s2, self._arm.acceleration_limit_rad_s2)

    def restart(self, q: Joints) -> None:
        """Does nothing: no way is planned ahead."""

    def reached(self, now: Kinetic, scaling: float) -> bool:
        """True where the arm moves at the target velocity."""
        return all(abs(v - scaling * w) < 1e-9 for v, w in zip(now.qd, self.target, strict=True))

    def advance(self, now: Kinetic, dt_s: float, scaling: float) -> tuple[Kinetic, bool]:
        """One sample on."""
        return towards(now, _scaled(self.target, scaling), self.acceleration_rad_s2, dt_s), False


class SpeedTool:
    """Towards a tool velocity (m/s, rad/s in the base frame), and on at it. Never complete by itself."""

    def __init__(self, arm: Arm, tcp: Frame, now: Kinetic) -> None:
        self._arm = arm
        self._tcp = tcp
        self._twist: Sequence[float] = arm.twist(arm.frames(now.q), now.qd, tcp)
        self.target: tuple[float, ...] = ZERO
        self.acceleration_m_s2 = 1.0

    def aim(self, target: tuple[float, ...], acceleration_m_s2: float) -> None:
        """A new velocity from now on."""
        self.target, self.acceleration_m_s2 = target, acceleration_m_s2

    def restart(self, q: Joints) -> None:
        """Starts again from rest."""
        del q
        self._twist = ZERO

    def reached(self, now: Kinetic, scaling: float) -> bool:
        """True where the tool's planned velocity is the target."""
        del now
        return all(abs(v - scaling * w) < 1e-9 for v, w in zip(self._twist, self.target, strict=True))

    def advance(self, now: Kinetic, dt_s: float, scaling: float) -> tuple[Kinetic, bool]:
        """One sample on; near a singularity the tool is slower than asked, the joints never faster than they may."""
        gap = [scaling * w - v for v, w in zip(self._twist, self.target, strict=True)]
        longest = max(map(abs, gap))
        part = min(1.0, self.acceleration_m_s2 * dt_s / longest) if longest > 0.0 else 0.0
        self._twist = [v + part * g for v, g in zip(self._twist, gap, strict=True)]
        columns = self._arm.columns(self._arm.frames(now.q), self._tcp)
        wanted = damped(columns, self._twist, damping=1e-3)  # it stays on its line
        if any(abs(v) > joint.speed_limit_rad_s for v, joint in zip(wanted, self._arm.joints, strict=True)):
            wanted = damped(columns, self._twist, damping=0.02)
        return towards(now, capped(self._arm, wanted), self._arm.acceleration_limit_rad_s2, dt_s), False


class ServoJoints:
    """Follows a joint target that is set again and again: a first-order lag within speed and acceleration limits.

    The real servoj's gain is not published; here `lookahead_s` alone sets the lag.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self.target: Joints | None = None
        self.lookahead_s = 0.1

    def restart(self, q: Joints) -> None:
        """Holds until it is given a target."""
        self.target = q

    def advance(self, now: Kinetic, dt_s: float, scaling: float) -> tuple[Kinetic, bool]:
        """One sample on; never faster than it can stop on the target."""
        del scaling
        limit = self._arm.acceleration_limit_rad_s2
        wanted: list[float] = []
        for q, goal in zip(now.q, self.target or now.q, strict=True):
            gap = goal - q
            wanted.append(math.copysign(min(abs(gap) / self.lookahead_s, math.sqrt(2.0 * limit * abs(gap))), gap))
        return towards(now, capped(self._arm, tuple(wanted)), limit, dt_s), False


class MoveTool:
    """Straight in space to a pose, rest to rest, the joints solved afresh each tick; `target` can be read.

    Args:
        arm: the kinematics.
        tcp: the tool centre point in the flange frame.
        start: joint angles at rest.
        target: the tool's pose to reach, in the base frame.
        speed_m_s: of the tool, along the line.
        acceleration_m_s2: of the tool.
    """

    TURN_LEVER_M = 0.1  # a turn in place takes the time its arc at this radius would

    def __init__(
        self, arm: Arm, tcp: Frame, start: Joints, target: Frame, *, speed_m_s: float, acceleration_m_s2: float
    ) -> None:
        self._arm, self._tcp, self.target = arm, tcp, target
        self._asked = (speed_m_s, acceleration_m_s2)
        self.restart(start)

    def restart(self, q: Joints) -> None:
        """Plans again from rest at `q`."""
        self._from = self._arm.tool(q, self._tcp)
        (x, y, z), rotation = self._from
        a, b, c = self.target[0]
        self._line = (a - x, b - y, c - z)
        self._turn = to_vector(compose(self.target[1], transpose(rotation)))
        self._plan(max(math.hypot(*self._line), math.hypot(*self._turn) * self.TURN_LEVER_M))

    def _plan(self, length_m: float) -> None:
        self._length = length_m
        self.profile = Trapezoid(length_m, *self._asked)
        self._t = 0.0

    def _pose(self, part: float) -> Frame:
        """Pose of the tool when this part of the way is done."""
        x, y, z = self._line
        rx, ry, rz = self._turn
        position = add(self._from[0], (part * x, part * y, part * z))
        return position, compose(from_vector((part * rx, part * ry, part * rz)), self._from[1])

    def advance(self, now: Kinetic, dt_s: float, scaling: float) -> tuple[Kinetic, bool]:
        """One sample on.

        Raises:
            MotionError: no joint angles reach the line here, or a joint would have to exceed its speed limit.
        """
        self._t += dt_s * scaling
        done = self._t >= self.profile.duration_s
        part = 1.0 if done or self._length == 0.0 else self.profile.at(self._t)[0] / self._length
        goal = self._pose(part)
        q = self._arm.reach(goal, now.q, self._tcp)
        if q is None:
            raise MotionError("no joint angles reach the line")
        qd = tuple((b - a) / dt_s for a, b in zip(now.q, q, strict=True))
        if any(abs(v) > joint.speed_limit_rad_s for v, joint in zip(qd, self._arm.joints, strict=True)):
            raise MotionError("the line asks a joint for more than its speed limit")
        qdd = tuple((b - a) / dt_s for a, b in zip(now.qd, qd, strict=True))
        return (Kinetic(q, ZERO, ZERO), True) if done else (Kinetic(q, qd, qdd), False)


class ServoTool:
    """Follows a tool pose that is set again and again, on the straight way to it. Never complete by itself.

    The real servoc bends its way inside the blend radius; here the turn is as sharp as `acceleration_m_s2` lets it be.
    """

    NEAR_S = 0.008  # the time constant of the last tenth of a millimetre: four ticks, so that it does not chatter

    def __init__(self, arm: Arm, tcp: Frame, now: Kinetic) -> None:
        self._arm, self._tcp = arm, tcp
        self._twist: Sequence[float] = arm.twist(arm.frames(now.q), now.qd, tcp)
        self.target = arm.tool(now.q, tcp)
        self.speed_m_s = self.acceleration_m_s2 = 0.1

    def aim(self, target: Frame, *, speed_m_s: float, acceleration_m_s2: float) -> None:
        """A new pose from now on."""
        self.target, self.speed_m_s, self.acceleration_m_s2 = target, speed_m_s, acceleration_m_s2

    def restart(self, q: Joints) -> None:
        """Starts again from rest."""
        del q
        self._twist = ZERO

    def left_m(self, now: Kinetic) -> float:
        """Distance to the target, metres; a turn counts as its arc at `MoveTool.TURN_LEVER_M`."""
        return _distance(miss(self.target, self._arm.tool(now.q, self._tcp)))

    def advance(self, now: Kinetic, dt_s: float, scaling: float) -> tuple[Kinetic, bool]:
        """One sample on; near a singularity the tool is slower than asked, the joints never faster than they may."""
        frames = self._arm.frames(now.q)
        away = miss(self.target, chain(frames[-1], self._tcp))
        left, ramp = _distance(away), self.acceleration_m_s2
        speed = min(self.speed_m_s * scaling, math.sqrt(2.0 * ramp * left), left / self.NEAR_S)
        wanted = _scaled(away, speed / left) if left > 0.0 else ZERO
        gap = [w - v for v, w in zip(self._twist, wanted, strict=True)]
        longest = max(map(abs, gap))
        part = min(1.0, ramp * dt_s / longest) if longest > 0.0 else 0.0
        self._twist = _along(self._twist, gap, part)
        qd = capped(self._arm, damped(self._arm.columns(frames, self._tcp), self._twist, damping=1e-3))
        return towards(now, qd, self._arm.acceleration_limit_rad_s2, dt_s), False


def _distance(twist: Sequence[float]) -> float:
    return max(math.hypot(*twist[:3]), math.hypot(*twist[3:]) * MoveTool.TURN_LEVER_M)


def capped(arm: Arm, qd: Joints) -> Joints:
    """`qd`, slowed as a whole until every joint is within its limit."""
    excess = max(abs(v) / joint.speed_limit_rad_s for v, joint in zip(qd, arm.joints, strict=True))
    return qd if excess <= 1.0 else _scaled(qd, 1.0 / excess)


def towards(now: Kinetic, wanted: Joints, acceleration_rad_s2: float, dt_s: float) -> Kinetic:
    """One tick of a straight change of joint velocity, the leading change bounded; exact while it is constant."""
    gap = [b - a for a, b in zip(now.qd, wanted, strict=True)]
    longest = max(map(abs, gap))
    part = 1.0 if longest <= acceleration_rad_s2 * dt_s else acceleration_rad_s2 * dt_s / longest
    qd = wanted if part == 1.0 else _along(now.qd, gap, part)
    q = tuple(p + 0.5 * (a + b) * dt_s for p, a, b in zip(now.q, now.qd, qd, strict=True))
    return Kinetic(q, qd, _scaled(gap, part / dt_s))
