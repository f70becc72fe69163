"""What a straight joint motion does to its scene, by MuJoCo at many instants, and by laws written down here once more.

Nothing is shared with the room or with its second engine: the arm is read from the model's TOML, MuJoCo places it and
measures all pairs at once, speeds come from its joint axes, timing and laws from the clauses. Scene, cell and motion are
plain numbers of the question. Of the two engines in reach this is the faster by a factor of three: pinocchio and coal need
half as long to measure, but hand out their distances one by one.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

import pep.pit
from pep.pit import Box, Capsule, MoveJ, Sphere
from tests.pit import twin

MODEL = tomllib.loads((Path(pep.pit.__file__).parent / "robots" / "ur3e.toml").read_text())
ARM_CAPSULES = {c["name"]: c for c in MODEL["capsules"]}
SPEED_LIMITS = np.array([j["speed_limit_rad_s"] for j in MODEL["joints"]])
POSITION_LIMITS = np.array([j["position_limit_rad"] for j in MODEL["joints"]])
MASSES = np.array([j["mass_kg"] for j in MODEL["joints"]])
LINKS = 7
ARM, THING = 1, 2  # bits: the arm meets things, neither meets its own kind
MEETS = {0: 0, ARM: THING, THING: ARM}
LEAST_LAW_M = 0.05
ARENA = 1 << 24  # bytes for contacts: some ten thousand
VIOLATED_BY_M = 1e-4 + 1e-6  # what a search may leave undecided, and what rounds
STILL = 1e-9


# ---- timing: a trapezoid of the leading axis


@dataclass(frozen=True)
class Timing:
    """Speeding up at `up` to `peak`, holding it, braking at `down`; rad, s, of the leading axis."""

    up: float
    down: float
    peak: float
    hold_s: float

    @property
    def duration_s(self):
        return self.peak / self.up + self.hold_s + self.peak / self.down

    def lead(self, t):
        """Way made and speed at these times."""
        ramp, braking = self.peak / self.up, self.peak / self.up + self.hold_s
        t = np.clip(t, 0, self.duration_s)
        a, b, c = np.minimum(t, ramp), np.clip(t - ramp, 0, self.hold_s), np.clip(t - braking, 0, None)
        way = self.up * a**2 / 2 + self.peak * b + self.peak * c - self.down * c**2 / 2
        speed = np.where(t < ramp, self.up * t, np.where(t <= braking, self.peak, self.peak - self.down * c))
        return way, np.maximum(speed, 0)


@dataclass(frozen=True)
class Driven:
    """A motion in time: joint angles are `start` plus `unit` times the leading axis' way."""

    start: np.ndarray
    unit: np.ndarray
    timing: Timing

    @property
    def end(self):
        return self.start + self.unit * self.timing.lead(np.array([self.timing.duration_s]))[0]

    def at(self, t):
        """Joint angles and joint speeds at these times, (n, 6) each."""
        way, speed = self.timing.lead(t)
        return self.start + way[:, None] * self.unit, speed[:, None] * self.unit


def driven(motion, cell):
    """The motion in time, or None when it goes nowhere."""
    start = np.array(motion.start)
    if isinstance(motion, MoveJ):
        delta = np.array(motion.target) - start
        way, up = float(np.abs(delta).max()), motion.acceleration_rad_s2
        if way <= STILL:
            return None
        peak = min(motion.speed_rad_s, (up * way) ** 0.5)
        return Driven(start, delta / way, Timing(up, up, peak, way / peak - peak / up))
    asked = np.array(motion.qd_rad_s)
    leading, up = float(np.abs(asked).max()), motion.acceleration_rad_s2
    if leading == 0:
        return None
    until = motion.duration_s + cell.stop_delay_s
    peak = min(leading, up * until)
    return Driven(start, asked / leading, Timing(up, cell.stop_deceleration_rad_s2, peak, until - peak / up))


# ---- the arm and its scene in MuJoCo


def rotation(roll, pitch, yaw):
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(x), np.sin(x)) for x in (roll, pitch, yaw))
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return z @ y @ x


def quaternion(matrix):
    found = np.zeros(4)
    mujoco.mju_mat2Quat(found, matrix.flatten())
    return found


@dataclass(frozen=True)
class Body:
    """A capsule or ball on a link."""

    name: str
    link: int
    a: tuple
    b: tuple
    radius: float
    part: str = ""


