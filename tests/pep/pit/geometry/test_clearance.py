"""Distances against coal, the trap in coal, and the interval bound against dense sampling."""

from dataclasses import replace

import coal
import numpy as np
import pinocchio
import pytest
from pep.pit.geometry.clearance import core_distance, segment_box, segment_segment
from pep.pit.geometry.solids import rotation_of
from pep.pit.path.straight_path import GRID
from pep.pit.scene.pairs import pairs_of
from tests.model.pit.path import NumpyPath
from tests.pep.pit.scenes import CELL, ROBOT, random_move, random_scene, random_shape

from pep.pit import Box, Capsule, Scene, Sphere, Thing


def placed(rotation, translation):
    pose = coal.Transform3s()
    pose.setRotation(rotation)
    pose.setTranslation(np.array(translation, dtype=float))
    return pose


def coal_shape(shape):
    match shape:
        case Sphere(center, radius):
            return coal.Sphere(radius), placed(np.eye(3), center)
        case Capsule(a, b, radius):
            a, b = np.array(a), np.array(b)
            turn = pinocchio.Quaternion.FromTwoVectors(np.array([0.0, 0, 1]), b - a).toRotationMatrix()
            return coal.Capsule(radius, float(np.linalg.norm(b - a))), placed(turn, (a + b) / 2)
        case Box(center, half, quaternion):
            return coal.Box(*(2 * h for h in half)), placed(rotation_of(quaternion), center)


def coal_distance(one, other):
    shape_a, pose_a = coal_shape(one)
    shape_b, pose_b = coal_shape(other)
    return coal.distance(shape_a, pose_a, shape_b, pose_b, coal.DistanceRequest(), coal.DistanceResult())


def ours(capsule, other):
    a, b = np.array([capsule.a_m]), np.array([capsule.b_m])
    match other:
        case Sphere(center, radius):
            x, y = segment_segment(a, b, np.array([center]), np.array([center]))
        case Capsule(c, d, radius):
            x, y = segment_segment(a, b, np.array([c]), np.array([d]))
        case Box(center, half, quaternion):
            radius = 0.0
            x, y = segment_box(a, b, np.array([center]), rotation_of(quaternion)[None], np.array([half]))
    return float(np.linalg.norm(x - y)) - capsule.radius_m - radius


@pytest.mark.parametrize(("kinds", "tolerance"), [("s", 1e-12), ("c", 1e-9), ("b", 2e-6)])
def test_distance_equals_coal_when_apart_and_agrees_on_contact(kinds, tolerance):
    rng = np.random.default_rng(11)
    for _ in range(1500):
        capsule, other = random_shape(rng, "c", 0.0, 0.6), random_shape(rng, kinds, 0.0, 0.6)
        theirs, mine = coal_distance(capsule, other), ours(capsule, other)
        if theirs > 1e-4:
            assert mine == pytest.approx(theirs, abs=tolerance)
        elif theirs < -1e-4:
            assert mine < 0


@pytest.mark.parametrize(
    ("p", "q", "c", "d", "distance"),
    [
        ((0, 0, 0), (0, 0, 0), (1, 0, 0), (1, 0, 0), 1),  # two points
        ((0, 0, 0), (0, 0, 0), (1, -1, 0), (1, 1, 0), 1),  # point and segment
        ((1, -1, 0), (1, 1, 0), (0, 0, 0), (0, 0, 0), 1),
        ((0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0), 1),  # parallel, overlapping
        ((0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0), 1),  # in one line
        ((0, 0, 0), (1, 0, 0), (3, 0, 0), (2, 0, 0), 1),  # likewise, turned around
        ((-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), 0),  # crossing
        ((-1, 0, 0), (1, 0, 0), (0, -1, 2), (0, 1, 2), 2),  # crossing above
        ((0, 0, 0), (1, 0, 0), (2, 1, 0), (3, 5, 0), 2**0.5),  # ends
    ],
)
def test_segments_that_are_special(p, q, c, d, distance):
    x, y = segment_segment(*(np.array([v], dtype=float) for v in (p, q, c, d)))
    assert np.linalg.norm(x - y) == pytest.approx(distance, abs=1e-12)


