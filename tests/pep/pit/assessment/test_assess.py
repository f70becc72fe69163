"""The walls of `assess`: bad input, missing or old views, violations, retreat, time, and engines that disagree."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from pep.pit.assessment.assessment import Assessment
from pep.pit.assessment.stream import Bounded, Stream
from pep.pit.path.straight_path import GRID
from pep.pit.scene.obstacles import AXIS_MET_M, PairKind
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.view import view_of
from pep.pit.search.certify import VIOLATION_RESOLUTION_M
from policies.evidence.evidence import ImpactFault
from policies.words.reason_table import Reason
from tests.model.pit.path import NumpyPath
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, SEED, empty, sweep, tcp, with_glass, with_person

from pep.pit import (
    Box,
    Capsule,
    CellParameters,
    Contact,
    Convex,
    GrippedObject,
    GripperMove,
    MoveJ,
    Person,
    Region,
    Robot,
    Scene,
    SpeedJ,
    Sphere,
    StaticObject,
    StaticZone,
    Thing,
    Workspace,
    Zone,
    assess,
    remaining,
    standing_adult,
)

NAN, INF = math.nan, math.inf


def ask(scene=None, motion=None, cell=CELL, age=0.1, robot=ROBOT, **more):
    return assess(
        robot,
        empty() if scene is None else scene,
        motion or sweep(),
        cell,
        perception_age_s=age,
        touch=NOTHING,
        seed=SEED,
        **more,
    )


def spoiled(joint, value, field="target"):
    move = sweep()
    angles = list(getattr(move, field))
    angles[joint] = value
    return replace(move, **{field: tuple(angles)})


BAD_MOTIONS = [
    *((spoiled(j, bad, f), "NOT_FINITE") for j in (0, 5) for bad in (NAN, INF, -INF) for f in ("start", "target")),
    *(
        (replace(sweep(), **{f: bad}), "NOT_FINITE")
        for f in ("speed_rad_s", "acceleration_rad_s2")
        for bad in (NAN, INF, -INF)
    ),
    *(
        (replace(sweep(), **{f: bad}), "OUT_OF_RANGE")
        for f in ("speed_rad_s", "acceleration_rad_s2")
        for bad in (0.0, -1.0, 1e-9, 5e-324)
    ),
    (MoveJ(HOME[:5], HOME, 1.0, 1.0), "PARAMETERS_WRONG"),
    (MoveJ(HOME, (*HOME, 0.0), 1.0, 1.0), "PARAMETERS_WRONG"),
    (MoveJ((), (), 1.0, 1.0), "PARAMETERS_WRONG"),
    (MoveJ(None, HOME, 1.0, 1.0), "PHYSICS_FAULT"),
    (MoveJ(("0",) * 6, HOME, 1.0, 1.0), "PHYSICS_FAULT"),
    (MoveJ(HOME, HOME, None, 1.0), "PHYSICS_FAULT"),
    (None, "PHYSICS_FAULT"),
    ("moveJ", "PHYSICS_FAULT"),
    (GripperMove(HOME, NAN, 0.05, 40.0), "NOT_FINITE"),
    (GripperMove(HOME, -0.01, 0.05, 40.0), "OUT_OF_RANGE"),
    (GripperMove(HOME, 0.05, NAN, 40.0), "NOT_FINITE"),
    (GripperMove(HOME, 0.05, 0.05, INF), "NOT_FINITE"),
    (GripperMove(HOME, 0.05, 0.0, 40.0), "OUT_OF_RANGE"),
    (GripperMove((NAN,) * 6, 0.05, 0.05, 40.0), "NOT_FINITE"),
]


@pytest.mark.parametrize(("motion", "reason"), BAD_MOTIONS)
def test_p13_a_motion_that_is_none_is_a_fault(motion, reason):
    answer = assess(ROBOT, empty(), motion, CELL, perception_age_s=0.1, touch=NOTHING, seed=SEED)
    assert isinstance(answer, ImpactFault)
    assert answer.reason == reason
    assert answer.reason in Reason.__members__


def person_with(*regions):
    return replace(empty(), people=(Person("p", tuple(regions)),))


def thing_with(shape, **more):
    return replace(empty(), objects=(Thing("t", "rigid", shape, 0.0),), **more)


BAD_SCENES = [
    person_with((Region.HEAD, Sphere((NAN, 0, 0), 0.1))),
    person_with((Region.HEAD, Sphere((1, 0, 0), NAN))),
    person_with((Region.HEAD, Sphere((1, 0, 0), 0.0))),
    person_with((Region.HEAD, Sphere((1, 0, 0), -0.1))),
    person_with((Region.HEAD, Sphere((1e9, 0, 0), 0.1))),
    person_with((Region.HEAD, Capsule((1, 0, 0), (1, 0, INF), 0.1))),
    person_with((Region.HEAD, Box((1, 0, 0), (1, 1, 1)))),
    person_with(),  # a person without a body would be "clear" everywhere
    person_with(*((Region.HAND, Sphere((1, 0, 0), 0.1)) for _ in range(1000))),
    thing_with(Box((1, 0, 0), (0.1, 0.1, 0.0))),
    thing_with(Box((1, 0, 0), (0.1, 0.1, NAN))),
    thing_with(Box((1, 0, 0), (0.1, 0.1, 0.1), (0.0, 0.0, 0.0, 0.0))),
    thing_with(Box((1, 0, 0), (0.1, 0.1, 0.1), (2.0, 0.0, 0.0, 0.0))),
    thing_with(Box((1, 0, 0), (0.1, 0.1, 0.1), (NAN, 0.0, 0.0, 1.0))),
    replace(empty(), objects=(Thing("t", "soft", Sphere((1, 0, 0), 0.1), 0.0),)),
    replace(empty(), objects=(Thing("t", "rigid", Sphere((1, 0, 0), 0.1), NAN),)),
    replace(empty(), objects=(Thing("t", "rigid", Sphere((1, 0, 0), 0.1), -0.5),)),
    replace(empty(), objects=tuple(Thing(f"t{k}", "rigid", Sphere((1, 0, 0), 0.1), 0.0) for k in range(1000))),
    replace(empty(), people=with_person().people * 100),
    replace(empty(), zones=(Zone("z", Sphere((1, 0, 0), 0.1), 9),)),
    replace(empty(), workspace=Workspace((0, 0, 0), (0, 1, 1))),
    replace(empty(), workspace=Workspace((NAN, 0, 0), (1, 1, 1))),
]


@pytest.mark.parametrize("scene", BAD_SCENES)
@pytest.mark.parametrize("motion", [sweep(), GripperMove(HOME, 0.05, 0.05, 40.0)])
def test_p13_a_scene_that_must_not_be_believed_is_a_fault(scene, motion):
    answer = ask(scene, motion)
    assert isinstance(answer, ImpactFault)
    assert answer.reason == "PERCEPTION_INVALID"


@pytest.mark.parametrize("age", [NAN, INF, -INF, -0.001])
def test_p13_an_age_that_is_none_is_a_fault(age):
    assert ask(age=age).reason == "PERCEPTION_INVALID"


@pytest.mark.parametrize(
    "bad", [{"stop_deceleration_rad_s2": 0.0}, {"warn_band_m": NAN}, {"person_speed_m_s": -1.0}, {"tool": "claw"}]
)
def test_a_cell_that_cannot_be_is_a_fault(bad):
    assert ask(cell=replace(CELL, **bad)).reason == "PHYSICS_FAULT"


def test_another_tool_than_the_cells_is_a_fault():
    assert isinstance(ask(cell=replace(CELL, tool="none")), ImpactFault)


def test_standing_still_has_no_effect():
    answer = ask(with_person(), MoveJ(HOME, HOME, 1.0, 1.0))
    assert (answer.tier, answer.index, answer.violations) == (0, 0, ())


# ---- perception (P3, P6)


@pytest.mark.parametrize(("scene", "age"), [(None, 0.1), (None, None), (empty(), None)])
def test_p6_no_view_is_at_least_tier_three(scene, age):
    answer = assess(ROBOT, scene, sweep(0.25, 0.8), CELL, perception_age_s=age, touch=NOTHING, seed=SEED)
    assert (answer.tier, answer.perception, answer.perception_age_s) == (3, "missing", None)
    assert answer.contributions[0].kind == "perception"
    assert answer.lower_tier_speed is None


def test_p6_what_is_surveyed_still_counts_without_a_view():
    wall = StaticObject("wall", "rigid", box=Box((*tcp()[:2], 0.0), (0.02, 0.02, 0.3)))
    glass = StaticZone("store", 4, box=Box((*tcp()[:2], 0.0), (0.02, 0.02, 0.3)))
    assert (
        assess(
            ROBOT, None, sweep(), replace(CELL, zones=(glass,)), perception_age_s=None, touch=NOTHING, seed=SEED
        ).tier
        == 4
    )
    assert (
        assess(
            ROBOT, None, sweep(), replace(CELL, objects=(wall,)), perception_age_s=None, touch=NOTHING, seed=SEED
        ).index
        == 3
    )


def test_an_old_view_is_stale_people_are_grown_and_the_floor_holds():
    fresh, stale = ask(with_person(2.2), age=0.5), ask(with_person(2.2), age=0.51)
    assert (fresh.perception, stale.perception) == ("fresh", "stale")
    assert fresh.tier < 3 == stale.tier
    assert ask(empty(), age=60.0).tier == 3
    # Grown people raise the index, but where nobody was seen nobody was met: no violation.
    old = ask(with_person(0.5), sweep(1.05), age=3.0)
    assert old.tier >= 3
    assert old.violations == ()
    assert ask(replace(empty(), people=(standing_adult(*(1.2 * tcp()[:2])),)), age=3.0).violations == ("person",)


def test_people_of_an_old_view_are_grown_by_walking_speed_times_age():
    assert view_of(empty(), 2.0, CELL).grown_m == pytest.approx(3.2)
    assert view_of(empty(), 0.5, CELL).grown_m == 0
    far, move = with_person(1.6), sweep(3.0, 5.0)
    grown = replace(CELL, person_uncertainty_m=CELL.person_uncertainty_m + 1.6 * 0.6)
    by_hand = assess(
        ROBOT, far, move, replace(grown, perception_age_limit_s=9.0), perception_age_s=0.6, touch=NOTHING, seed=SEED
    )
    assert by_hand.index > 3
    assert ask(far, move, age=0.6).index == pytest.approx(by_hand.index, abs=1e-9)


def test_p6_an_incomplete_view_counts_what_it_shows_and_is_at_least_tier_three():
    answer = ask(replace(empty(), complete=False))
    assert (answer.tier, answer.perception) == (3, "missing")
    through = replace(empty(), complete=False, people=(standing_adult(*(1.2 * tcp()[:2])),))
    assert ask(through).violations == ("person",)


def test_p6_a_person_without_arms_may_reach_farther():
    whole = with_person(1.2)
    trunk = replace(
        whole,
        people=tuple(
            replace(p, regions=tuple(r for r in p.regions if r[0] is not Region.LOWER_ARM)) for p in whole.people
        ),
    )
    assert ask(trunk).index > ask(whole).index


# ---- violations


def test_joint_limits():
    for joint, value in ((2, 3.2), (0, 6.3), (5, -6.3), (1, 1e6), (3, 1e300)):
        answer = ask(motion=spoiled(joint, value))
        assert answer.violations == ("joint_limit",)
        assert answer.tier == 4
        assert answer.contributions[0].link == ROBOT.model.joints[joint].name


def test_back_from_beyond_a_joint_limit_slowly():
    out, less, more = (spoiled(5, v, "start").start for v in (6.40, 6.30, 6.45))
    slow = {"speed_rad_s": 0.3, "acceleration_rad_s2": 1.0}
    back = ask(motion=MoveJ(out, less, **slow))
    assert back.violations == ()
    assert back.tier == 3
    assert ask(motion=MoveJ(out, more, **slow)).violations == ("joint_limit",)
    other_side = tuple(-6.3 if k == 5 else v for k, v in enumerate(out))
    assert ask(motion=MoveJ(out, other_side, **slow)).violations == ("joint_limit",)


def test_workspace_and_zones():
    x, y, z = tcp()
    fence = replace(empty(), workspace=Workspace((x - 0.02, -1, -1), (1, 1, 1)))
    hard = replace(empty(), zones=(Zone("press", Sphere((x, y, z), 0.05), None),))
    assert ask(fence).violations == ("workspace",)
    assert ask(hard).violations == ("zone",)
    for tier in (1, 2, 3, 4):
        soft = ask(replace(empty(), zones=(Zone("store", Sphere((x, y, z), 0.05), tier),)))
        assert (soft.tier, soft.violations) == (tier, ())


def test_a_zone_that_only_the_end_of_the_path_enters():
    """Violations are looked for where the arm comes to rest: half the search's resolution deep is found there alone."""
    move = sweep(0.5, 1.0)
    at, before = np.array(tcp(move.target)), np.array(tcp((0.55, *HOME[1:])))
    ahead = at + (at - before) / np.linalg.norm(at - before) * 0.2
    path = NumpyPath(ROBOT, move)

    def scene(radius):
        return replace(empty(), zones=(Zone("press", Sphere(tuple(ahead.tolist()), radius), None),))

    pairs = pairs_of(ROBOT, scene(0.05), CELL, grown_m=0.0)
    zone = np.flatnonzero(pairs.kind == pairs.code_of(PairKind.HARD_ZONE))
    gap = float(path.clearance_at(pairs, GRID, zone).min())
    assert ask(scene(0.05 + gap - VIOLATION_RESOLUTION_M), move).violations == ()
    assert ask(scene(0.05 + gap + VIOLATION_RESOLUTION_M / 2), move).violations == ("zone",)


