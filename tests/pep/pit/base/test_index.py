"""P1 to P4 and P10 on the index functions, the tie of tiers, and agreement with the slow twin."""

import math

import numpy as np
import pytest
from capabilities.values.scope import Tier
from hypothesis import given
from hypothesis import strategies as st
from pep.pit.base.tier import TIE, person_index, ratio_index, thing_index, tier_of, zone_index
from pep.pit.scene.cell import CellParameters
from pep.pit.scene.contact_limits import LIMITS, contact_speed_m_s, harm_speed_m_s
from pep.pit.scene.scene import Region
from pep.pit.scene.separation import stopping
from tests.pep.pit import twin
from tests.pep.pit.scenes import ROBOT

CELL = CellParameters()
DISTANCE = st.floats(-0.3, 3.0)
SPEED = st.just(0.0) | st.floats(1e-6, 3)  # slower commands are refused
OMEGA = st.floats(0, 6)
AGE = st.floats(0, 2)
HARM = st.floats(0.05, 3)


def at(age, omega):
    return stopping(CELL, perception_age_s=age, joint_speed_rad_s=omega)


def person(d, v, age, omega, harm=0.8, z=0.055, c=0.1):
    index = person_index(
        np.array([d - z]), np.array([d]), np.array([v]), harm_speed=np.array([harm]), intrusion=np.array([c]),
        warn_band=CELL.warn_band_m, penetration_band=CELL.penetration_band_m, stop=at(age, omega),
    )  # fmt: skip
    return float(index[0])


def thing(d, v, omega, band):
    return float(thing_index(np.array([d]), np.array([v]), band=np.array([band]), stop=at(0.1, omega))[0])


def zone(d, v, omega, tier):
    index = zone_index(
        np.array([d]), np.array([v]), band=np.array([0.02]), declared=np.array([tier]), stop=at(0.1, omega)
    )
    return float(index[0])


@given(d=DISTANCE, v=SPEED, age=AGE, omega=OMEGA, harm=HARM, z=st.floats(0, 0.2))
def test_equals_the_slow_twin(d, v, age, omega, harm, z):
    assert person(d, v, age, omega, harm, z) == pytest.approx(
        twin.person(d - z, d, v, harm, age=age, omega=omega), abs=1e-9
    )
    assert thing(d, v, omega, 0.25) == pytest.approx(twin.thing(d, v, 0.25, omega=omega), abs=1e-9)
    assert zone(d, v, omega, 3) == pytest.approx(twin.zone(d, v, 3, omega=omega), abs=1e-9)


@given(near=DISTANCE, more=st.floats(0, 1), v=SPEED, age=AGE, omega=OMEGA, harm=HARM)
def test_p1_closer_never_lowers(near, more, v, age, omega, harm):
    assert person(near, v, age, omega, harm) >= person(near + more, v, age, omega, harm) - TIE
    for band in (0.02, 0.25):
        assert thing(near, v, omega, band) >= thing(near + more, v, omega, band) - TIE
    assert zone(near, v, omega, 4) >= zone(near + more, v, omega, 4) - TIE


@given(d=DISTANCE, v=SPEED, faster=st.floats(0, 2), age=AGE, omega=OMEGA, quicker=st.floats(0, 3), harm=HARM)
def test_p2_faster_never_lowers(d, v, faster, age, omega, quicker, harm):
    assert person(d, v + faster, age, omega + quicker, harm) >= person(d, v, age, omega, harm) - TIE
    for band in (0.02, 0.25):
        assert thing(d, v + faster, omega + quicker, band) >= thing(d, v, omega, band) - TIE
    assert zone(d, v + faster, omega + quicker, 2) >= zone(d, v, omega, 2) - TIE