def test_segment_and_box_equals_dense_search():
    """The exact root against 4001 points of the segment, also when it runs along a face or through the box."""
    rng = np.random.default_rng(12)
    t = np.linspace(0, 1, 4001)[:, None]
    for k in range(400):
        p, q = rng.uniform(-1, 1, (2, 3))
        if k % 4 == 0:
            q[rng.integers(3)] = p[rng.integers(3)]
        if k % 7 == 0:
            q = p.copy()
        half = rng.uniform(0.05, 0.5, 3)
        x, y = segment_box(p[None], q[None], np.zeros((1, 3)), np.eye(3)[None], half[None])
        points = p + t * (q - p)
        dense = np.linalg.norm(points - np.clip(points, -half, half), axis=1).min()
        exact = float(np.linalg.norm(x - y))
        assert exact <= dense + 1e-12
        assert exact >= dense - np.linalg.norm(q - p) / 4000 - 1e-12


def test_coal_keeps_the_nearest_of_one_result():
    """The cause of the broad-phase trap: a second, farther pair overwrites a shared result. Remove the warning when this fails."""
    result, request = coal.DistanceResult(), coal.DistanceRequest()
    ball = coal.Sphere(0.1)
    for at in (1.0, 3.0):
        coal.distance(ball, placed(np.eye(3), (0, 0, 0)), ball, placed(np.eye(3), (at, 0, 0)), request, result)
    broken = result.min_distance == pytest.approx(2.8)
    kept = result.min_distance == pytest.approx(0.8)
    assert broken or kept
    if broken:
        # So no shared result and no broad-phase distance anywhere in the room.
        from pathlib import Path as File

        import pep.pit

        for source in File(pep.pit.__file__).parent.rglob("*.py"):
            text = source.read_text()
            assert "BroadPhase" not in text
            fresh = source.name == "remarks.py"  # a result of its own for each pair
            assert text.count("DistanceResult(") == fresh


