"""The questions of the campaign: anything, what is seldom answered by a whole number, and what grazes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tests.pep.pit.campaign.dense import World
from tests.pep.pit.campaign.laws import ratio_law, thing_law
from tests.pep.pit.checker.test_checker import asked, random_question
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, aged, random_shape

from pep.pit import MoveJ, Person, Region, Scene, Sphere, Thing, Workspace, Zone

PATIENCE_S = 60.0
AGES_S = (0.02, 0.1, 0.3)
CANDIDATES, GRAZED = (8, 17), 6
LATE = 0.1
ROUGHLY, HALVINGS = 40, 20
WIDE_M, FARTHEST_M, WALLED = 2.0, 2.0, 0.5
WIDE = Workspace((-WIDE_M,) * 3, (WIDE_M,) * 3)
LEAST_RADIUS_M, MOST_RADIUS_M, BALL_UNCERTAINTY_M = 0.005, 0.2, 0.01


def drawn(seed, number):
    """The question of one trial."""
    rng = np.random.default_rng([seed, number])
    return patient(KINDS[number % len(KINDS)](rng))


def patient(question):
    """The same with time enough: a slow machine must not make faults of answers."""
    return question | {"cell": replace(question["cell"], time_limit_s=PATIENCE_S)}


def mild_question(rng):
    """A question whose answer is seldom the same whole number: little stands near, and the arm is not folded."""
    start = np.array(HOME) + rng.uniform(-0.4, 0.4, 6)
    target = start + rng.choice([0.05, 0.3, 1.0]) * rng.uniform(-1, 1, 6)
    move = MoveJ(
        tuple(start.tolist()), tuple(target.tolist()), float(rng.uniform(0.1, 2.0)), float(rng.uniform(0.5, 4.0))
    )
    things = tuple(
        Thing(f"thing{k}", str(rng.choice(["fragile", "rigid"])), random_shape(rng, near=0.4, far=0.9), 0.01)
        for k in range(int(rng.integers(1, 4)))
    )
    people = ()
    if rng.random() < 0.4:
        part = Region(str(rng.choice(list(Region))))
        people = (Person("someone", ((part, random_shape(rng, "cs", 0.9, 2.2)),)),)
    zones = (Zone("zone", random_shape(rng, near=0.4), int(rng.integers(1, 5))),) if rng.random() < 0.3 else ()
    scene = Scene(people=people, objects=things, zones=zones)
    age = float(rng.choice(AGES_S))
    return asked(aged(rng, scene) if rng.random() < LATE else scene, move, age=age)


def grazing_question(rng):
    """Long way past balls and walls, each so near that all are passed at about the same index.

    No interval may then be settled by less than its own worst instant, which may decide.
    """
    while True:
        move = long_move(rng)
        count = int(rng.integers(*CANDIDATES))
        centers = [random_shape(rng, "s", near=0.3, far=0.8).center_m for _ in range(count)]
        scene = replace(balls(centers, [LEAST_RADIUS_M] * count), workspace=WIDE)
        world = World(ROBOT, scene, move, CELL, 0.0, NOTHING)
        world.look(np.linspace(0, world.run.timing.duration_s, ROUGHLY), at_least_m=MOST_RADIUS_M + CELL.rigid_band_m)
        aim, moving, walls = (
            float(rng.uniform(1.2, 2.8)),
            len(world.stage.moving),
            world.around + len(world.stage.apart),
        )
        alone = world.index[:, world.around : walls].max()
        if not max(alone, *map(ratio_law, world.seen().ratios.values())) < aim:
            continue
        clear, speed = (
            world.clear[:, : world.around].reshape(ROUGHLY, moving, count),
            world.shots.speed[:, :moving, None],
        )
        grown = nearer_by(clear, speed, aim, world.things[0], world.stop)
        fit = np.flatnonzero((grown > 0) & (grown < MOST_RADIUS_M))[:GRAZED]
        if len(fit) > 1:
            scene = balls([centers[k] for k in fit], (LEAST_RADIUS_M + grown[fit]).tolist())
            if rng.random() < WALLED:
                clear = world.clear[:, walls:].reshape(ROUGHLY, 6, moving).swapaxes(1, 2)
                shut = nearer_by(clear, speed, aim, world.faces[0], world.stop)
                low, high = tuple((shut[3:] - WIDE_M).tolist()), tuple((WIDE_M - shut[:3]).tolist())
                scene = replace(scene, workspace=Workspace(low, high))
            return asked(scene, move, age=float(rng.choice(AGES_S)))


def nearer_by(clear, speed, aim, law, stop):
    """Distance (metre) by which each obstacle has to come nearer until its index is the aim.

    Args:
        clear: clearances (samples, bodies, obstacles).
        speed: speeds (samples, bodies, 1).
        aim: the index.
        law: that of all of them.
        stop: the stopping of the motion.
    """
    low, high = np.zeros(clear.shape[2]), np.full(clear.shape[2], FARTHEST_M)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        less = thing_law(clear - middle, speed, z=law.z, band=law.band, stop=stop).max(axis=(0, 1)) < aim
        low, high = np.where(less, middle, low), np.where(less, high, middle)
    return low


def long_move(rng):
    """A move with much way on all joints, that does not fold the arm."""
    start = np.array(HOME) + rng.uniform(-0.3, 0.3, 6)
    target = start + rng.uniform(-1, 1, 6) * (2.5, 0.8, 0.6, 1.5, 1.5, 2.5)
    return MoveJ(
        tuple(start.tolist()), tuple(target.tolist()), float(rng.uniform(0.3, 2.0)), float(rng.uniform(1.0, 8.0))
    )


def balls(centers, radii):
    """Rigid balls."""
    return Scene(
        objects=tuple(
            Thing(f"ball{k}", "rigid", Sphere(center, radius), BALL_UNCERTAINTY_M)
            for k, (center, radius) in enumerate(zip(centers, radii, strict=True))
        )
    )


KINDS = (random_question, mild_question) * 4 + (random_question, grazing_question)
