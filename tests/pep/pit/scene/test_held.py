"""Held object as a part of the robot: body, mass, place in the view, and a frame's guess."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pep.pit.base.motion import profile_of
from pep.pit.geometry.solids import rotation_of
from pep.pit.path.straight_path import GRID
from pep.pit.robot.kinematics import link_frames
from pep.pit.scene.contact_limits import effective_mass_kg, harm_speed_m_s
from pep.pit.scene.grip_sightings import _capsule_around, without_held
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.scene import Region
from pep.pit.search.certify import RESOLUTION
from pep.pit.second.second_engine import SecondWorld
from policies.evidence.evidence import ImpactFault
from tests.model.pit.demands import Demands
from tests.model.pit.path import NumpyPath
from tests.pep.pit.scenes import (
    CELL,
    HOME,
    NOTHING,
    ROBOT,
    SEED,
    at_time,
    empty,
    random_move,
    random_scene,
    random_shape,
    sweep,
    tcp,
    with_glass,
    with_person,
)

from pep.pit import (
    Assessment,
    Box,
    Capsule,
    GrippedObject,
    GripperMove,
    ModelError,
    MoveJ,
    Part,
    Robot,
    Sphere,
    Thing,
    assess,
    gripped,
    remaining,
    unknown_part,
)

STICK = GrippedObject("stick", Capsule((0.0, 0.0, 0.16), (0.0, 0.0, 0.24), 0.015), 0.3, blunt=True)
WITH_STICK = ROBOT.holding(STICK)
FRESH = 0.1


def ask(robot, scene, motion, cell=CELL, age=FRESH):
    return assess(robot, scene, motion, cell, perception_age_s=age, touch=NOTHING, seed=SEED)


def in_world(shape, q, offset=(0.0, 0.0, 0.0)):
    rotation, origin = link_frames(ROBOT, np.array([q]))
    rotation, origin = rotation[0, -1], origin[0, -1] + np.array(offset)

    def point(p):
        return tuple((rotation @ np.array(p) + origin).tolist())

    match shape:
        case Capsule(a, b, r):
            return Capsule(point(a), point(b), r)
        case Sphere(c, r):
            return Sphere(point(c), r)


def seen(shape, name="stick", kind="fragile"):
    return replace(empty(), objects=(*empty().objects, Thing(name, kind, shape, 0.01)))


# ---- the body


def test_what_is_held_comes_nearer_than_the_gripper():
    alone, carrying = (ask(robot, with_glass(), sweep(0.3, 1.0)) for robot in (ROBOT, WITH_STICK))
    assert alone.tier == 2
    assert carrying.tier == 3
    assert carrying.contributions[0].link == "payload"
    assert carrying.clearance_m < alone.clearance_m - 0.04


def test_the_digest_names_what_is_held():
    others = [
        ROBOT,
        WITH_STICK,
        ROBOT.holding(replace(STICK, object="pen")),
        ROBOT.holding(replace(STICK, mass_kg=0.31)),
        ROBOT.holding(replace(STICK, mass_kg=None)),
        ROBOT.holding(replace(STICK, blunt=False)),
        ROBOT.holding(replace(STICK, shape=Sphere((0.0, 0.0, 0.2), 0.05))),
    ]
    assert len({robot.model_digest for robot in others}) == len(others)
    assert ROBOT.holding(STICK) is WITH_STICK
    assert WITH_STICK.holding(None).model_digest == ROBOT.model_digest == Robot.load("ur3e").model_digest
    assert WITH_STICK.holding(others[2].held).model_digest == others[2].model_digest


def test_p12_the_engines_agree_on_a_carrying_robot():
    rng = np.random.default_rng(950)
    for _ in range(25):
        start = np.array([0.0, 0.0, 0.17])
        way = rng.standard_normal(3) * 0.06
        shape = Capsule(tuple((start - way).tolist()), tuple((start + way).tolist()), float(rng.uniform(0.01, 0.06)))
        robot = ROBOT.holding(GrippedObject("part", shape, float(rng.uniform(0.05, 1.5))))
        answer = ask(robot, random_scene(rng, things=3, regions=2), random_move(rng))
        assert isinstance(answer, Assessment)


def test_a_payload_that_the_kernel_has_elsewhere_is_found_out():
    bodies = tuple(
        replace(b, a_m=(*b.a_m[:2], b.a_m[2] - 0.003)) if b.name == "payload" else b for b in WITH_STICK.bodies
    )
    wrong = replace(WITH_STICK, bodies=bodies)
    answers = [
        assess(wrong, empty(), sweep(), CELL, perception_age_s=FRESH, touch=NOTHING, seed=bytes([k])) for k in range(4)
    ]
    assert any(isinstance(a, ImpactFault) and a.reason == "ENGINES_DISAGREE" for a in answers)


def test_bounds_hold_for_the_payload_in_every_sample():
    rng = np.random.default_rng(951)
    scene = with_person(0.6)
    for _ in range(4):
        move = random_move(rng, 1.0)
        path, profile = NumpyPath(WITH_STICK, move), profile_of(move)
        pairs = pairs_of(WITH_STICK, scene, CELL, grown_m=0.0)
        rows = np.flatnonzero([WITH_STICK.bodies[b].name == "payload" for b in pairs.body])
        assert {pairs.kind_of(int(row)).value for row in rows} == {"person", "rigid", "self"}
        low = np.arange(8, dtype=np.int64) * (GRID // 8)
        world = SecondWorld(WITH_STICK, scene, pairs)
        times = np.linspace(0, profile.duration_s, 200)
        keys = np.array([profile.at(t)[0] for t in times])
        found = [world.ask(*at_time(path, profile, t)) for t in times]
        for k in range(8):
            leaves = path.examine(pairs, np.full(len(rows), low[k]), np.full(len(rows), low[k] + GRID // 8), rows)
            bound = leaves.rush * profile.highest_rate(leaves.low / GRID, leaves.high / GRID)
            for s, (clearance, speed) in zip(keys, found, strict=True):
                if low[k] / GRID <= s <= (low[k] + GRID // 8) / GRID:
                    assert (clearance[rows] >= leaves.clear_m - 5e-6).all()
                    assert (speed[rows] <= bound + 1e-6).all()


def test_the_payload_may_meet_the_arm_itself():
    long = ROBOT.holding(GrippedObject("bar", Capsule((0.0, -0.3, 0.17), (0.0, 0.3, 0.17), 0.02), 0.3, blunt=True))
    fold = MoveJ(HOME, (0.0, -1.62, 2.3, -1.2, -1.57, 0.0), 0.3, 1.0)
    assert "payload" in {c.link for c in ask(long, empty(), fold).contributions if c.kind == "self"}


# ---- the mass


def test_mass_enters_dynamics_momentum_contact_and_payload():
    move = sweep()
    heavy = ROBOT.holding(replace(STICK, mass_kg=1.2))
    light, more = (
        {r.name: r.ratio for r in Demands(NumpyPath(robot, move), CELL).ratios(profile_of(move))}
        for robot in (WITH_STICK, heavy)
    )
    for name in ("torque", "momentum", "payload"):
        assert more[name] > light[name]
    assert more["payload"] == pytest.approx((1.0 + 1.2) / 3.0)
    assert more["momentum"] - light["momentum"] == pytest.approx(
        0.9
        * float(
            Demands(NumpyPath(heavy, move), CELL).surface_speed_m_s(profile_of(move))[heavy.body_index("com_payload")]
        )
        / 25
    )
    total = sum(i.mass for i in heavy.pinocchio.inertias)
    assert total == pytest.approx(sum(i.mass for i in ROBOT.pinocchio.inertias) + 1.2)
    assert effective_mass_kg(heavy, CELL) == pytest.approx(effective_mass_kg(ROBOT, CELL) + 1.2)


def test_an_unknown_mass_is_the_whole_payload_and_an_unknown_shape_has_edges():
    unknown = ROBOT.holding(replace(STICK, mass_kg=None))
    assert effective_mass_kg(unknown, CELL) == pytest.approx(effective_mass_kg(ROBOT, CELL) + 3.0)
    assert ask(unknown, empty(), sweep(0.25, 0.8)).tier == 4
    edged = ROBOT.holding(replace(STICK, blunt=False))
    for region in Region:
        assert harm_speed_m_s(region, edged, CELL) <= harm_speed_m_s(region, WITH_STICK, CELL)
    assert harm_speed_m_s(Region.TORSO, edged, CELL) < harm_speed_m_s(Region.TORSO, WITH_STICK, CELL)


def test_p4_p7_heavier_or_larger_never_lowers():
    rng = np.random.default_rng(952)
    for _ in range(5):
        scene, move = random_scene(rng, things=2, regions=2), random_move(rng, 1.0)
        plain = ask(ROBOT, scene, move).index
        held = ask(WITH_STICK, scene, move).index
        assert held >= plain - RESOLUTION
        for more in (
            replace(STICK, mass_kg=1.0),
            replace(STICK, blunt=False),
            replace(STICK, shape=replace(STICK.shape, radius_m=0.04)),
        ):
            assert ask(ROBOT.holding(more), scene, move).index >= held - RESOLUTION


@pytest.mark.parametrize(
    "bad",
    [
        replace(STICK, mass_kg=0.0),
        replace(STICK, mass_kg=-1.0),
        replace(STICK, mass_kg=math.nan),
        replace(STICK, mass_kg=math.inf),
        replace(STICK, shape=Sphere((math.nan, 0, 0), 0.1)),
        replace(STICK, shape=Sphere((0, 0, 0), math.nan)),
        replace(STICK, shape=Sphere((0, 0, 0), 0.0)),
        replace(STICK, shape=Capsule((0, 0, 0), (0, 0, 99.0), 0.1)),
    ],
)
def test_a_held_object_that_cannot_be_is_refused(bad):
    with pytest.raises(ModelError):
        ROBOT.holding(bad)


# ---- the view


def test_seen_where_it_is_held_it_is_no_obstacle():
    here = seen(in_world(STICK.shape, HOME))
    move = MoveJ(HOME, (0.3, *HOME[1:]), 0.3, 1.0)
    assert ask(ROBOT, here, move).tier == 3
    assert ask(WITH_STICK, here, move).tier == 1
    assert without_held(here, ROBOT, HOME, tolerance_m=0.03) is here
    # Another object in the same place is one.
    assert ask(WITH_STICK, seen(in_world(STICK.shape, HOME), name="pen"), move).tier == 3
    pen = Thing("pen", "fragile", in_world(STICK.shape, HOME), 0.01)
    assert ask(WITH_STICK, replace(here, objects=(*here.objects, pen)), move).tier == 3


def test_seen_elsewhere_both_count():
    move = MoveJ(HOME, (0.3, *HOME[1:]), 0.3, 1.0)
    ahead = seen(in_world(STICK.shape, (0.2, *HOME[1:])))
    answer = ask(WITH_STICK, ahead, move)
    assert answer.tier == 3
    assert answer.contributions[0].object == "stick"
    near_glass = ask(WITH_STICK, replace(ahead, objects=(*ahead.objects, with_glass().objects[-1])), move)
    assert {c.object for c in near_glass.contributions} == {"stick", "glass"}


def test_how_near_counts_as_held():
    for off, kept in ((0.0, False), (0.029, False), (0.031, True)):
        scene = seen(in_world(Sphere((0.0, 0.0, 0.2), 0.015), HOME, (off, 0.0, 0.0)))
        left = without_held(scene, WITH_STICK, HOME, tolerance_m=0.03)
        assert ("stick" in {o.id for o in left.objects}) is kept
    # One that sticks out farther than the tolerance is not wholly where it is held.
    for shape in (
        Capsule((0.0, 0.0, 0.2), (0.0, 0.0, 0.29), 0.015),
        Sphere((0.0, 0.0, 0.2), 0.05),
    ):
        left = without_held(seen(in_world(shape, HOME)), WITH_STICK, HOME, tolerance_m=0.03)
        assert "stick" in {o.id for o in left.objects}
    x, y, z = in_world(Sphere((0.0, 0.0, 0.2), 0.01), HOME).center_m
    for half, kept in ((0.02, False), (0.06, True)):
        left = without_held(seen(Box((x, y, z), (half,) * 3)), WITH_STICK, HOME, tolerance_m=0.03)
        assert ("stick" in {o.id for o in left.objects}) is kept


def test_under_way_the_camera_may_lag_behind_the_hand():
    move = MoveJ(HOME, (0.8, *HOME[1:]), 0.5, 1.0)
    cell = replace(CELL, watch_time_limit_s=30.0)

    def left(seen_at, age):
        return remaining(
            WITH_STICK,
            seen(in_world(STICK.shape, (seen_at, *HOME[1:]))),
            move,
            cell,
            at_rad=(0.4, *HOME[1:]),
            authorised_milli=2000,
            perception_age_s=age,
            touch=NOTHING,
        )

    assert left(0.4, 0.1).holds
    assert left(0.36, 0.1).holds
    assert left(0.2, 0.3).holds
    ahead = left(0.6, 0.1)
    assert (ahead.holds, ahead.cause) == (False, "fragile")


# ---- what was gripped


def test_the_one_object_between_the_fingers():
    cell = replace(CELL, parts=(Part("cube", 0.25, True), Part("cup", 0.1)))
    x, y, z = tcp()
    cube = Thing("cube", "rigid", Box((x, y, z), (0.02, 0.02, 0.02)), 0.01)
    cup = Thing("cup", "fragile", Sphere((x, y, z - 0.01), 0.02), 0.01)
    far = Thing("glass", "fragile", Sphere((x + 0.2, y, z), 0.03), 0.01)
    held = gripped(ROBOT, HOME, (*empty().objects, far, cube), cell)
    assert (held.object, held.mass_kg, held.blunt) == ("cube", 0.25, True)
    assert gripped(ROBOT, HOME, (cup,), CELL).mass_kg is None
    assert not gripped(ROBOT, HOME, (cup,), cell).blunt
    assert gripped(ROBOT, HOME, (far,), cell) is None
    assert gripped(ROBOT, HOME, (), cell) is None
    assert gripped(ROBOT, HOME, (cube, cup), cell) is None
    # What was gripped moves with the arm, and is then seen where it is held.
    robot = ROBOT.holding(held)
    assert not without_held(replace(empty(), objects=(cube,)), robot, HOME, tolerance_m=0.0).objects
    assert unknown_part(ROBOT, cell).mass_kg is None
    assert ask(ROBOT.holding(unknown_part(ROBOT, cell)), empty(), sweep(0.25, 0.8)).tier == 4


def test_one_object_that_two_sensors_see_is_held_with_every_sight_of_it():
    x, y, z = tcp()
    first = Thing("cup", "fragile", Sphere((x, y, z - 0.01), 0.02), 0.01, "camera-1")
    second = replace(first, shape=Sphere((x + 0.01, y, z - 0.01), 0.03), source="camera-2")
    held = gripped(ROBOT, HOME, (first, second), CELL)
    assert held.object == "cup"
    assert held.shape.radius_m == pytest.approx(0.01 + 0.03 + 0.01, abs=1e-6)
    both = replace(empty(), objects=(first, second))
    assert not without_held(both, ROBOT.holding(held), HOME, tolerance_m=0.0).objects
    assert gripped(ROBOT, HOME, (first, first), CELL) == gripped(ROBOT, HOME, (first,), CELL)
    assert gripped(ROBOT, HOME, (first, replace(second, id="can")), CELL) is None
    assert gripped(ROBOT, HOME, (first, replace(second, age_s=CELL.perception_age_limit_s + 0.01)), CELL) is None


def test_how_near_to_the_pads_counts_as_gripped():
    x, y, z = tcp()
    for gap, caught in ((0.005, True), (0.019, True), (0.021, False)):
        ball = Thing("ball", "rigid", Sphere((x + 0.03 + gap, y, z + 0.01), 0.03), 0.01)
        assert (gripped(ROBOT, HOME, (ball,), CELL) is not None) is caught


def test_the_capsule_around_a_shape_contains_it():
    rng = np.random.default_rng(953)
    for _ in range(200):
        shape = random_shape(rng, "bcs")
        a, b, radius = _capsule_around(shape)
        match shape:
            case Box(center, half, quaternion):
                inside = rng.uniform(-1, 1, (100, 3)).round() * np.array(half) @ rotation_of(quaternion).T + center
                slack = 0.0
            case Capsule(start, end, slack):
                inside = np.array([start, end])
            case Sphere(center, slack):
                inside = np.array([center])
        way = b - a
        share = np.clip(((inside - a) @ way) / max(float(way @ way), 1e-30), 0, 1)
        distance = np.linalg.norm(inside - a - share[:, None] * way, axis=1)
        assert (distance + slack <= radius + 1e-12).all()


def test_opening_the_gripper_on_a_held_part():
    grip = GripperMove(HOME, 0.05, 0.05, 40.0)
    assert ask(ROBOT, empty(), grip).tier == 1
    let_go = ask(WITH_STICK, empty(), grip)
    assert (let_go.tier, let_go.index, let_go.contributions[0].kind) == (2, 2.0, "held_part")
    # What the fingers hold is fragile: force on it counts, though it is where it is held.
    assert ask(WITH_STICK, seen(in_world(STICK.shape, HOME)), grip).tier == 3