def test_one_pass_over_all_pairs_is_right_where_the_manager_is_not():
    """`computeDistances` keeps one result per pair: the smallest equals coal asked pair by pair."""
    rng = np.random.default_rng(13)
    from pep.pit.second.second_engine import SecondWorld

    for _ in range(10):
        scene = random_scene(rng)
        pairs = pairs_of(ROBOT, scene, CELL, grown_m=0.0)
        move = random_move(rng)
        path = NumpyPath(ROBOT, move)
        clearance, _ = SecondWorld(ROBOT, scene, pairs).ask(path.q(0.5), np.zeros(6))
        kernel = path.clearance_at(pairs, GRID // 2, np.arange(len(pairs)))
        assert np.abs(clearance - kernel).max() <= 2e-6


def test_the_second_engine_measures_things_where_they_are_now():
    """Bodies of coal stay from scene to scene, and only what moved is put elsewhere."""
    rng = np.random.default_rng(15)
    from pep.pit.second import collision_model, straight_check

    for _ in range(10):
        scene, q = random_scene(rng), rng.uniform(-1, 1, 6)
        first, *rest = scene.objects
        moved = replace(scene, objects=(replace(first, shape=_lifted(first.shape)), *rest))
        seen = []
        for each in (scene, moved, scene):
            world = straight_check.SecondWorld(ROBOT, each, pairs_of(ROBOT, each, CELL, grown_m=0.0))
            seen.append(world.ask(q, np.ones(6))[0])
            # What is read again and again is where coal writes.
            told = [result.min_distance for result in world.stage.found.distanceResults]
            assert [result.min_distance for result in world.stage.distances] == told
            frames = list(world.stage.kinematics.oMi)
            assert (world.stage.turns == np.array([frame.rotation for frame in frames])).all()
            assert (world.stage.origins == np.array([frame.translation for frame in frames])).all()
        assert np.abs(seen[0] - seen[2]).max() <= 2e-6
        assert np.abs(seen[0] - seen[1]).max() > 1e-3
        collision_model.STAGES.of.cache_clear()
        world = straight_check.SecondWorld(ROBOT, moved, pairs_of(ROBOT, moved, CELL, grown_m=0.0))
        assert np.abs(world.ask(q, np.ones(6))[0] - seen[1]).max() <= 2e-6


def test_what_does_not_lie_at_equal_distances_is_no_array():
    rows = np.arange(12.0).reshape(6, 2)
    from pep.pit.second import collision_model

    assert (collision_model._in_one([rows[0], rows[2], rows[4]]) == rows[::2]).all()
    with pytest.raises(ValueError, match="equal distances"):
        collision_model._in_one([rows[0], rows[1], rows[3]])


def _lifted(shape):
    """The same shape, 5 cm higher."""
    names = ("a_m", "b_m") if isinstance(shape, Capsule) else ("center_m",)
    return replace(shape, **{name: (*getattr(shape, name)[:2], getattr(shape, name)[2] + 0.05) for name in names})


@pytest.mark.long
def test_interval_bound_holds_on_dense_samples():
    rng = np.random.default_rng(14)
    for _ in range(15):
        scene = random_scene(rng, things=6, regions=3)
        pairs = pairs_of(ROBOT, scene, CELL, grown_m=0.0)
        path = NumpyPath(ROBOT, random_move(rng))
        every = np.arange(len(pairs))
        for level in (4, 16):
            k = int(rng.integers(level))
            low, high = k * (GRID // level), (k + 1) * (GRID // level)
            leaves = path.examine(pairs, np.full(len(every), low), np.full(len(every), high), every)
            for key in np.linspace(low, high, 60).astype(np.int64):
                at, known = path.nodes(np.array([key]))
                distance, _ = core_distance(known.ends[at[0], pairs.body], pairs.cores)
                assert (distance - pairs.radii >= leaves.clear_m - 1e-12).all()
                body = pairs.body
                rush = known.speed[at[0], body] + path.layout.radius[body] * known.spin[at[0], body]
                assert (rush <= leaves.rush + 1e-12).all()


def test_where_cores_meet_nothing_is_proven_but_that_they_may_meet():
    """A body whose axis runs through a box has no separating direction: the bound is the deepest that can be."""
    at = random_move(np.random.default_rng(16))
    path = NumpyPath(ROBOT, at)
    pairs = pairs_of(ROBOT, Scene(objects=(Thing("all", "rigid", Box((0, 0, 0), (2, 2, 2)), 0.0),)), CELL, grown_m=0.0)
    inside = np.flatnonzero(pairs.cores.is_box)
    leaves = path.examine(pairs, np.full(len(inside), 0), np.full(len(inside), GRID), inside)
    assert (leaves.clear_mid_m == -pairs.radii[inside]).all()
    assert (leaves.clear_m == -pairs.radii[inside]).all()


def test_bound_closes_with_the_square_of_the_interval():
    """Halving an interval twice brings the bound at least four times nearer: second order, not first."""
    rng = np.random.default_rng(15)
    scene = random_scene(rng, things=6)
    pairs = pairs_of(ROBOT, scene, CELL, grown_m=0.0)
    path = NumpyPath(ROBOT, random_move(rng))
    every = np.arange(len(pairs))
    slack = []
    for width in (2**18, 2**16):
        mid = GRID // 3
        leaves = path.examine(
            pairs, np.full(len(every), mid - width // 2), np.full(len(every), mid + width // 2), every
        )
        keys = np.linspace(mid - width // 2, mid + width // 2, 40).astype(np.int64)
        truth = np.min([path.clearance_at(pairs, int(k), every) for k in keys], axis=0)
        apart = truth > 0
        slack.append(float((truth - leaves.clear_m)[apart].max()))
    assert slack[1] <= slack[0] / 4