def test_self_collision():
    folded = (0.0, -2.4, 2.5, -1.6, -1.57, 0.0)  # capsules overlap by millimetres where the housings do not
    shallow = ask(motion=MoveJ((0.0, -1.6, 1.6, -1.6, -1.57, 0.0), folded, 0.5, 1.0))
    assert (shallow.tier, shallow.violations) == (3, ())
    assert shallow.contributions[0].kind == "self"
    deep = ask(motion=MoveJ(HOME, (0.0, -1.62, 2.9, 0.5, -1.57, 0.0), 0.5, 1.0))
    assert deep.violations == ("self",)


def inside_the_tip(depth):
    """A scene in which the resting gripper's tip touches a fist-sized part of a person by `depth`."""
    x, y, z = tcp()
    fist = Sphere((x, y, z - 0.0345 + 0.0328 - 0.05 + depth), 0.05)
    return person_with((Region.HAND, fist))


def test_a_stuck_arm_may_retreat_slowly_and_only_away():
    scene = inside_the_tip(0.01)
    up, down = ((0.0, HOME[1] + d, *HOME[2:]) for d in (-0.1, 0.1))
    away = ask(scene, MoveJ(HOME, up, 0.2, 1.0))
    assert (away.tier, away.violations) == (3, ())
    assert "retreat" in {c.kind for c in away.contributions}
    assert ask(scene, MoveJ(HOME, down, 0.2, 1.0)).violations == ("person",)
    assert ask(scene, MoveJ(HOME, up, 1.5, 3.0)).violations == ("person",)
    there_and_back = (0.0, HOME[1] - 0.1, HOME[2] + 1.0, *HOME[3:])
    assert ask(scene, MoveJ(HOME, there_and_back, 0.2, 1.0)).violations == ("person",)


