"""Stream of targets or joint speeds, judged step by step: prepared once per view, microseconds per step.

A step is answered in two stages. First one look at all motion that it allows until the arm stands (`kernel.steps`): a
proven upper bound of its index, which settles the step where it is at most the authorised index and nothing can be
violated. Else the whole question, `assess`, whose answer holds.
"""

from __future__ import annotations

import math
import traceback
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pep.pit.assessment.assess import assess
from pep.pit.assessment.straight_remaining import PER_MILLI
from pep.pit.base.errors import PitError
from pep.pit.base.motion import MoveJ, ServoJ, SpeedJ
from pep.pit.base.tier import tier_of
from pep.pit.path.path import NO_LEAVES
from pep.pit.scene.grip_sightings import without_held
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.separation import stopping
from pep.pit.scene.view import view_of
from pep.pit.search.certify import Certified
from pep.pit.search.engine import chosen
from pep.pit.search.kernel.step_arrays import ready_of
from pep.pit.search.kernel.step_bound import Settled, settle
from pep.pit.search.kernel.step_envelope import JOINTS, SERVO, SPEED, STEP
from pep.pit.search.question import refuse_nonsense, refuse_unreal
from pep.pit.search.speed_envelope import stream_envelope
from pep.pit.second.second_engine import SPEED_TOLERANCE_M_S, SecondWorld
from pep.pit.second.straight_check import Disagreement, cross_check_rest, judged
from policies.evidence.evidence import ImpactFault

if TYPE_CHECKING:
    from collections.abc import Callable

    from capabilities.values.scope import Tier
    from pep.pit.assessment.assessment import Assessment
    from pep.pit.base.motion import Floats, Joints, Motion
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.pairs import Pairs
    from pep.pit.scene.scene import Scene
    from pep.pit.second.straight_check import Agreement

CONFIRMED_OF: Final = 128  # ours: of so many settled steps one is asked of the second engine, four a second
_REST: Final = (0.0,) * 4  # of the row that holds two times


@dataclass(frozen=True, slots=True)
class Bounded:
    """A step that was settled at once.

    Attributes:
        index: proven upper bound of the index of all that the step lets follow; at or below what was authorised.
        tier: of that index.
        tcp_speed_m_s: proven bound on the speed of the tool point.
        contact_ratio: proven bound on speed by limit speed of any body region that could be met.
        perception_age_s: of the view, or None when there is none.
    """

    index: float
    tier: Tier
    tcp_speed_m_s: float
    contact_ratio: float
    perception_age_s: float | None


@dataclass(frozen=True, slots=True, eq=False)
class _World:
    """Scene that is ready for questions; `settle` bounds a step in it."""

    scene: Scene
    pairs: Pairs
    settle: Callable[[int, Floats, float, float], Settled]


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """View that the stream was given last.

    Attributes:
        scene, age_s: as told.
        since: the clock then.
        seen: the scene, or the cell alone.
        unheld: the same without what the tool holds; None where that is not seen, or nothing is held.
        fault: defect of the view; then it is the answer to every step.
    """

    scene: Scene | None
    age_s: float | None
    since: float
    seen: _World | None = None
    unheld: _World | None = None
    fault: ImpactFault | None = None


