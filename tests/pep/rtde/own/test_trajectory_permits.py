"""Permit of a trajectory: exactly what was decided is sent, once, in time, from where it was assessed, or nothing."""

import math
from dataclasses import replace

import pytest
from capabilities.values.arguments import Argument
from pep.base.errors import ActuationRefusedError
from pep.base.operations import FOLLOW_TRAJECTORY
from pep.mcp.mapping import to_request
from pep.request.permit import Permit
from pep.world.timed_request import arguments_of
from policies.words.reason_table import Reason
from tests.pep.kit import AUDIENCE
from tests.pep.rtde.motion.moved_arm import HERE
from tests.pep.rtde.own.test_tool_motions import Tools

from pep.pit import JointTrajectory

pytestmark = pytest.mark.clause("LSD-25")

PLAN = JointTrajectory((0.0, 1.0, 2.0), (HERE, (0.2, *HERE[1:]), (0.4, *HERE[1:])))


def decided():
    return to_request(FOLLOW_TRAJECTORY, arguments_of(PLAN), request_id="r", audience=AUDIENCE, at=0.0)


class Trajectories(Tools):
    """The tools, with permits of a trajectory."""

    def permitted(self, *, request=None, digest=None):
        now = self.clock.monotonic_ms()
        request = decided() if request is None else request
        return Permit(
            request_id="r", digest=request.digest if digest is None else digest, since_ms=now, deadline_ms=now + 50,
            clock=self.clock, standing=lambda: self.fault, request=request, index_milli=1_000, agent="robotic",
        )  # fmt: skip

    def refused(self, reason, permit):
        with pytest.raises(ActuationRefusedError) as raised:
            self.played(lambda tools: tools.act(FOLLOW_TRAJECTORY, (1.0, 1.0), permit))
        assert raised.value.reason is reason
        assert self.lines.given == []


@pytest.fixture
def world():
    return Trajectories()


def changed(request, name, at, by):
    """The request with one integer of a list changed."""
    values = [
        replace(each, value=tuple(n + by * (k == at) for k, n in enumerate(each.value)))
        if isinstance(each, Argument) and each.name == name
        else each
        for each in request.values
    ]
    return replace(request, values=tuple(values))


@pytest.mark.parametrize(("name", "at"), [("t", 1), ("q0", 0), ("q5", 2)])
def test_one_integer_off_is_something_else(world, name, at):
    """The permit is of what was decided; what it would send is another request."""
    permit = world.permitted(request=changed(decided(), name, at, 1), digest=decided().digest)
    world.refused(Reason.NOT_WHAT_WAS_DECIDED, permit)


def test_too_late(world):
    permit = world.permitted()
    permit.deadline_ms = world.clock.mono - 1
    world.refused(Reason.VERDICT_EXPIRED, permit)


def test_a_stop_voids_what_was_asked_for_before(world):
    permit = world.permitted()
    world.arm.stopped_ms = permit.since_ms
    world.refused(Reason.VERDICT_EXPIRED, permit)


@pytest.mark.parametrize("start", [None, (0.003, *HERE[1:])])
def test_an_arm_that_is_elsewhere_than_assessed_does_not_move(world, start):
    world.starts = start
    permit = world.permitted()
    world.refused(Reason.NOT_WHAT_WAS_DECIDED, permit)
    assert not permit.spent


def test_a_permit_of_no_trajectory(world):
    permit = world.permitted()
    permit.request = None
    world.refused(Reason.NOT_WHAT_WAS_DECIDED, permit)


def test_lists_that_are_no_trajectory(world):
    request = decided()
    shorter = replace(request, values=(replace(request.values[0], value=(0,)), *request.values[1:]))
    world.refused(Reason.OUT_OF_RANGE, world.permitted(request=shorter))


@pytest.mark.parametrize("how", ["not ready", "not taken"])
def test_a_controller_that_takes_no_command(world, how):
    world.lines.is_ready, world.lines.untaken = how != "not ready", 0
    permit = world.permitted()
    world.refused(Reason.EFFECT_FAILED, permit)
    assert permit.spent is (how == "not taken")
    assert math.isfinite(world.lines.untaken)
