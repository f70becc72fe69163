"""PHY-22: polytopes. Their hulls, their distances against coal, MuJoCo and dense search, and whole answers with them."""

import itertools
import math
from dataclasses import replace

import coal
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pep.perception.consistency import grip_contradicted
from pep.pit.base.motion import profile_of
from pep.pit.geometry.clearance import core_distance, segment_hull
from pep.pit.geometry.hull import CORNERS_MOST, hull_of, widths_of
from pep.pit.geometry.shape import shape_of
from pep.pit.geometry.solids import cores_of
from pep.pit.path.straight_path import GRID
from pep.pit.proof.proof_document import document
from pep.pit.robot.enclosing_capsule import capsule_around_points
from pep.pit.robot.kinematics import link_frames
from pep.pit.scene.cell import StaticObject
from pep.pit.scene.grip_sightings import _outermost
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.separation import stopping
from pep.pit.search.engine import chosen
from pep.pit.search.question import as_run
from tests.model.pit.clearance import interval_clearance
from tests.model.pit.engine import NUMPY
from tests.model.pit.path import NumpyPath
from tests.pep.pit.assessment.test_bad_numbers import BAD, ask, matrix
from tests.pep.pit.geometry.test_clearance import placed
from tests.pep.pit.lines import pose_of
from tests.pep.pit.scenes import (
    CELL,
    HOME,
    NOTHING,
    ROBOT,
    SEED,
    empty,
    random_convex,
    random_move,
    random_scene,
    random_shape,
    sweep,
    tcp,
    with_convex,
)
from pep.pit.picture.postures import PostureCapsule, nearest

from capabilities.statements import observation as wire
from pep.pit import (
    Assessment,
    Box,
    Capsule,
    CellParameters,
    Convex,
    LineLeg,
    LinePath,
    MoveJ,
    MoveL,
    Person,
    Region,
    Scene,
    SceneError,
    ServoJ,
    SpeedL,
    Thing,
    Zone,
    assess,
    gripped,
    remaining,
)
from pep.pit.checker import Verified, distances, verify

pytestmark = pytest.mark.long

PATIENT = replace(CELL, time_limit_s=60.0)  # a slow machine is no fault here
CUBE = tuple(itertools.product((-0.1, 0.1), repeat=3))
coordinate = st.integers(-60, 60).map(lambda k: k / 400)
corners = st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=4, max_size=20, unique=True).map(tuple)


def spanning(points):
    """The hull, or None for points of which there is none."""
    try:
        return hull_of(points)
    except SceneError:
        return None


def directions(count, seed):
    found = np.random.default_rng(seed).standard_normal((count, 3))
    return found / np.linalg.norm(found, axis=1)[:, None]


# ---- the hull


@given(corners)
def test_a_hull_is_closed_convex_and_no_larger_than_its_points(points):
    hull = spanning(points)
    if hull is None:
        centered = np.array(points) - points[0]
        across = np.linalg.svd(centered, compute_uv=False)
        assert across[-1] < 1e-6 * math.sqrt(len(points))
        return
    every = np.array(points)
    assert np.abs(np.linalg.norm(hull.normals, axis=1) - 1).max() < 1e-12
    assert (every @ hull.normals.T <= hull.offsets + 1e-12).all()  # all points are behind all faces
    on = np.einsum("fki,fi->fk", hull.vertices[hull.faces], hull.normals)
    assert np.abs(on - hull.offsets[:, None]).max() < 1e-9  # and each face's own corners on it
    sides = [(face[k], face[(k + 1) % 3]) for face in hull.faces.tolist() for k in range(3)]
    assert len(set(sides)) == len(sides)
    assert {(b, a) for a, b in sides} == set(sides)  # closed: each side lies against one other, the other way round
    assert len(hull.vertices) - len(sides) // 2 + len(hull.faces) == 2
    assert set(map(tuple, hull.vertices.tolist())) <= set(points)
    ways = directions(200, 1)
    assert np.abs(along(every, ways).max(axis=0) - along(hull.vertices, ways).max(axis=0)).max() < 1e-12


