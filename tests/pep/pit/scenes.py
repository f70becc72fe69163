"""The paper's three cells, and random scenes and moves, for the tests of the physics room."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from tests.model.pit.path import NumpyPath

from pep.pit import (
    Box,
    Capsule,
    CellParameters,
    Convex,
    MoveJ,
    Person,
    Region,
    Robot,
    Scene,
    Sphere,
    Thing,
    Workspace,
    Zone,
    adult_at_distance,
)

ROBOT = Robot.load("ur3e")
CELL = CellParameters()
NOTHING = frozenset()
SEED = b"a command's digest"
HOME = (0.0, -1.62, 1.25, -1.20, -1.57, 0.0)


def sweep(speed=1.05, acceleration=1.4, half=0.6):
    """The paper's arc from left to right, through the front."""
    return MoveJ((-half, *HOME[1:]), (half, *HOME[1:]), speed, acceleration)


def tcp(q=HOME):
    path = NumpyPath(ROBOT, MoveJ(q, q, 1.0, 1.0))
    _, poses = path.nodes(np.array([0]))
    return poses.ends[0, ROBOT.body_index("tcp"), 0]


FRONT = math.atan2(tcp()[1], tcp()[0])


def empty():
    return CELL.surveyed


def with_glass():
    x, y, _ = tcp()
    glass = Thing("glass", "fragile", Capsule((x, y, 0.03), (x, y, 0.10), 0.035), CELL.object_uncertainty_m)
    return replace(empty(), objects=(*empty().objects, glass))


def with_person(distance=0.5, bearing=FRONT):
    return replace(empty(), people=(adult_at_distance(distance, bearing_rad=bearing),))


def along(move, share):
    """Joint angles after that share of a straight move's way."""
    start, target = np.array(move.start), np.array(move.target)
    return tuple((start + share * (target - start)).tolist())


def at_time(path, profile, time_s):
    """Joint angles and joint speeds of a straight path at a time."""
    s, rate = profile.at(time_s)
    return path.q(s), path.delta * rate


def random_move(rng, amplitude=2.0):
    while True:
        start = np.array(
            [
                rng.uniform(-math.pi, math.pi),
                rng.uniform(-2.2, -0.9),
                rng.uniform(0.4, 2.0) * rng.choice([-1, 1]),
                rng.uniform(-2.5, 0),
                rng.uniform(-2, 2),
                rng.uniform(-math.pi, math.pi),
            ]
        )
        target = start + amplitude * rng.uniform(-1, 1, 6)
        if abs(target[2]) < 3.1 and -3.3 < target[1] < 0.2:
            return MoveJ(
                tuple(start.tolist()), tuple(target.tolist()), float(rng.uniform(0.1, 3)), float(rng.uniform(0.5, 5))
            )


def random_shape(rng, kinds="csb", near=0.25, far=0.9):
    while True:
        direction = rng.standard_normal(3)
        center = direction / np.linalg.norm(direction) * rng.uniform(near, far) + np.array([0, 0, 0.15])
        if math.hypot(center[0], center[1]) > 0.15:
            break
    center = center.tolist()
    match rng.choice(list(kinds)):
        case "s":
            return Sphere(tuple(center), float(rng.uniform(0.02, 0.06)))
        case "c":
            way = rng.standard_normal(3)
            way *= rng.uniform(0.03, 0.12) / np.linalg.norm(way)
            return Capsule(
                tuple((center - way).tolist()), tuple((center + way).tolist()), float(rng.uniform(0.015, 0.05))
            )
        case "v":
            return random_convex(rng, center)
        case _:
            turn = rng.standard_normal(4)
            turn /= np.linalg.norm(turn)
            return Box(tuple(center), tuple(rng.uniform(0.02, 0.07, 3).tolist()), tuple(turn.tolist()))


def random_bounds(rng, scene, share):
    """The scene with a workspace and a hard zone, each in this share of all cases."""
    if rng.random() < share:
        scene = replace(scene, workspace=Workspace((-0.8, -0.8, -0.3), (0.8, 0.8, 1.0)))
    if rng.random() < share:
        scene = replace(scene, zones=(*scene.zones, Zone("hard", random_shape(rng), None)))
    return scene


def random_convex(rng, center):
    """Scattered corners, a prism whose faces have many, or a wedge; every other one rounded."""
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    match rng.integers(3):
        case 0:
            corners = rng.uniform(-0.07, 0.07, (int(rng.integers(6, 25)), 3))
        case 1:
            around = np.linspace(0, 2 * math.pi, int(rng.integers(3, 12)), endpoint=False)
            ring = np.stack([np.cos(around), np.sin(around)], axis=1) * rng.uniform(0.02, 0.07)
            half = rng.uniform(0.02, 0.07)
            corners = np.array([(x, y, z) for x, y in ring for z in (-half, half)])
        case _:
            a, b, c = rng.uniform(0.02, 0.1, 3)
            corners = np.array([(0, 0, 0), (a, 0, 0), (0, b, 0), (0, 0, c), (a, 0, c)])
    placed = corners @ turn.T + center
    return Convex(tuple(map(tuple, placed.tolist())), float(rng.choice([0.0, 0.01, 0.03])))


def aged(rng, scene):
    """The same scene with some of what sensors show not seen for a while."""
    ages = (0.0, 0.03, 0.2, 0.6, 3.0)

    def late(each):
        return replace(each, source="camera", age_s=float(rng.choice(ages)))

    return replace(scene, people=tuple(map(late, scene.people)), objects=tuple(map(late, scene.objects)))


def with_convex(rng, scene):
    """The same scene with some polytopes more: things, and perhaps a zone."""
    things = tuple(
        Thing(f"hull{k}", str(rng.choice(["fragile", "rigid"])), random_shape(rng, "v"), float(rng.uniform(0, 0.02)))
        for k in range(int(rng.integers(1, 4)))
    )
    zones = (Zone("hull zone", random_shape(rng, "v"), [None, 2, 4][int(rng.integers(3))]),) * int(rng.integers(2))
    return replace(scene, objects=(*scene.objects, *things), zones=(*scene.zones, *zones))


def random_scene(rng, things=4, regions=3, zones=1):
    people = ()
    if regions:
        parts = tuple((Region(rng.choice(list(Region))), random_shape(rng, "cs", 0.4, 1.5)) for _ in range(regions))
        people = (Person("someone", parts),)
    return Scene(
        people=people,
        objects=tuple(
            Thing(f"thing{k}", str(rng.choice(["fragile", "rigid"])), random_shape(rng), float(rng.uniform(0, 0.02)))
            for k in range(things)
        ),
        zones=tuple(Zone(f"zone{k}", random_shape(rng), int(rng.integers(1, 5))) for k in range(zones)),
    )
