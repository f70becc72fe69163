"""Answer for a straight joint motion: limits, demands, certified index, second engine, a sufficient speed."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from capabilities.values.units import Unit
from pep.pit.assessment.assessment import LISTED, Assessment, Evident, SearchCertificate, micro, milli, seen
from pep.pit.base.motion import Run, profile_of
from pep.pit.base.tier import HIGHEST, MOVING, TIE, tier_of
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.separation import stopping
from pep.pit.search.certify import Slower
from pep.pit.search.engine import chosen
from pep.pit.search.meant_contact import gentle_rows
from pep.pit.search.speed_bisection import highest_speed
from pep.pit.search.start_violations import RETREAT, departure, joint_limits, slow_enough, violated_at_rest
from pep.pit.second.straight_check import Disagreement, cross_check, cross_check_rest
from policies.evidence.evidence import Contribution, ImpactFault

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from capabilities.values.scope import Tier
    from pep.pit.assessment.assessment import Certificate
    from pep.pit.base.motion import Profile
    from pep.pit.base.travel import Stopping
    from pep.pit.path.path import Route
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.pairs import Pairs
    from pep.pit.scene.view import View
    from pep.pit.search.arm_limits import Ratio
    from pep.pit.search.certify import Certified, Witness
    from pep.pit.search.engine import Engine
    from pep.pit.search.kernel.compiled_limits import Demands
    from pep.pit.search.kernel.compiled_path import CompiledPath

JOINT_LIMIT: Final = "joint_limit"
SLOWEST_RAD_S: Final = 0.01  # slower than this is of no use, so no lower tier is named


class MoveQuestion:
    """One straight joint motion in one view of the world, and the steps to its answer."""

    def __init__(
        self,
        robot: Robot,
        view: View,
        move: Run,
        cell: CellParameters,
        *,
        touch: frozenset[str],
        seed: bytes,
        check_time: Callable[[], None],
        engine: Engine | None = None,
    ) -> None:
        """Makes a question of which nothing is computed yet.

        Without an `engine` the one of this installation answers.
        """
        self.engine = chosen() if engine is None else engine
        self.robot, self.view, self.move, self.cell, self.seed = robot, view, move, cell, seed
        self.touch, self.check_time = touch, check_time

    def answer(self) -> Assessment | ImpactFault:
        """Answer by the steps, in order."""
        profile = profile_of(self.move)
        # 1. A move to where the arm stands is none.
        if profile is None:
            return self._standing()
        # 2. Joint limits, before a path is drawn through them.
        limits = joint_limits(self.robot, self.move.start, self.move.target)
        if limits.broken:
            return self._past_limit(limits.joint)
        # 3. What the move asks of the arm.
        path = self.engine.path(self.robot, self.move)
        bare = pairs_of(self.robot, self.view.scene, self.cell, grown_m=self.view.grown_m, touch=self.touch)
        pairs = self._with_meant(path, bare, profile)
        demands = self.engine.demands(path, self.cell)
        ratios = demands.ratios(profile)
        speeds = demands.surface_speed_m_s(profile)
        speed = float(speeds[: self.robot.world_bodies].max())
        stop = self._stop(profile)
        # 4. What is violated where the arm stands, and whether this is a retreat from it.
        slow = slow_enough(self.cell, joint_speed_rad_s=profile.peak_rad_s, speed_m_s=speed)
        start = departure(path, pairs, self.cell, slow=slow)
        retreats = limits.retreating or start.retreating.size > 0
        violations = {"joint_limit"} if limits.retreating and not slow else set()
        # 5. The proven index of all the rest.
        floor = max(MOVING, self.view.floor, RETREAT if retreats else 0.0, *(r.index for r in ratios))
        # A touch that is meant at one speed is another one at another: then each speed is a question of its own.
        slows = not (retreats or bare.touchable.any())
        slower = self._slower_asked() if slows else None
        certified = path.certify(
            pairs, profile, stop, rows=start.rows, floor=floor, check_time=self.check_time, slower=slower
        )
        violations |= set(certified.violated)
        # 6. The second engine has to agree.
        self.check_time()
        checked = cross_check(
            path, pairs, self.view.scene, profile, stop, certified=certified, rows=start.rows, seed=self.seed
        )
        if isinstance(checked, Disagreement):
            return ImpactFault("ENGINES_DISAGREE", checked.what)
        # 7. The answer, and the speed at which it would be a tier lower.
        index = min(certified.upper, HIGHEST)
        causes = self._causes(profile, pairs, certified, ratios=ratios, speed_m_s=speed, retreating=start.retreating)
        lower = None
        if not (violations or retreats):
            lower = self._lower_speed(path, bare, demands, certified, tier_of(index), ratios=ratios, slows=slows)
        decided = certified.witnesses[0] if certified.witnesses and certified.attained > floor else None
        return self._assessment(
            index,
            causes,
            tuple(sorted(violations)),
            clearance_m=math.inf if decided is None else decided.clearance_m,
            speed_m_s=speed,
            tcp_speed_m_s=float(speeds[self.robot.body_index("tcp")]),
            lower=lower,
            contact_ratio=path.blow_ratio(pairs, profile, stop, check_time=self.check_time),
            certificate=SearchCertificate(certified, start.rows),
        )

    def _standing(self) -> Assessment | ImpactFault:
        """The answer of a motion that leaves the arm where it stands: none, unless what is there must not be."""
        still = Run(self.move.start, self.move.start, 0.0, math.inf, math.inf)
        path = self.engine.path(self.robot, still)
        pairs = pairs_of(self.robot, self.view.scene, self.cell, grown_m=self.view.grown_m, touch=self.touch)
        clearance = path.clearance_at(pairs, 0, np.arange(len(pairs)))
        checked = cross_check_rest(path, pairs, self.view.scene, clearance)
        if isinstance(checked, Disagreement):
            return ImpactFault("ENGINES_DISAGREE", checked.what)
        violated = violated_at_rest(pairs, clearance)
        index = HIGHEST if violated else 0.0
        told = [self._told_at_rest(pairs, pair, float(clearance[pair])) for pair in violated.values()]
        return self._assessment(index, tuple(told), tuple(sorted(map(str, violated))), certificate=Evident("still"))

    def _told_at_rest(self, pairs: Pairs, pair: int, clearance_m: float) -> Contribution:
        return Contribution(
            kind=str(pairs.kind_of(pair)),
            index_milli=milli(HIGHEST),
            link=self.robot.bodies[pairs.body[pair]].name,
            object=pairs.name_of(pair),
            at_ms=0,
            clearance_um=micro(clearance_m),
            speed_um_s=0,
            source=pairs.source_of(pair),
        )

    def _past_limit(self, joint: str) -> Assessment:
        """The answer of a motion that goes beyond a joint's limit, or comes from there and is no retreat."""
        told = Contribution(JOINT_LIMIT, milli(HIGHEST), joint, self.robot.model.name, 0, 0, 0)
        return self._assessment(HIGHEST, (told,), (JOINT_LIMIT,), certificate=Evident(JOINT_LIMIT))

    def _stop(self, profile: Profile) -> Stopping:
        return stopping(self.cell, perception_age_s=self.view.stopping_age_s, joint_speed_rad_s=profile.peak_rad_s)

    def _with_meant(self, route: Route, pairs: Pairs, profile: Profile) -> Pairs:
        return pairs.meant(gentle_rows(route, pairs, profile, self.cell, check_time=self.check_time))

    def _told(self, pairs: Pairs, profile: Profile, witness: Witness) -> Contribution:
        return Contribution(
            kind=str(pairs.kind_of(witness.pair)),
            index_milli=milli(witness.index),
            link=self.robot.bodies[pairs.body[witness.pair]].name,
            object=pairs.name_of(witness.pair),
            at_ms=round(profile.time_of(witness.s) * Unit.MILLISECOND.per_si),
            clearance_um=micro(witness.clearance_m),
            speed_um_s=micro(witness.speed_m_s),
            source=pairs.source_of(witness.pair),
        )

    def _causes(
        self,
        profile: Profile,
        pairs: Pairs,
        certified: Certified,
        *,
        ratios: tuple[Ratio, ...],
        speed_m_s: float,
        retreating: NDArray[np.intp],
    ) -> tuple[Contribution, ...]:
        """Causes that raise the index, highest first."""
        speed = micro(speed_m_s)
        causes = [
            *seen(self.view),
            *(Contribution(r.name, milli(r.index), "", "", 0, 0, speed) for r in ratios if r.index > MOVING),
            *self._witnessed(pairs, profile, certified),
            *(
                Contribution("retreat", milli(RETREAT), "", pairs.name_of(p), 0, 0, speed, pairs.source_of(p))
                for p in retreating
            ),
        ]
        return tuple(sorted(causes, key=lambda c: -c.index_milli))

    def _witnessed(self, pairs: Pairs, profile: Profile, certified: Certified) -> list[Contribution]:
        """Contribution of each obstacle that raises the index or is violated; where violated, at its deepest."""
        by_obstacle = {pairs.group[w.pair]: w for w in certified.witnesses if w.index > MOVING + TIE}
        for deepest in certified.violated.values():
            group = pairs.group[deepest.pair]
            index = by_obstacle[group].index if group in by_obstacle else MOVING
            by_obstacle[group] = deepest._replace(index=index)
        return [self._told(pairs, profile, w) for w in by_obstacle.values()]

    def _lower_speed(
        self,
        path: CompiledPath,
        pairs: Pairs,
        demands: Demands,
        certified: Certified,
        tier: Tier,
        *,
        ratios: tuple[Ratio, ...],
        slows: bool,
    ) -> float | None:
        """Highest speed, to a step of the bisection, at which the index is proven to fall a tier."""
        target = float(tier - 1)
        if target < MOVING or self.view.floor > target:
            return None
        # What counts no more at this speed counts no more at a lower one (faster never lowers).
        asks = max(ratio.index for ratio in ratios) > target
        if slows:
            return self._slowest_of_both(demands, certified.slower, target=target, asks=asks)
        leaves = certified.leaves.take(certified.leaf_index > target)

        def falls(speed: float) -> bool:
            nonlocal leaves
            profile = profile_of(self.move, speed)
            if profile is None or (asks and not demands.at_most(profile, target)):
                return False
            meant = self._with_meant(path, pairs, profile)
            fit = path.fits(meant, profile, self._stop(profile), leaves, index=target, check_time=self.check_time)
            leaves = fit.leaves
            return fit.proven

        return highest_speed(falls, slowest=SLOWEST_RAD_S, fastest=self.move.speed_rad_s)

    def _slower_asked(self) -> Slower:
        cell = self.cell
        return Slower(cell.stop_delay_s, cell.stop_deceleration_rad_s2, SLOWEST_RAD_S, self.move.speed_rad_s)

    def _slowest_of_both(self, demands: Demands, of_pairs: float | None, *, target: float, asks: bool) -> float | None:
        """Speed at which both the pairs and the demands on the arm are in a lower tier."""
        if of_pairs is None or not asks:
            return of_pairs

        of_arm = demands.fastest(self.move, target, slowest=SLOWEST_RAD_S, check_time=self.check_time)
        return None if of_arm is None else min(of_pairs, of_arm)

    def _assessment(
        self,
        index: float,
        told: tuple[Contribution, ...],
        violations: tuple[str, ...],
        *,
        clearance_m: float = math.inf,
        speed_m_s: float = 0.0,
        tcp_speed_m_s: float = 0.0,
        contact_ratio: float = 0.0,
        lower: float | None = None,
        certificate: Certificate,
    ) -> Assessment:
        if told:  # the first one decides, so it carries the proven index
            told = told[:LISTED]
            if milli(index) > told[0].index_milli:
                told = (replace(told[0], index_milli=milli(index)), *told[1:])
        return Assessment(
            tier=tier_of(index),
            index=index,
            clearance_m=clearance_m,
            speed_m_s=speed_m_s,
            contributions=told,
            violations=violations,
            lower_tier_speed=lower,
            tcp_speed_m_s=tcp_speed_m_s,
            contact_ratio=contact_ratio,
            start=self.move.start,
            certificate=certificate,
            perception=self.view.perception,
            perception_age_s=self.view.age_s,
            engine=self.engine.name,
            model_digest=self.robot.model_digest,
            scene_digest=self.view.scene.digest,
        )
