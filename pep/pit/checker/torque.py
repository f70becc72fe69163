"""The torque of every joint by the recursion of Newton and Euler, and the highest by its limit (PHY-7, PHY-33).

All vectors are in the base frame. Out along the arm go angular velocity, its change and the acceleration of each
joint's origin; back come the force and the moment that each link needs and passes on. Torque is linear in gravity, in
the joints' accelerations and in what their rates alone do, so three runs are all that any timing of a way needs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.pit.checker.arm import frames
from pep.pit.checker.distances import ORIGIN, cross, dot, minus, plus, product, transposed, turned
from pep.pit.checker.robot import JOINTS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pep.pit.checker.distances import Mat, Vec
    from pep.pit.checker.question import Cell
    from pep.pit.checker.robot import CheckerMass, CheckerRobot
    from pep.pit.checker.stance import Six

LIFT: Final = (0.0, 0.0, 9.81)  # m/s^2: what a resting base has to give the arm, gravity upside down
NO_RATES: Final = (0.0,) * JOINTS


@dataclass(frozen=True, slots=True)
class TorquePlace:
    """The arm somewhere on its way.

    Attributes:
        q, dq, ddq: joint angles, rad, and their derivatives by s.
        rate: ds/dt there, 1/s.
    """

    q: Six
    dq: Six
    ddq: Six
    rate: float


def torque_ratio(
    robot: CheckerRobot, cell: Cell, places: Iterable[TorquePlace], *, forward: float, backward: float
) -> float:
    """The highest torque by limit at these places: braking or speeding up, at rest or at the full rate.

    Coasting lies between the other two, so it is never the worst. No number anywhere is the worst of all.

    Args:
        robot: the arm.
        cell: says what is always carried, at the tool point.
        places: where it is asked.
        forward: greatest s'' that speeds up, 1/s^2.
        backward: greatest that slows down.
    """
    always = robot.payload_limit_kg if cell.payload_kg is None else cell.payload_kg
    masses = (*robot.links, robot.carried(always))
    worst = 0.0
    for place in places:
        hold, push, swing = _torques(robot, masses, place)
        square = place.rate * place.rate
        for still, by_push, by_rate, limit in zip(hold, push, swing, robot.torque_limits, strict=True):
            for load in (still, still + by_rate * square):
                most = max(abs(load + by_push * forward), abs(load - by_push * backward))
                if math.isnan(most):
                    return math.inf
                worst = max(worst, most / limit)
    return worst


def _torques(robot: CheckerRobot, masses: tuple[CheckerMass, ...], place: TorquePlace) -> tuple[Six, Six, Six]:
    """Torques of each joint that hold the arm, that s'' asks, and that s' squared asks, Nm."""
    turns, origins = frames(robot, place.q)
    axes = [transposed(turn)[2] for turn in turns[1:]]
    arm = _Arm(origins, axes, [_Placed.of(each, turns, origins) for each in masses])
    return (
        arm.needs(NO_RATES, NO_RATES, LIFT),
        arm.needs(NO_RATES, place.dq, ORIGIN),
        arm.needs(place.dq, place.ddq, ORIGIN),
    )


@dataclass(frozen=True, slots=True)
class _Placed:
    """A mass in the base frame: the link that carries it, its centre, and how it resists turning (rows)."""

    link: int
    kg: float
    at: Vec
    inertia: Mat | None

    @staticmethod
    def of(mass: CheckerMass, turns: list[Mat], origins: list[Vec]) -> _Placed:
        turn = turns[mass.link]
        at = plus(turned(turn, mass.com), origins[mass.link])
        inertia = None if mass.inertia is None else product(turn, product(mass.inertia, transposed(turn)))
        return _Placed(mass.link, mass.kg, at, inertia)


class _Arm:
    """The arm in one configuration."""

    def __init__(self, origins: list[Vec], axes: list[Vec], masses: list[_Placed]) -> None:
        self._origins, self._axes, self._masses = origins, axes, masses

    def needs(self, rates: Six, changes: Six, lift: Vec) -> Six:
        """The torque of each joint that turns so, with this acceleration of the base."""
        origins, axes = self._origins, self._axes
        # 1. Out: how each link turns, and how its origin is accelerated.
        spin, growth, acceleration = ORIGIN, ORIGIN, lift
        spins, growths, accelerations = [spin], [growth], [acceleration]
        for joint in range(1, JOINTS + 1):
            out, axis, rate = minus(origins[joint], origins[joint - 1]), axes[joint - 1], rates[joint - 1]
            acceleration = plus(acceleration, _carried(spin, growth, out))
            growth = plus(plus(growth, axis, changes[joint - 1]), cross(spin, axis), rate)
            spin = plus(spin, axis, rate)
            spins.append(spin)
            growths.append(growth)
            accelerations.append(acceleration)
        # 2. What each mass needs, and back along the arm what each joint passes on.
        forces, moments = [ORIGIN] * (JOINTS + 1), [ORIGIN] * (JOINTS + 1)
        for mass in self._masses:
            link = mass.link
            lever = minus(mass.at, origins[link])
            pulled = plus(accelerations[link], _carried(spins[link], growths[link], lever))
            force = plus(ORIGIN, pulled, mass.kg)
            moment = cross(lever, force)
            if mass.inertia is not None:
                turning = turned(mass.inertia, spins[link])
                moment = plus(moment, plus(turned(mass.inertia, growths[link]), cross(spins[link], turning)))
            forces[link], moments[link] = plus(forces[link], force), plus(moments[link], moment)
        torques = [0.0] * JOINTS
        for joint in range(JOINTS, 0, -1):
            torques[joint - 1] = dot(axes[joint - 1], moments[joint])
            back = minus(origins[joint], origins[joint - 1])
            forces[joint - 1] = plus(forces[joint - 1], forces[joint])
            moments[joint - 1] = plus(moments[joint - 1], plus(moments[joint], cross(back, forces[joint])))
        return tuple(torques)


def _carried(spin: Vec, growth: Vec, lever: Vec) -> Vec:
    """Acceleration of what turns with the link at this lever, beside that of the link's origin."""
    return plus(cross(growth, lever), cross(spin, cross(spin, lever)))
