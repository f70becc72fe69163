"""Path of waypoints as one command: one request, one permit, one verdict on all of it.

Each leg is sent when the one before has ended.
"""

import asyncio
from dataclasses import replace

import pytest
from capabilities.values.chain import Refusal
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.scope import Grant, Limit, Range
from pep.base.errors import ActuationRefusedError
from pep.base.operations import MOVE_PATH, WAYPOINTS, padded, targets_of
from pep.mcp.mapping import ARM_TOOLS, Misfit, to_request
from pep.rtde.command.limits import Ur3eLimits
from pep.rtde.motion.drive import MotionOutcome
from pep.rtde.robot.state_receiver import JointState
from pep.world.world import _motion
from policies.evidence.model import Effect
from policies.words.reason_table import Reason
from tests.pep import kit
from tests.pep.rtde.motion.test_drive import HERE, World, driven, until

from pep.pit import JointPath

A, B, C = ((x, 0.0, 0.0, 0.0, 0.0, 0.0) for x in (0.3, 0.1, 0.5))
PATH = (A, B, C)
QUICK, SLOW = (2.0, 1.4), (0.2, 1.4)


def asked(waypoints=PATH, speed=0.5, acceleration=1.4):
    arguments = {
        "waypoints_rad": [list(point) for point in waypoints],
        "speed_rad_s": speed,
        "acceleration_rad_s2": acceleration,
    }
    return to_request(ARM_TOOLS["move_path"], arguments, request_id="r", audience=kit.AUDIENCE, at=0.0)


def numbers(waypoints, timing):
    return (*(q for point in padded(waypoints) for q in point), *timing)


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
    limits = Ur3eLimits()
    assert limits.refuse(asked()) is None
    for at in range(WAYPOINTS):
        points = [A] * WAYPOINTS
        points[at] = (0.0, 0.0, 0.0, 6.3, 0.0, 0.0)
        refused = limits.refuse(asked(tuple(points)))
        assert isinstance(refused, Refusal)
        assert refused.parameter == f"p{at}_q3"
    assert limits.refuse(asked(speed=3.2)).parameter == "speed"


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


# -- what is sent


def driving(world, waypoints=PATH, timing=QUICK):
    permit = world.permit(MOVE_PATH, numbers(waypoints, timing))
    return lambda drive: drive.move_path(waypoints, *timing, permit)


@pytest.fixture
def world():
    world = World()
    sent = world.arm.moveJ
    world.targets = []

    def remembered(q, *more):
        world.targets.append(q[0])
        return sent(q, *more)

    world.arm.moveJ = remembered
    return world


def test_it_goes_through_every_waypoint_in_order(world):
    end = driven(world, driving(world))
    assert (end.end, end.q_rad[0]) == (MotionOutcome.REACHED, pytest.approx(0.5, abs=1e-3))
    assert world.targets == [0.3, 0.1, 0.5]


async def in_the_second_leg(world, drive, act):
    moving = asyncio.create_task(driving(world, timing=SLOW)(drive))
    await until(lambda: len(world.targets) == 2)
    await act()
    return await moving


def test_a_stop_in_a_leg_ends_the_path(world):
    async def scenario(drive):
        return await in_the_second_leg(world, drive, drive.stop)

    assert driven(world, scenario).end is MotionOutcome.STOPPED
    assert world.targets == [0.3, 0.1]
    assert world.arm.target is None


def test_lost_authority_in_a_leg_ends_the_path(world):
    async def scenario(drive):
        async def revoke():
            world.fault = Fault(FaultCode.REVOKED, "TOK-9")

        return await in_the_second_leg(world, drive, revoke)

    end = driven(world, scenario)
    assert (end.end, end.reason) == (MotionOutcome.AUTHORITY_LOST, "REVOKED")
    assert world.targets == [0.3, 0.1]


def test_a_world_that_changes_in_a_leg_ends_the_path(world):
    async def scenario(drive):
        async def change():
            world.rest = replace(world.rest, holds=False, cause="person", index_milli=2_500)

        return await in_the_second_leg(world, drive, change)

    assert driven(world, scenario).end is MotionOutcome.WORLD_CHANGED
    assert world.targets == [0.3, 0.1]


def test_a_path_is_stopped_where_a_move_would_be_slowed(world):
    """PHY-50: nobody asks about another speed of it, and none is set."""
    asked_at = []

    def left(request, q_rad, *, authorised_milli, touch, running):
        asked_at.append(running)
        return world.rest if q_rad[0] < 0.05 else replace(world.rest, holds=False, index_milli=2_500, pace=0.4)

    world.left = left
    end = driven(world, driving(world, timing=SLOW))
    assert (end.end, end.changes, world.arm.sliders) == (MotionOutcome.WORLD_CHANGED, (), [])
    assert set(asked_at) == {None}


def test_a_leg_that_the_controller_does_not_take_ends_the_path(world):
    async def scenario(drive):
        moving = asyncio.create_task(driving(world)(drive))
        await until(lambda: world.targets)
        world.arm.unheard = True
        return await moving

    end = driven(world, scenario)
    assert end.end is MotionOutcome.ROBOT_FAILED
    assert world.targets == [0.3, 0.1]
    assert world.arm.target is None


@pytest.mark.parametrize("waypoints", [(), (A,) * (WAYPOINTS + 1)])
def test_no_waypoint_and_too_many_are_no_path(waypoints):
    with pytest.raises(ValueError):
        padded(waypoints)


def test_after_a_first_leg_that_was_not_taken_no_other_is_sent(world):
    control = world.drive()._control
    world.arm.unheard = True
    with pytest.raises(ActuationRefusedError):
        control.move_path(PATH, *QUICK, permit=world.permit(MOVE_PATH, numbers(PATH, QUICK)))
    world.arm.unheard = False
    assert not control.next_leg()
    assert world.targets == [0.3]


def test_after_a_stop_no_leg_is_sent(world):
    control = world.drive()._control
    control.move_path(PATH, *QUICK, permit=world.permit(MOVE_PATH, numbers(PATH, QUICK)))
    control.stopJ()
    assert not control.next_leg()
    assert not control.next_leg()
    assert world.targets == [0.3]


def test_another_command_is_no_leg_of_the_path_before_it(world):
    control = world.drive()._control
    control.move_path(PATH, *QUICK, permit=world.permit(MOVE_PATH, numbers(PATH, QUICK)))
    control.moveJ(C, *QUICK, True, permit=world.permit(numbers=(*C, *QUICK)))  # noqa: FBT003 - the interface's own order
    assert not control.next_leg()
    assert world.targets == [0.3, 0.5]


@pytest.mark.parametrize("other", [(A, B), (B, A, C), (A, B, (0.500001, *C[1:]))])
def test_a_permit_is_for_its_own_waypoints(world, other):
    permit = world.permit(MOVE_PATH, numbers(PATH, QUICK))

    async def scenario(drive):
        with pytest.raises(ActuationRefusedError) as raised:
            await drive.move_path(other, *QUICK, permit)
        assert raised.value.reason is Reason.NOT_WHAT_WAS_DECIDED

    driven(world, scenario)
    assert world.targets == []
