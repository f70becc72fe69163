"""Meshes out of files, their capsules, and the proof that these hold all of them."""

import itertools
import math
import struct

import numpy as np
import pytest
from pep.pit.geometry.triangle_mesh import TRIANGLES_LIMIT, mesh_of
from pep.pit.robot.mesh_capsules import ROOM_M, enclosed
from pep.pit.robot.mesh_cover import depths, distances, excess_of, uncovered

from pep.pit import ModelError

FACES = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]  # fmt: skip
"""Of a box whose corners are counted in the order of `itertools.product`."""


def box(size, center=(0, 0, 0)):
    """Triangles of a box."""
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * size + center
    return corners[np.array(FACES)]


def stl(triangles):
    """A binary STL."""
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *each.reshape(-1).tolist(), 0) for each in triangles)
    return b"\0" * 80 + struct.pack("<I", len(triangles)) + rows


def text_stl(triangles):
    """The same as text."""
    facets = (
        "facet normal 0 0 0 outer loop " + "".join(f"vertex {x!r} {y!r} {z!r}\n" for x, y, z in each.tolist()) + "endloop endfacet\n"
        for each in triangles
    )  # fmt: skip
    return ("solid a body\n" + "".join(facets) + "endsolid a body\n").encode()


def line(a, b, radius):
    return np.array(a, dtype=float), np.array(b, dtype=float), radius


BOX = box((0.1, 0.2, 0.4))


def test_a_mesh_is_read_from_both_forms():
    for raw in (stl(BOX), text_stl(BOX)):
        assert np.abs(mesh_of(raw, "m") - BOX).max() <= 1e-8
    assert np.abs(mesh_of(stl(1000 * BOX), "m", (1e-3, 1e-3, 1e-3)) - BOX).max() <= 1e-8


def refusal(raw, scale=(1.0, 1.0, 1.0)):
    with pytest.raises(ModelError) as caught:
        mesh_of(raw, "arm.stl", scale)
    assert caught.value.reason == "PHYSICS_FAULT"
    assert caught.value.detail.startswith("arm.stl: ")
    return caught.value.detail