# ---- things that the way leads through

CAP_M = 0.0345  # of the fingers' lowest capsule, whose lower side is 34.5 mm below its axis
OVER_TIP_M = 0.1767 - 0.1439  # its axis is so far above the tool point
NEARLY = 2 * VIOLATION_RESOLUTION_M
THROUGH = ("fragile", "rigid")


def under_the_fingers(shape, kind="rigid", uncertainty_m=0.01):
    """A scene with a thing under the resting fingers, which point down."""
    return replace(empty(), objects=(*empty().objects, Thing("it", kind, shape, uncertainty_m)))


def ball(depth, radius=0.06):
    """A ball into which the fingers' capsule reaches so deep."""
    x, y, z = tcp()
    return Sphere((x, y, z + OVER_TIP_M - CAP_M - radius + depth), radius)


def block(depth, half_z=0.03):
    """A block whose top the fingers' capsule is so far beyond."""
    x, y, z = tcp()
    return Box((x, y, z + OVER_TIP_M - CAP_M + depth - half_z), (0.1, 0.1, half_z))


def wedge(depth):
    """The block as a polytope."""
    box = block(depth)
    return Convex(
        tuple(
            tuple(c + s * h for c, s, h in zip(box.center_m, signs, box.half_m, strict=True))
            for signs in itertools.product((-1, 1), repeat=3)
        )
    )


