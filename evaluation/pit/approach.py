"""Laws of the index on one motion, and a referee that knows none of them.

The shipped law takes the whole speed of a link; another one takes its speed of approach, as speed and separation
monitoring of ISO/TS 15066 does; a third one does so of things alone. All are sampled here. The referee asks of each
instant what may follow: a person who sets out at 1.6 m/s in any direction while the arm is stopped along its way, and a
stop in which each joint comes to rest by itself, such as that of brakes. It measures clearances alone.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base.motion import profile_of
from pep.pit.geometry.clearance import core_distance
from pep.pit.robot.kinematics import layout, poses
from pep.pit.scene.obstacles import PairKind
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.separation import stopping

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit import CellParameters, MoveJ, Robot, Scene
    from pep.pit.base.motion import Floats, Profile
    from pep.pit.scene.pairs import Pairs

AGE_S: Final = 0.15
"""Age of the view: nothing younger counts as younger (PHY-2)."""
SAMPLES: Final = 121
"""Instants of a motion, evenly in time."""
LOOKS: Final = 13
"""Instants at which the referee lets something happen."""
STEP_S: Final = 0.01
"""Time between two looks at a stop that follows."""
APPROACHED: Final = 3.0
"""Index from which the arm's own travel reaches a person: there the blow counts, which has the whole speed."""


@dataclass(frozen=True, slots=True)
class Judged:
    """One motion under each law, and by the referee.

    Attributes:
        whole: highest index by the whole speed.
        approach: highest index by the speed of approach.
        mixed: highest index by the whole speed towards people, and by the speed of approach to anything else.
        clear_m: least clearance of any pair.
        person: a person who sets out may be touched by an arm that still moves.
        thing: a stop of each joint by itself may touch a thing, the arm itself or a boundary.
    """

    whole: float
    approach: float
    mixed: float
    clear_m: float
    person: bool
    thing: bool

    @property
    def hazardous(self) -> bool:
        """True where the referee finds something that may be touched."""
        return self.person or self.thing


