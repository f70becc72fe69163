"""Cobot-Claw's 3D vision and kinematics: what is found by the depths alone, and joint angles that reach a place."""

from __future__ import annotations

import math

import pytest

pytest.importorskip("mujoco", reason="3D vision casts its rays by MuJoCo")

from cobot_claw import depth, reach
from cobot_claw.table import PART
from ursim.sensor.sensor_scene import Seen

GLASS = {
    "id": "truth",
    "kind": "fragile",
    "shape": {"type": "capsule", "a_m": [-0.27, -0.25, 0.03], "b_m": [-0.27, -0.25, 0.1], "radius_m": 0.035},
}
PIXEL_M = 2 * depth.SPREAD * depth.CAMERA_M[2] / depth.PIXELS


@pytest.fixture(scope="module")
def camera():
    return depth.DepthCamera()


def seen(camera, *, people=(), objects=()):
    _, there, things = Seen.nothing().told({"people": list(people), "objects": list(objects)}, now_s=0).at(0)
    return camera.detect(camera.capture(there, things))


def test_an_empty_cell_shows_nothing(camera):
    assert seen(camera) == []


def test_a_part_a_glass_and_a_person_are_told_apart_and_enclosed(camera):
    found = {
        each.kind: each for each in seen(camera, people=[{"id": "p", "x_m": -0.9, "y_m": 0.3}], objects=[PART, GLASS])
    }
    assert sorted(found) == ["glass", "part", "person"]
    part, half = found["part"], PART["shape"]["half_m"]
    for axis in range(2):
        middle = PART["shape"]["center_m"][axis]
        assert part.low_m[axis] <= middle - half[axis]
        assert part.high_m[axis] >= middle + half[axis]
        assert part.high_m[axis] - part.low_m[axis] <= 2 * half[axis] + 2 * PIXEL_M + 2 * depth.GRID_M
    assert part.high_m[2] == pytest.approx(0.045, abs=1e-6)
    assert math.dist(found["person"].middle_m[:2], (-0.9, 0.3)) <= 2 * PIXEL_M


def test_things_keep_their_names_while_they_move_a_little(camera):
    following = depth.Following()
    first = following.named(seen(camera, objects=[PART, GLASS]))
    moved = {**PART, "shape": {**PART["shape"], "center_m": [-0.34, -0.05, 0.02]}}
    again = following.named(seen(camera, objects=[GLASS, moved]))
    assert {each.name for each in first} == {each.name for each in again} == {"part-1", "glass-1"}


def test_nothing_but_a_low_small_thing_is_a_part(camera):
    tall = {**PART, "shape": {**PART["shape"], "center_m": [-0.3, -0.05, 0.2], "half_m": [0.05, 0.05, 0.2]}}
    (found,) = seen(camera, objects=[tall])
    assert found.kind == "thing"
    (told,) = depth.commands_of(depth.Following().named([found]))["objects"]
    assert told["kind"] == "fragile"


@pytest.mark.parametrize("place", [(-0.3, -0.05, 0.12), (-0.3, -0.05, 0.02), (-0.25, 0.2, 0.15), (-0.4, -0.2, 0.1)])
def test_the_fingers_are_where_they_were_wanted(place):
    assert math.dist(reach.tool_at(reach.joints_at(*place)), place) <= 1e-5


@pytest.mark.parametrize("place", [(3.0, 0.0, 0.1), (-0.9, 0.0, 0.1), (math.nan, 0.0, 0.1), (math.inf, 0.0, 0.0)])
def test_what_is_out_of_reach_has_no_angles(place):
    with pytest.raises(reach.OutOfReachError):
        reach.joints_at(*place)
