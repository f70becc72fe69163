"""A camera's pixels and points in the base frame, by hand.

It hangs 2 m up, 1 m before the base, and looks straight down.
"""

import math

import numpy as np
import pytest

from pep.sensor import Camera, PixelBox, SensorError, SolidBox, detected

DOWN = ((1, 0, 0), (0, -1, 0), (0, 0, -1))
"""Turn of a camera that looks down: its axes are x, -y and -z of the base frame."""
ABOVE = Camera((1.0, 0.0, 2.0), DOWN, fx=600, fy=500, cx=320, cy=240)


def near(point, wanted):
    assert point == pytest.approx(wanted, abs=1e-9)


def test_a_pixel_with_depth_is_where_the_pinhole_puts_it():
    # 60 px right of the centre at 2 m: 60 / 600 x 2 = 0.2 m; 100 px below: 100 / 500 x 2 = 0.4 m
    near(ABOVE.point(380, 340, 2.0), (0.2, 0.4, 2.0))
    near(ABOVE.in_base(ABOVE.point(380, 340, 2.0)), (1.2, -0.4, 0.0))
    near(ABOVE.in_base(ABOVE.point(320, 240, 0.5)), (1.0, 0.0, 1.5))


def test_a_point_behind_another_is_on_the_line_of_sight():
    # (0.3, 0, 0.4) is 0.5 m away; 0.1 m behind it is 0.6 m away: (0.36, 0, 0.48)
    near(ABOVE.behind((0.3, 0.0, 0.4), 0.1), (1.36, 0.0, 1.52))


def test_a_pose_as_a_matrix_is_the_same_camera():
    pose = [[1, 0, 0, 1.0], [0, -1, 0, 0.0], [0, 0, -1, 2.0], [0, 0, 0, 1]]
    other = Camera.posed(pose, [[600, 0, 320], [0, 500, 240], [0, 0, 1]])
    assert other.in_base(other.point(380, 340, 2.0)) == ABOVE.in_base(ABOVE.point(380, 340, 2.0))


@pytest.mark.parametrize(
    ("ask", "code"),
    [
        (lambda: ABOVE.point(1, 1, 0), "NO_DEPTH"),
        (lambda: ABOVE.point(1, 1, math.nan), "NO_DEPTH"),
        (lambda: ABOVE.point(1, 1, None), "NO_DEPTH"),
        (lambda: ABOVE.point(1, 1, np.float32("nan")), "NO_DEPTH"),
        (lambda: ABOVE.point(1, 1, np.uint16(1850)), "NOT_METRES"),
        (lambda: ABOVE.point(1, 1, "1.85"), "SIGHT_MALFORMED"),
        (lambda: ABOVE.point(1, 1, -1), "SIGHT_MALFORMED"),
        (lambda: ABOVE.point(math.inf, 1, 1), "NOT_FINITE"),
        (lambda: ABOVE.behind((0, 0, 0), 0.1), "NO_DEPTH"),
        (lambda: Camera((1, 0, 2), DOWN).point(1, 1, 1), "SIGHT_MALFORMED"),
        (lambda: Camera((1000, 0, 2000), DOWN), "NOT_METRES"),
        (lambda: Camera((1, 0, math.nan), DOWN), "NOT_FINITE"),
        (lambda: Camera((1, 0, 2), ((1, 0, 0), (0, 1, 0), (0, 0, -1))), "SIGHT_MALFORMED"),  # a mirror
        (lambda: Camera((1, 0, 2), ((2, 0, 0), (0, 1, 0), (0, 0, 1))), "SIGHT_MALFORMED"),
        (lambda: Camera.posed([[1, 0, 0], [0, 1, 0], [0, 0, 1]]), "SIGHT_MALFORMED"),
    ],
)
def test_what_is_no_camera_or_point_of_one_is_refused(ask, code):
    with pytest.raises(SensorError) as refused:
        ask()
    assert refused.value.code == code and refused.value.step


# --- detections ------------------------------------------------------------------------------------------------------

KINDS = {"person": "person", "cup": "fragile", "crate": "rigid"}


def corners(thing):
    return {tuple(round(each / 1e6, 4) for each in vertex) for vertex in thing.shape.vertices_um}