@cache
def tool_of(name):
    return next(tool for tool in MODEL["tools"] if tool["name"] == name)


def bodies_of(tool, held):
    """All capsules of the robot; those of the base first, the moving ones in the order of the model."""
    found = [Body(c["name"], c["link"], tuple(c["a_m"]), tuple(c["b_m"]), c["radius_m"]) for c in MODEL["capsules"]]
    found += [Body(c["name"], 6, tuple(c["a_m"]), tuple(c["b_m"]), c["radius_m"], "tool") for c in tool["capsules"]]
    if held is not None:
        a, b, radius = ends_of(held.shape)
        found.append(Body("payload", 6, a, b, radius, "payload"))
    return found


def apart_of(tool, held):
    """Names of the capsules that must stay apart: (inner, outer)."""
    on_tool = [c["name"] for c in tool["capsules"]]
    for inner, outers in MODEL["self_pairs"].items():
        for outer in outers:
            for name in sorted(on_tool) if outer == "tool" else [outer]:
                if name in ARM_CAPSULES or name in on_tool:
                    yield inner, name
    if held is not None:
        yield from ((c["name"], "payload") for c in MODEL["capsules"] if c["link"] < 6)


def ends_of(shape):
    match shape:
        case Capsule(a, b, radius):
            return a, b, radius
        case Sphere(center, radius):
            return center, center, radius


def add_round(parent, name, a, b, radius, bits):
    a, b = np.array(a), np.array(b)
    more = {"name": name, "contype": bits, "conaffinity": MEETS[bits]}
    if np.linalg.norm(b - a) < 1e-9:
        parent.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], pos=a, **more)
    else:
        parent.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[radius, 0, 0], fromto=[*a, *b], **more)


def compiled(bodies, apart, shapes):
    """MuJoCo's model of the arm among these shapes."""
    spec = mujoco.MjSpec()
    spec.memory = ARENA
    links = [spec.worldbody]
    for joint in MODEL["joints"]:
        link = links[-1].add_body(pos=joint["offset_m"], quat=quaternion(rotation(*joint["rpy_rad"])))
        link.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
        link.mass, link.inertia, link.explicitinertial = 1.0, [1.0, 1.0, 1.0], True
        links.append(link)
    for body in bodies:
        bits = ARM if body.link else 0
        add_round(links[body.link], body.name, body.a, body.b, body.radius, bits)
    for k, shape in enumerate(shapes):
        match shape:
            case Box(center, half, quat):
                spec.worldbody.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_BOX, name=f"/{k}", size=half, pos=center, quat=quat,
                    contype=THING, conaffinity=ARM,
                )  # fmt: skip
            case _:
                add_round(spec.worldbody, f"/{k}", *ends_of(shape), THING)
    for inner, outer in apart:
        spec.add_pair(geomname1=inner, geomname2=outer)
    return spec.compile()


def summed(turns, anchors):
    """Over the joints up to each link the sums of w and of w x o, (n, 7, 3) each: there v(p) = w x p - w x o."""
    none = np.zeros((len(turns), 1, 3))
    return tuple(np.concatenate([none, np.cumsum(each, axis=1)], axis=1) for each in (turns, np.cross(turns, anchors)))


# ---- laws (docs/physics.md, PHY-2 to PHY-7), in arrays; `twin` has them one number at a time


@dataclass(frozen=True)
class Stop:
    """T_r, T_s and metres of braking travel per m/s."""

    reaction: float
    brake: float
    travel: float

    @staticmethod
    def of(cell, age_s, omega):
        ramp = omega / cell.stop_deceleration_rad_s2
        reaction = max(age_s, cell.watch_age_limit_s) + cell.reaction_s
        return Stop(reaction, cell.stop_delay_s + ramp, cell.stop_delay_s + ramp / 2)


def person_law(d, v, *, z, harm, reach, cell, stop):
    near, hit = d - z, v * (stop.reaction + stop.travel)
    approach = cell.person_speed_m_s * (stop.reaction + stop.brake) + reach
    safe = approach + hit
    with np.errstate(divide="ignore", invalid="ignore"):
        blow = np.where(hit > 0, np.minimum(1, (hit - near) / hit), 0) * np.maximum(0, v / harm - 1)
    met = 3 + np.minimum(1, np.maximum(blow, np.maximum(0, -d) / cell.penetration_band_m))
    far = 1 + np.clip((safe + cell.warn_band_m - near) / cell.warn_band_m, 0, 1)
    index = np.where(near <= hit, met, np.where(near < safe, 2 + (safe - near) / approach, far))
    return np.where(v > 0, index, 0)


