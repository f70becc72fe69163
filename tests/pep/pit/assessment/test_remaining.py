"""`remaining`: never more permissive than `assess` of the same view, never holds against a sample, never raises."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from pep.pit.scene.obstacles import AXIS_MET_M
from pep.pit.search.certify import RESOLUTION
from policies.evidence.evidence import ImpactFault
from policies.words.reason_table import Reason
from tests.pep.pit.scenes import (
    CELL,
    HOME,
    NOTHING,
    ROBOT,
    SEED,
    along,
    empty,
    random_move,
    random_scene,
    sweep,
    tcp,
    with_glass,
    with_person,
)
from tests.pep.pit.search.test_soundness import dense_index

from pep.pit import (
    Assessment,
    GripperMove,
    MoveJ,
    Output,
    OutputSet,
    Person,
    Region,
    Remaining,
    Scene,
    SpeedJ,
    Sphere,
    Thing,
    Zone,
    assess,
    remaining,
    standing_adult,
)

NAN, INF = math.nan, math.inf
AGE = 0.1
STOPPED = frozenset({"person", "fragile", "rigid", "self", "workspace", "zone"})


PATIENT = replace(CELL, watch_time_limit_s=30.0, time_limit_s=30.0)  # the tests share the machine


def rest(scene, move, share=0.0, authorised=4000, cell=PATIENT, age=AGE, at=None, robot=ROBOT, touch=NOTHING, **more):
    return remaining(
        robot,
        scene,
        move,
        cell,
        at_rad=along(move, share) if at is None else at,
        authorised_milli=authorised,
        perception_age_s=age,
        touch=touch,
        **more,
    )


def whole(scene, move, cell=PATIENT, age=AGE):
    return assess(ROBOT, scene, move, cell, perception_age_s=age, touch=NOTHING, seed=SEED)


@pytest.mark.parametrize("seed", range(6))
def test_what_holds_for_the_whole_path_holds_for_each_rest_of_it(seed):
    rng = np.random.default_rng(1000 + seed)
    asked = 0
    while asked < 4:
        scene, move = random_scene(rng, things=3, regions=2), random_move(rng, amplitude=rng.choice([0.3, 1.0, 2.0]))
        answer = whole(scene, move)
        if answer.violations:
            continue
        asked += 1
        authorised = answer.reading().index_milli
        for share in (0.0, 1.0, *rng.uniform(0, 1, 4)):
            left = rest(scene, move, share, authorised)
            assert left.holds
            assert left.cause == ""
            assert left.index_milli <= authorised
            assert rest(scene, move, share, min(authorised + 300, 4000)).holds


@pytest.mark.parametrize("seed", range(6))
def test_no_rest_holds_against_a_sample_of_it(seed):
    """Samples come from the other engine and the slow twin; a sample above what is authorised, or violated, forbids."""
    rng = np.random.default_rng(2000 + seed)
    for _ in range(4):
        scene, move = random_scene(rng, things=3, regions=2), random_move(rng, amplitude=rng.choice([0.3, 1.0, 2.0]))
        share = float(rng.uniform(0, 0.9))
        worst, _, violated = dense_index(scene, move, samples=150, since=share)
        if worst > 1.01:
            refused = rest(scene, move, share, math.floor(worst * 1000) - 1)
            assert not refused.holds
            assert refused.index_milli >= math.floor(worst * 1000)
            assert refused.cause
        if violated:
            assert not rest(scene, move, share).holds
            assert rest(scene, move, share).cause in STOPPED


def test_the_highest_rate_of_an_interval_counts_not_that_of_its_middle():
    """A hand above the base axis keeps its distance: only the rate decides, and it peaks at an edge."""
    hand = Person("p", ((Region.HAND, Sphere((0.0, 0.0, 1.15), 0.05)),))
    scene, move = replace(empty(), people=(hand,)), sweep(3.0, 0.4, half=1.0)
    worst, demands, _ = dense_index(scene, move, samples=41)  # the middle one is at the peak
    assert max(demands, 1.05) < worst < 3
    assert not rest(scene, move, 0.1, math.floor(worst * 1000) - 1).holds
    assert rest(scene, move, 0.1, math.ceil(worst * 1000) + 5).holds


@pytest.mark.parametrize("seed", range(3))
def test_a_violation_of_the_whole_path_forbids_at_its_start(seed):
    rng = np.random.default_rng(3000 + seed)
    met = 0
    while met < 4:
        scene, move = random_scene(rng, things=3, regions=3), random_move(rng, 2.0)
        answer = whole(scene, move)
        if not answer.violations:
            continue
        met += 1
        left = rest(scene, move)
        assert not left.holds
        assert left.cause in answer.violations
        assert left.index_milli == 4000


def test_what_lies_behind_the_arm_is_done():
    move, scene = sweep(), with_glass()
    before, after = rest(scene, move, 0.3, 1900), rest(scene, move, 0.97, 1900)
    assert (before.holds, before.cause) == (False, "fragile")
    assert after.holds
    assert after.index_milli < 1900 < before.index_milli


def test_an_arrived_arm_has_nothing_left():
    assert rest(with_glass(), sweep(), 1.0, 1000) == Remaining(holds=True, index_milli=1000, cause="")
    still = MoveJ(HOME, HOME, 1.0, 1.0)
    assert rest(with_person(), still, 0.0, 0) == Remaining(holds=True, index_milli=0, cause="")
    # But where it stands now somebody came to be.
    x, y, z = tcp(sweep().target)
    hand = replace(empty(), people=(Person("p", ((Region.HAND, Sphere((x, y, z), 0.05)),)),))
    assert rest(hand, sweep(), 1.0) == Remaining(holds=False, index_milli=4000, cause="person")


def test_somebody_comes_in():
    move = sweep(0.5, 1.0)
    authorised = whole(empty(), move).reading().index_milli
    assert rest(empty(), move, 0.4, authorised).holds
    came = rest(with_person(), move, 0.4, authorised)
    assert (came.holds, came.cause) == (False, "person")
    assert came.index_milli > 2000
    in_the_way = replace(empty(), people=(standing_adult(*(1.2 * tcp()[:2])),))
    assert rest(in_the_way, move, 0.1) == Remaining(holds=False, index_milli=4000, cause="person")


def test_new_zones_and_things_and_the_arm_itself():
    x, y, z = tcp()
    move = sweep()
    cup = replace(empty(), objects=(*empty().objects, Thing("cup", "rigid", Sphere((x, y, z), 0.03), 0.01)))
    assert rest(cup, move, 0.1, 2000).cause == "rigid"
    assert rest(replace(empty(), zones=(Zone("press", Sphere((x, y, z), 0.03), None),)), move, 0.1).cause == "zone"
    assert rest(replace(empty(), zones=(Zone("store", Sphere((x, y, z), 0.03), 4),)), move, 0.1, 3999).cause == (
        "tiered_zone"
    )
    folding = MoveJ(HOME, (0.0, -1.62, 2.9, 0.5, -1.57, 0.0), 0.5, 1.0)
    assert rest(empty(), folding, 0.5).cause == "self"


@pytest.mark.parametrize("wrist", [0.0, math.pi / 2])
def test_a_violation_between_the_looks_is_found(wrist):
    """A zone that the fingers graze by 2 mm on a small part of a long turn, anywhere on it."""
    home = (*HOME[1:5], wrist)
    move = MoveJ((-2.8, *home), (2.8, *home), 0.5, 1.0)
    for share in np.linspace(0.41, 0.53, 9):
        x, y, z = tcp((-2.8 + 5.6 * share, *home))
        graze = Sphere((x, y, z + 0.1767 - 0.1784 - 0.01 + 0.002), 0.01)
        left = rest(replace(empty(), zones=(Zone("press", graze, None),)), move, 0.2)
        assert left == Remaining(holds=False, index_milli=4000, cause="zone")
        # A thing that they graze 2 mm deeper than a person may allow, and one of which they stay 2 mm short.
        for deeper in (0.002, -0.002):
            deep = Sphere((x, y, z + 0.1767 - 0.1784 - 0.06 + 0.0345 - AXIS_MET_M + deeper), 0.06)
            left = rest(replace(empty(), objects=(Thing("bowl", "fragile", deep, 0.01),)), move, 0.2)
            assert (left.holds, left.cause) == ((False, "fragile") if deeper > 0 else (True, ""))


def test_the_measured_age_enters_the_reaction_time():
    """T_r = max(age, 0.15) + 0.06: below the watch's own limit nothing changes, above it the index grows."""
    scene, move = with_person(1.2), sweep()
    authorised = whole(scene, move, age=0.15).reading().index_milli
    assert rest(scene, move, 0.1, authorised, age=0.0).holds
    assert rest(scene, move, 0.1, authorised, age=0.15).holds
    late = rest(scene, move, 0.1, authorised, age=0.25)
    assert (late.holds, late.cause) == (False, "person")
    same = rest(scene, move, 0.1, authorised, age=0.15, cell=replace(PATIENT, watch_age_limit_s=0.25))
    assert not same.holds


