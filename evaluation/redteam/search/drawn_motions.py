"""Motions that a token would allow, drawn at random, and how the arm carries them out: by a plain trapezoid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from evaluation.redteam.referee import Seen

if TYPE_CHECKING:
    from collections.abc import Iterator

Joints: TypeAlias = tuple[float, float, float, float, float, float]

ANGLE_RAD: Final = 3.0
"""Farthest angle of the scope that is lent."""
SPEED_RAD_S: Final = (0.3, 1.0)
"""Slowest (chosen) and fastest speed of the leading axis: what the red team's robotic agent is lent."""
ACCELERATION_RAD_S2: Final = (0.8, 2.0)
"""Lowest (chosen) and highest acceleration of the scope that is lent."""
STREAM_S: Final = (0.6, 2.0)
"""Shortest (chosen) and longest time of one `speed_joint`."""
STOP_RAD_S2: Final = 2.0
"""Deceleration of ur_rtde's `stopJ`, with which a stream ends."""
HZ: Final = 125
"""Samples of a simulated motion; the referee looks in between (chosen)."""
POSTURE_RAD: Final = (-1.62, 1.25, -1.2, -1.57, 0.0)
"""Working posture of the five joints beyond the base: the tool points down, 0.2 m above the table."""
AROUND_RAD: Final = (0.25, 0.25, 0.4, 0.3, 1.0)
"""Most that each joint is off that posture at the beginning (chosen)."""
TURN_RAD: Final = (1.6, 0.7, 0.7, 0.9, 0.9, 1.5)
"""Most that each joint turns in one leg (chosen)."""
_DECIMALS: Final = 4


@dataclass(frozen=True, slots=True)
class JointPath:
    """Legs from rest to rest: one `move_joint`, or several that follow each other.

    Attributes:
        through_rad: ends of the legs, the last one the target.
        speed_rad_s: of the leading axis.
        acceleration_rad_s2: of the same.
    """

    through_rad: tuple[Joints, ...]
    speed_rad_s: float
    acceleration_rad_s2: float


@dataclass(frozen=True, slots=True)
class JointStream:
    """Steady joint speeds for a time, from rest to rest: one `speed_joint`.

    Attributes:
        qd_rad_s: six speeds.
        acceleration_rad_s2: of the leading axis.
        duration_s: until the stop begins.
    """

    qd_rad_s: Joints
    acceleration_rad_s2: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class JointServo:
    """Stream of targets on a straight way, each reached at once.

    Attributes:
        to_rad: the last one.
        over_s: time until it.
    """

    to_rad: Joints
    over_s: float


Drawn: TypeAlias = JointPath | JointStream | JointServo


def drawn_start(rng: np.random.Generator) -> Joints:
    """Pose near the working posture, with the base turned to the front half."""
    base = rng.uniform(-1.0, 1.0)
    return _joints([base, *(q + rng.uniform(-d, d) for q, d in zip(POSTURE_RAD, AROUND_RAD, strict=True))])


def drawn_motion(rng: np.random.Generator, start: Joints) -> Drawn:
    """Half of them one leg, a quarter each several legs and streams."""
    speed = _rounded(rng.uniform(*SPEED_RAD_S))
    acceleration = _rounded(rng.uniform(*ACCELERATION_RAD_S2))
    form = rng.choice(["leg", "leg", "legs", "stream"])
    if form == "stream":
        ways = drawn_turn(rng)
        scale = speed / max(abs(way) for way in ways)
        return JointStream(_joints([way * scale for way in ways]), acceleration, _rounded(rng.uniform(*STREAM_S)))
    through, here = [], start
    for _ in range(1 if form == "leg" else int(rng.integers(2, 4))):
        ways = drawn_turn(rng)
        here = _joints([min(max(q + turn, -ANGLE_RAD), ANGLE_RAD) for q, turn in zip(here, ways, strict=True)])
        through.append(here)
    return JointPath(tuple(through), speed, acceleration)


