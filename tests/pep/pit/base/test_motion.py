"""The trapezoid in closed form against itself in the time domain and against dense sampling."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.pit.base.motion import Profile, profile_of

from pep.pit import MoveJ

PROFILES = st.builds(Profile, st.floats(1e-3, 6), st.floats(1e-3, 6), st.floats(1e-2, 40))


@given(profile=PROFILES, share=st.floats(0, 1))
def test_rate_along_the_path_is_rate_in_time(profile, share):
    s, rate = profile.at(share * profile.duration_s)
    assert profile.rate(np.array([s]))[0] == pytest.approx(
        rate, rel=1e-5, abs=1e-5 * profile.peak_rad_s / profile.way_rad
    )
    assert profile.time_of(s) == pytest.approx(share * profile.duration_s, rel=1e-6, abs=1e-6 * profile.duration_s)


@given(profile=PROFILES, a=st.floats(0, 1), b=st.floats(0, 1))
def test_supremum_of_the_rate(profile, a, b):
    low, high = min(a, b), max(a, b)
    dense = profile.rate(np.linspace(low, high, 500)).max()
    bound = profile.highest_rate(np.array([low]), np.array([high]))[0]
    assert dense <= bound * (1 + 1e-12)
    if low <= 0.5 <= high:
        assert bound * profile.way_rad == pytest.approx(profile.peak_rad_s)


@given(profile=PROFILES)
def test_the_way_is_the_integral_of_the_speed(profile):
    times = np.linspace(0, profile.duration_s, 4001)
    rates = np.array([profile.at(t)[1] for t in times])
    assert np.trapezoid(rates, times) == pytest.approx(1, rel=1e-3)
    assert profile.at(0)[0] == 0
    assert profile.at(profile.duration_s)[0] == pytest.approx(1)
    assert rates.max() * profile.way_rad <= min(profile.speed_rad_s, profile.peak_rad_s) * (1 + 1e-12)


def test_the_leading_axis_leads_and_no_way_is_no_motion():
    q = (0.1, -1.0, 0.5, 0.2, -0.3, 1.0)
    assert profile_of(MoveJ(q, q, 1.0, 1.0)) is None
    profile = profile_of(MoveJ(q, (0.3, -1.7, 0.5, 0.2, -0.3, 1.0), 0.5, 1.0))
    assert profile.way_rad == pytest.approx(0.7)
    assert profile.peak_rad_s == 0.5