def thing_law(d, v, *, z, band, stop):
    near, hit = d - z, v * stop.travel
    with np.errstate(divide="ignore", invalid="ignore"):
        met = 2 + np.minimum(1, np.where(hit > 0, (hit - near) / hit, 1))
    index = np.where(near <= hit, met, 1 + np.clip((hit + band - near) / band, 0, 1))
    return np.where(v > 0, index, 0)


def zone_law(d, v, *, z, band, tier, stop):
    share = np.clip((v * stop.travel + band - (d - z)) / band, 0, 1)
    return np.where(v > 0, 1 + (tier - 1) * share, 0)


def ratio_law(ratio):
    if ratio > 1:
        return 4.0
    return 1 + max(0.0, ratio - 0.75) / 0.15 if ratio <= 0.9 else 2 + (ratio - 0.9) / 0.1


@dataclass
class Law:
    """One obstacle: what it is, its uncertainty, and what its law needs."""

    kind: str
    z: float
    reach: float  # farther than this plus the uncertainty the law says 1
    harm: float = np.inf
    intrusion: float = 0.0
    band: float = 0.0
    tier: int = 0
    touched_by: frozenset = frozenset()
    below: float = -np.inf

    def index(self, d, v, cell, stop):
        match self.kind:
            case "person":
                return person_law(d, v, z=self.z, harm=self.harm, reach=self.intrusion, cell=cell, stop=stop)
            case "tiered_zone":
                return zone_law(d, v, z=self.z, band=self.band, tier=self.tier, stop=stop)
            case _:
                return thing_law(d, v, z=self.z, band=self.band, stop=stop)


@dataclass
class Seen:
    """What the samples so far showed.

    Attributes:
        low: highest index with every allowance that the samples bear out (retreat, meant contact).
        high: the same with none.
        violated: kinds that are met more deeply than a search may leave open, retreats left out.
        nearest: least clearance to an obstacle, infinite when none came within what was measured.
        ratios: each quantity of PHY-7 by its limit, torque left out.
        samples: how many.
    """

    low: float = 0.0
    high: float = 0.0
    violated: set = field(default_factory=set)
    nearest: float = np.inf
    ratios: dict = field(default_factory=dict)
    samples: int = 0