@pytest.mark.parametrize(("scene", "age"), [(None, None), (None, 0.1), (empty(), None), (empty(), 0.6)])
def test_without_a_fresh_view_at_least_three(scene, age):
    assert rest(scene, sweep(), 0.5, 2999, age=age) == Remaining(holds=False, index_milli=3000, cause="perception")
    assert rest(scene, sweep(), 0.5, 3000, age=age).holds
    unseen = rest(replace(empty(), complete=False), sweep(), 0.5, 2999)
    assert (unseen.holds, unseen.cause) == (False, "perception")


def test_off_the_path():
    move = sweep()
    for joint in range(6):
        for off in (0.05, -0.05, 2 * math.pi, -2 * math.pi):
            at = list(along(move, 0.5))
            at[joint] += off
            left = rest(empty(), move, at=tuple(at))
            if joint == 0 and abs(off) < 1:  # along the path: only elsewhere on it
                assert left.holds
            else:
                assert left == Remaining(holds=False, index_milli=4000, cause="off_path")
    near = tuple(q + 2e-4 * (-1) ** k for k, q in enumerate(along(move, 0.5)))
    assert rest(empty(), move, at=near).holds
    assert rest(empty(), move, at=near, cell=replace(PATIENT, tracking_tolerance_m=1e-5)).cause == "off_path"
    short, long = (along(move, share) for share in (-0.05, 1.05))
    assert rest(empty(), move, at=short).cause == rest(empty(), move, at=long).cause == "off_path"
    assert rest(empty(), MoveJ(HOME, HOME, 1.0, 1.0), at=long).cause == "off_path"


