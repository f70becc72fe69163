"""Arm among things in MuJoCo: a model is built once for a number of things, which each scene places.

Places of bodies, their distances and directions are MuJoCo's answer; the arm is read from the model's TOML. Speeds of
points follow from MuJoCo's joint axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from tests.pep.pit.campaign.facts import JOINTS, LINKS, MODEL, Points, apart_of, bodies_of, ends_of, tool_of
from tests.pep.pit.campaign.laws import FAR_M

from pep.pit import Box, Capsule

ARM, THING = 1, 2  # bits: the arm meets things, neither meets its own kind
MEETS = {0: 0, ARM: THING, THING: ARM}
ARENA = 1 << 24  # bytes for contacts: some ten thousand
POINT_M = 1e-9
STAGES = 64  # tools and held parts times numbers of things


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
class Placed:
    """Place of a shape in MuJoCo, and its kind."""

    kind: int
    size: tuple
    position: tuple
    turn: tuple
    bound: float
    core_radius: float

    @staticmethod
    def of(shape):
        match shape:
            case Box(center, half, turn):
                bound = float(np.linalg.norm(half))
                return Placed(mujoco.mjtGeom.mjGEOM_BOX, tuple(half), tuple(center), tuple(turn), bound, 0.0)
        a, b, radius = ends_of(shape)
        middle, way = (np.array(a) + b) / 2, np.array(b) - a
        length = float(np.linalg.norm(way))
        if length < POINT_M:
            size, still = (radius, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
            return Placed(mujoco.mjtGeom.mjGEOM_SPHERE, size, tuple(middle), still, radius, radius)
        turn = np.zeros(4)
        mujoco.mju_quatZ2Vec(turn, way / length)
        size = (radius, length / 2, 0.0)
        return Placed(
            mujoco.mjtGeom.mjGEOM_CAPSULE, size, tuple(middle), tuple(turn), length / 2 + radius, radius
        )  # fmt: skip


def add_body(parent, body):
    """This capsule or ball, on its link."""
    placed, bits = Placed.of(Capsule(body.a, body.b, body.radius)), ARM if body.link else 0
    parent.add_geom(
        name=body.name, type=placed.kind, size=placed.size, pos=placed.position, quat=placed.turn,
        contype=bits, conaffinity=MEETS[bits],
    )  # fmt: skip


def compiled(bodies, apart, count):
    """MuJoCo's model of the arm and so many balls, each a body of its own."""
    spec = mujoco.MjSpec()
    spec.memory = ARENA
    links = [spec.worldbody]
    for joint in MODEL["joints"]:
        link = links[-1].add_body(pos=joint["offset_m"], quat=quaternion(rotation(*joint["rpy_rad"])))
        link.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
        link.mass, link.inertia, link.explicitinertial = 1.0, [1.0, 1.0, 1.0], True
        links.append(link)
    for body in bodies:
        add_body(links[body.link], body)
    for k in range(count):
        place = spec.worldbody.add_body(name=f"/{k}")
        place.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, name=f"/{k}", size=[1, 0, 0], contype=THING, conaffinity=ARM)
    for inner, outer in apart:
        spec.add_pair(geomname1=inner, geomname2=outer)
    model = spec.compile()
    # The trees of boxes within a body are made for shapes as they are compiled; ours are changed.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
    return model


@dataclass(frozen=True)
class Shots:
    """Measurements of MuJoCo at n instants: m moving bodies, t things, s pairs of bodies, p points.

    Attributes:
        thing, thing_way: clearance (n, m, t), and the direction from the thing to the body (n, m, t, 3).
        own, own_way: clearance (n, s), and the direction from the inner to the outer body as the inner link sees it.
        ends: both ends of the moving bodies' axes (n, m, 3, 2).
        own_ends: those of the outer bodies as the inner links see them (n, s, 3, 2).
        speed: surface speeds of moving bodies, then of outer bodies past the inner links (n, m + s).
        points: speeds of the points (n, p).
    """

    thing: np.ndarray
    thing_way: np.ndarray
    own: np.ndarray
    own_way: np.ndarray
    ends: np.ndarray
    own_ends: np.ndarray
    speed: np.ndarray
    points: np.ndarray

    def arrays(self):
        """All of them, in their order."""
        return tuple(getattr(self, name) for name in self.__dataclass_fields__)

    def taken(self, order):
        """These in this order."""
        return Shots(*(each[order] for each in self.arrays()))

    def joined(self, other, order):
        """These and the others in this order."""
        return Shots(*(np.concatenate(both)[order] for both in zip(self.arrays(), other.arrays(), strict=True)))