@given(corners)
def test_a_hulls_volume_is_that_of_qhull(points):
    hull = spanning(points)
    if hull is None:
        return
    theirs = coal.StdVec_Vec3s()
    theirs.extend([np.array(point, dtype=float) for point in points])
    a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
    ours = float(np.einsum("fi,fi->f", a, np.cross(b, c)).sum() / 6)
    assert ours == pytest.approx(coal.Convex.convexHull(theirs, True, "Qt").computeVolume(), rel=1e-9, abs=1e-15)


def test_a_cube_has_twelve_edges_and_none_across_its_faces():
    hull = hull_of(CUBE)
    assert (len(hull.vertices), len(hull.faces), len(hull.edges)) == (8, 12, 12)
    lengths = np.linalg.norm(hull.vertices[hull.edges[:, 0]] - hull.vertices[hull.edges[:, 1]], axis=1)
    assert lengths == pytest.approx(np.full(12, 0.2))


def test_a_hull_is_the_same_every_time():
    rng = np.random.default_rng(2200)
    for _ in range(20):
        points = random_convex(rng, np.zeros(3)).vertices_m
        one, other = hull_of.__wrapped__(points), hull_of.__wrapped__(points)
        assert (one.faces == other.faces).all()
        assert (one.normals == other.normals).all()


