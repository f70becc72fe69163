"""P5, P7 to P9, P11, P12: the certified answer against dense sampling by pinocchio and coal.

Some changes may not lower it.
"""

from dataclasses import replace

import numpy as np
import pytest
from pep.pit.base.motion import profile_of
from pep.pit.path.straight_path import GRID
from pep.pit.robot.model import Model
from pep.pit.scene.pairs import pairs_of
from pep.pit.search.certify import RESOLUTION
from pep.pit.second.second_engine import SecondWorld
from tests.model.pit.demands import Demands
from tests.model.pit.path import NumpyPath
from tests.pep.pit import twin
from tests.pep.pit.scenes import (
    CELL,
    NOTHING,
    ROBOT,
    SEED,
    at_time,
    random_move,
    random_scene,
    sweep,
    with_glass,
    with_person,
)

from pep.pit import Box, Capsule, CellParameters, MoveJ, Person, Scene, Sphere, Workspace, assess

AGE = 0.1


def ask(scene, move, cell=CELL, robot=ROBOT, age=AGE):
    return assess(robot, scene, move, cell, perception_age_s=age, touch=NOTHING, seed=SEED)


def dense_index(scene, move, samples=500, since=0.0):
    """Highest index over times from path parameter `since` on, from the other engine and the slow twin; violations met."""
    path, profile = NumpyPath(ROBOT, move), profile_of(move)
    pairs = pairs_of(ROBOT, scene, CELL, grown_m=0.0)
    world = SecondWorld(ROBOT, scene, pairs)
    omega = profile.peak_rad_s
    mass = ROBOT.moving_mass_kg / 2 + ROBOT.tool.mass_kg
    worst, violated = 0.0, set()
    laws = []
    columns = [("person", str(r), 0.055, p) for p in scene.people for r, _ in p.regions]
    columns += [(o.kind, None, o.uncertainty_m + 0.005, None) for o in scene.objects]
    columns += [("tiered_zone", z.tier, 0.005, None) for z in scene.zones]
    for column in columns:
        laws += [column] * ROBOT.world_bodies
    laws += [("self", None, 0.0, None)] * len(ROBOT.self_pairs)
    for t in np.linspace(profile.time_of(since), profile.duration_s, samples):
        clearance, speed = world.ask(*at_time(path, profile, t))
        near = np.flatnonzero(clearance < 2.5)
        for row in near:
            kind, detail, z, who = laws[row]
            d, v = clearance[row], speed[row]
            match kind:
                case "person":
                    c = 0.10 if who.limbs_tracked else 0.85
                    index = twin.person(d - z, d, v, twin.harm_speed(detail, mass), age=AGE, omega=omega, c=c)
                    if d < -1e-3:
                        violated.add("person")
                case "fragile":
                    index = twin.thing(d - z, v, 0.25, omega=omega)
                case "tiered_zone":
                    index = twin.zone(d - z, v, detail, omega=omega)
                case _:
                    index = twin.thing(d - z, v, 0.02, omega=omega)
                    if kind == "self" and d < -0.051:
                        violated.add("self")
            worst = max(worst, index)
    demands = max(r.index for r in Demands(path, CELL).ratios(profile))
    return max(worst, 1.0), demands, violated


@pytest.mark.parametrize("seed", range(5))
def test_p9_certified_is_above_every_dense_sample_and_close(seed):
    rng = np.random.default_rng(100 + seed)
    scene = random_scene(rng, things=3, regions=2)
    move = random_move(rng, amplitude=rng.choice([0.3, 1.0, 2.0]))
    answer = ask(scene, move)
    geometric, demands, violated = dense_index(scene, move)
    assert answer.index >= geometric - 1e-9
    assert answer.index <= max(geometric, demands) + RESOLUTION + 0.02  # what 500 samples can miss
    assert set(answer.violations) >= violated


def test_p12_the_second_engine_agrees_on_many_random_scenes():
    """No false alarm: coal and pinocchio confirm every answer on scenes with touching and crossing bodies."""
    rng = np.random.default_rng(200)
    met = set()
    for _ in range(40):
        scene = random_scene(rng, things=5, regions=3)
        answer = ask(scene, random_move(rng))
        met.update(answer.violations)
        assert 1 <= answer.index <= 4
    assert met == {"person", "fragile", "rigid", "self"}


