"""A scanner's fields: a person in one is anywhere in it, and a wire that broke counts as a person."""

import math
import random
import time

import pytest
from tests.pep.sensor.test_keypoints import depth_in

from pep.sensor import ScannerField, SensorError, entered

FIELD = ScannerField("front", [(1.0, -1.0), (3.0, -1.0), (3.0, 1.0), (1.0, 1.0)], floor_z_m=-0.8, plane_m=0.2)
ANGLED = ScannerField("door", [(1, 0), (3, 0), (3, 0.4), (1.5, 0.4), (1.5, 3), (1, 3)], floor_z_m=-0.8, plane_m=0.9)


def test_a_field_is_entered_where_its_bit_is_not_clear():
    assert entered([FIELD, ANGLED], [1, 1]) == []
    assert [each.id for each in entered([FIELD, ANGLED], [1, 0])] == ["door"]
    assert [each.id for each in entered([FIELD, ANGLED], [1, 0], clear=0)] == ["front"]
    assert [each.id for each in entered([FIELD, ANGLED], [False, False])] == ["front", "door"]


@pytest.mark.parametrize("field", [FIELD, ANGLED])
def test_somebody_anywhere_in_it_is_inside_up_to_their_height(field):
    person, draw = field.sight, random.Random(11)
    assert len(person.regions) <= 64 and {region for region, _ in person.regions} == {"head"} and person.unseen
    for _ in range(300):
        low, high = ((1, -1), (3, 1)) if field is FIELD else ((1, 0), (1.5, 3))
        at = [draw.uniform(a, b) for a, b in zip(low, high, strict=True)]
        assert depth_in(person, (*at, draw.uniform(-0.8, 1.2))) > 0


def test_a_low_scan_plane_reaches_further_as_iso_13855_has_it():
    # C = 1.2 - 0.4 x 0.2 = 1.12 m, of which physics adds 0.85: 0.27 m, and 0.10 m of error, beyond the edge at x = 1
    person = FIELD.sight
    assert depth_in(person, (0.64, 0.0, 0.0)) > 0
    # squares of at most 0.33 m: less than half a diagonal more
    assert depth_in(person, (1.0 - 0.37 - 0.24, 0.0, 0.0)) < 0
    # from 0.875 m on nothing is added: only the error
    assert depth_in(ANGLED.sight, (1.0 - 0.10 - 0.25, 1.0, 0.0)) < 0


def test_a_hall_is_laid_out_at_once_and_once():
    hall = ScannerField("hall", [(-25, -25), (25, -25), (25, 25), (-25, 25)], floor_z_m=-0.8, plane_m=0.3)
    began = time.process_time()
    assert len(hall.sight.regions) <= 60 and hall.sight is hall.sight
    assert time.process_time() - began < 1


@pytest.mark.parametrize(
    ("bits", "code"), [([1], "SIGHT_MALFORMED"), ([1, 2], "SIGHT_MALFORMED"), ([1, None], "SIGHT_MALFORMED")]
)
def test_a_bit_that_is_missing_is_refused(bits, code):
    with pytest.raises(SensorError) as refused:
        entered([FIELD, ANGLED], bits)
    assert refused.value.code == code


@pytest.mark.parametrize(
    ("outline", "plane", "code"),
    [
        ([(1000, -1000), (3000, -1000), (3000, 1000)], 0.2, "NOT_METRES"),
        ([(1, -1), (3, -1), (3, 1)], 300, "NOT_METRES"),
        ([(1, -1), (3, -1), (math.nan, 1)], 0.2, "NOT_FINITE"),
        ([(1, -1), (3, -1)], 0.2, "SIGHT_MALFORMED"),
        ([(1, -1), (2, -1), (3, -1)], 0.2, "SIGHT_MALFORMED"),
        ([(1, -1, 0), (3, -1, 0), (3, 1, 0)], 0.2, "SIGHT_MALFORMED"),
    ],
)
def test_a_field_that_is_none_is_refused(outline, plane, code):
    with pytest.raises(SensorError) as refused:
        ScannerField("f", outline, floor_z_m=-0.8, plane_m=plane)
    assert refused.value.code == code and refused.value.step
