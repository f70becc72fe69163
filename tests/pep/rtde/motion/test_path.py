"""Path of waypoints as one command: one request, one permit, one verdict on all of it.

Each leg is sent when the one before has ended.
"""

import asyncio
from dataclasses import replace

import pytest
from capabilities.values.chain import Refusal
from capabilities.values.scope import Grant, Limit, Range
from pep.base.operations import MOVE_PATH, WAYPOINTS, padded, targets_of
from pep.mcp.mapping import ARM_TOOLS, Misfit, to_request
from pep.pit import JointPath
from pep.rtde.robot.state_receiver import JointState
from pep.world.world import _motion
from policies.evidence.model import Effect
from policies.words.reason_table import Reason
from tests.pep import kit
from tests.pep.rtde.motion.moved_arm import HERE

A, B, C = ((x, 0.0, 0.0, 0.0, 0.0, 0.0) for x in (0.3, 0.1, 0.5))
PATH = (A, B, C)


def asked(waypoints=PATH, speed=0.5, acceleration=1.4):
    arguments = {
        "waypoints_rad": [list(point) for point in waypoints],
        "speed_rad_s": speed,
        "acceleration_rad_s2": acceleration,
    }
    return to_request(ARM_TOOLS["move_path"], arguments, request_id="r", audience=kit.AUDIENCE, at=0.0)


# -- from arguments to a request


def test_every_waypoint_is_in_the_request_and_its_digest():
    request = asked()
    assert [value.value for value in request.values[::6]][:4] == [300_000, 100_000, 500_000, 500_000]
    assert tuple(value.name for value in request.values) == tuple(p.name for p in MOVE_PATH.parameters)
    digests = {asked(points).digest for points in (PATH, (B, A, C), (A, C), (A, B), (C,))}
    assert len(digests) == 5
    assert asked((A, A)).digest == asked((A,)).digest  # no way is no other path
    assert targets_of(MOVE_PATH, [value.value for value in request.values]) == tuple(
        (x, 0, 0, 0, 0, 0) for x in (300_000, 100_000, 500_000)
    )


@pytest.mark.parametrize(
    "waypoints",
    [
        [],
        [list(A)] * (WAYPOINTS + 1),
        list(A),
        [list(A)[:5]],
        [list(A), [0.0] * 7],
        {"0": list(A)},
        "path",
        None,
        [None],
    ],
)
def test_what_is_no_path_is_refused(waypoints):
    arguments = {"waypoints_rad": waypoints, "speed_rad_s": 0.5, "acceleration_rad_s2": 1.4}
    found = to_request(ARM_TOOLS["move_path"], arguments, request_id="r", audience=kit.AUDIENCE, at=0.0)
    assert isinstance(found, Misfit)
    assert (found.reason, found.argument) == (Reason.PARAMETERS_WRONG, "waypoints_rad")


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), "0", True, 1e-7])
def test_a_waypoint_with_a_number_that_is_none_is_refused(bad):
    found = asked((A, (*B[:5], bad)))
    assert isinstance(found, Misfit)
    assert found.argument == "waypoints_rad"


def test_the_robots_limits_hold_at_every_waypoint():
    assert MOVE_PATH.refuse(asked()) is None
    for at in range(WAYPOINTS):
        points = [A] * WAYPOINTS
        points[at] = (0.0, 0.0, 0.0, 6.3, 0.0, 0.0)
        refused = MOVE_PATH.refuse(asked(tuple(points)))
        assert isinstance(refused, Refusal)
        assert refused.parameter == f"p{at}_q3"
    assert MOVE_PATH.refuse(asked(speed=3.2)).parameter == "speed"


def test_a_token_limits_each_waypoint_by_itself(tmp_path):
    rig = kit.Rig(tmp_path)
    whole = kit.full_scope(rig.clock.wall_s())
    wide = {p.name: Range(-6_500_000, 6_500_000) for p in MOVE_PATH.parameters[:-2]} | {
        "speed": Range(0, 1_000_000), "acceleration": Range(0, 2_000_000),
    }  # fmt: skip
    narrow = wide | {"p2_q0": Range(-400_000, 400_000)}
    limits = tuple(Limit(p, narrow[p.name]) for p in MOVE_PATH.parameters)
    others = tuple(g for g in whole.grants if g.operation != "move_path")
    grants = tuple(sorted((*others, Grant("ur3e", "move_path", limits)), key=lambda g: (g.object, g.operation)))
    holder = rig.agent(scope=replace(whole, grants=grants))

    def decided(points):
        arguments = {"waypoints_rad": [list(p) for p in points], "speed_rad_s": 0.5, "acceleration_rad_s2": 1.4}
        return asyncio.run(rig.gate.run(rig.call(holder, "move_path", arguments), rig.effect)).decision

    assert decided((C, C, A)).effect is Effect.PERMIT
    refused = decided((A, A, C))
    assert (refused.effect, refused.reason) == (Effect.DENY, Reason.LIMIT_EXCEEDED_BY_REQUEST)
    assert refused.findings[0].detail["parameter"] == "p2_q0"
    assert decided((A, C)).reason is Reason.LIMIT_EXCEEDED_BY_REQUEST  # a shorter path ends at its last waypoint


# -- what is assessed


def test_all_legs_are_assessed_from_where_the_arm_stands():
    state = JointState(HERE, HERE, 7, 1)
    motion = _motion(asked(), state, None, None)
    assert isinstance(motion, JointPath)
    assert motion.start == HERE
    assert [(leg.target, leg.speed_rad_s, leg.acceleration_rad_s2, leg.blend_m) for leg in motion.legs] == [
        (point, 0.5, 1.4, 0.0) for point in PATH
    ]


@pytest.mark.parametrize("waypoints", [(), (A,) * (WAYPOINTS + 1)])
def test_no_waypoint_and_too_many_are_no_path(waypoints):
    with pytest.raises(ValueError):
        padded(waypoints)