@pytest.mark.parametrize("kind", THROUGH)
@pytest.mark.parametrize("uncertainty_m", [0.0, 0.01, 0.2])
@pytest.mark.parametrize(
    ("shape", "deepest"),
    [(ball, CAP_M - AXIS_MET_M), (block, CAP_M - AXIS_MET_M), (wedge, CAP_M - AXIS_MET_M)],
    ids=["ball", "block", "polytope"],
)
def test_a_thing_hit_deeper_than_capsules_can_pretend_is_a_violation(shape, deepest, kind, uncertainty_m):
    """Things of every shape count from the fingers' axis on; before, a person may be asked."""
    still = MoveJ(HOME, HOME, 0.2, 1.0)
    turn = MoveJ(HOME, (*HOME[:5], 0.4), 0.2, 1.0)  # about the tool's own axis: no clearance changes
    for depth, violations in ((deepest - NEARLY, ()), (deepest + NEARLY, (kind,))):
        scene = under_the_fingers(shape(depth), kind, uncertainty_m)
        rest = ask(scene, still)
        assert (rest.index, rest.violations) == (4.0 if violations else 0.0, violations)
        quick = replace(turn, speed_rad_s=1.5)  # too fast for a retreat
        found = ask(scene, quick)
        assert (found.tier, found.violations) == (3, violations)
        held = remaining(
            ROBOT, scene, quick, replace(CELL, watch_time_limit_s=30.0), at_rad=HOME, authorised_milli=4000,
            perception_age_s=0.1, touch=NOTHING,
        )  # fmt: skip
        assert (held.holds, held.cause) == ((False, kind) if violations else (True, ""))