@given(d=DISTANCE, v=SPEED, age=AGE, older=st.floats(0, 3), omega=OMEGA, z=st.floats(0, 0.2), vaguer=st.floats(0, 0.5))
def test_p3_older_or_vaguer_never_lowers(d, v, age, older, omega, z, vaguer):
    assert person(d, v, age + older, omega, z=z + vaguer) >= person(d, v, age, omega, z=z) - TIE


@given(region=st.sampled_from(list(Region)), mass=st.floats(0.5, 12), heavier=st.floats(0, 10))
def test_p4_heavier_never_raises_the_speed_that_is_borne(region, mass, heavier):
    light, heavy = (contact_speed_m_s(region, mass_kg=m, area_m2=1.96e-4) for m in (mass, mass + heavier))
    assert heavy <= light
    assert person(0.1, 1.0, 0.1, 1.0, heavy) >= person(0.1, 1.0, 0.1, 1.0, light) - TIE


@given(d=DISTANCE, v=st.floats(1e-3, 3), omega=OMEGA, harm=HARM)
def test_p10_continuous_in_distance(d, v, omega, harm):
    step = 1e-7
    hit = v * (0.21 + 0.06 + omega / 16)
    steepest = max(1 / 0.02, (v / harm) / hit, 1 / (v * 0.06))
    for index in (
        lambda x: person(x, v, 0.1, omega, harm),
        lambda x: thing(x, v, omega, 0.02),
        lambda x: zone(x, v, omega, 4),
    ):
        assert abs(index(d + step) - index(d)) <= 4 * steepest * step + 1e-9


@given(d=DISTANCE, v=st.floats(1e-3, 3), omega=OMEGA)
def test_p10_continuous_in_speed(d, v, omega):
    step = 1e-9
    assert abs(person(d, v + step, 0.1, omega) - person(d, v, 0.1, omega)) <= 1e-3
    assert abs(thing(d, v + step, omega, 0.02) - thing(d, v, omega, 0.02)) <= 1e-3


def test_ratio_bands():
    table = {0: 0, 0.5: 1, 0.75: 1, 0.825: 1.5, 0.9: 2, 0.95: 2.5, 1.0: 3, 1.0001: 4, math.inf: 4}
    for ratio, index in table.items():
        assert ratio_index(ratio) == pytest.approx(index)
    for bad in (math.nan, -1):
        with pytest.raises(ValueError):
            ratio_index(bad)


def test_one_tie_for_all_tiers():
    table = {0: 0, 1e-12: 0, 0.5: 1, 1: 1, 1 + 1e-10: 1, 1 + 1e-8: 2, 3: 3, 3.001: 4, 4: 4}
    for index, tier in table.items():
        assert tier_of(index) is Tier(tier)
    for bad in (math.nan, -0.1, 4.1, math.inf):
        with pytest.raises(ValueError):
            tier_of(bad)


@pytest.mark.parametrize("region", list(Region))
def test_speed_limits_of_body_regions(region):
    """The published worked table: m_R of 5.4 kg, force limit, transient but for the face; millimetres per second."""
    table = {
        "head": 152, "neck": 1354, "torso": 812, "abdomen": 1009, "pelvis": 1044,
        "upper_arm": 1247, "lower_arm": 1324, "hand": 1391, "thigh": 877, "shin": 473,
    }  # fmt: skip
    speed = contact_speed_m_s(region, mass_kg=5.4, area_m2=CELL.contact_area_m2)
    assert speed * 1000 == pytest.approx(table[region], abs=1)
    mass = ROBOT.moving_mass_kg / 2 + ROBOT.tool.mass_kg
    assert harm_speed_m_s(region, ROBOT, CELL) == pytest.approx(twin.harm_speed(region, mass))
    assert set(LIMITS) == set(Region)


def test_a_part_of_unknown_mass_is_the_heaviest_and_sharpest():
    unknown, held = CellParameters(payload_kg=None), CellParameters(payload_kg=3.0)
    for region in Region:
        assert harm_speed_m_s(region, ROBOT, unknown) <= harm_speed_m_s(region, ROBOT, held)