def test_off_the_path_is_never_inside_what_the_clearance_already_gives():
    """A deviation that passes moves no part of the arm farther than the tolerance."""
    from tests.model.pit.path import NumpyPath

    rng = np.random.default_rng(4000)
    passed = 0
    for _ in range(60):
        move = random_move(rng)
        share = rng.uniform(0, 1)
        at = np.array(along(move, share)) + rng.uniform(-1, 1, 6) * 10 ** rng.uniform(-4, -2)
        if rest(Scene(), move, at=tuple(at.tolist())).cause == "off_path":
            continue
        passed += 1
        path = NumpyPath(ROBOT, move)
        s = np.clip((at - path.start) @ path.delta / (path.delta @ path.delta), 0, 1)
        here, there = (NumpyPath(ROBOT, MoveJ(tuple(q), tuple(q), 1.0, 1.0)) for q in (at, path.q(s)))
        (_, a), (_, b) = here.nodes(np.array([0])), there.nodes(np.array([0]))
        assert np.linalg.norm(a.ends - b.ends, axis=3).max() <= CELL.tracking_tolerance_m
    assert 5 < passed < 60


def test_limits_of_the_arm():
    out, less, more = (tuple(v if k == 5 else q for k, q in enumerate(HOME)) for v in (6.40, 6.30, 6.45))
    back = MoveJ(out, less, 0.3, 1.0)
    assert rest(empty(), back, 0.3, 3000).holds
    assert rest(empty(), back, 0.3, 2999).cause == "retreat"
    assert rest(empty(), MoveJ(out, more, 0.3, 1.0), 0.3).cause == "joint_limit"
    assert rest(empty(), MoveJ(out, less, 1.5, 3.0), 0.3).cause == "joint_limit"
    assert rest(empty(), sweep(3.2, 5.0), 0.3, 3999).cause == "joint_speed"


def test_a_retreat_under_way():
    x, y, z = tcp()
    fist = Sphere((x, y, z - 0.0345 + 0.0328 - 0.05 + 0.01), 0.05)
    scene = replace(empty(), people=(Person("p", ((Region.HAND, fist),)),))
    up, down = ((0.0, HOME[1] + d, *HOME[2:]) for d in (-0.1, 0.1))
    assert rest(scene, MoveJ(HOME, up, 0.2, 1.0), 0.0, 3000).holds
    assert rest(scene, MoveJ(HOME, up, 0.2, 1.0), 0.01, 3000).holds
    assert rest(scene, MoveJ(HOME, up, 0.2, 1.0), 0.01, 2999).cause in ("retreat", "person")
    assert rest(scene, MoveJ(HOME, down, 0.2, 1.0)).cause == "person"
    assert rest(scene, MoveJ(HOME, up, 1.5, 3.0)).cause == "person"


@pytest.mark.parametrize("seed", range(2))
def test_a_held_speed_is_watched_like_a_move(seed):
    rng = np.random.default_rng(5000 + seed)
    asked = 0
    while asked < 4:
        scene, move = random_scene(rng, things=2, regions=1), random_move(rng, 1.0)
        held = SpeedJ(move.start, tuple(rng.uniform(-0.6, 0.6, 6).tolist()), 1.0, float(rng.uniform(0.1, 1.5)))
        answer = whole(scene, held)
        if answer.violations:
            continue
        asked += 1
        authorised = answer.reading().index_milli
        ends = [tuple(q + t * v for q, v in zip(held.start, held.qd_rad_s, strict=True)) for t in (0.0, 0.05)]
        for at in ends:
            assert rest(scene, held, at=at, authorised=authorised).holds
    assert rest(empty(), SpeedJ(HOME, (0.5, 0, 0, 0, 0, 0), 1.0, 1.0), at=(-0.1, *HOME[1:])).cause == "off_path"