def test_a_surveyed_thing_is_one_too_and_the_parameter_says_how_deep():
    table = ask(motion=MoveJ(HOME, (0.0, HOME[1] + 1.0, *HOME[2:]), 0.5, 1.0))  # the hand would be below it
    assert (table.violations, table.contributions[0].object) == (("rigid",), "table")
    post = StaticObject("post", "fragile", sphere=ball(0.03))
    surveyed = replace(CELL, objects=(post,))
    for limit, violations in ((0.02, ("fragile",)), (0.05, ())):
        cell = replace(surveyed, overlap_limit_m=limit)
        assert ask(cell.surveyed, sweep(), cell).violations == violations


@pytest.mark.parametrize("body", ROBOT.bodies[: ROBOT.world_bodies], ids=lambda body: body.name)
def test_a_body_deeper_in_a_thing_than_its_capsule_sticks_out_is_a_violation(body):
    """A small ball beside the axis of one body, to either side of its limit alone."""
    limits = {
        each.name: min(CELL.overlap_limit_m, each.radius_m - AXIS_MET_M, each.overhang_m or math.inf)
        for each in ROBOT.bodies[: ROBOT.world_bodies]
    }
    ends = NumpyPath(ROBOT, MoveJ(HOME, HOME, 1.0, 1.0)).nodes(np.array([0]))[1].ends[0]
    radius, small = body.radius_m, 0.01
    (a, b), mine = ends[ROBOT.body_index(body.name)], limits[body.name]
    around = np.random.default_rng(3).normal(size=(2000, 3))
    across = around - np.outer(around @ (b - a), b - a) / ((b - a) @ (b - a))
    across /= np.linalg.norm(across, axis=1)[:, None]
    places = a + np.linspace(0, 1, 2000)[:, None] * (b - a) + (radius + small - mine) * across

    def spare(name):
        """Overlap that the other body still may have there."""
        p, q = ends[ROBOT.body_index(name)]
        share = np.clip((places - p) @ (q - p) / ((q - p) @ (q - p)), 0, 1)
        off = np.linalg.norm(places - p - share[:, None] * (q - p), axis=1)
        return off - ROBOT.bodies[ROBOT.body_index(name)].radius_m - small + limits[name]

    others = np.min([spare(name) for name in limits if name != body.name], axis=0)
    best = int(others.argmax())
    assert others[best] > 2 * NEARLY
    still, way = MoveJ(HOME, HOME, 0.2, 1.0), across[best]
    for deeper, violations in ((-NEARLY, ()), (NEARLY, ("rigid",))):
        x, y, z = places[best] - deeper * way
        assert ask(thing_with(Sphere((x, y, z), small)), still).violations == violations