@pytest.mark.parametrize(
    ("raw", "cause", "step"),
    [
        (stl(BOX[:-1]), "hole", "convex hull"),
        (stl(np.concatenate([BOX, BOX[:1]])), "hole", "convex hull"),
        (stl(1000 * BOX), "400 m", 'scale="0.001 0.001 0.001"'),
        (stl(1e-3 * BOX), "0.0004 m", "scale"),
        (stl(BOX)[:-20], "cut off", "export"),
        (text_stl(BOX)[:-40], "cut off", "export"),
        (text_stl(BOX).replace(b"vertex", b"vertices"), "one solid", "export"),
        (text_stl(BOX).replace(b"-0.05", b"minus"), "one solid", "export"),
        (stl(np.where(BOX > 0.19, np.nan, BOX)), "no number", "export"),
        (stl(np.where(BOX > 0.19, np.inf, BOX)), "no number", "export"),
        (stl(BOX[:3]), "fewer than four", "whole body"),
        (b"", "cut off", "export"),
        (b"\0" * 80 + struct.pack("<I", 1_000_000) + b"\0" * 50_000_000, "bytes", "decimate"),
        (stl(np.tile(BOX, (TRIANGLES_LIMIT // 12 + 1, 1, 1))), f"beyond {TRIANGLES_LIMIT}", "decimate"),
        (b"\x89PNG\r\n\x1a\n" + b"\0" * 200, "no STL", "export"),
    ],
    ids=["hole", "a face twice", "millimetres", "tiny", "cut off", "text cut off", "no vertices", "words", "nan", "inf",
         "three", "empty", "a million", "too many", "a picture"],
)  # fmt: skip
def test_a_mesh_that_is_no_body_is_refused_with_the_next_step(raw, cause, step):
    found = refusal(raw)
    assert cause in found
    assert step in found


def test_what_is_covered_is_in_the_capsules_and_what_is_not_is_found():
    """A box in one capsule, in two that share it, and in two with a slit between them."""
    corner = math.hypot(0.05, 0.1)
    assert uncovered(BOX, [line((0, 0, -0.2), (0, 0, 0.2), corner + 1e-6)]) == 0
    assert uncovered(BOX, [line((0, 0, -0.2), (0, 0, 0.2), corner - 1e-6)]) > 0
    reach = math.hypot(corner, 0.01)
    halves = [line((0, 0, s * 0.01), (0, 0, s * 0.2), reach + 1e-4) for s in (-1, 1)]
    assert uncovered(BOX, halves) == 0
    apart = [line((0, 0, s * (0.01 + 1e-4)), (0, 0, s * 0.2), corner + 1e-6) for s in (-1, 1)]
    assert uncovered(BOX, apart) > 0
    assert uncovered(BOX, halves[:1]) > 0


@pytest.mark.parametrize(
    ("size", "ends", "radius", "excess"),
    [
        ((0.2, 0.2, 0.2), ((0, 0, 0), (0, 0, 0)), 0.2, 0.1),  # over the middle of a side
        ((0.1, 0.1, 0.4), ((0, 0, -0.2), (0, 0, 0.2)), 0.08, 0.08),  # over an end
        ((0.1, 0.1, 0.4), ((0, 0, -0.2), (0, 0, 0.3)), 0.08, 0.18),
    ],
)
def test_the_excess_is_bounded_from_both_sides(size, ends, radius, excess):
    found = excess_of(box(size), [line(*ends, radius)])
    assert found.least_m <= excess + 1e-9
    assert excess <= found.most_m <= found.least_m + 0.0021
    assert excess - found.least_m <= 0.0021


def test_a_surface_inside_another_capsule_is_no_excess():
    """A ball of 0.3 m around a small one: the small one's surface counts for nothing."""
    both = [line((0, 0, 0), (0, 0, 0), 0.3), line((0, 0, 0.05), (0, 0, 0.05), 0.2)]
    alone, together = excess_of(box((0.2, 0.2, 0.2)), both[:1]), excess_of(box((0.2, 0.2, 0.2)), both)
    assert together.most_m == pytest.approx(alone.most_m, abs=0.0021)


@pytest.mark.parametrize("seed", range(4))
def test_distances_are_those_of_dense_points_on_the_triangles(seed):
    rng = np.random.default_rng(seed)
    triangles = rng.normal(size=(7, 3, 3))
    points = 2 * rng.normal(size=(40, 3))
    weights = rng.dirichlet([0.5, 0.5, 0.5], 20_000)
    on = np.einsum("wk,tkj->twj", weights, triangles).reshape(-1, 3)
    sampled = np.array([np.linalg.norm(on - point, axis=1).min() for point in points])
    found = distances(points, triangles)
    assert (found <= sampled + 1e-9).all()
    assert (sampled - found <= 0.05).all()


def spindle():
    """A body that is no convex one: two heads on a thin shaft, turned round z."""
    rings = [
        (0.0, -0.2),
        (0.09, -0.19),
        (0.09, -0.12),
        (0.03, -0.1),
        (0.03, 0.1),
        (0.07, 0.12),
        (0.07, 0.19),
        (0.0, 0.2),
    ]
    turn = np.linspace(0, 2 * math.pi, 24, endpoint=False)
    points = [np.stack([r * np.cos(turn), r * np.sin(turn), np.full(24, z)], axis=1) for r, z in rings]
    found = []
    for low, high in itertools.pairwise(points):
        for k in range(24):
            a, b, c, d = low[k], low[(k + 1) % 24], high[(k + 1) % 24], high[k]
            found += [
                t
                for t in ((a, b, c), (a, c, d))
                if not any(np.array_equal(p, q) for p, q in itertools.combinations(t, 2))
            ]
    return np.array(found)


def test_a_thin_shaft_between_heads_gets_a_capsule_of_its_own():
    """Every point of the mesh is in a capsule, and each of its corners so deep as is said."""
    triangles = mesh_of(stl(spindle()), "spindle")
    one, several = enclosed(triangles, "spindle", most=1), enclosed(triangles, "spindle", most=3)
    for found in (one, several):
        assert uncovered(triangles, found.lines) == 0
        deepest = np.max([depths(triangles.reshape(-1, 3), each) for each in found.lines], axis=0)
        assert deepest.min() >= ROOM_M - 1e-9
    assert len(several.lines) == 3
    assert min(radius for _, _, radius in several.lines) <= 0.06
    assert several.excess.most_m < one.excess.least_m


def test_the_same_mesh_gets_the_same_capsules():
    first, second = (enclosed(BOX, "box") for _ in range(2))
    assert [[*a, *b, r] for a, b, r in first.lines] == [[*a, *b, r] for a, b, r in second.lines]