FLAT = {
    "a point": ((0.1, 0.2, 0.3),) * 4,
    "a line": tuple((0.1 * k, 0.2 * k, 0.0) for k in range(5)),
    "a sheet": tuple((x, y, 0.3) for x in (0.0, 0.1) for y in (0.0, 0.1)),
    "a slanted sheet": tuple((x, y, 0.3 * x + 0.7 * y) for x in (0.0, 0.125, 0.25) for y in (0.0, 0.5)),
    "thinner than a micrometre": tuple((x, y, z) for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 5e-7)),
}
WRONG = {
    **{name: Convex(points) for name, points in FLAT.items()},
    "three corners": Convex(CUBE[:3]),
    "too many": Convex(tuple(map(tuple, directions(CORNERS_MOST + 1, 3).tolist()))),
    "no number": Convex((*CUBE, (math.nan, 0.0, 0.0))),
    "no end": Convex((*CUBE, (math.inf, 0.0, 0.0))),
    "too far": Convex((*CUBE, (101.0, 0.0, 0.0))),
    "a radius below 0": Convex(CUBE, -0.01),
    "no radius": Convex(CUBE, math.nan),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_spans_no_volume_or_is_no_number_is_refused(name):
    for scene in (
        replace(empty(), objects=(Thing("it", "rigid", WRONG[name], 0.0),)),
        replace(empty(), zones=(Zone("it", WRONG[name], None),)),
    ):
        assert scene.defect() is not None
        answer = assess(ROBOT, scene, sweep(), CELL, perception_age_s=0.1, touch=NOTHING, seed=SEED)
        assert not isinstance(answer, Assessment)
        assert answer.reason == "PERCEPTION_INVALID"


@pytest.mark.parametrize("name", FLAT)
def test_flat_points_have_no_hull(name):
    with pytest.raises(SceneError) as refused:
        hull_of(FLAT[name])
    assert refused.value.reason == "PERCEPTION_INVALID"


def test_as_many_corners_as_there_may_be_are_taken():
    scene = replace(
        empty(), objects=(Thing("it", "rigid", Convex(tuple(map(tuple, directions(64, 4).tolist()))), 0.0),)
    )
    assert scene.defect() is None


def test_a_persons_region_is_never_a_polytope():
    assert replace(empty(), people=(Person("p", ((Region.HEAD, Convex(CUBE)),)),)).defect() is not None


def test_the_second_engine_lives_through_corners_that_are_all_but_flat():
    """Coal's own `convexHull` ends the process at 1e-9 m; what may stand in a scene must not."""
    for thin in (1.1e-6, 1e-5, 1e-3):
        shape = Convex(tuple((x, y, z) for x in (0.5, 0.7) for y in (0.0, 0.2) for z in (0.1, 0.1 + thin)))
        scene = Scene(objects=(Thing("sheet", "rigid", shape, 0.0),))
        answer = assess(ROBOT, scene, sweep(), PATIENT, perception_age_s=0.1, touch=NOTHING, seed=SEED)
        assert isinstance(answer, Assessment)


def test_the_ball_that_the_second_engine_settles_by_holds_every_corner():
    from pep.pit.geometry.coal_shapes import core_of

    rng = np.random.default_rng(2214)
    for _ in range(50):
        shape = random_convex(rng, rng.uniform(-1, 1, 3))
        *center, radius, _ = core_of(shape).numbers
        far = np.linalg.norm(np.array(shape.vertices_m) - center, axis=1).max()
        assert far <= radius <= 1.2 * far


# ---- distances


def coal_polytope(shape):
    points = coal.StdVec_Vec3s()
    points.extend([np.array(vertex) for vertex in shape.vertices_m])
    return coal.Convex.convexHull(points, True, "Qt")


def coal_core_distance(p, q, shape):
    way = q - p
    turn = np.eye(3)
    if np.linalg.norm(way) > 1e-12:
        import pinocchio

        turn = pinocchio.Quaternion.FromTwoVectors(np.array([0.0, 0, 1]), way).toRotationMatrix()
    rod = coal.Capsule(0.0, float(np.linalg.norm(way)))
    found = coal.distance(
        rod, placed(turn, (p + q) / 2), coal_polytope(shape), placed(np.eye(3), (0, 0, 0)),
        coal.DistanceRequest(), coal.DistanceResult(),
    )  # fmt: skip
    return max(found, 0.0)


def along(points, ways):
    return np.einsum("ni,wi->nw", points, ways)


def axes(rng, count, far=0.25):
    """Segments near the origin: of any length, points, and parallel to an axis."""
    p, q = rng.uniform(-far, far, (2, count, 3))
    sort = rng.integers(5, size=count)
    q[sort == 0] = p[sort == 0]
    q[sort == 1, :2] = p[sort == 1, :2]
    q[sort == 2] = p[sort == 2] + 0.05 * (q - p)[sort == 2]
    return p, q


def test_distance_equals_coal():
    rng = np.random.default_rng(2201)
    apart = 0
    for _ in range(300):
        shape = random_convex(rng, rng.uniform(-0.1, 0.1, 3))
        p, q = axes(rng, 5, 0.12)
        on_body, on_core = segment_hull(p, q, hull_of(shape.vertices_m))
        ours = np.linalg.norm(on_body - on_core, axis=1)
        theirs = [coal_core_distance(a, b, shape) for a, b in zip(p, q, strict=True)]
        assert ours == pytest.approx(np.array(theirs), abs=2e-6)
        apart += int((ours > 1e-3).sum())
    assert 300 < apart < 1450


def test_distance_equals_dense_search():
    """Against the nearest of many points of the segment to the polytope's surface, found by projecting many times."""
    rng = np.random.default_rng(2202)
    t, ways = np.linspace(0, 1, 201)[:, None], directions(1500, 5)
    for _ in range(60):
        shape = random_convex(rng, np.zeros(3))
        p, q = (each[0] for each in axes(rng, 1))
        hull = hull_of(shape.vertices_m)
        x, y = segment_hull(p[None], q[None], hull)
        points = p + t * (q - p)
        # Along every direction the gap of points and polytope is at most their distance.
        gap = (along(points, ways) - along(hull.vertices, ways).max(axis=0)).max(axis=1)
        exact = float(np.linalg.norm(x - y))
        assert exact >= gap.min() - 0.5 * np.linalg.norm(q - p) / 200 - 1e-12
        # The point on the polytope is of it, the other one of the segment.
        assert (y @ hull.normals.T <= hull.offsets + 1e-9).all()
        assert np.abs(np.linalg.norm(x[0] - p) + np.linalg.norm(x[0] - q) - np.linalg.norm(p - q)) < 1e-9


def test_a_box_of_corners_is_a_box():
    rng = np.random.default_rng(2203)
    for _ in range(300):
        box = random_shape(rng, "b", 0.0, 0.3)
        from pep.pit.geometry.solids import rotation_of

        turned = np.array(CUBE) * 10 * np.array(box.half_m) @ rotation_of(box.quaternion).T + np.array(box.center_m)
        twin = Convex(tuple(map(tuple, turned.tolist())))
        p, q = axes(rng, 8)
        ends = np.stack([p, q], axis=1)
        ours, way = core_distance(ends, cores_of([twin] * 8)[0])
        theirs, their_way = core_distance(ends, cores_of([box] * 8)[0])
        assert ours == pytest.approx(theirs, abs=1e-9)
        far = theirs > 1e-3
        assert way[far] == pytest.approx(their_way[far], abs=1e-6)


def test_cores_that_meet_are_nothing_apart_and_have_no_direction():
    shape = Convex(CUBE, 0.02)
    through = np.array(
        [[(-1.0, 0.0, 0.0), (1.0, 0.01, 0.02)], [(0.0, 0.0, 0.0), (0.0, 0.0, 0.0)], [(0.1, 0.0, 0.0)] * 2]
    )
    distance, way = core_distance(through, cores_of([shape] * 3)[0])
    assert (distance == 0).all()
    assert (way == 0).all()


def test_no_direction_proves_more_than_the_distance_and_its_own_proves_that():
    rng = np.random.default_rng(2204)
    for _ in range(40):
        shape = random_convex(rng, rng.uniform(-0.1, 0.1, 3))
        p, q = axes(rng, 30)
        ends, cores = np.stack([p, q], axis=1), cores_of([shape] * 30)[0]
        distance, way = core_distance(ends, cores)
        still = np.stack([ends] * 3)
        zero = np.zeros(30)
        own = interval_clearance(still, way, cores, radii=zero, sag=zero)
        assert own == pytest.approx(np.maximum(distance - 1e-9, 0), abs=1e-9)
        for any_way in directions(20, 6):
            other = interval_clearance(still, np.tile(any_way, (30, 1)), cores, radii=zero, sag=zero)
            assert (other <= distance + 1e-12).all()


def test_a_wrong_face_brings_nearer_and_never_farther():
    """A hull that lost its faces towards the body: the distance is still no more than the corners say."""
    rng = np.random.default_rng(2205)
    for _ in range(50):
        shape = random_convex(rng, np.zeros(3))
        hull = hull_of(shape.vertices_m)
        p, q = axes(rng, 20)
        ends, cores = np.stack([p, q], axis=1), cores_of([shape] * 20)[0]
        true, _ = core_distance(ends, cores)
        keep = rng.random(len(hull.faces)) < 0.5
        keep[0] = True
        torn = replace(
            hull, faces=hull.faces[keep], normals=hull.normals[keep], offsets=hull.offsets[keep],
            sides=hull.sides[keep], side_offsets=hull.side_offsets[keep], edges=hull.edges[:2],
        )  # fmt: skip
        found, _ = core_distance(ends, replace(cores, hulls=(torn,) * 20))
        assert (found <= true + 1e-12).all()


def test_rows_of_many_shapes_are_each_asked_of_their_own():
    rng = np.random.default_rng(2206)
    shapes = [random_shape(rng, "csbvv", 0.0, 0.4) for _ in range(40)]
    p, q = axes(rng, 40)
    ends = np.stack([p, q], axis=1)
    together, way = core_distance(ends, cores_of(shapes)[0])
    order = rng.permutation(40)
    mixed, _ = core_distance(ends[order], cores_of(shapes)[0].take(order))
    assert (mixed == together[order]).all()
    for k, shape in enumerate(shapes):
        alone, its_way = core_distance(ends[k : k + 1], cores_of([shape])[0])
        assert together[k] == alone[0]
        assert (way[k] == its_way[0]).all()
    both, _ = core_distance(np.concatenate([ends, ends[::-1]]), cores_of([*shapes, *shapes[::-1]])[0])
    assert (both == np.concatenate([together, together[::-1]])).all()


def test_the_checkers_way_is_the_rooms():
    rng = np.random.default_rng(2207)
    apart = 0
    for _ in range(400):
        shape = random_convex(rng, rng.uniform(-0.1, 0.1, 3))
        p, q = (each[0] for each in axes(rng, 1, 0.15))
        ours, way = core_distance(np.array([[p, q]]), cores_of([shape])[0])
        body = distances.Polytope(shape.vertices_m)
        theirs = distances.from_polytope(tuple(p.tolist()), tuple(q.tolist()), body)
        assert distances.length(theirs) == pytest.approx(ours[0], abs=1e-9)
        if ours[0] > 1e-3:
            apart += 1
            assert np.array(theirs) / ours[0] == pytest.approx(way[0], abs=1e-7)
            assert distances.reach(body, tuple(way[0].tolist())) == pytest.approx(
                (hull_of(shape.vertices_m).vertices @ way[0]).max()
            )
    assert 100 < apart < 390


# ---- rows and whole answers


def test_interval_bound_holds_on_dense_samples_of_polytopes():
    rng = np.random.default_rng(2208)
    for _ in range(8):
        scene = with_convex(rng, random_scene(rng, things=1, regions=1))
        pairs = pairs_of(ROBOT, scene, CELL, grown_m=0.0)
        path = NumpyPath(ROBOT, random_move(rng))
        rows = np.flatnonzero(pairs.cores.hull >= 0)
        for level in (4, 16):
            k = int(rng.integers(level))
            low, high = k * (GRID // level), (k + 1) * (GRID // level)
            leaves = path.examine(pairs, np.full(len(rows), low), np.full(len(rows), high), rows)
            attained = [path.clearance_at(pairs, int(key), rows) for key in np.linspace(low, high, 40)]
            assert (np.min(attained, axis=0) >= leaves.clear_m - 1e-12).all()
            assert (leaves.clear_mid_m >= leaves.clear_m).all()


def test_both_engines_agree_on_polytopes_and_every_certificate_is_verified():
    """Coal is asked inside `assess`; a disagreement would be a fault."""
    decided = 0
    for k in range(25):
        rng = np.random.default_rng([2209, k])
        scene = with_convex(rng, random_scene(rng, things=1, regions=1, zones=0))
        move = random_move(rng, amplitude=float(rng.choice([0.05, 0.3, 1.0])))
        answer = assess(ROBOT, scene, move, PATIENT, perception_age_s=0.1, touch=NOTHING, seed=SEED)
        assert isinstance(answer, Assessment), answer
        decided += any(each.object.startswith("hull") for each in answer.contributions)
        text = document(
            answer, robot=ROBOT, scene=scene, motion=move, cell=PATIENT, perception_age_s=0.1, touch=NOTHING
        )
        verdict = verify(text)
        assert isinstance(verdict, Verified), verdict
        assert verdict.index == answer.index
    assert decided > 8


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_the_kernel_measures_a_polytope_as_its_twin_does(seed):
    """Distance, and what is proven of whole intervals, past polytopes that the path may pierce."""
    rng = np.random.default_rng([2214, seed])
    scene, move = with_convex(rng, random_scene(rng, things=1, regions=1, zones=0)), random_move(rng, amplitude=0.6)
    pairs = pairs_of(ROBOT, scene, CELL, grown_m=0.0)
    rows = np.flatnonzero(pairs.solids.hull >= 0)
    kernel, twin = chosen().path(ROBOT, move), NumpyPath(ROBOT, move)
    for key in (0, GRID // 3, GRID):
        ours, theirs = (path.clearance_at(pairs, key, rows) for path in (kernel, twin))
        assert ours == pytest.approx(theirs, abs=1e-9)
    for low, high in ((0, GRID), (0, GRID // 8), (GRID // 2, GRID // 2 + GRID // 64)):
        every = np.ones(len(rows), dtype=np.int64)
        ours, theirs = (path.examine(pairs, low * every, high * every, rows) for path in (kernel, twin))
        assert ours.clear_m == pytest.approx(theirs.clear_m, abs=1e-8)
        assert ours.clear_mid_m == pytest.approx(theirs.clear_mid_m, abs=1e-9)


def test_the_kernel_finds_the_index_of_polytopes_that_its_twin_finds():
    met = 0
    for k in range(12):
        rng = np.random.default_rng([2215, k])
        scene = with_convex(rng, random_scene(rng, things=1, regions=1, zones=0))
        move = random_move(rng, amplitude=float(rng.choice([0.05, 0.3, 1.0])))
        pairs = pairs_of(ROBOT, scene, CELL, grown_m=0.0)
        profile = profile_of(as_run(move, CELL))
        stop = stopping(CELL, perception_age_s=0.1, joint_speed_rad_s=profile.peak_rad_s)
        rows = np.arange(len(pairs))
        ours, theirs = (
            engine.path(ROBOT, move).certify(pairs, profile, stop, rows=rows, floor=1.0, check_time=lambda: None)
            for engine in (chosen(), NUMPY)
        )
        met += any(pairs.name_of(each.pair).startswith("hull") and each.index > 1.01 for each in ours.witnesses)
        assert ours.upper == pytest.approx(theirs.upper, abs=0.011)
        assert set(ours.violated) == set(theirs.violated)
    assert met > 2


def test_a_surveyed_polytope_is_decided_on_by_the_kernel():
    wedge = replace(CELL, objects=(StaticObject("wedge", convex=Convex(CUBE)),))
    answer = assess(ROBOT, None, sweep(), wedge, perception_age_s=None, touch=NOTHING, seed=SEED)
    assert (answer.engine, answer.tier) == ("numba-1", 3)


def test_a_polytope_counts_as_much_as_the_box_that_it_is():
    x, y, z = tcp()
    box = Box((x, y + 0.15, z - 0.1), (0.06, 0.04, 0.05))
    turned = np.array(CUBE) * 10 * np.array(box.half_m) + np.array(box.center_m)
    answers = [
        assess(
            ROBOT, replace(empty(), objects=(*empty().objects, Thing("it", "fragile", shape, 0.01))), sweep(), PATIENT,
            perception_age_s=0.1, touch=NOTHING, seed=SEED,
        )
        for shape in (box, Convex(tuple(map(tuple, turned.tolist()))))
    ]  # fmt: skip
    assert answers[0].index > 1.5
    assert answers[1].index == pytest.approx(answers[0].index, abs=0.011)
    assert answers[1].tier == answers[0].tier


def test_a_curved_motion_past_a_polytope_counts_it_as_the_box_that_it_is():
    unhurried = replace(PATIENT, watch_time_limit_s=60.0)
    x, y, z = tcp()
    box = Box((x, y + 0.15, z), (0.06, 0.04, 0.05))
    corners = np.array(CUBE) * 10 * np.array(box.half_m) + np.array(box.center_m)
    line = MoveL(HOME, (x, y + 0.06, z, *pose_of(HOME)[3:]), 0.1, 0.5)
    held = SpeedL(HOME, (0.0, 0.1, 0.0, 0.0, 0.0, 0.0), 1.0, 0.3)
    servo = ServoJ(HOME, (0.2, 0.0, 0.0, 0.0, 0.0, 0.0), (HOME[0] + 0.02, *HOME[1:]), 0.002, 0.1)
    path = LinePath(HOME, (LineLeg(line.target, 0.1, 0.5),))
    for motion in (line, held, servo, path):
        found, left = [], []
        for shape in (box, Convex(tuple(map(tuple, corners.tolist())))):
            scene = replace(empty(), objects=(*empty().objects, Thing("it", "fragile", shape, 0.01)))
            found.append(assess(ROBOT, scene, motion, unhurried, perception_age_s=0.1, touch=NOTHING, seed=SEED))
            left.append(
                remaining(
                    ROBOT, scene, motion, unhurried, at_rad=HOME, authorised_milli=found[-1].reading().index_milli + 20,
                    perception_age_s=0.1, touch=NOTHING,
                )
            )  # fmt: skip
        assert found[0].index > 1.1
        assert found[1].index == pytest.approx(found[0].index, abs=0.011)
        assert found[0].violations == found[1].violations
        met = "".join(found[0].violations)
        assert [(each.holds, each.cause) for each in left] == [(not met, met)] * 2


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.0, 0.05))
def test_p1_a_larger_radius_or_another_corner_never_lowers_the_clearance_index(seed, more):
    """P1 of polytopes: what is larger is nearer."""
    rng = np.random.default_rng([2210, seed])
    shape = random_convex(rng, np.array(tcp()) + rng.uniform(-0.2, 0.2, 3))
    corner = tuple((np.array(shape.vertices_m[0]) + rng.uniform(-0.1, 0.1, 3)).tolist())
    p, q = axes(rng, 10)
    ends = np.stack([p, q], axis=1) + np.array(tcp())

    def clear(each):
        cores, radius = cores_of([each] * 10)
        return core_distance(ends, cores)[0] - radius

    plain = clear(shape)
    rounder = clear(replace(shape, radius_m=shape.radius_m + more))
    assert rounder == pytest.approx(plain - more, abs=1e-12)
    assert (clear(replace(shape, vertices_m=(*shape.vertices_m, corner))) <= plain + 1e-9).all()


def test_mujoco_measures_the_same():
    from evaluation.pit.mujoco_sampled import SampledByMujoco
    from evaluation.pit.question import Question

    rng = np.random.default_rng(2211)
    for _ in range(5):
        shapes = [random_shape(rng, "v", 0.5, 0.9) for _ in range(3)]
        scene = Scene(objects=tuple(Thing(f"t{k}", "rigid", shape, 0.0) for k, shape in enumerate(shapes)))
        move = MoveJ(HOME, tuple(a + 0.1 for a in HOME), 0.5, 1.0)
        names = Question.__dataclass_fields__
        given_ = {"robot": ROBOT, "scene": scene, "motion": move, "cell": CELL}
        measured = SampledByMujoco(Question(**{name: given_.get(name) for name in names}))
        pairs = pairs_of(ROBOT, scene, CELL, grown_m=0.0)
        path = NumpyPath(ROBOT, move)
        ours = min(path.clearance_at(pairs, GRID // 2, np.arange(len(pairs))))
        assert measured.least([path.q(0.5)]) == pytest.approx(ours, abs=1e-4)
    assert mujoco.__version__


@pytest.mark.timeout(600)
def test_p13_every_number_of_a_polytope():
    far = ((1.1, 0.0, 0.2), (1.2, 0.0, 0.2), (1.1, 0.1, 0.2), (1.1, 0.0, 0.3))
    scene = Scene(
        objects=(Thing("wedge", "rigid", Convex(far, 0.01), 0.01, "camera", 0.1),),
        zones=(Zone("press", Convex(tuple((-x, y, z) for x, y, z in far)), None),),
    )
    found, count = matrix(lambda each: ask(scene=each, cell=PATIENT), scene)
    assert found == []
    assert count == (13 + 13 + 2) * len(BAD)


# ---- where shapes come from, and what else is asked of them


def test_an_observed_polytope_is_the_same_in_metres():
    shape = shape_of(wire.Convex(((0, 0, 0), (100_000, 0, 0), (0, 200_000, 0), (0, 0, -300_000)), 5_000))
    assert shape == Convex(((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, -0.3)), 0.005)


def test_a_surveyed_polytope_stands_in_the_scene():
    cell = CellParameters.from_toml(
        '[[objects]]\nname = "wedge"\n[objects.convex]\nradius_m = 0.01\n'
        "vertices_m = [[0.3,0.0,0.0],[0.4,0.0,0.0],[0.3,0.1,0.0],[0.3,0.0,0.1]]\n"
    )
    assert cell.objects[0].shape == cell.surveyed.objects[0].shape
    assert isinstance(cell.objects[0].shape, Convex)
    with pytest.raises(Exception) as refused:
        StaticObject("two", convex=Convex(CUBE), box=Box((0, 0, 0), (1, 1, 1))).shape
    assert refused.value.reason == "PARAMETERS_WRONG"


def test_nearest_points_of_a_rounded_polytope():
    part = PostureCapsule("rod", 1, (0.5, -0.2, 0.0), (0.5, 0.2, 0.0), 0.05)
    near = nearest(part, Convex(CUBE, 0.02))
    assert near.clearance_m == pytest.approx(0.5 - 0.1 - 0.05 - 0.02)
    assert near.on_thing_m[0] == pytest.approx(0.12)
    assert near.on_part_m[0] == pytest.approx(0.45)


@given(st.integers(0, 10**6))
def test_an_enclosing_capsule_holds_every_corner_and_is_not_vast(seed):
    rng = np.random.default_rng([2212, seed])
    points = np.array(random_convex(rng, rng.uniform(-1, 1, 3)).vertices_m)
    a, b, radius = capsule_around_points(points)
    way = b - a
    share = np.clip((points - a) @ way / max(way @ way, 1e-30), 0, 1)
    assert np.linalg.norm(points - a - share[:, None] * way, axis=1).max() <= radius
    widest = np.linalg.norm(points[:, None] - points[None], axis=2).max()
    assert radius <= widest
    assert np.linalg.norm(way) + 2 * radius <= 2.5 * widest


def test_a_gripped_polytope_is_held_as_a_capsule_around_it():
    rotation, origin = (each[0, -1] for each in link_frames(ROBOT, np.array([HOME])))
    grip = origin + rotation @ np.array(ROBOT.tool.tcp_m)
    shape = Convex(tuple(map(tuple, (np.array(CUBE) * 0.2 + grip).tolist())), 0.002)
    held = gripped(ROBOT, HOME, (Thing("part", "rigid", shape, 0.003),), CELL)
    assert held is not None
    assert held.object == "part"
    around = (np.array(shape.vertices_m) - origin) @ rotation
    a, b = np.array(held.ends_m)
    way = b - a
    share = np.clip((around - a) @ way / max(way @ way, 1e-30), 0, 1)
    reach = np.linalg.norm(around - a - share[:, None] * way, axis=1).max() + 0.002 + 0.003
    assert reach <= held.shape.radius_m + 1e-12
    axis = np.array([origin + rotation @ a, origin + rotation @ b])
    assert _outermost(shape, axis) == pytest.approx(reach - 0.003, abs=1e-12)


@given(corners)
def test_widths_are_the_least_and_the_greatest_of_all_directions(points):
    if spanning(points) is None:
        return
    least, most = widths_of(points)
    seen = np.ptp(np.array(points) @ directions(3000, 7).T, axis=0)
    assert least <= seen.min() + 1e-12
    assert most >= seen.max() - 1e-12
    assert seen.min() <= least + 0.1 * most  # of 3000 directions one is this near to it


def test_what_the_fingers_contradict_of_a_polytope():
    half = 20_000
    corners_um = tuple(itertools.product((-half, half), repeat=3))
    seen = wire.Convex(corners_um, 0)
    assert grip_contradicted(40_000, seen, on_something=True) == ""
    assert grip_contradicted(15_000, seen, on_something=True) != ""
    assert grip_contradicted(95_000, seen, on_something=True) != ""
    assert grip_contradicted(15_000, wire.Convex(corners_um, 3_000), on_something=True) != ""


def test_two_scenes_that_differ_in_a_corner_have_two_digests():
    def scene(last):
        return Scene(objects=(Thing("it", "rigid", Convex((*CUBE, (0.0, 0.0, last))), 0.0),))

    assert scene(0.3).digest != scene(math.nextafter(0.3, 1)).digest
    assert scene(0.3).digest == scene(0.3).digest


def test_a_capsule_of_corners_is_refused_by_nobody_but_counts_as_itself():
    """A rounded polytope about a capsule's axis is at least as near as the capsule."""
    rng = np.random.default_rng(2213)
    for _ in range(50):
        capsule = random_shape(rng, "c", 0.0, 0.3)
        a, b = np.array(capsule.a_m), np.array(capsule.b_m)
        corners_ = (
            *map(tuple, (a + 0.005 * directions(4, 8)).tolist()),
            *map(tuple, (b + 0.005 * directions(4, 8)).tolist()),
        )
        p, q = axes(rng, 10)
        ends = np.stack([p, q], axis=1)
        hull_cores, r = cores_of([Convex((*corners_, capsule.a_m, capsule.b_m), capsule.radius_m)] * 10)
        rod_cores, s = cores_of([Capsule(capsule.a_m, capsule.b_m, capsule.radius_m)] * 10)
        near, _ = core_distance(ends, hull_cores)
        far, _ = core_distance(ends, rod_cores)
        assert (near - r <= far - s + 1e-9).all()
        assert (near - r >= far - s - 0.005 - 1e-9).all()
