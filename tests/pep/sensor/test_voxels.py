"""Point clouds and OctoMaps as boxes: all that is occupied is covered, and their number, time and size are bounded."""

import math
import time

import numpy as np
import pytest

from pep.sensor import Camera, SensorError, cloud_boxes, octomap_boxes

SPACE = {"low_m": (-1, -1, 0), "high_m": (1, 1, 1)}


def spans(boxes):
    """(low, high) corners of boxes, metres."""
    return [
        tuple(tuple(round((c + s * h) / 1e6, 6) for c, h in zip(b.shape.center_um, b.shape.half_um, strict=True)) for s in (-1, 1))
        for b in boxes
    ]  # fmt: skip


def covers(boxes, points):
    found = np.zeros(len(points), dtype=bool)
    for low, high in spans(boxes):
        found |= ((points >= np.array(low) - 1e-6) & (points <= np.array(high) + 1e-6)).all(axis=1)
    return found.all()


def test_a_block_of_points_is_one_box_on_the_grid():
    block = np.array([[x, y, z] for x in (0.11, 0.16, 0.21) for y in (0.02, 0.07) for z in (0.01, 0.06)])
    boxes = cloud_boxes(block, **SPACE, voxel_m=0.05)
    assert spans(boxes) == [((0.1, 0.0, 0.0), (0.25, 0.1, 0.1))]
    assert (boxes[0].id, boxes[0].kind) == ("cloud-0", "rigid")


def test_points_of_a_camera_come_into_the_base_frame():
    above = Camera((0.5, 0.0, 1.0), ((1, 0, 0), (0, -1, 0), (0, 0, -1)))
    boxes = cloud_boxes([(0.02, 0.03, 0.97)], **SPACE, voxel_m=0.1, camera=above)
    # (0.52, -0.03, 0.03): the voxel from 0.5 to 0.6, -0.1 to 0.0, 0.0 to 0.1
    assert spans(boxes) == [((0.5, -0.1, 0.0), (0.6, 0.0, 0.1))]


@pytest.mark.parametrize("most", [1, 8, 64])
def test_a_ragged_surface_is_covered_by_few_boxes(most):
    draw = np.random.default_rng(3)
    x, y = draw.uniform(-1, 1, (2, 20_000))
    points = np.stack([x, y, 0.3 + 0.2 * np.sin(5 * x) * np.cos(4 * y)], axis=1)
    boxes = cloud_boxes(points, **SPACE, voxel_m=0.02, most=most)
    assert 0 < len(boxes) <= most and covers(boxes, points)


def test_outside_the_space_nothing_is_told_and_rays_without_a_distance_are_none():
    points = np.array([[5.0, 0, 0.5], [0.5, 0.5, 0.5], [math.nan] * 3, [0, 0, 0]])
    assert len(cloud_boxes(points, **SPACE)) == 1
    assert cloud_boxes(points[:1], **SPACE) == []


def test_a_million_points_take_a_moment():
    points = np.random.default_rng(5).uniform((-1, -1, 0), (1, 1, 1), (1_000_000, 3))
    began = time.process_time()
    assert covers(cloud_boxes(points, **SPACE, voxel_m=0.02), points[::1000])
    assert time.process_time() - began < 5


def test_leaves_of_every_size_are_covered_and_no_other_voxel():
    boxes = octomap_boxes([(0.2, 0.2, 0.2), (-0.475, 0.025, 0.025)], [0.4, 0.05], **SPACE, voxel_m=0.05)
    assert sorted(spans(boxes)) == [((-0.5, 0.0, 0.0), (-0.45, 0.05, 0.05)), ((0.0, 0.0, 0.0), (0.4, 0.4, 0.4))]
    assert octomap_boxes([(1.2, 0.2, 0.2)], [0.4], **SPACE, voxel_m=0.05) == []  # it ends where the space does
    ((low, high),) = spans(octomap_boxes([(1.1, 0.2, 0.2)], [0.4], **SPACE, voxel_m=0.05))
    assert (low, high) == ((0.9, 0.0, 0.0), (1.0, 0.4, 0.4))


@pytest.mark.parametrize(
    ("ask", "code"),
    [
        (lambda: cloud_boxes(np.broadcast_to(0.5, (10_000_000, 3)), **SPACE), "TOO_LARGE"),
        (lambda: cloud_boxes(np.full((100, 3), math.nan), **SPACE), "NO_DEPTH"),
        (lambda: cloud_boxes(np.zeros((100, 3)), **SPACE), "NO_DEPTH"),
        (lambda: cloud_boxes(np.zeros((0, 3)), **SPACE), "NO_DEPTH"),
        (lambda: cloud_boxes(np.full((100, 3), 500.0), **SPACE), "NOT_METRES"),
        (lambda: cloud_boxes(np.ones((100, 2)), **SPACE), "SIGHT_MALFORMED"),
        (lambda: cloud_boxes(np.ones((1, 3)), low_m=(0, 0, 0), high_m=(1, 1, 0)), "SIGHT_MALFORMED"),
        (lambda: cloud_boxes(np.ones((1, 3)), low_m=(-1000, 0, 0), high_m=(1, 1, 1)), "NOT_METRES"),
        (lambda: cloud_boxes(np.ones((1, 3)), **SPACE, voxel_m=0.001), "TOO_LARGE"),
        (lambda: cloud_boxes(np.ones((1, 3)), **SPACE, voxel_m=0), "SIGHT_MALFORMED"),
        (lambda: cloud_boxes(np.ones((1, 3)), **SPACE, most=1000), "SIGHT_MALFORMED"),
        (lambda: octomap_boxes(np.ones((300_000, 3)), np.ones(300_000), **SPACE), "TOO_LARGE"),
        (lambda: octomap_boxes([(math.nan, 0, 0)], [0.1], **SPACE), "NOT_FINITE"),
        (lambda: octomap_boxes([(0, 0, 0)], [0.0], **SPACE), "SIGHT_MALFORMED"),
        (lambda: octomap_boxes([(0, 0, 0)], [0.1, 0.1], **SPACE), "SIGHT_MALFORMED"),
        (lambda: octomap_boxes([(500, 0, 0)], [50], **SPACE), "NOT_METRES"),
    ],
)
def test_a_cloud_or_map_that_cannot_be_told_is_refused(ask, code):
    with pytest.raises(SensorError) as refused:
        ask()
    assert refused.value.code == code and refused.value.step