def test_a_way_through_a_thing_is_found_however_short_the_meeting():
    """Fast sweeps through posts thinner than the fingers: two bodies are deepest in one instant between looks."""
    for share in np.linspace(-0.4, 0.4, 9):
        x, y, z = map(float, tcp((float(share), *HOME[1:])))
        post = Capsule((x, y, z - 0.05), (x, y, z + 0.2), 0.02)
        assert ask(under_the_fingers(post), sweep(3.0, 20.0)).violations == ("rigid",)
        assert ask(under_the_fingers(replace(post, radius_m=0.001)), sweep(3.0, 20.0)).violations == ("rigid",)


@pytest.mark.parametrize("shape", [ball, block, wedge])
def test_an_arm_deep_in_a_thing_may_leave_it_slowly(shape):
    scene = under_the_fingers(shape(0.055))
    up, down = ((0.0, HOME[1] + d, *HOME[2:]) for d in (-0.2, 0.25))
    away = ask(scene, MoveJ(HOME, up, 0.2, 1.0))
    assert (away.tier, away.violations) == (3, ())
    assert "retreat" in {c.kind for c in away.contributions}
    assert ask(scene, MoveJ(HOME, down, 0.2, 1.0)).violations == ("rigid",)
    assert ask(scene, MoveJ(HOME, up, 1.5, 3.0)).violations == ("rigid",)


def test_a_part_held_thinner_than_a_gentle_touch_is_deep_may_be_set_down():
    """Pins thinner than PHY-12's depth touch the tray gently with their axis in it, and that is no violation."""
    pin = ROBOT.holding(GrippedObject("pin", Capsule((0.0, 0.0, 0.16), (0.0, 0.0, 0.24), 0.005), 0.1, blunt=True))
    cell = replace(CELL, contacts=(Contact("table", "payload"),))
    path = NumpyPath(pin, MoveJ(HOME, HOME, 1.0, 1.0))
    _, poses = path.nodes(np.array([0]))
    low = float(poses.ends[0, pin.body_index("payload"), :, 2].min()) - 0.005
    x, y, _ = tcp()
    tray = replace(empty().objects[0], shape=Box((x, y, low + 0.012 - 0.02), (0.1, 0.1, 0.02)))
    scene = replace(empty(), objects=(tray,))
    turn = MoveJ(HOME, (0.05, *HOME[1:]), 0.1, 0.5)
    for touch, told in ((frozenset({"table"}), (2, ())), (NOTHING, (3, ()))):
        found = assess(pin, scene, turn, cell, perception_age_s=0.1, touch=touch, seed=SEED)
        assert (found.tier, found.violations) == told
        assert ("retreat" in {c.kind for c in found.contributions}) is (not touch)
    step = SpeedJ(HOME, (0.02, 0.0, 0.0, 0.0, 0.0, 0.0), 2.0, 0.1)
    stream = Stream(pin, cell, touch=frozenset({"table"}), clock=lambda: 0.0)
    stream.see(scene, age_s=0.1, at_rad=HOME)
    assert isinstance(stream.step(step, authorised_milli=2000, seed=SEED), Bounded)


# ---- parameters


@pytest.mark.parametrize(
    ("speed", "acceleration", "kind"),
    [(3.2, 5.0, "joint_speed"), (1e6, 5.0, "joint_speed"), (1.0, 41.0, "acceleration"), (1.0, 1e9, "acceleration")],
)
def test_asking_to_break_a_limit_is_tier_four(speed, acceleration, kind):
    answer = ask(motion=sweep(speed, acceleration))
    assert answer.tier == 4
    assert kind in {c.kind for c in answer.contributions}


def test_configured_limits_count():
    for limit in ("tcp_speed_limit_m_s", "elbow_speed_limit_m_s", "momentum_limit_kg_m_s"):
        assert ask(cell=replace(CELL, **{limit: 0.01})).tier == 4
    assert ask(cell=replace(CELL, payload_kg=1.9)).tier == 3
    assert ask(cell=replace(CELL, payload_kg=2.5)).tier == 4
    assert ask(cell=replace(CELL, payload_kg=None)).tier == 4


# ---- gripper


def grip(scene=None, force=40.0, width=0.05, speed=0.05, cell=CELL, age=0.1):
    return ask(scene, GripperMove(HOME, width, speed, force), cell=cell, age=age)