class MotionReferee:
    """Robot, scene and cell, made ready for many motions."""

    def __init__(self, robot: Robot, scene: Scene, cell: CellParameters, *, more_m: float = 0.0) -> None:
        """Pairs of bodies and obstacles, each of them so much more uncertain; nothing is measured yet."""
        self._robot, self._cell = robot, cell
        pairs = pairs_of(robot, scene, cell, grown_m=0.0)
        self._pairs: Pairs = replace(pairs, uncertainty=pairs.uncertainty + more_m)
        self._plan = layout(robot)
        self._people = self._pairs.kind == self._pairs.code_of(PairKind.PERSON)

    def judged(self, move: MoveJ) -> Judged:
        """The motion under each law, and what may follow from it.

        Raises:
            ValueError: a move that goes nowhere.
        """
        profile = profile_of(move)
        if profile is None:
            raise ValueError("a move that goes nowhere")
        start = np.array(move.start)
        delta = np.array(move.target) - start
        times = np.linspace(0.0, profile.duration_s, SAMPLES)
        way, rate = np.array([profile.at(float(t)) for t in times]).T
        angles = start + way[:, None] * delta
        clear = self._clear(angles)
        whole, approach, mixed = self._laws(profile, times, clear, self._speeds(angles, rate, delta))
        looks = np.unique(np.linspace(0, SAMPLES - 1, LOOKS).astype(int))
        person = self._people.any() and any(self._reached(profile, way, clear, float(times[k])) for k in looks)
        thing = self._touches(angles[looks], rate[looks, None] * delta)
        return Judged(whole, approach, mixed, float(clear.min()), bool(person), thing)

    def touches_on_its_way(self, move: MoveJ) -> bool:
        """True where the way itself leads into something, uncertainty included."""
        ways = np.linspace(0.0, 1.0, SAMPLES)[:, None]
        start = np.array(move.start)
        left = self._clear(start + ways * (np.array(move.target) - start)) - self._pairs.uncertainty
        return bool(left.min() < 0)

    def _clear(self, angles: Floats, chosen: NDArray[np.bool_] | None = None) -> Floats:
        """Clearance of each pair, or of the chosen ones, at each configuration, (n, pairs), metre."""
        pairs = self._pairs
        which = np.arange(len(pairs)) if chosen is None else np.flatnonzero(chosen)
        still = np.zeros(len(self._robot.model.joints))
        ends = poses(self._robot, self._plan, angles, still).ends[:, pairs.body[which]]
        distance, _ = core_distance(ends.reshape(-1, 2, 3), pairs.cores.take(np.tile(which, len(angles))))
        return np.asarray(distance.reshape(len(angles), len(which)) - pairs.radii[which])

    def _speeds(self, angles: Floats, rate: Floats, delta: Floats) -> Floats:
        """Surface speed of each pair's body at each instant, (n, pairs), m/s."""
        moving = poses(self._robot, self._plan, angles, delta)
        return np.asarray((moving.speed + self._plan.radius * moving.spin)[:, self._pairs.body] * rate[:, None])

    def _laws(self, profile: Profile, times: Floats, clear: Floats, speed: Floats) -> list[float]:
        """Highest index by whole speed, by speed of approach, and by each where `mixed` says so."""
        pairs = self._pairs
        closing = -np.diff(clear, axis=0) / np.diff(times)[:, None]
        toward = np.maximum(0.0, np.maximum(np.vstack([closing[:1], closing]), np.vstack([closing, closing[-1:]])))
        toward = np.minimum(toward, speed)
        stop = stopping(self._cell, perception_age_s=AGE_S, joint_speed_rad_s=profile.peak_rad_s)
        rows = np.tile(np.arange(len(pairs)), len(times))
        by_whole = pairs.index(rows, clear.ravel(), speed.ravel(), stop)
        by_approach = np.maximum(1.0, pairs.index(rows, clear.ravel(), toward.ravel(), stop))
        people, moving = np.tile(self._people, len(times)), speed.ravel() > 0
        by_approach = np.where(people & (by_approach >= APPROACHED), by_whole, by_approach)
        laws = by_whole, by_approach, np.where(people, by_whole, by_approach)
        return [float(law[moving].max()) for law in laws]

    def _reached(self, profile: Profile, way: Floats, clear: Floats, at_s: float) -> bool:
        """True where a person who sets out at this instant may meet the arm before it stands.

        The arm goes on for the time of reaction and of the stop's delay, then brakes along its way.
        """
        cell, pairs = self._cell, self._pairs
        goes_on = max(AGE_S, cell.watch_age_limit_s) + cell.reaction_s + cell.stop_delay_s
        s, rate = profile.at(at_s + goes_on)
        brakes = rate * profile.way_rad / cell.stop_deceleration_rad_s2
        after = np.arange(0.0, goes_on + brakes, STEP_S)
        going = np.array([profile.at(at_s + float(t))[0] for t in after[after <= goes_on]])
        t = after[after > goes_on] - goes_on
        slowing = s + rate * t - 0.5 * cell.stop_deceleration_rad_s2 / profile.way_rad * t * t
        places = np.minimum(np.concatenate([going, slowing]), 1.0)
        moving = np.array([profile.at(at_s + float(x))[1] > 0 for x in after])
        for pair in np.flatnonzero(self._people):
            left = np.interp(places, way, clear[:, pair]) - pairs.uncertainty[pair] - pairs.intrusion[pair]
            if (moving & (left - cell.person_speed_m_s * after <= 0)).any():
                return True
        return False

    def _touches(self, angles: Floats, rates: Floats) -> bool:
        """True where a stop from one of these instants may touch a thing, each joint stopping by itself.

        Corners alone are looked at: of each joint no way at all, or the longest.
        """
        cell = self._cell
        lead = np.abs(rates).max(axis=1, keepdims=True)
        longest = rates * (cell.stop_delay_s + 0.5 * lead / cell.stop_deceleration_rad_s2)
        moves = np.flatnonzero(np.abs(longest).max(axis=0) > 0)
        corners = np.zeros((2 ** len(moves), angles.shape[1]))
        corners[:, moves] = list(itertools.product((0.0, 1.0), repeat=len(moves)))
        ends = (angles[:, None] + corners * longest[:, None]).reshape(-1, angles.shape[1])
        left = self._clear(ends, ~self._people) - self._pairs.uncertainty[~self._people]
        return bool(left.min(initial=math.inf) < 0)
