"""Timed trajectory as a request: integers both ways, never faster than it says, from where the arm stands."""

import hashlib
import json

import numpy as np
import pytest
import rfc8785
from capabilities.values.arguments import Argument, kind_given, plain
from capabilities.values.scope import Each
from pep.base.operations import FOLLOW_TRAJECTORY, OPERATIONS, targets_of
from pep.mcp.mapping import ARM_TOOLS, Misfit, to_request
from pep.pit.base.errors import MotionError
from pep.pit.path.timed_curve import curve_of
from pep.world.motion_history import act_of, joined
from pep.world.timed_request import (
    arguments_of,
    end_urad,
    refuse_elsewhere,
    refuse_faster,
    request_of,
    trajectory_of,
)
from policies.words.reason_table import Reason
from tests.pep.kit import AUDIENCE
from tests.pep.pit.campaign.timetables import random_trajectory

from pep.pit import JointTrajectory

pytestmark = pytest.mark.clause("LSD-24")

START = (0.0, -1.62, 1.25, -1.2, -1.57, 0.0)
PLAN = JointTrajectory((0.0, 1.0, 2.0), (START, (0.2, *START[1:]), (0.4, *START[1:])))


def asked(arguments):
    return to_request(FOLLOW_TRAJECTORY, arguments, request_id="r", audience=AUDIENCE, at=0.0)


@pytest.mark.parametrize("seed", range(20))
def test_what_is_sent_is_what_was_decided_to_the_last_integer(seed):
    drawn = random_trajectory(np.random.default_rng([24, seed]))
    request = asked(json.loads(json.dumps(arguments_of(drawn))))
    sent = trajectory_of(request)
    speed, acceleration = request.quantities
    assert request_of(sent, speed=speed, acceleration=acceleration, audience=AUDIENCE).digest == request.digest
    assert np.array(sent.points) == pytest.approx(np.array(drawn.points), abs=5.1e-7)
    assert np.array(sent.times_s) == pytest.approx(np.array(drawn.times_s), abs=5.1e-7)
    assert FOLLOW_TRAJECTORY.refuse(request) is None or max(np.abs(drawn.points).max(), 6) > 6


def test_its_digest_is_that_of_the_canonical_text():
    request = asked(arguments_of(PLAN))
    content = {
        "audience": request.audience,
        "object": request.object,
        "operation": request.operation,
        "values": [[each.name, str(kind_given(each)), plain(each)] for each in request.values],
    }
    assert request.digest == hashlib.sha256(rfc8785.dumps(content)).hexdigest()


@pytest.mark.parametrize("name", ["times_s", "positions_rad", "velocities_rad_s", "speed_rad_s", "acceleration_rad_s2"])
def test_one_unit_off_anywhere_is_another_request(name):
    arguments = arguments_of(PLAN) | {"velocities_rad_s": [[0.0] * 6] * 3}
    other = json.loads(json.dumps(arguments))
    if isinstance(other[name], list):
        row = other[name][1] if isinstance(other[name][1], list) else other[name]
        row[1] += 1e-6
    else:
        other[name] += 1e-6
    assert asked(other).digest != asked(arguments).digest


@pytest.mark.parametrize("seed", range(10))
def test_the_stated_speed_and_acceleration_hold_and_no_less(seed):
    drawn = random_trajectory(np.random.default_rng([25, seed]))
    arguments = arguments_of(drawn)
    request = asked(arguments)
    motion = trajectory_of(request)
    for name in ("speed_rad_s", "acceleration_rad_s2"):
        less = asked(arguments | {name: round(arguments[name] * 0.999, 6)})
        with pytest.raises(MotionError) as raised:
            refuse_faster(less, motion)
        assert raised.value.reason == "OUT_OF_RANGE"
    generous = asked(
        {
            name: round(value * 1.01, 6) if "_rad_s" in name and isinstance(value, float) else value
            for name, value in arguments.items()
        }
    )
    refuse_faster(generous, motion)
    assert curve_of(motion).fastest_rad_s <= 1.01 * arguments["speed_rad_s"]


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("off", [-2.1e-3, 2.1e-3, float("nan")])
def test_it_begins_where_the_arm_stands(joint, off):
    refuse_elsewhere(PLAN, START)
    elsewhere = list(START)
    elsewhere[joint] += off
    with pytest.raises(MotionError) as raised:
        refuse_elsewhere(PLAN, elsewhere)
    assert raised.value.reason == "OUT_OF_RANGE"
    assert raised.value.detail.startswith("point 0")


@pytest.mark.parametrize(
    ("change", "reason", "argument"),
    [
        ({"times_s": 1.0}, Reason.PARAMETERS_WRONG, "times_s"),
        ({"times_s": [0.0, "1", 2.0]}, Reason.NOT_A_NUMBER, "times_s[1]"),
        ({"times_s": [0.0, float("nan"), 2.0]}, Reason.NOT_FINITE, "times_s[1]"),
        ({"times_s": [0.0] * 257}, Reason.OUT_OF_RANGE, "times_s"),
        ({"positions_rad": [[0.0] * 5]}, Reason.PARAMETERS_WRONG, "positions_rad"),
        ({"positions_rad": [0.0] * 6}, Reason.PARAMETERS_WRONG, "positions_rad"),
        ({"positions_rad": [[0.0] * 6] * 257}, Reason.OUT_OF_RANGE, "positions_rad"),
        ({"positions_rad": [[0.0] * 6, [0.0] * 5 + [float("inf")]]}, Reason.NOT_FINITE, "positions_rad[1]"),
        ({"velocities_rad_s": [[0.0]]}, Reason.PARAMETERS_WRONG, "velocities_rad_s"),
        ({"effort": []}, Reason.PARAMETERS_WRONG, ""),
    ],
)
def test_arguments_that_are_no_request(change, reason, argument):
    found = asked(arguments_of(PLAN) | change)
    assert isinstance(found, Misfit)
    assert (found.reason, found.argument) == (reason, argument)


def test_points_without_a_value_for_each_time_are_no_trajectory():
    for change in ({"times_s": [0.0, 1.0]}, {"velocities_rad_s": [[0.0] * 6]}):
        with pytest.raises(MotionError) as raised:
            trajectory_of(asked(arguments_of(PLAN) | change))
        assert raised.value.reason == "OUT_OF_RANGE"


def test_its_row_bounds_every_list():
    assert ARM_TOOLS["follow_trajectory"] is FOLLOW_TRAJECTORY in OPERATIONS
    lists = [each for each in FOLLOW_TRAJECTORY.limits if isinstance(each.bound, Each)]
    assert [each.bound.most for each in lists] == [256] * 13
    assert all(isinstance(each, Argument) for each in asked(arguments_of(PLAN)).values[:13])


def test_the_sequence_knows_where_it_leads_and_takes_it_for_no_straight_way():
    request = asked(arguments_of(PLAN))
    start = tuple(round(1e6 * q) for q in START)
    act = act_of(request, agent="a", at_ms=0, start_urad=start)
    assert end_urad(request) == tuple(round(1e6 * q) for q in PLAN.points[-1])
    assert targets_of(FOLLOW_TRAJECTORY, [value for _, _, value in act.values]) == (end_urad(request),)
    assert joined(request, act, [act]) is None