def test_leaves_of_every_pair_cover_the_path_and_hold():
    """The certificate: each pair's intervals tile [0, 1], and each row's index is recomputed to at most what is claimed."""
    scene, move = with_glass(), sweep(2.0, 3.0)
    answer = ask(scene, move)
    ends = {}
    for pair, low, high, index in answer.certificate.rows:
        assert low == ends.get(pair, 0)
        assert high > low
        assert index <= answer.index + 1e-12
        ends[pair] = high
    pairs = pairs_of(ROBOT, scene, CELL, grown_m=0.0)
    assert set(ends) == set(range(len(pairs)))
    assert set(ends.values()) == {GRID}


def test_p5_more_things_never_lower():
    rng = np.random.default_rng(300)
    for _ in range(6):
        scene, move = random_scene(rng, things=2, regions=1, zones=1), random_move(rng, 1.0)
        more = random_scene(rng, things=2, regions=2, zones=1)
        people = (*scene.people, *(replace(p, id="another") for p in more.people))
        objects = (*scene.objects, *(replace(o, id=f"more-{o.id}") for o in more.objects))
        zones = (*scene.zones, *(replace(z, id=f"more-{z.id}") for z in more.zones))
        few = ask(scene, move)
        many = ask(replace(scene, people=people, objects=objects, zones=zones), move)
        assert many.index >= few.index - RESOLUTION
        assert many.tier >= few.tier
        assert set(many.violations) >= set(few.violations)
        fenced = ask(replace(scene, workspace=Workspace((-0.3, -0.3, -0.1), (0.3, 0.3, 0.4))), move)
        assert fenced.index >= few.index - RESOLUTION


def test_p1_p7_growing_the_robot_or_a_body_never_lowers():
    rng = np.random.default_rng(400)
    capsules = tuple(replace(c, radius_m=c.radius_m + 0.01) for c in ROBOT.model.capsules)
    from pep.pit.robot.robot import _assemble

    model = ROBOT.model
    parts = {f: getattr(model, f) for f in Model.__dataclass_fields__ if f != "__pydantic_config__"}
    thick = _assemble(Model(**parts | {"capsules": capsules}), "robotiq_2f85")
    for _ in range(5):
        scene, move = random_scene(rng, things=3, regions=2), random_move(rng, 1.0)
        plain = ask(scene, move)
        assert ask(scene, move, robot=thick).index >= plain.index - RESOLUTION
        grown = tuple(
            replace(p, regions=tuple((r, replace(s, radius_m=s.radius_m + 0.02)) for r, s in p.regions))
            for p in scene.people
        )
        assert ask(replace(scene, people=grown), move).index >= plain.index - RESOLUTION


def test_p2_p3_p4_faster_older_heavier_never_lowers():
    rng = np.random.default_rng(500)
    for _ in range(4):
        scene, move = random_scene(rng, things=2, regions=2), random_move(rng, 1.0)
        plain = ask(scene, move)
        assert ask(scene, replace(move, speed_rad_s=move.speed_rad_s * 1.5)).index >= plain.index - RESOLUTION
        assert (
            ask(scene, replace(move, acceleration_rad_s2=move.acceleration_rad_s2 * 2)).index
            >= plain.index - RESOLUTION
        )
        assert ask(scene, move, cell=CellParameters(payload_kg=1.5)).index >= plain.index - RESOLUTION
        assert ask(scene, move, cell=CellParameters(stop_deceleration_rad_s2=4.0)).index >= plain.index - RESOLUTION
        ages = [ask(scene, move, age=age).index for age in (0.0, 0.1, 0.4, 0.5, 0.51, 0.8, 2.0)]
        assert all(a <= b + RESOLUTION for a, b in zip(ages, ages[1:], strict=False))


