"""Random lines, held tool speeds and servo targets, and what an independent engine makes of them by dense sampling."""

from __future__ import annotations

import numpy as np
import pinocchio
from pep.pit.scene.contact_limits import payload_kg
from pep.pit.scene.pairs import pairs_of
from pep.pit.second.second_engine import SecondWorld
from tests.pep.pit import twin
from tests.pep.pit.scenes import CELL, HOME, ROBOT

from pep.pit import MoveL, ServoJ, SpeedL

AGE = 0.1
MODEL, TCP = ROBOT.pinocchio, np.array(ROBOT.tool.tcp_m)


def placed(q, scratch=None):
    """Position and rotation of the tool by pinocchio."""
    scratch = MODEL.createData() if scratch is None else scratch
    pinocchio.forwardKinematics(MODEL, scratch, np.array(q))
    return scratch.oMi[6].act(TCP), scratch.oMi[6].rotation.copy()


def pose_of(q):
    position, rotation = placed(q)
    return (*position.tolist(), *pinocchio.log3(rotation).tolist())


def tool_jacobian(q, scratch):
    """Linear and angular velocity of the tool in the base frame by joint speeds."""
    local = pinocchio.computeJointJacobian(MODEL, scratch, q, 6)
    rotation = scratch.oMi[6].rotation
    linear, angular = rotation @ local[:3], rotation @ local[3:]
    return np.concatenate([linear - pinocchio.skew(rotation @ TCP) @ angular, angular])


def followed(q, position, rotation, scratch):
    """Newton with pinocchio's own kinematics, from the sample before; None when it does not arrive."""
    for _ in range(30):
        here, turned = placed(q, scratch)
        error = np.concatenate([position - here, pinocchio.log3(rotation @ turned.T)])
        if np.abs(error).max() < 1e-12:
            return q
        q = q + np.linalg.solve(tool_jacobian(q, scratch), error)
        if not np.abs(q).max() < 20:
            return None
    return q if np.abs(error).max() < 1e-9 else None


def marched(start, line, turn, shares):
    """Joint angles and their derivative by s at rising `shares` of a constant twist; None where it is lost."""
    scratch = MODEL.createData()
    position, rotation = placed(start)
    q, dq, before, found = np.array(start), np.zeros(6), 0.0, []
    for s in shares:
        near = q + (s - before) * dq
        q, before = followed(near, position + s * line, pinocchio.exp3(s * turn) @ rotation, scratch), s
        if q is None:
            return None
        dq = np.linalg.solve(tool_jacobian(q, scratch), np.concatenate([line, turn]))
        found.append((q, dq))
    return found


def random_start(rng, spread=0.6):
    return tuple((np.array(HOME) + rng.uniform(-spread, spread, 6)).tolist())


def random_way(rng, longest=0.3, turn=0.8):
    line, axis = rng.standard_normal(3), rng.standard_normal(3)
    return (
        line / np.linalg.norm(line) * rng.uniform(0.01, longest),
        axis / np.linalg.norm(axis) * rng.uniform(0, turn) * rng.integers(0, 2),
    )


def random_line(rng):
    """A line that stays well inside the arm's reach, found by marching along it."""
    while True:
        start, (line, turn) = random_start(rng), random_way(rng)
        track = marched(start, line, turn, np.linspace(0, 1, 41))
        if track is None or not all(np.abs(dq).max() < 12 and np.abs(q[2]) < 3.1 for q, dq in track):
            continue
        position, rotation = placed(start)
        target = (*(position + line).tolist(), *pinocchio.log3(pinocchio.exp3(turn) @ rotation).tolist())
        return MoveL(start, target, float(rng.uniform(0.02, 0.5)), float(rng.uniform(0.2, 3)))


def random_hold(rng):
    while True:
        start, (line, turn) = random_start(rng), random_way(rng)
        duration = float(rng.uniform(0.05, 0.5))
        speed = float(rng.uniform(0.02, 0.3))
        direction = line / np.linalg.norm(line) * speed if rng.integers(0, 3) else turn
        twist = (*direction, 0.0, 0.0, 0.0) if rng.integers(0, 3) else (0.0, 0.0, 0.0, *turn)
        v = np.array(twist) * (duration + 0.1)
        track = marched(start, v[:3], v[3:], np.linspace(0, 1, 41))
        if track is not None and all(np.abs(dq).max() < 8 for _, dq in track) and any(twist):
            return SpeedL(start, tuple(float(x) for x in twist), float(rng.uniform(0.2, 5)), duration)


def random_servo(rng):
    start, qd = np.array(random_start(rng)), rng.uniform(-0.6, 0.6, 6)
    target = start + 0.1 * (qd + rng.uniform(-0.1, 0.1, 6))
    return ServoJ(tuple(start.tolist()), tuple(qd.tolist()), tuple(target.tolist()), 0.002, 0.1)


class Sampled:
    """Samples of pinocchio, coal and the slow twin at single instants of a motion, in one scene."""

    def __init__(self, scene):
        self.pairs = pairs_of(ROBOT, scene, CELL, grown_m=0.0)
        self.world = SecondWorld(ROBOT, scene, self.pairs)
        self.mass = ROBOT.moving_mass_kg / 2 + ROBOT.tool.mass_kg + payload_kg(ROBOT, CELL)
        columns = [("person", str(r), 0.055, p) for p in scene.people for r, _ in p.regions]
        columns += [(o.kind, None, o.uncertainty_m + 0.005, None) for o in scene.objects]
        columns += [("tiered_zone", z.tier, 0.005, None) for z in scene.zones]
        self.laws = [column for column in columns for _ in range(ROBOT.world_bodies)]
        self.laws += [("self", None, 0.0, None)] * len(ROBOT.self_pairs)
        self.worst, self.violated, self.fastest = 0.0, set(), 0.0

    def look(self, q, qd, *, omega):
        """One instant: joint angles, joint speeds, and the leading joint speed of the whole motion."""
        clearance, speed = self.world.ask(np.array(q), np.array(qd))
        self.fastest = max(self.fastest, float(speed[self.pairs.body < ROBOT.world_bodies].max()))
        for row in np.flatnonzero(clearance < 2.5):
            kind, detail, z, who = self.laws[row]
            d, v = clearance[row], speed[row]
            match kind:
                case "person":
                    c = 0.10 if who.limbs_tracked else 0.85
                    index = twin.person(d - z, d, v, twin.harm_speed(detail, self.mass), age=AGE, omega=omega, c=c)
                    if d < -1e-3:
                        self.violated.add("person")
                case "fragile":
                    index = twin.thing(d - z, v, 0.25, omega=omega)
                case "tiered_zone":
                    index = twin.zone(d - z, v, detail, omega=omega)
                case _:
                    index = twin.thing(d - z, v, 0.02, omega=omega)
                    if kind == "self" and d < -0.051:
                        self.violated.add("self")
            self.worst = max(self.worst, index)
