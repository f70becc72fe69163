"""Samples of a motion in its scene, by MuJoCo at many instants.

Nothing is shared with the room or with its second engine: MuJoCo places the arm and measures (`stage`), speeds come
from its joint axes, timing (`timing`) and laws (`laws`) from the clauses. Scene, cell and motion are plain numbers of
the question. Another module chooses the instants: `bracket` takes as many as leave nothing unseen between them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from tests.pep.pit import twin
from tests.pep.pit.campaign.between import Between
from tests.pep.pit.campaign.facts import MODEL, tool_of
from tests.pep.pit.campaign.laws import FAR_M, Columns, Law, Stop, ratio_law
from tests.pep.pit.campaign.stage import stage_of
from tests.pep.pit.campaign.timing import FIRST_MOST, Driven, driven

from pep.pit import MoveJ

SPEED_LIMITS = np.array([j["speed_limit_rad_s"] for j in MODEL["joints"]])
POSITION_LIMITS = np.array([j["position_limit_rad"] for j in MODEL["joints"]])
MASSES = np.array([j["mass_kg"] for j in MODEL["joints"]])
LEAST_LAW_M = 0.05
INSIDE_M = 1e-6
"""So near to being as deep as can be the direction says nothing."""
AXIS_MET_M = 1e-3  # PHY-6: so near to a thing's surface the axis of a body meets it
VIOLATED_BY_M = 1e-4 + 1e-6  # what a search may leave undecided, and what rounds


@dataclass
class Seen:
    """Findings of the samples so far.

    Attributes:
        low: highest index with every allowance that the samples bear out (retreat, meant contact).
        high: the same with none.
        violated: kinds that are met more deeply than a search may leave open, retreats left out.
        nearest: least clearance to an obstacle, infinite when none came within the measured distance.
        ratios: each quantity of PHY-7 by its limit, torque left out.
        samples: their number.
    """

    low: float = 0.0
    high: float = 0.0
    violated: set = field(default_factory=set)
    nearest: float = np.inf
    ratios: dict = field(default_factory=dict)
    samples: int = 0


class World:
    """One question, sampled in MuJoCo."""

    def __init__(self, robot, scene, motion, cell, age_s, touch, run=None):
        """Of `robot` only its tool's name and what it holds are used; `run` is the motion in time."""
        self.cell, self.motion, self.scene, self.age_s = cell, motion, scene, age_s
        self.tool, self.held = tool_of(robot.tool.name), robot.held
        self.run = driven(motion, cell) if run is None else run
        self.omega = self.run.timing.peak
        stale = age_s > cell.perception_age_limit_s
        late_s = max((each.age_s for each in (*scene.people, *scene.objects)), default=0.0)
        unknown = age_s + late_s > cell.perception_age_limit_s or not scene.complete
        self.floor = cell.unknown_floor if unknown else 0.0
        self.stop = Stop.of(cell, age_s, self.omega)
        regions = [(p, r, s) for p in scene.people for r, s in p.regions]
        self.shapes = [s for _, _, s in regions] + [x.shape for x in (*scene.objects, *scene.zones)]
        self.things = self._laws(regions, cell.person_speed_m_s * age_s if stale else 0.0, touch)
        self.stage = stage_of(self.tool["name"], None if self.held is None else self.held.shape, len(self.shapes))
        moving, own = len(self.stage.moving), len(self.stage.apart)
        face = Law("workspace", cell.robot_uncertainty_m, cell.rigid_band_m, below=0.0)
        self.faces = faces = [] if scene.workspace is None else [face]
        alone = Law("self", 0.0, cell.rigid_band_m, below=-cell.overlap_limit_m)
        laws = self.things * moving + [alone] * own + faces * (6 * moving)
        self.columns = Columns(laws, cell, self.stop)
        # Whose speed meets which clearance: bodies' for things and faces, outer bodies' for pairs.
        self.mover = np.concatenate(
            [
                np.repeat(np.arange(moving), len(self.things)),
                moving + np.arange(own),
                np.tile(np.arange(moving), 6 * len(faces)),
            ]
        )
        touched = [[part in law.touched_by for law in self.things] for part in self.stage.parts]
        self.touchable = np.zeros(len(laws), bool)
        self.touchable[: moving * len(self.things)] = np.array(touched, bool).ravel()
        self.around = moving * len(self.things)
        self.between = Between(self.stage, self.run) if isinstance(self.run, Driven) else None
        self.reach_m = None
        self.forget()

    # -- what counts

    def carried_kg(self):
        held = 0.0 if self.held is None else self.held.mass_kg
        whole = MODEL["payload_limit_kg"]
        return whole if self.cell.payload_kg is None or held is None else self.cell.payload_kg + held

    def _laws(self, regions, grown, touch):
        cell = self.cell
        mass = MASSES.sum() / 2 + self.tool["mass_kg"] + self.carried_kg()
        blunt = self.tool["shape"] == "blunt" and cell.payload_kg is not None
        blunt = blunt and (self.held is None or self.held.blunt)
        arms = {"upper_arm", "lower_arm", "hand"}
        found = []
        for person, region, _ in regions:
            tracked = any(str(r) in arms for r, _ in person.regions)
            reach = cell.intrusion_tracked_m if tracked else cell.intrusion_untracked_m
            full = twin.harm_speed(str(region), mass)
            harm = full if blunt else full / twin.LIMITS[str(region)][4]
            z = cell.person_uncertainty_m + cell.robot_uncertainty_m + grown + cell.person_speed_m_s * person.age_s
            found.append(Law("person", z, harm=harm, intrusion=reach, below=0.0))
        for thing in self.scene.objects:
            band = cell.fragile_band_m if thing.kind == "fragile" else cell.rigid_band_m
            by = frozenset(c.by for c in cell.contacts if c.object == thing.id and thing.id in touch)
            found.append(Law(thing.kind, thing.uncertainty_m + cell.robot_uncertainty_m, band, touched_by=by))
        for zone in self.scene.zones:
            kind = "zone" if zone.tier is None else "tiered_zone"
            below = 0.0 if zone.tier is None else -np.inf
            found.append(Law(kind, cell.robot_uncertainty_m, cell.rigid_band_m, tier=zone.tier or 0, below=below))
        return found

    # -- sampling

    def forget(self):
        """Nothing was sampled yet."""
        self.times, self.shots = np.zeros(0), None

    def place(self, *, at_least_m=LEAST_LAW_M):
        """From now on all is measured that is nearer than its law, and `at_least_m`, reach."""
        fastest, spare = self._fastest()
        reaches = np.array([law.reaches(fastest, self.cell, self.stop) for law in self.things])
        reaches = np.maximum(reaches, at_least_m) + spare
        own = self.cell.rigid_band_m + fastest * self.stop.travel + spare
        self.stage.place(self.shapes, reaches, own)
        moving = len(self.stage.moving)
        whole = np.full(len(self.mover), FAR_M)
        whole[: self.around] = np.tile(reaches, moving)
        whole[self.around : self.around + len(self.stage.apart)] = own
        self.reach_m = whole
        radius = self.stage.radius[:moving, None] + self.stage.core_radius
        self.least_m = -np.concatenate([radius.ravel(), self.stage.own_radius])
        solid = np.flatnonzero(np.isin(self.columns.kinds, ["fragile", "rigid"]))
        moved = [self.stage.bodies[k] for k in self.stage.moving]
        most = self.cell.overlap_limit_m
        deepest = np.array([min(most, max(each.radius - AXIS_MET_M, 0.0), each.overhang) for each in moved])
        self.columns.below[solid] = -deepest[self.mover[solid]]

    def _fastest(self):
        """No body goes faster (m/s), and what can be nearer between two first samples than at both (m)."""
        if self.between is None:
            return self.run.fastest_m_s(self.stage), 0.0
        fastest = float(self.between.speed_most.max())
        return fastest, fastest * self.run.timing.duration_s / FIRST_MOST / 2

    def look(self, times, *, at_least_m=LEAST_LAW_M):
        """Measure everything at these times; what is farther than its law and `at_least_m` reach is not measured."""
        if not len(times):
            return
        self.place(at_least_m=at_least_m)
        self.more(np.asarray(times))

    def more(self, times):
        """These samples too; the places of the new ones among all."""
        shots = self.stage.shots(*self.run.at(times))
        clear = self._clear(shots)
        index = self.columns.index(clear, shots.speed[:, self.mover])
        joined = np.concatenate([self.times, times])
        order = np.argsort(joined, kind="stable")
        if self.shots is None:
            self.shots, self.clear, self.index = shots.taken(order), clear[order], index[order]
        else:
            self.shots = self.shots.joined(shots, order)
            self.clear = np.concatenate([self.clear, clear])[order]
            self.index = np.concatenate([self.index, index])[order]
        known = len(self.times)
        self.times = joined[order]
        return np.flatnonzero(order >= known)

    def _clear(self, shots):
        """Clearances of all columns, (n, columns)."""
        count = len(shots.own)
        parts = [shots.thing.reshape(count, -1), shots.own]
        room = self.scene.workspace
        if room is not None:
            radius = self.stage.radius[: len(self.stage.moving)]
            parts += [np.array(room.high_m)[:, None] - shots.ends.max(axis=3).swapaxes(1, 2) - radius]
            parts += [shots.ends.min(axis=3).swapaxes(1, 2) - np.array(room.low_m)[:, None] - radius]
        return np.concatenate([part.reshape(count, -1) for part in parts], axis=1)

    def sided(self, at):
        """True where the direction of a pair is that to its nearest points.

        It is not when a body's axis is inside a box.
        """
        inside = self.clear[at, : len(self.least_m)] <= self.least_m + INSIDE_M
        return ~inside

    # -- what it says

    def ratios(self, fastest=None):
        """Each quantity by its limit, as far as it was seen; joint speed and acceleration as they are commanded."""
        timing, share, motion = self.run.timing, np.abs(self.run.unit), self.motion
        asked = motion.speed_rad_s if isinstance(motion, MoveJ) else np.abs(motion.qd_rad_s).max()
        wanted, got = ((share * v / SPEED_LIMITS).max() for v in (asked, timing.peak))
        return {
            "joint_speed": wanted if wanted > 1 else got,
            "acceleration": timing.up / MODEL["acceleration_limit_rad_s2"],
            "payload": (self.tool["mass_kg"] + self.carried_kg()) / MODEL["payload_limit_kg"],
        } | self.speed_ratios(self.shots.points.max(axis=0) if fastest is None else fastest)

    def speed_ratios(self, fastest):
        """Those that points going so fast make."""
        cell, masses = self.cell, self.masses()
        return {
            "tcp_speed": fastest[0] / cell.tcp_speed_limit_m_s,
            "elbow_speed": fastest[1] / cell.elbow_speed_limit_m_s,
            "momentum": float(masses @ fastest) / cell.momentum_limit_kg_m_s,
        }

    def masses(self):
        """Of each of the stage's points, kg."""
        held = 0.0 if self.held is None else self.held.mass_kg
        held = MODEL["payload_limit_kg"] if held is None else held
        at_tip = MODEL["payload_limit_kg"] if self.cell.payload_kg is None else self.cell.payload_kg
        return np.array([at_tip, 0.0, self.tool["mass_kg"], *MASSES, held])

    def allowed(self):
        """Columns that lead away from where the arm must not be, and those whose contact is meant and gentle."""
        cell, below = self.cell, self.columns.below
        retreats, gentle = np.zeros(len(below), bool), np.zeros(len(below), bool)
        fastest = float(self.shots.speed[:, : len(self.stage.moving)].max())
        if self.omega <= cell.retreat_joint_speed_rad_s and fastest <= cell.retreat_speed_m_s:
            at = np.flatnonzero(self.clear[0] < below)
            clear = self.clear[:, at]
            best = np.minimum(np.maximum.accumulate(clear, axis=0), below[at])
            retreats[at] = (clear >= best - cell.retreat_tolerance_m).all(axis=0)
        if len(at := np.flatnonzero(self.touchable)):
            clear, speed = self.clear[:, at], self.shots.speed[:, self.mover[at]]
            apart, deep = clear >= cell.contact_near_m, clear < -cell.contact_depth_m
            gentle[at] = (apart | ((speed <= cell.contact_speed_m_s) & ~deep)).all(axis=0)
        return retreats, gentle

    def seen(self):
        """Findings of all samples so far together."""
        found = Seen(samples=len(self.times), ratios=self.ratios())
        least = max(1.0, self.floor, *(ratio_law(r) for r in found.ratios.values()))
        met = self.clear < FAR_M
        index = np.where(met, self.index, 0.0).max(axis=0)
        retreats, gentle = self.allowed()
        found.high = max(least, float(index.max(initial=0.0)))
        index = np.where(retreats, 3.0, np.where(gentle, np.minimum(index, 2), index))
        found.low = max(least, float(index.max(initial=0.0)))
        nearest = self.clear[:, : self.around].min(initial=FAR_M)
        found.nearest = float(nearest) if nearest < FAR_M else np.inf
        deep = (self.clear < self.columns.below - VIOLATED_BY_M).any(axis=0) & ~retreats & ~gentle
        found.violated = set(self.columns.kinds[deep].tolist())
        return found
