"""A program's doubles are whole units of a request before it is judged, and those are written."""

import math
from dataclasses import fields

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.rtde.command.rounding import on_grid
from pep.rtde.judge.command_requests import CommandedOperation, ToolSetup, asked_of, request_of
from policies.evidence.model import Request

from pep.rtde.command import command_values as v

NUMBER = st.floats(-100, 100)
SIX = st.tuples(*[NUMBER] * 6)
THREE = st.tuples(*[NUMBER] * 3)
ROUNDED = st.one_of(
    st.builds(v.MoveJ, SIX, NUMBER, NUMBER, st.booleans()),
    st.builds(v.MoveL, SIX, NUMBER, NUMBER, st.booleans()),
    st.builds(v.SpeedL, SIX, NUMBER, st.floats(0, 100)),
    st.builds(v.SetTcp, SIX),
    st.builds(v.SetPayload, st.floats(0, 100), THREE),
)


def numbers(command):
    """Every number of a command, in order."""
    found = []
    for field in fields(command):
        value = getattr(command, field.name)
        found += value if isinstance(value, tuple) else [value]
    return found


@given(ROUNDED)
def test_every_request_is_one_of_whole_units(command):
    taken = on_grid(command)
    own = taken.pose_m_rad if isinstance(taken, v.SetTcp) else (0.0,) * 6
    held = (taken.mass_kg, taken.centre_m) if isinstance(taken, v.SetPayload) else (0.0, (0.0,) * 3)
    asked = asked_of(taken, path=(), fitted=ToolSetup(own, *held))
    assert isinstance(asked, CommandedOperation)
    assert isinstance(request_of(asked, request_id="", audience="http://a/b", at=0.0), Request)


@given(ROUNDED)
def test_nothing_is_farther_off_than_half_a_unit_and_taken_once_it_stays(command):
    taken = on_grid(command)
    unit = {v.SetPayload: 1e-3, v.SpeedL: 1e-3}.get(type(command), 1e-6)  # a gram, a millisecond; else a millionth
    assert all(abs(a - b) <= 0.5001 * unit for a, b in zip(numbers(command), numbers(taken), strict=True))
    assert on_grid(taken) == taken


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e308])
def test_what_is_no_number_stays_and_is_refused_later(bad):
    taken = on_grid(v.MoveJ((bad, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0, 1.0, False))
    assert taken.q_rad[0] == bad or math.isnan(bad)


@given(SIX, NUMBER, NUMBER)
def test_a_streams_values_are_as_they_came(six, time_s, gain):
    for command in (v.ServoJ(six, abs(time_s), 0.1, gain), v.SpeedJ(six, gain, abs(time_s))):
        assert on_grid(command) == command