def test_gripper():
    x, y, z = tcp()
    hand_in = person_with((Region.HAND, Sphere((x, y, z), 0.04)))
    hand_near = person_with((Region.HAND, Sphere((x, y, z - 0.3), 0.04)))
    cup = replace(empty(), objects=(Thing("cup", "fragile", Sphere((x, y, z), 0.03), 0.01),))
    assert grip().tier == 1
    assert grip(hand_near, force=70.0).index == pytest.approx(2.5)
    assert grip(hand_near, force=200.0).tier == 3
    assert grip(hand_in, force=140.0).tier == 3
    assert grip(hand_in, force=141.0).tier == 4
    assert grip(cup, force=20.0).tier == 2
    assert grip(cup, force=40.0).tier == 3
    assert grip(force=236.0).tier == grip(width=0.09).tier == grip(speed=0.2).tier == 4
    assert grip(cell=replace(CELL, payload_kg=0.2)).tier == 2
    assert grip(age=0.6).tier == 3
    assert grip(with_person(2.5)).tier == 1


# ---- time and engines (P14)


def test_p14_no_answer_in_time_is_a_fault():
    ticks = itertools.count(0, CELL.time_limit_s)
    answer = ask(with_person(), clock=lambda: float(next(ticks)))
    assert answer == ImpactFault("PHYSICS_FAULT", "no answer in time")
    assert isinstance(ask(clock=lambda: NAN), ImpactFault)


def test_a_question_that_is_too_large_ends():
    rng = np.random.default_rng(1)
    crowd = tuple(
        Person(f"p{k}", tuple((Region.HAND, Sphere(tuple(rng.uniform(-1, 1, 3).tolist()), 0.05)) for _ in range(64)))
        for k in range(32)
    )
    answer = assess(
        ROBOT,
        replace(empty(), people=crowd),
        spoiled(0, 5.9),
        replace(CELL, time_limit_s=0.3),
        perception_age_s=0.1,
        seed=SEED,
        touch=NOTHING,
    )
    assert isinstance(answer, ImpactFault)
    assert answer.reason == "PHYSICS_FAULT"


def break_kinematics(monkeypatch):
    from pep.pit.robot import kinematics

    true = kinematics.link_frames

    def wrong(robot, q):
        rotation, origin = true(robot, q)
        return rotation, origin + np.array([0, 0, 0.001])

    monkeypatch.setattr(kinematics, "link_frames", wrong)


def break_boxes(monkeypatch):
    from pep.pit.geometry import clearance

    true = clearance.segment_box
    monkeypatch.setattr(clearance, "segment_box", lambda p, q, c, x, h: true(p, q, c, x, h + 0.005))


def break_radii(monkeypatch):
    import sys

    from pep.pit import assess as _  # noqa: F401

    module = sys.modules["pep.pit.assessment.straight_assessment"]
    true = module.pairs_of

    def thinner(*args, **more):
        pairs = true(*args, **more)
        return replace(pairs, radii=pairs.radii - 0.05)

    monkeypatch.setattr(module, "pairs_of", thinner)


def break_speed(monkeypatch):
    from tests.model.pit import path

    true = path.poses
    monkeypatch.setattr(path, "poses", lambda *a: replace(true(*a), speed=true(*a).speed * 0.5))


def break_search(monkeypatch):
    """A search that forgets the last half of the path: no witness there, so only the unforeseeable configurations can tell."""
    from pep.pit.search import certify

    true = certify.cut

    def half(path):
        low, high = true(path)
        keep = len(low) // 2
        return low[:keep], high[:keep]

    monkeypatch.setattr(certify, "cut", half)


def break_compiled_kinematics(monkeypatch):
    from pep.pit.search.kernel import compiled_path as engine

    true = engine.arm_of
    monkeypatch.setattr(engine, "blocks", engine.blocks.__wrapped__)
    monkeypatch.setattr(engine, "arm_of", lambda robot: true(robot)._replace(offsets=true(robot).offsets + 0.001))


def break_compiled_boxes(monkeypatch):
    from pep.pit.base import pair_columns
    from pep.pit.search.kernel import compiled_path as engine

    true = engine.packed

    def smaller(pairs):
        field = true(pairs)
        field.numbers[:, pair_columns.HALF : pair_columns.HALF + 3] -= 0.005
        return field

    monkeypatch.setattr(engine, "packed", smaller)