def test_grippers_and_outputs():
    x, y, z = tcp()
    near = replace(empty(), people=(Person("p", ((Region.HAND, Sphere((x, y, z - 0.3), 0.04)),)),))
    grip = GripperMove(HOME, 0.05, 0.05, 70.0)
    assert rest(near, grip, at=HOME, authorised=2500).holds
    assert rest(near, grip, at=HOME, authorised=2499) == Remaining(holds=False, index_milli=2500, cause="person")
    assert rest(None, grip, at=HOME, authorised=2499).cause == "perception"
    assert rest(near, grip, at=along(sweep(), 0.0)).cause == "off_path"
    cell = replace(PATIENT, outputs=(Output(3, 2, "conveyor"),))
    assert rest(None, OutputSet(3, True), at=HOME, authorised=2000, cell=cell).holds
    assert rest(None, OutputSet(3, True), at=HOME, authorised=1999, cell=cell).cause == "output"
    assert rest(None, OutputSet(4, True), at=HOME, authorised=2999, cell=cell).cause == "undeclared_output"


BAD = [
    ({"at": (NAN, *HOME[1:])}, "NOT_FINITE"),
    ({"at": (*HOME[:5], INF)}, "NOT_FINITE"),
    ({"at": HOME[:5]}, "PARAMETERS_WRONG"),
    ({"at": ("0",) * 6}, "PHYSICS_FAULT"),
    ({"at": 7}, "PHYSICS_FAULT"),
    ({"authorised": 4001}, "PARAMETERS_WRONG"),
    ({"authorised": -1}, "PARAMETERS_WRONG"),
    ({"authorised": True}, "PARAMETERS_WRONG"),
    ({"authorised": 2000.0}, "PARAMETERS_WRONG"),
    ({"authorised": None}, "PARAMETERS_WRONG"),
    ({"age": NAN}, "PERCEPTION_INVALID"),
    ({"age": -0.1}, "PERCEPTION_INVALID"),
    ({"touch": "table"}, "PHYSICS_FAULT"),
    ({"touch": None}, "PHYSICS_FAULT"),
    ({"cell": replace(CELL, watch_time_limit_s=0.0)}, "PHYSICS_FAULT"),
    ({"cell": replace(CELL, tracking_tolerance_m=0.1)}, "PHYSICS_FAULT"),
    ({"cell": replace(CELL, tool="claw")}, "PHYSICS_FAULT"),
    ({"cell": None}, "PHYSICS_FAULT"),
    ({"robot": None}, "PHYSICS_FAULT"),
    ({"scene": replace(empty(), zones=(Zone("z", Sphere((NAN, 0, 0), 0.1), None),))}, "PERCEPTION_INVALID"),
    ({"move": replace(sweep(), speed_rad_s=NAN)}, "NOT_FINITE"),
    ({"move": None, "at": HOME}, "PHYSICS_FAULT"),
]


@pytest.mark.parametrize(("more", "reason"), BAD)
def test_nonsense_is_a_fault_and_never_raises(more, reason):
    given = {"scene": empty(), "move": sweep(), "at": along(sweep(), 0.5)} | more
    answer = rest(given.pop("scene"), given.pop("move"), **given)
    assert isinstance(answer, ImpactFault)
    assert answer.reason == reason
    assert answer.reason in Reason.__members__


def test_too_late_is_a_fault():
    ticks = itertools.count(0, CELL.watch_time_limit_s)
    late = rest(with_person(), sweep(), 0.1, cell=CELL, clock=lambda: float(next(ticks)))
    assert late == ImpactFault("PHYSICS_FAULT", "no answer in time")
    assert isinstance(rest(empty(), sweep(), 0.1, clock=lambda: NAN), ImpactFault)


def test_the_rest_asked_as_a_move_of_its_own_holds_too():
    """A rest that holds here has no more than a new question about it would find."""
    rng = np.random.default_rng(6000)
    for _ in range(8):
        scene, move = random_scene(rng, things=2, regions=2), random_move(rng, 1.0)
        share = float(rng.uniform(0, 0.8))
        own = whole(scene, replace(move, start=along(move, share)))
        assert isinstance(own, Assessment)
        below = own.reading().index_milli - 1 - round(1000 * RESOLUTION)
        if own.violations:
            assert not rest(scene, move, share).holds
        elif below >= 1000:
            assert not rest(scene, move, share, below).holds