def drawn_turn(rng: np.random.Generator) -> list[float]:
    """Way of each joint; one leading part of the arm, the others less."""
    return [float(rng.uniform(-far, far) * rng.choice([0.2, 0.6, 1.0])) for far in TURN_RAD]


def turned_to(rng: np.random.Generator, start: Joints, base_rad: float) -> JointPath:
    """One leg that turns the base to an angle, the posture kept."""
    speed, acceleration = _rounded(rng.uniform(*SPEED_RAD_S)), _rounded(rng.uniform(*ACCELERATION_RAD_S2))
    return JointPath((_joints([base_rad, *start[1:]]),), speed, acceleration)


def allowed(motion: Drawn, start: Joints) -> bool:
    """True where no joint leaves the scope that is lent."""
    return all(abs(q) <= ANGLE_RAD + 1e-9 for sample in carried_out(motion, start) for q in sample.q_rad)


def carried_out(motion: Drawn, start: Joints) -> list[Seen]:
    """Samples of a motion from rest to rest."""
    samples: list[Seen] = []
    if isinstance(motion, JointStream):
        samples.extend(_streamed(motion, np.array(start)))
        return samples
    if isinstance(motion, JointServo):
        way, cycles = np.array(motion.to_rad) - np.array(start), max(1, round(motion.over_s * HZ))
        shares = [n / cycles for n in range(cycles + 1)]
        return [Seen(share * motion.over_s, tuple((np.array(start) + share * way).tolist())) for share in shares]
    begun_s = 0.0
    for a, b in pairwise((start, *motion.through_rad)):
        way = np.array(b) - np.array(a)
        length = float(np.abs(way).max())
        if length <= 0:
            continue
        times, shares = _trapezoid(length, motion.speed_rad_s, motion.acceleration_rad_s2)
        samples += [
            Seen(begun_s + at, tuple((np.array(a) + share * way).tolist()))
            for at, share in zip(times, shares, strict=True)
        ]
        begun_s = samples[-1].at_s
    return samples or [Seen(0.0, start)]


def _trapezoid(length: float, speed: float, acceleration: float) -> tuple[list[float], list[float]]:
    """Times and shares of a way of this length."""
    speed = min(speed, math.sqrt(length * acceleration))
    rising_s = speed / acceleration
    whole_s = rising_s + length / speed
    times = [n / HZ for n in range(math.ceil(whole_s * HZ))] + [whole_s]

    def gone(at: float) -> float:
        if at < rising_s:
            return acceleration * at * at / 2
        if at > whole_s - rising_s:
            return length - acceleration * (whole_s - at) ** 2 / 2
        return speed * (at - rising_s / 2)

    return times, [gone(at) / length for at in times]


def _streamed(motion: JointStream, start: np.ndarray) -> Iterator[Seen]:
    qd = np.array(motion.qd_rad_s)
    leading = float(np.abs(qd).max())
    rising_s = min(leading / motion.acceleration_rad_s2, motion.duration_s)
    top = min(1.0, motion.acceleration_rad_s2 * rising_s / leading)
    falling_s = top * leading / STOP_RAD_S2
    whole_s = motion.duration_s + falling_s
    for at in [*(n / HZ for n in range(math.ceil(whole_s * HZ))), whole_s]:
        rising, late = min(at, rising_s), max(0.0, at - motion.duration_s)
        gone = top * (rising**2 / (2 * rising_s) + max(0.0, min(at, motion.duration_s) - rising_s))
        gone += top * (late - late**2 / (2 * falling_s))
        yield Seen(at, tuple((start + qd * gone).tolist()))


def _joints(angles: list[float]) -> Joints:
    a, b, c, d, e, f = (_rounded(angle) for angle in angles)
    return a, b, c, d, e, f


def _rounded(number: float) -> float:
    return round(float(number), _DECIMALS)
