"""The answer for a joint move: limits, demands, certified index, second engine, and a speed that would do."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from capabilities.units import Unit
from pep.pit.assessment import EMPTY_CERTIFICATE, ENGINE, LISTED, Assessment, Certificate, micro, milli, seen
from pep.pit.certify import approaching, certify, fits
from pep.pit.contact import contact_ratio
from pep.pit.errors import WorkLimitError
from pep.pit.motion import profile_of
from pep.pit.oracle import Disagreement, cross_check
from pep.pit.pairs import pairs_of
from pep.pit.parameters import Demands
from pep.pit.path import Path
from pep.pit.separation import stopping
from pep.pit.tier import HIGHEST, MOVING, TIE, tier_of
from policies.evidence import Contribution, ImpactFault

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from capabilities.scope import Tier
    from pep.pit.cell import CellParameters
    from pep.pit.certify import Certified, Witness
    from pep.pit.motion import MoveJ, Profile
    from pep.pit.pairs import Pairs
    from pep.pit.path import Leaves
    from pep.pit.robot import Robot
    from pep.pit.separation import Stopping
    from pep.pit.view import View

RETREAT: Final = 3.0  # PHY-6: index of a stuck arm's retreat
SLOWEST_RAD_S: Final = 0.01  # slower than this is of no use, so no lower tier is named
SPEED_STEPS: Final = 9  # bisections of the speed: 1 / 500 of it, finer than anyone drives


@dataclass(frozen=True, slots=True)
class _Start:
    """What is already violated where the arm stands.

    Attributes:
        rows: pairs that the search asks about.
        retreating: pairs that are violated and proven never to come nearer.
    """

    rows: NDArray[np.intp]
    retreating: NDArray[np.intp]


class MoveQuestion:
    """One joint move in one view of the world, and the steps to its answer."""

    def __init__(
        self,
        robot: Robot,
        view: View,
        move: MoveJ,
        cell: CellParameters,
        *,
        seed: bytes,
        check_time: Callable[[], None],
    ) -> None:
        """Nothing is computed yet."""
        self.robot, self.view, self.move, self.cell, self.seed = robot, view, move, cell, seed
        self.check_time = check_time

    def answer(self) -> Assessment | ImpactFault:
        """The steps, in order."""
        profile = profile_of(self.move)
        # 1. A move to where the arm stands is none.
        if profile is None:
            return self._assessment(0.0, (), ())
        # 2. Joint limits, before a path is drawn through them.
        limits = self._joint_limits()
        if limits.broken:
            told = Contribution("joint_limit", milli(HIGHEST), limits.joint, self.robot.model.name, 0, 0, 0)
            return self._assessment(HIGHEST, (told,), ("joint_limit",))
        # 3. What the move asks of the arm.
        path = Path(self.robot, self.move)
        pairs = pairs_of(self.robot, self.view.scene, self.cell, grown_m=self.view.grown_m)
        demands = Demands(path, self.move, self.cell)
        ratios = demands.ratios(profile)
        speeds = demands.surface_speed_m_s(profile)
        speed = float(speeds[: self.robot.world_bodies].max())
        stop = self._stop(profile)
        # 4. What is violated where the arm stands, and whether this is a retreat from it.
        slow = profile.peak_rad_s <= self.cell.retreat_joint_speed_rad_s and speed <= self.cell.retreat_speed_m_s
        start = self._start(path, pairs, slow=slow)
        retreats = limits.retreating or start.retreating.size > 0
        violations = {"joint_limit"} if limits.retreating and not slow else set()
        # 5. The proven index of all the rest.
        floor = max(MOVING, self.view.floor, RETREAT if retreats else 0.0, *(r.index for r in ratios))
        certified = certify(path, pairs, profile, stop, rows=start.rows, floor=floor, check_time=self.check_time)
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
        causes = [
            *seen(self.view),
            *(Contribution(r.name, milli(r.index), "", "", 0, 0, micro(speed)) for r in ratios if r.index > MOVING),
            *self._witnessed(pairs, profile, certified),
            *(
                Contribution("retreat", milli(RETREAT), "", pairs.names[p], 0, 0, micro(speed))
                for p in start.retreating
            ),
        ]
        lower = (
            None
            if violations or retreats
            else self._lower_speed(path, pairs, demands, certified.leaves, tier_of(index))
        )
        decided = certified.witnesses[0] if certified.witnesses and certified.attained > floor else None
        return self._assessment(
            index,
            tuple(sorted(causes, key=lambda c: -c.index_milli)),
            tuple(sorted(violations)),
            clearance_m=math.inf if decided is None else decided.clearance_m,
            speed_m_s=speed,
            tcp_speed_m_s=float(speeds[self.robot.body_index("tcp")]),
            lower=lower,
            certificate=Certificate(
                certified.leaves.pair, certified.leaves.low, certified.leaves.high, certified.leaf_index
            ),
        )

    def _stop(self, profile: Profile) -> Stopping:
        return stopping(self.cell, perception_age_s=self.view.stopping_age_s, joint_speed_rad_s=profile.peak_rad_s)

    def _told(self, pairs: Pairs, profile: Profile, witness: Witness) -> Contribution:
        return Contribution(
            kind=str(pairs.kind_of(witness.pair)),
            index_milli=milli(witness.index),
            link=self.robot.bodies[pairs.body[witness.pair]].name,
            object=pairs.names[witness.pair],
            at_ms=round(profile.time_of(witness.s) * Unit.MILLISECOND.per_si),
            clearance_um=micro(witness.clearance_m),
            speed_um_s=micro(witness.speed_m_s),
        )

    def _witnessed(self, pairs: Pairs, profile: Profile, certified: Certified) -> list[Contribution]:
        """One contribution per obstacle that raises the index or is violated; where violated, at its deepest."""
        by_obstacle = {pairs.group[w.pair]: w for w in certified.witnesses if w.index > MOVING + TIE}
        for deepest in certified.violated.values():
            group = pairs.group[deepest.pair]
            index = by_obstacle[group].index if group in by_obstacle else MOVING
            by_obstacle[group] = replace(deepest, index=index)
        return [self._told(pairs, profile, w) for w in by_obstacle.values()]

    def _joint_limits(self) -> _JointLimits:
        limit = self.robot.position_limits_rad
        before = np.maximum(np.abs(self.move.start) - limit, 0)
        after = np.maximum(np.abs(self.move.target) - limit, 0)
        # From beyond one limit to beyond the other is no retreat, however the two excesses compare.
        crossed = (before > 0) & (after > 0) & (np.sign(self.move.start) != np.sign(self.move.target))
        worse = (after > before) | crossed
        joint = self.robot.model.joints[int(worse.argmax())].name
        return _JointLimits(broken=bool(worse.any()), retreating=bool((before > 0).any()), joint=joint)

    def _start(self, path: Path, pairs: Pairs, *, slow: bool) -> _Start:
        rows = np.arange(len(pairs))
        may = rows[np.isfinite(pairs.violated_below)]
        violated = may[path.clearance_at(pairs, 0, may) < pairs.violated_below[may]]
        if not violated.size or not slow:
            return _Start(rows, violated[:0])
        nearer = approaching(path, pairs, violated, tolerance_m=self.cell.retreat_tolerance_m)
        retreating = np.setdiff1d(violated, nearer)
        return _Start(np.setdiff1d(rows, retreating), retreating)

    def _lower_speed(self, path: Path, pairs: Pairs, demands: Demands, leaves: Leaves, tier: Tier) -> float | None:
        """The highest speed, to a step of the bisection, at which the index is proven to be in a lower tier.

        This is advice: when time runs out, the best speed proven so far is named, and the answer itself stands.
        """
        target = float(tier - 1)
        if target < MOVING or self.view.floor > target:
            return None

        def falls(speed: float) -> bool:
            nonlocal leaves
            profile = profile_of(self.move, speed)
            if profile is None or max(r.index for r in demands.ratios(profile)) > target:
                return False
            fit = fits(path, pairs, profile, self._stop(profile), leaves, index=target, check_time=self.check_time)
            leaves = fit.leaves
            return fit.proven

        proven: float | None = None
        high = self.move.speed_rad_s
        try:
            if high > SLOWEST_RAD_S and falls(SLOWEST_RAD_S):
                proven = SLOWEST_RAD_S
                for _ in range(SPEED_STEPS):
                    middle = 0.5 * (proven + high)
                    if falls(middle):
                        proven = middle
                    else:
                        high = middle
        except WorkLimitError:
            return proven
        return proven

    def _assessment(
        self,
        index: float,
        told: tuple[Contribution, ...],
        violations: tuple[str, ...],
        *,
        clearance_m: float = math.inf,
        speed_m_s: float = 0.0,
        tcp_speed_m_s: float = 0.0,
        lower: float | None = None,
        certificate: Certificate = EMPTY_CERTIFICATE,
    ) -> Assessment:
        if told:  # the first one is what decides, so it carries the proven index
            told = (replace(told[0], index_milli=max(told[0].index_milli, milli(index))), *told[1:LISTED])
        return Assessment(
            tier=tier_of(index),
            index=index,
            clearance_m=clearance_m,
            speed_m_s=speed_m_s,
            contributions=told,
            violations=violations,
            lower_tier_speed=lower,
            tcp_speed_m_s=tcp_speed_m_s,
            contact_ratio=contact_ratio(self.view.scene.people, self.robot, self.cell, speed_m_s=speed_m_s),
            start=self.move.start,
            certificate=certificate,
            perception=self.view.perception,
            perception_age_s=self.view.age_s,
            engine=ENGINE,
            model_digest=self.robot.model_digest,
            scene_digest=self.view.scene.digest,
        )


@dataclass(frozen=True, slots=True)
class _JointLimits:
    """How the move stands to the joint limits: it breaks one (and which), or it comes back from beyond one."""

    broken: bool
    retreating: bool
    joint: str