def break_compiled_speed(monkeypatch):
    from pep.pit.base import pair_columns
    from pep.pit.search.kernel import compiled_path as engine

    true = engine.timing_of

    def slower(profile):
        timing = list(true(profile))
        timing[pair_columns.PEAK] *= 0.5
        return timing

    monkeypatch.setattr(engine, "timing_of", slower)


def break_compiled_search(monkeypatch):
    """A search that forgets the pairs of the last obstacle that was asked about, and of the arm with itself."""
    from pep.pit.search.kernel import compiled_path as engine

    true = engine.certify
    kept = ROBOT.world_bodies * len(empty().objects)

    def forgetful(*asked):  # the pairs that it is asked about stand in the tenth place
        return true(*asked[:9], asked[9][:kept], *asked[10:])

    monkeypatch.setattr(engine, "certify", forgetful)


def late_glass():
    x, y, _ = tcp((0.45, *HOME[1:]))
    glass = Thing("glass", "fragile", Capsule((x, y, 0.03), (x, y, 0.13), 0.035), 0.01)
    return replace(empty(), objects=(*empty().objects, glass))


@pytest.mark.parametrize(
    ("engine", "sabotage", "scene"),
    [
        ("numpy-1", break_kinematics, with_glass()),
        ("numpy-1", break_boxes, empty()),
        ("numpy-1", break_radii, with_person(0.9)),
        ("numpy-1", break_speed, with_person(0.9)),
        ("numpy-1", break_search, late_glass()),
        ("numba-1", break_compiled_kinematics, with_glass()),
        ("numba-1", break_compiled_boxes, empty()),
        ("numba-1", break_radii, with_person(0.9)),
        ("numba-1", break_compiled_speed, with_person(0.9)),
        ("numba-1", break_compiled_search, late_glass()),
    ],
)
def test_a_broken_engine_is_found_out(monkeypatch, engine, sabotage, scene):
    from tests.model.pit.engine import NUMPY

    if engine == NUMPY.name:
        monkeypatch.setattr("pep.pit.assessment.straight_assessment.chosen", lambda: NUMPY)
    move = sweep(2.0, 3.0)
    assert ask(scene, move).engine == engine
    assert isinstance(ask(scene, move), Assessment)
    sabotage(monkeypatch)
    seen = [replace(scene) for _ in range(8)]  # another one each time: nothing is kept of what was laid out before
    answers = [
        assess(ROBOT, each, move, CELL, perception_age_s=0.1, touch=NOTHING, seed=bytes([k]))
        for k, each in enumerate(seen)
    ]
    assert any(isinstance(a, ImpactFault) and a.reason == "ENGINES_DISAGREE" for a in answers)


def test_whatever_breaks_inside_is_a_fault(monkeypatch):
    monkeypatch.setattr("pep.pit.assessment.straight_assessment.pairs_of", lambda *a, **k: 1 / 0)
    answer = ask()
    assert isinstance(answer, ImpactFault)
    assert answer.reason == "PHYSICS_FAULT"


def test_the_answer_is_the_same_again():
    first, second = ask(with_person()), ask(with_person())
    assert first.reading() == second.reading()
    assert first.certificate.rows == second.certificate.rows
    assert Robot.load("ur3e") is Robot.load("ur3e")


def test_equal_things_that_are_spelt_differently_have_two_digests():
    """Memory of one thing is never told of another: the digest is exact to each number's last bit."""
    thing = Thing("ball", "rigid", Sphere((0.0, 0.5, 0.5), 0.1), 0.01)
    other = replace(thing, shape=Sphere((-0.0, 0.5, 0.5), 0.1))
    assert thing == other
    first, second = Scene(objects=(thing,)), Scene(objects=(other,))
    assert first.digest != second.digest
    assert replace(second, objects=(thing,)).digest == first.digest == Scene(objects=(replace(thing),)).digest


def test_digests_tell_scenes_apart():
    scenes = [empty(), with_glass(), with_person(), with_person(0.5001), replace(empty(), complete=False), Scene()]
    assert len({s.digest for s in scenes}) == len(scenes)
    assert CellParameters() == CELL