def test_p8_splitting_a_move_never_lowers_and_nothing_hides_in_slices():
    """Slices at the same speed reach the whole's index where geometry decides.

    The whole is at most the worst slice, plus its speed.
    """
    scene = with_person(0.9)
    whole = sweep(0.3, 40.0)
    parts = []
    for k in range(4):
        a, b = (-0.6 + 1.2 * j / 4 for j in (k, k + 1))
        parts.append(ask(scene, MoveJ((a, *whole.start[1:]), (b, *whole.start[1:]), 0.3, 40.0)).index)
    one = ask(scene, whole).index
    assert max(parts) == pytest.approx(one, abs=2 * RESOLUTION)


def turned(scene, angle):
    c, s = np.cos(angle), np.sin(angle)

    def point(p):
        return (c * p[0] - s * p[1], s * p[0] + c * p[1], p[2])

    def shape(x):
        match x:
            case Sphere(center, radius):
                return Sphere(point(center), radius)
            case Capsule(a, b, radius):
                return Capsule(point(a), point(b), radius)
            case Box(center, half, (w, i, j, k)):
                cw, cz = np.cos(angle / 2), np.sin(angle / 2)
                return Box(point(center), half, (cw * w - cz * k, cw * i - cz * j, cw * j + cz * i, cw * k + cz * w))

    return Scene(
        people=tuple(Person(p.id, tuple((r, shape(x)) for r, x in p.regions)) for p in scene.people),
        objects=tuple(replace(o, shape=shape(o.shape)) for o in scene.objects),
        zones=tuple(replace(z, shape=shape(z.shape)) for z in scene.zones),
    )


def test_p11_turning_the_world_with_the_base_joint_changes_nothing():
    rng = np.random.default_rng(600)
    for angle in (0.7, -2.0, 3.0):
        scene, move = random_scene(rng, things=3, regions=2), random_move(rng, 0.8)
        start, target = ((q[0] + angle, *q[1:]) for q in (move.start, move.target))
        here = ask(scene, move)
        there = ask(turned(scene, angle), replace(move, start=start, target=target))
        assert there.index == pytest.approx(here.index, abs=2 * RESOLUTION)
        assert there.violations == here.violations
        shuffled = replace(scene, objects=scene.objects[::-1], people=scene.people[::-1])
        assert ask(shuffled, move).index == pytest.approx(here.index, abs=2 * RESOLUTION)


def test_surface_speed_is_above_every_sample():
    rng = np.random.default_rng(700)
    for _ in range(5):
        move = random_move(rng)
        path, profile = NumpyPath(ROBOT, move), profile_of(move)
        bound = Demands(path, CELL).surface_speed_m_s(profile)[: ROBOT.world_bodies]
        scene = Scene(objects=with_glass().objects)
        world = SecondWorld(ROBOT, scene, pairs_of(ROBOT, scene, CELL, grown_m=0.0))
        seen = np.max(
            [
                world.ask(*at_time(path, profile, t))[1][: ROBOT.world_bodies]
                for t in np.linspace(0, profile.duration_s, 300)
            ],
            axis=0,
        )
        assert (bound >= seen - 1e-12).all()
        assert (bound <= seen * 1.05 + 0.05).all()


def test_torque_is_what_rigid_bodies_need():
    """At rest in the horizontal stretch the shoulder carries the arm's weight: sum of m g lever."""
    import pinocchio

    stretched = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    move = MoveJ(stretched, (1e-3, 0.0, 0.0, 0.0, 0.0, 0.0), 1e-3, 1e-3)
    path = NumpyPath(ROBOT, move)
    ratio = {r.name: r.ratio for r in Demands(path, CELL).ratios(profile_of(move))}["torque"]
    model, data = ROBOT.pinocchio, ROBOT.pinocchio.createData()
    pinocchio.centerOfMass(model, data, np.zeros(6))
    lever = sum(i.mass * (data.oMi[k] * i.lever)[0] for k, i in enumerate(model.inertias) if k >= 2)
    assert ratio == pytest.approx(abs(lever) * 9.81 / 54, rel=1e-5)
    heavy = {r.name: r.ratio for r in Demands(path, CellParameters(payload_kg=2.0)).ratios(profile_of(move))}
    assert heavy["torque"] > ratio
    assert heavy["payload"] == pytest.approx(1.0)