def test_a_box_of_pixels_is_the_piece_of_its_view_between_its_depths():
    people, (cup,) = detected([PixelBox("cup", (320, 240, 380, 340), 1.0, 2.0, id="cup-1")], ABOVE, kinds=KINDS)
    # at 1 m the box is 0.1 m by 0.2 m, at 2 m twice that; y goes down in the image, and 1 m deep is z = 1 m
    assert corners(cup) == {
        (1.0, 0.0, 1.0), (1.1, 0.0, 1.0), (1.0, -0.2, 1.0), (1.1, -0.2, 1.0),
        (1.0, 0.0, 0.0), (1.2, 0.0, 0.0), (1.0, -0.4, 0.0), (1.2, -0.4, 0.0),
    }  # fmt: skip
    assert (people, cup.id, cup.kind) == ([], "cup-1", "fragile")


def test_a_solid_box_is_turned_with_the_camera():
    _, (crate,) = detected([SolidBox("crate", (0.1, 0.2, 1.9), (0.2, 0.4, 0.1), id="crate-1")], ABOVE, kinds=KINDS)
    wanted = {(x, y, z) for x in (1.0, 1.2) for y in (0.0, -0.4) for z in (0.15, 0.05)}
    assert (corners(crate), crate.kind) == (wanted, "rigid")


def test_a_person_is_a_rod_around_all_corners_of_the_region_with_the_least_limits():
    (person,), _ = detected([SolidBox("person", (0.0, 0.0, 1.9), (0.6, 0.4, 1.8))], ABOVE, kinds=KINDS, error_m=0.05)
    ((region, shape),) = person.regions
    # the longest axis is the camera's own z, from z = 1.0 m to -0.8 m; the corners are hypot(0.3, 0.2) off it
    assert region == "head" and person.unseen
    assert {shape.a_um, shape.b_um} == {(1_000_000, 0, 1_000_000), (1_000_000, 0, -800_000)}
    assert shape.radius_um == pytest.approx((math.hypot(0.3, 0.2) + 0.05) * 1e6, abs=1)


@pytest.mark.parametrize(
    ("label", "confidence", "size", "kind"),
    [
        ("crate", 0.9, 0.2, "rigid"),
        ("crate", 0.4, 0.2, "fragile"),  # not sure that it is a crate
        ("crate", 0.4, 0.6, "person"),
        ("plant", 0.9, 0.2, "fragile"),  # nobody said what a plant is
        ("plant", 0.9, 0.6, "person"),
        ("person", 0.1, 0.2, "person"),
    ],
)
def test_a_doubtful_detection_is_the_worst_that_it_could_be(label, confidence, size, kind):
    people, things = detected([SolidBox(label, (0, 0, 1), (size,) * 3, confidence, "x")], ABOVE, kinds=KINDS)
    assert kind == ("person" if people else things[0].kind)


@pytest.mark.parametrize(
    ("found", "code"),
    [
        (PixelBox("cup", (320, 240, 380, 340), 0.0, 2.0, id="c"), "NO_DEPTH"),
        (PixelBox("cup", (320, 240, 380, 340), math.nan, 2.0, id="c"), "NOT_FINITE"),
        (PixelBox("cup", (320, 240, 380, 340), 1000, 2000, id="c"), "NOT_METRES"),
        (PixelBox("cup", (320, 240, 380, 340), 1.0, 1.0, id="c"), "SIGHT_MALFORMED"),
        (PixelBox("cup", (380, 240, 320, 340), 1.0, 2.0, id="c"), "SIGHT_MALFORMED"),
        (SolidBox("cup", (0, 0, 0), (0.1,) * 3, id="c"), "NO_DEPTH"),
        (SolidBox("cup", (0, 0, 1), (0.1,) * 3), "SIGHT_MALFORMED"),  # a thing without an id
        (SolidBox("cup", (0, 0, 1), (0.1, 0.0, 0.1), id="c"), "SIGHT_MALFORMED"),
        (SolidBox("cup", (0, 0, 1), (0.1,) * 3, 7, "c"), "SIGHT_MALFORMED"),
    ],
)
def test_a_detection_that_is_none_is_refused(found, code):
    with pytest.raises(SensorError) as refused:
        detected([found], ABOVE, kinds=KINDS)
    assert refused.value.code == code and refused.value.step