class World:
    """One question, sampled in MuJoCo."""

    def __init__(self, robot, scene, motion, cell, age_s, touch):
        """Of `robot` only its tool's name and what it holds are used."""
        self.cell, self.motion, self.scene, self.age_s = cell, motion, scene, age_s
        self.tool, self.held = tool_of(robot.tool.name), robot.held
        self.run = driven(motion, cell)
        self.bodies = bodies_of(self.tool, self.held)
        self.apart = list(apart_of(self.tool, self.held))
        self.moving = [k for k, body in enumerate(self.bodies) if body.link]
        self.link = np.array([body.link for body in self.bodies])
        self.radius = np.array([body.radius for body in self.bodies])
        self.omega = self.run.timing.peak
        stale = age_s > cell.perception_age_limit_s
        self.floor = cell.unknown_floor if stale or not scene.complete else 0.0
        self.stop = Stop.of(cell, age_s, self.omega)
        regions = [(p, r, s) for p in scene.people for r, s in p.regions]
        self.shapes = [s for _, _, s in regions] + [x.shape for x in (*scene.objects, *scene.zones)]
        self.laws = self._laws(regions, cell.person_speed_m_s * age_s if stale else 0.0, touch)
        self.model = compiled(self.bodies, self.apart, self.shapes)
        self.state = mujoco.MjData(self.model)
        names = {mujoco.mj_id2name(self.model, mujoco.mjtObj.mjOBJ_GEOM, g): g for g in range(self.model.ngeom)}
        self.of_body = np.full(self.model.ngeom, -1)
        self.of_thing = np.full(self.model.ngeom, -1)
        for k, body in enumerate(self.bodies):
            self.of_body[names[body.name]] = k
        for k in range(len(self.shapes)):
            self.of_thing[names[f"/{k}"]] = k
        at = {body.name: k for k, body in enumerate(self.bodies)}
        self.inner = np.array([at[a] for a, _ in self.apart])
        self.outer = np.array([at[b] for _, b in self.apart])
        self.row_of = np.full((len(self.bodies), len(self.bodies)), -1)
        self.row_of[self.inner, self.outer] = self.row_of[self.outer, self.inner] = np.arange(len(self.apart))
        self.clear_thing, self.clear_own, self.clear_face, self.speed, self.own_speed = [], [], [], [], []
        self.times = np.zeros(0)
        self.point_speed = np.zeros((0, 3 + LINKS))

    # -- what counts

    def carried_kg(self):
        held = 0.0 if self.held is None else self.held.mass_kg
        whole = MODEL["payload_limit_kg"]
        return whole if self.cell.payload_kg is None or held is None else self.cell.payload_kg + held

    def _laws(self, regions, grown, touch):
        cell, stop = self.cell, self.stop
        mass = MASSES.sum() / 2 + self.tool["mass_kg"] + self.carried_kg()
        blunt = self.tool["shape"] == "blunt" and cell.payload_kg is not None
        blunt = blunt and (self.held is None or self.held.blunt)
        fastest = 2.0 * self.omega  # m/s per rad/s: nothing of the arm is farther than this from all its axes together
        fastest *= max(1.0, np.abs(self.run.unit).sum())
        travel = fastest * (stop.reaction + stop.travel)
        arms = {"upper_arm", "lower_arm", "hand"}
        found = []
        for person, region, _ in regions:
            tracked = any(str(r) in arms for r, _ in person.regions)
            reach = cell.intrusion_tracked_m if tracked else cell.intrusion_untracked_m
            full = twin.harm_speed(str(region), mass)
            harm = full if blunt else full / twin.LIMITS[str(region)][4]
            away = cell.person_speed_m_s * (stop.reaction + stop.brake) + reach + cell.warn_band_m + travel
            z = cell.person_uncertainty_m + cell.robot_uncertainty_m + grown
            found.append(Law("person", z, away, harm, reach, below=0.0))
        for thing in self.scene.objects:
            band = cell.fragile_band_m if thing.kind == "fragile" else cell.rigid_band_m
            by = frozenset(c.by for c in cell.contacts if c.object == thing.id and thing.id in touch)
            z = thing.uncertainty_m + cell.robot_uncertainty_m
            found.append(Law(thing.kind, z, band + travel, band=band, touched_by=by))
        for zone in self.scene.zones:
            kind = "zone" if zone.tier is None else "tiered_zone"
            below = 0.0 if zone.tier is None else -np.inf
            z, away = cell.robot_uncertainty_m, cell.rigid_band_m + travel
            found.append(Law(kind, z, away, band=cell.rigid_band_m, tier=zone.tier or 0, below=below))
        return found

    # -- sampling

    def look(self, times, *, at_least_m=LEAST_LAW_M):
        """Measure everything at these times; what is farther than its law and `at_least_m` reach is not measured."""
        if not len(times):
            return
        q, qd = self.run.at(times)
        count, model, state = len(times), self.model, self.state
        for geom in range(model.ngeom):
            thing = self.of_thing[geom]
            if thing >= 0:
                model.geom_margin[geom] = max(self.laws[thing].z + self.laws[thing].reach, at_least_m)
        model.body_margin[:] = model.geom_margin.max()  # the broad phase goes by the bodies' own
        model.pair_margin[:] = self.cell.rigid_band_m + 4.0 * self.omega * self.stop.travel
        thing = np.full((count, len(self.shapes), len(self.bodies)), np.inf)
        own = np.full((count, len(self.apart)), np.inf)
        frames = np.empty((count, LINKS, 3, 4))
        axes, anchors = np.empty((count, 6, 3)), np.empty((count, 6, 3))
        for n in range(count):
            state.qpos[:] = q[n]
            mujoco.mj_kinematics(model, state)
            mujoco.mj_collision(model, state)
            frames[n, :, :, :3] = state.xmat.reshape(LINKS, 3, 3)
            frames[n, :, :, 3] = state.xpos
            axes[n], anchors[n] = state.xaxis, state.xanchor
            if not state.ncon:
                continue
            pair, gap = state.contact.geom, state.contact.dist
            a, b = pair[:, 0], pair[:, 1]
            on, off = np.maximum(self.of_body[a], self.of_body[b]), np.maximum(self.of_thing[a], self.of_thing[b])
            met = off >= 0
            np.minimum.at(thing[n], (off[met], on[met]), gap[met])
            if not met.all():
                one, two = self.of_body[a[~met]], self.of_body[b[~met]]
                np.minimum.at(own[n], self.row_of[one, two], gap[~met])
        # By definition a clearance is never below minus both radii: no engine's depth counts.
        thing = np.maximum(thing, -(self.radius + self._thing_radius()[:, None]))
        own = np.maximum(own, -(self.radius[self.inner] + self.radius[self.outer]))
        ends = self._ends(frames)
        turning = summed(axes * qd[:, :, None], anchors)
        self.times = np.concatenate([self.times, times])
        self.clear_thing.append(thing)
        self.clear_own.append(own)
        self.clear_face.append(self._faces(ends))
        self.speed.append(self._speed(ends, turning, np.zeros_like(self.link), self.link, self.radius))
        inner, outer = self.link[self.inner], self.link[self.outer]
        self.own_speed.append(self._speed(ends[:, self.outer], turning, inner, outer, self.radius[self.outer]))
        self._points(frames, turning)

    def _thing_radius(self):
        return np.array([0.0 if isinstance(s, Box) else s.radius_m for s in self.shapes])

    def _ends(self, frames):
        local = np.array([(body.a, body.b) for body in self.bodies])
        on = frames[:, self.link]
        return np.einsum("nbij,bej->nbei", on[..., :3], local) + on[:, :, None, :, 3]

    @staticmethod
    def _carried(points, turning, inner, outer):
        """Velocity of points (n, p, e, 3) that the joints from link `inner` to link `outer` carry, and how they turn."""
        spin = turning[0][:, outer] - turning[0][:, inner]
        about = turning[1][:, outer] - turning[1][:, inner]
        return np.cross(spin[:, :, None], points) - about[:, :, None], np.linalg.norm(spin, axis=2)

    def _speed(self, ends, turning, inner, outer, radius):
        """Surface speed of capsules: the faster end, and the radius times the turning."""
        velocity, spin = self._carried(ends, turning, inner, outer)
        return np.linalg.norm(velocity, axis=3).max(axis=2) + radius * spin

    def _faces(self, ends):
        room = self.scene.workspace
        if room is None:
            return np.full((len(ends), 6, len(self.bodies)), np.inf)
        high = np.array(room.high_m) - ends.max(axis=2)
        low = ends.min(axis=2) - np.array(room.low_m)
        return np.concatenate([np.moveaxis(high, 2, 1), np.moveaxis(low, 2, 1)], axis=1) - self.radius

    def _points(self, frames, turning):
        """Speeds of tool point, elbow, tool's mass, and the links' masses."""
        places = [(6, self.tool["tcp_m"]), (2, MODEL["joints"][2]["offset_m"]), (6, self.tool["com_m"])]
        places += [(k + 1, joint["com_m"]) for k, joint in enumerate(MODEL["joints"])]
        middle = (0.0, 0.0, 0.0) if self.held is None else np.mean(ends_of(self.held.shape)[:2], axis=0)
        places.append((6, tuple(middle)))
        link = np.array([where for where, _ in places])
        local = np.array([point for _, point in places])
        on = frames[:, link]
        at = np.einsum("npij,pj->npi", on[..., :3], local) + on[..., 3]
        velocity, _ = self._carried(at[:, :, None], turning, np.zeros_like(link), link)
        self.point_speed = np.concatenate([self.point_speed, np.linalg.norm(velocity[:, :, 0], axis=2)])

    # -- what it says

    def ratios(self):
        """Each quantity by its limit, as far as it was seen; joint speed and acceleration as they are commanded."""
        cell, timing, share = self.cell, self.run.timing, np.abs(self.run.unit)
        motion = self.motion
        asked = motion.speed_rad_s if isinstance(motion, MoveJ) else np.abs(motion.qd_rad_s).max()
        wanted, got = ((share * v / SPEED_LIMITS).max() for v in (asked, timing.peak))
        fastest = self.point_speed.max(axis=0)
        held = 0.0 if self.held is None else self.held.mass_kg
        held = MODEL["payload_limit_kg"] if held is None else held
        at_tip = MODEL["payload_limit_kg"] if cell.payload_kg is None else cell.payload_kg
        masses = np.array([at_tip, 0.0, self.tool["mass_kg"], *MASSES, held])
        return {
            "joint_speed": wanted if wanted > 1 else got,
            "acceleration": timing.up / MODEL["acceleration_limit_rad_s2"],
            "tcp_speed": fastest[0] / cell.tcp_speed_limit_m_s,
            "elbow_speed": fastest[1] / cell.elbow_speed_limit_m_s,
            "momentum": float(masses @ fastest) / cell.momentum_limit_kg_m_s,
            "payload": (self.tool["mass_kg"] + self.carried_kg()) / MODEL["payload_limit_kg"],
        }

    def rows(self):
        """Per obstacle its law, and over the samples in the order of time each pair's clearance and speed, (n, pairs)."""
        order = np.argsort(self.times, kind="stable")
        thing, own, face, speed, own_speed = (
            np.concatenate(parts)[order]
            for parts in (self.clear_thing, self.clear_own, self.clear_face, self.speed, self.own_speed)
        )
        moving, speed = self.moving, speed[:, self.moving]
        part = np.array([self.bodies[body].part for body in moving])
        for k, law in enumerate(self.laws):
            yield law, thing[:, k, moving], speed, np.isin(part, list(law.touched_by))
        band, z = self.cell.rigid_band_m, self.cell.robot_uncertainty_m
        yield (
            Law("self", 0.0, 0.0, band=band, below=-self.cell.self_overlap_m),
            own,
            own_speed,
            np.zeros(own.shape[1], bool),
        )
        if self.scene.workspace is not None:
            for k in range(6):
                yield (
                    Law("workspace", z, 0.0, band=band, below=0.0),
                    face[:, k, moving],
                    speed,
                    np.zeros(len(moving), bool),
                )

    def seen(self):
        """What all samples so far say together."""
        cell, found = self.cell, Seen(samples=len(self.times), ratios=self.ratios())
        fastest = max(float(part[:, self.moving].max()) for part in self.speed)
        slow = self.omega <= cell.retreat_joint_speed_rad_s and fastest <= cell.retreat_speed_m_s
        least = max(1.0, self.floor, *(ratio_law(r) for r in found.ratios.values()))
        found.low = found.high = least
        for law, clear, speed, touchable in self.rows():
            met = np.isfinite(clear).any(axis=0)
            if not met.any():
                continue
            clear, speed, touchable = clear[:, met], speed[:, met], touchable[met]
            if law.kind not in ("self", "workspace"):
                found.nearest = min(found.nearest, float(clear.min()))
            index = law.index(clear, speed, cell, self.stop)
            found.high = max(found.high, float(index.max()))
            best = np.minimum(np.maximum.accumulate(clear, axis=0), law.below)
            retreats = slow & (clear[0] < law.below) & (clear >= best - cell.retreat_tolerance_m).all(axis=0)
            apart, deep = clear >= cell.contact_near_m, clear < -cell.contact_depth_m
            gentle = touchable & (apart | ((speed <= cell.contact_speed_m_s) & ~deep)).all(axis=0)
            index = np.where(gentle, np.minimum(index, 2), index)
            found.low = max(found.low, float(np.where(retreats, 3.0, index.max(axis=0)).max()))
            if (clear < law.below - VIOLATED_BY_M)[:, ~retreats].any():
                found.violated.add(law.kind)
        return found

    def peaks(self, count):
        """Times of the samples at which some pair counts most or comes nearest, best first."""
        order = np.argsort(self.times, kind="stable")
        rank = np.zeros(len(order))
        gap = np.full(len(order), np.inf)
        for law, clear, speed, _ in self.rows():
            met = np.isfinite(clear).any(axis=0)
            if met.any():
                rank = np.maximum(rank, law.index(clear[:, met], speed[:, met], self.cell, self.stop).max(axis=1))
                if law.kind not in ("self", "workspace"):
                    gap = np.minimum(gap, clear.min(axis=1))
        best = [*np.lexsort((gap, -rank))[:count], *np.argsort(gap)[:count]]
        return self.times[order][np.unique(best)]