class Stream:
    """One robot in one cell that follows a stream, and the newest view of it.

    A view is told now and then (`see`, milliseconds), a step is asked about at each cycle (`step`, microseconds where
    the bound settles it). One thread may tell while another one asks: a step is answered in one view, the newest that
    was complete when it was asked. What the tool holds is part of the robot: with another part begins another stream.

    The second engine is asked (PHY-10) at each new view, about every pair at the arm's measured angles; at every
    `CONFIRMED_OF`th step that the bound settles, about every pair at the step's own angles and speeds, whose index must
    not be above the bound; and by `assess` wherever that is asked. A disagreement is the answer to that step and to all
    that follow, until the next view.
    """

    def __init__(
        self, robot: Robot, cell: CellParameters, *, touch: frozenset[str], clock: Callable[[], float]
    ) -> None:
        """Makes a stream without a view: its steps have the index floor of a missing one.

        Args:
            robot: the arm with its tool, which must be the one that the cell names, and with what that holds.
            cell: the cell's parameters.
            touch: names of objects that the token grants to touch.
            clock: monotonic seconds; ages of views run on it.
        """
        self._robot, self._cell, self._touch, self._clock = robot, cell, touch, clock
        self._settled = 0
        self._view = self._looked_at(None, None, None)

    def see(self, scene: Scene | None, *, age_s: float | None, at_rad: Joints) -> None:
        """Takes the view for all later steps. Never raises.

        A view that must not be believed becomes the answer to each step.

        Args:
            scene: the newest valid view, or None when there is none any more.
            age_s: its age now, or None when there is none.
            at_rad: measured joint angles, at which both engines measure this view.
        """
        self._view = self._looked_at(scene, age_s, at_rad)

    def step(
        self, motion: ServoJ | SpeedJ, *, authorised_milli: int, seed: bytes
    ) -> Bounded | Assessment | ImpactFault:
        """Judges the motion that one step allows until the arm stands. Never raises.

        The bound is at least the index that `assess` proves of the same step, and at most the authorised one; an
        `Assessment` may be above that. No step that is settled at once violates anything.

        Args:
            motion: a servo target, or joint speeds that the arm takes up or goes on with (`stream.moves_with`), through
                its duration, the controller's patience and the stop.
            authorised_milli: thousandths of the index that was authorised.
            seed: digest of the command, for the whole question.
        """
        try:
            return self._step(motion, authorised_milli, seed)
        except Exception as error:  # noqa: BLE001 - any failure in here must end in a denial, not in the caller
            return _fault_of(error)

    def _looked_at(self, scene: Scene | None, age_s: float | None, at_rad: Joints | None) -> _View:
        try:
            return self._prepared(scene, age_s, at_rad)
        except Exception as error:  # noqa: BLE001 - likewise
            return _View(scene, age_s, math.nan, fault=_fault_of(error))

    def _prepared(self, scene: Scene | None, age_s: float | None, at_rad: Joints | None) -> _View:
        since, robot, cell = self._clock(), self._robot, self._cell
        at: Any = (0.0,) * len(robot.model.joints) if at_rad is None else at_rad
        rest = MoveJ(at, at, 1.0, 1.0)
        refuse_nonsense(robot, rest, cell, self._touch)
        whole = view_of(scene, age_s, cell).scene
        missing = scene is None or age_s is None
        late = whole.oldest()
        sighted_s = math.inf if missing or not whole.complete else 0.0 if late is None else late.age_s
        seen = self._world(whole, sighted_s)
        path = chosen().path(robot, rest)
        clearance = path.clearance_at(seen.pairs, 0, np.arange(len(seen.pairs)))
        fault = _disagreed(cross_check_rest(path, seen.pairs, whole, clearance))
        held = None if missing or robot.held is None else robot.held.object  # as `view_around`: seen, not surveyed
        bare = replace(whole, objects=tuple(thing for thing in whole.objects if thing.id != held))
        unheld = None if len(bare.objects) == len(whole.objects) else self._world(bare, sighted_s)
        return _View(scene, age_s, since, seen, unheld, fault)

    def _world(self, scene: Scene, sighted_s: float) -> _World:
        robot, cell = self._robot, self._cell
        pairs = pairs_of(robot, scene, cell, grown_m=0.0, touch=self._touch)
        bound = partial(settle, ready_of(robot, pairs, cell, sighted_s=sighted_s))
        bound(
            SERVO, np.zeros((STEP, JOINTS)), 0.0, 0.0
        )  # compiled, or read from where it was kept, before a step waits for it
        return _World(scene, pairs, bound)

    def _step(self, motion: Motion, authorised_milli: int, seed: bytes) -> Bounded | Assessment | ImpactFault:
        view = self._view
        if view.fault is not None:
            return view.fault
        assert view.seen is not None
        age_s = None if view.scene is None or view.age_s is None else _older(view.age_s, self._clock() - view.since)
        match motion:
            case ServoJ(start, now, target, period_s, lookahead_s):
                form, step = SERVO, _numbers(start, now, target, period_s, lookahead_s)
            case SpeedJ(start, now, acceleration, duration_s):
                form, step = SPEED, _numbers(start, now, start, acceleration, duration_s)
            case _:
                return ImpactFault("PARAMETERS_WRONG", "neither a servo target nor joint speeds")
        if step is not None:
            world = view.seen if view.unheld is None else self._around(view.seen, view.unheld, start)
            found = world.settle(form, step, age_s or 0.0, float(authorised_milli * PER_MILLI))
            if found.proven:
                return self._bounded(view, world, step, age_s, found)
        return self._whole(view, motion, age_s, seed)

    def _around(self, seen: _World, unheld: _World, at: Joints) -> _World:
        """Surroundings of the arm at these angles: without the held object where the gripper shows it."""
        found = without_held(seen.scene, self._robot, at, tolerance_m=self._cell.held_tolerance_m)
        return unheld if len(found.objects) == len(unheld.scene.objects) else seen

    def _bounded(
        self, view: _View, world: _World, step: Floats, age_s: float | None, found: Settled
    ) -> Bounded | ImpactFault:
        self._settled += 1
        if self._settled % CONFIRMED_OF == 0:
            fault = self._confirmed(world, step, age_s, found.upper)
            if fault is not None:
                self._view = replace(view, fault=fault)
                return fault
        return Bounded(found.upper, tier_of(found.upper), found.tool, found.contact, age_s)

    def _confirmed(self, world: _World, step: Floats, age_s: float | None, index: float) -> ImpactFault | None:
        """Fault of the bound at the step's beginning, by pinocchio and coal, or None."""
        pairs = world.pairs.meant(np.flatnonzero(world.pairs.touchable))  # under whichever law the bound may be
        start, now = step[0], step[1]
        clearance, speed = SecondWorld(self._robot, world.scene, pairs).ask_all([(start, now)])
        speed = np.where(speed > SPEED_TOLERANCE_M_S, speed, 0.0)  # rounding moves a body at rest
        stop = stopping(self._cell, perception_age_s=age_s or 0.0, joint_speed_rad_s=float(np.abs(now).max()))
        bound = Certified(index, index, (), {}, NO_LEAVES, np.zeros(0))
        return _disagreed(judged(pairs, stop, bound, np.arange(len(pairs)), clearance=clearance, speed=speed))

    def _whole(
        self, view: _View, motion: ServoJ | SpeedJ, age_s: float | None, seed: bytes
    ) -> Assessment | ImpactFault:
        asked: ServoJ | MoveJ
        if isinstance(motion, SpeedJ):
            refuse_unreal(motion)
            asked = stream_envelope(motion, self._cell, under_way=True)
        else:
            asked = motion
        return assess(
            self._robot,
            view.scene,
            asked,
            self._cell,
            perception_age_s=age_s,
            touch=self._touch,
            seed=seed,
            clock=self._clock,
        )


def _fault_of(error: Exception) -> ImpactFault:
    """Fault in the words of `assess`."""
    if isinstance(error, PitError):
        return ImpactFault(error.reason, error.detail)
    frames = traceback.extract_tb(error.__traceback__)
    return ImpactFault("PHYSICS_FAULT", f"{type(error).__name__} in {frames[-1].name}")


def _disagreed(found: Agreement | Disagreement) -> ImpactFault | None:
    return ImpactFault("ENGINES_DISAGREE", found.what) if isinstance(found, Disagreement) else None


def _older(age_s: float, by_s: float) -> float:
    """Age after that time; NaN where the clock is invalid."""
    return age_s + by_s if by_s >= 0 else math.nan


def _numbers(start: Joints, now: Joints, target: Joints, first: float, second: float) -> Floats | None:
    """The step as the kernel's array; None where it has another form or holds text."""
    try:
        step = np.array((start, now, target, (first, second, *_REST)))
    except (TypeError, ValueError, OverflowError):
        return None
    return step if step.dtype == np.float64 and step.shape == (STEP, JOINTS) else None