class Stage:
    """One arm with its tool and part, and so many things; not shared between threads."""

    def __init__(self, tool, held, count):
        """Nothing is in its place yet."""
        self.bodies, self.apart = bodies_of(tool, held), list(apart_of(tool, held))
        self.moving = [k for k, body in enumerate(self.bodies) if body.link]
        self.parts = np.array([self.bodies[k].part for k in self.moving])
        at = {body.name: k for k, body in enumerate(self.bodies)}
        inner, outer = (np.array([at[pair[side]] for pair in self.apart]) for side in (0, 1))
        link = np.array([body.link for body in self.bodies])
        radius = np.array([body.radius for body in self.bodies])
        axes = np.array([(body.a, body.b) for body in self.bodies]).swapaxes(1, 2)
        self.points, self.held = Points.of(tool, held), held
        # Whose speed counts: moving bodies, outer bodies past the inner ones' links, points.
        self.links = np.concatenate([link[self.moving], link[outer], self.points.link])
        self.past = np.concatenate([np.zeros(len(self.moving), int), link[inner], np.zeros(len(self.points.link), int)])
        at_points = np.repeat(self.points.at[:, :, None], 2, axis=2)
        self.axes = np.concatenate([axes[self.moving], axes[outer], at_points])
        self.radius = np.concatenate([radius[self.moving], radius[outer], np.zeros(len(self.points.link))])
        self.own_radius = radius[inner] + radius[outer]
        self.levers = self._levers()
        self._on = {link: (of, self.axes[of].swapaxes(0, 1).reshape(3, -1)) for link, of in grouped(self.links)}
        self._inside = dict(grouped(link[inner]))
        self.count = count
        self.model = compiled(self.bodies, self.apart, count)
        self.state = mujoco.MjData(self.model)
        named = {mujoco.mj_id2name(self.model, mujoco.mjtObj.mjOBJ_GEOM, g): g for g in range(self.model.ngeom)}
        self._thing_geoms = np.array([named[f"/{k}"] for k in range(count)], int)
        self._thing_bodies = self.model.geom_bodyid[self._thing_geoms]
        # Each pair of geoms has a column: moving bodies times things, then pairs of bodies; and which comes first.
        columns = len(self.moving) * count
        self._column = np.full((self.model.ngeom, self.model.ngeom), -1)
        for m, k in enumerate(self.moving):
            for t, thing in enumerate(self._thing_geoms):
                self._enter(thing, named[self.bodies[k].name], m * count + t)
        for s, (first, second) in enumerate(self.apart):
            self._enter(named[first], named[second], columns + s)

    def _enter(self, first, second, column):
        self._column[first, second] = 2 * column
        self._column[second, first] = 2 * column + 1

    def _levers(self):
        """Greatest distance of each of `axes` from the axis of each joint that moves it, by lengths: (k, 6)."""
        lengths = np.array([np.linalg.norm(joint["offset_m"]) for joint in MODEL["joints"]])
        found = np.zeros((len(self.links), JOINTS))
        own = np.linalg.norm(self.axes, axis=1).max(axis=1)
        for k, (past, link) in enumerate(zip(self.past, self.links, strict=True)):
            for joint in range(past, link):
                found[k, joint] = own[k] + lengths[joint + 1 : link].sum()
        return found

    def place(self, shapes, margins, own_margin):
        """These shapes stand there; what is nearer than these margins is measured."""
        model = self.model
        placed = [Placed.of(shape) for shape in shapes]
        self.core_radius = np.array([each.core_radius for each in placed])
        self.boxed = np.array([each.kind == mujoco.mjtGeom.mjGEOM_BOX for each in placed], bool)
        for geom, body, each in zip(self._thing_geoms, self._thing_bodies, placed, strict=True):
            model.geom_type[geom], model.geom_size[geom], model.geom_rbound[geom] = each.kind, each.size, each.bound
            model.body_pos[body], model.body_quat[body] = each.position, each.turn
        model.geom_margin[self._thing_geoms] = margins
        model.body_margin[:] = np.max(margins, initial=0.0)  # the broad phase goes by the bodies' own
        model.pair_margin[:] = own_margin

    def shots(self, q, qd):
        """Measurements at these joint angles and speeds, (n, 6) each."""
        count, model, state = len(q), self.model, self.state
        turns, origins = np.empty((count, LINKS, 9)), np.empty((count, LINKS, 3))
        axes, anchors = np.empty((count, JOINTS, 3)), np.empty((count, JOINTS, 3))
        xmat, xpos, xaxis, xanchor = state.xmat[:LINKS], state.xpos[:LINKS], state.xaxis, state.xanchor
        geoms, gaps, ways, met = [], [], [], np.zeros(count, int)
        for n in range(count):
            state.qpos[:] = q[n]
            mujoco.mj_kinematics(model, state)
            mujoco.mj_collision(model, state)
            turns[n], origins[n], axes[n], anchors[n] = xmat, xpos, xaxis, xanchor
            met[n] = state.ncon
            if met[n]:
                contact = state.contact
                geoms.append(contact.geom.copy())
                gaps.append(contact.dist.copy())
                ways.append(contact.frame[:, :3].copy())
        columns = len(self.moving) * self.count + len(self.apart)
        gap, way = np.full(count * columns, FAR_M), np.zeros((count * columns, 3))
        if geoms:
            self._noted(np.repeat(np.arange(count), met), *map(np.concatenate, (geoms, gaps, ways)), gap, way)
        return self._shots(
            gap.reshape(count, columns), way.reshape(count, columns, 3),
            turns.reshape(count, LINKS, 3, 3), origins, axes * qd[:, :, None], anchors,
        )  # fmt: skip

    def _noted(self, shot, pair, gaps, ways, gap, way):
        """Of each pair's contacts the nearest, in its column."""
        column = self._column[pair[:, 0], pair[:, 1]]
        if (column < 0).any():
            raise ValueError("a pair that nobody asked for")
        order = np.argsort(-gaps, kind="stable")  # of equal places the last assignment stays
        turned = np.where(column & 1, -1.0, 1.0)[:, None] * ways
        at = shot * self._columns + column // 2
        gap[at[order]], way[at[order]] = gaps[order], turned[order]

    @property
    def _columns(self):
        return len(self.moving) * self.count + len(self.apart)

    def _shots(self, gap, way, turns, origins, turning, anchors):
        moving, own, count = len(self.moving), len(self.apart), len(gap)
        # By definition a clearance is never below minus both radii: no engine's depth counts.
        thing = gap[:, : moving * self.count].reshape(count, moving, self.count)
        thing = np.maximum(thing, -(self.radius[:moving, None] + self.core_radius))
        between = np.maximum(gap[:, moving * self.count :], -self.own_radius)
        places = self._places(turns, origins)
        outer, seen = places[:, moving : moving + own], way[:, moving * self.count :]
        outer, seen = self._from_inner(turns, origins, outer, seen)
        speed = self._speeds(places, turning, anchors)
        return Shots(
            thing, way[:, : moving * self.count].reshape(count, moving, self.count, 3),
            between, seen, places[:, :moving], outer, speed[:, : moving + own], speed[:, moving + own :],
        )  # fmt: skip

    def _places(self, turns, origins):
        """Both ends of all `axes`, (n, k, 3, 2)."""
        found = np.empty((len(turns), len(self.links), 3, 2))
        for link, (of, flat) in self._on.items():
            on = turns[:, link] @ flat + origins[:, link, :, None]
            found[:, of] = on.reshape(len(turns), 3, len(of), 2).swapaxes(1, 2)
        return found

    def _from_inner(self, turns, origins, ends, way):
        """Ends (n, s, 3, 2) and directions (n, s, 3) as the inner bodies' links see them."""
        both = np.concatenate([ends, way[..., None]], axis=3)
        for link, of in self._inside.items():
            if link:
                part = both[:, of]
                part[..., :2] -= origins[:, link, None, :, None]
                back = turns[:, link].swapaxes(1, 2)
                flat = part.swapaxes(1, 2).reshape(len(both), 3, -1)
                both[:, of] = (back @ flat).reshape(len(both), 3, len(of), 3).swapaxes(1, 2)
        return both[..., :2], both[..., 2]

    def _speeds(self, places, turning, anchors):
        """Surface speeds: the faster end, and the radius times the turning.

        Over the joints up to each link the sums of w and of w x o are taken: there v(p) = w x p - w x o.
        """
        count = len(turning)
        moments = np.stack(crossed(components(turning), components(anchors)), axis=2)
        sums = np.zeros((count, LINKS, 6))
        np.cumsum(np.concatenate([turning, moments], axis=2), axis=1, out=sums[:, 1:])
        sums = sums[:, self.links] - sums[:, self.past]
        spin, about = components(sums[..., :3]), components(sums[..., 3:])
        ends = []
        for end in (0, 1):
            velocity = crossed(spin, (places[:, :, 0, end], places[:, :, 1, end], places[:, :, 2, end]))
            ends.append(square(*(v - w for v, w in zip(velocity, about, strict=True))))
        return np.sqrt(np.maximum(*ends)) + self.radius * np.sqrt(square(*spin))


def components(a):
    """The three along the last axis."""
    return a[..., 0], a[..., 1], a[..., 2]


def square(x, y, z):
    """Squared length."""
    return x * x + y * y + z * z


def crossed(a, b):
    """The components of a vector product; numpy's own takes five times as long for so few."""
    (ax, ay, az), (bx, by, bz) = a, b
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


def grouped(links):
    """Each link with its places."""
    return [(link, np.flatnonzero(links == link)) for link in np.unique(links).tolist()]


@lru_cache(maxsize=STAGES)
def stage_of(tool, held, count):
    """The one stage for this tool (by name), part (by its shape) and so many things."""
    return Stage(tool_of(tool), held, count)
