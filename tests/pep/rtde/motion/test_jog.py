"""Streams of joint speeds on the simulated controller: they end inside what was assessed, and leave nothing behind."""

import asyncio
import socket
import time
from concurrent.futures import Future

import numpy as np
import pytest
from pep.base.clock import SystemClock
from pep.base.operations import SPEED_JOINT
from pep.base.request_digest import digest_of
from pep.base.ports import RemainingVerdict
from pep.base.stop_model import STOP_DELAY_S, patience_s
from pep.perception.sensor_frames import Seen
from pep.pit import CellParameters, SpeedJ
from pep.pit.base.motion import profile_of
from pep.pit.search.speed_envelope import stream_envelope
from pep.request.permit import Permit
from pep.rtde.line.lease_stop import StopMeans
from pep.rtde.motion.motions import Motions
from pep.rtde.own.tool_motions import ToolMotions
from pep.rtde.robot.state_receiver import JointState
from tests.pep.rtde.packages import received
from pep.watch.watch import MotionOutcome, Watch, WatchAges
from policies.evidence.model import Request
from tests.pep.kit import AUDIENCE
from tests.pep.rtde.own.test_own_lines import Served
from tests.ursim.cell import HOME, until
from ursim.ports.launch import SimulatedController

pytestmark = pytest.mark.e2e

QD = (0.4, 0.0, 0.0, 0.0, 0.0, -0.2)
STOP = 8.0


class Nothing:
    """No fingers, no outputs, and a world in which all holds."""

    def halt(self):
        pass

    def close(self):
        pass

    def left(self, request, q_rad, *, authorised_milli, touch, running, oldest_ms):
        return RemainingVerdict(holds=True, index_milli=900, cause="", fault="", age_ms=20)

    def view(self, *, oldest_ms=None):
        return Seen((), 20)


class Rig:
    """The tools at a controller, on the loop of their own line."""

    def __init__(self, host):
        self.clock, self.state, self.starts = SystemClock(), received(host), {}
        self.served = Served(host)
        until(lambda: self.served.own.up)
        self.served.do(self.make())

    async def make(self):
        nothing = Nothing()

        def watching(permit, *, governor=None):
            # How late the watch may be is tested elsewhere, without a controller that shares this machine.
            limits = WatchAges(view_ms=150, judged_ms=2_000, look_ms=2_000)
            return Watch(permit, remaining=nothing, views=nothing, limits=limits, clock=self.clock, submit=submit)

        self.motions = Motions(
            starts=self,
            hurry=lambda *, moving: None,
            state=self.state,
            stopper=self,
            clock=self.clock,
            pause=time.sleep,
        )
        self.tools = ToolMotions(
            self.served.own,
            self.motions,
            gripper=nothing,
            outputs=nothing,
            watching=watching,
            speed=None,
            gripped=None,
            audience=AUDIENCE,
            clock=self.clock,
        )

    def start_of(self, request_id):
        return self.starts[request_id]

    # the stopper
    def stop(self, reason):
        self.served.loop.call_soon_threadsafe(self.served.ports.stop, StopMeans.PROGRAM)

    @property
    def stopped_ms(self):
        return self.served.ports.stopped_ms

    def permit(self, duration):
        now = self.clock.monotonic_ms()
        self.starts["r"] = self.state.read().q_rad
        return Permit(
            request_id="r",
            digest=digest_of(SPEED_JOINT, (*QD, 2.0, duration), audience=AUDIENCE),
            since_ms=now,
            deadline_ms=now + 5_000,
            clock=self.clock,
            standing=lambda: None,
            agent="robotic",
            request=Request("r", frozenset(), AUDIENCE, "ur3e", SPEED_JOINT.name, (), 0.0),
            index_milli=1_000,
        )

    def go(self, duration):
        acting = self.tools.act(SPEED_JOINT, (*QD, 2.0, duration), self.permit(duration))
        return asyncio.run_coroutine_threadsafe(acting, self.served.loop)

    def moving(self, duration=2.0):
        going = self.go(duration)
        until(lambda: going.done() or self.state.read().qd_rad_s[0] > 0.3)
        assert not going.done(), going.result()
        return going

    def close(self):
        self.served.do(self.tools.close())
        self.motions.close()
        self.served.close()
        self.state.close()


def submit(judge):
    judging = Future()
    judging.set_result(judge())
    return judging


@pytest.fixture(scope="module")
def controller():
    with SimulatedController.start(joints=HOME) as one:
        yield one


@pytest.fixture
def rig(controller):
    rig = Rig(controller.host)
    yield rig
    rig.close()


def test_it_ends_by_itself_inside_what_was_assessed_and_leaves_nothing_behind(rig):
    start = rig.state.read()
    end = rig.go(0.5).result(10)
    assert (end.end, end.reason) == (MotionOutcome.ENDED, "")
    travelled = end.q_rad[0] - start.q_rad[0]
    envelope = stream_envelope(SpeedJ(start.q_rad, QD, 2.0, 0.5), CellParameters(), under_way=False)
    assert 0.02 < travelled < envelope.target[0] - start.q_rad[0]  # its time counts from before it is sent
    assert end.q_rad[5] - start.q_rad[5] == pytest.approx(-travelled / 2, abs=1e-6)
    assert rig.served.own.up, "the control script lives on"
    assert rig.served.move(HOME, 1.0)


def test_a_stop_ends_it_as_the_stop_model_says_and_the_script_lives_on(rig):
    going = rig.moving()
    at, speed = rig.state.read().q_rad[0], rig.state.read().qd_rad_s[0]
    stopped = rig.served.do(rig.tools.stop())
    assert stopped.end is going.result(10).end is MotionOutcome.STOPPED
    room = speed * (STOP_DELAY_S + 0.1) + speed**2 / (2 * STOP)  # 0.1 s: a loaded host reads late
    assert 0.0 <= rig.state.read().q_rad[0] - at <= room
    assert rig.served.own.up
    assert rig.served.move(HOME, 1.0)


def test_after_a_protective_stop_nothing_is_taken_up_again(controller, rig):
    going = rig.moving()
    rig.served.free = False
    controller.fault("protective_stop")
    assert going.result(10).end is MotionOutcome.ROBOT_FAILED
    with socket.create_connection((controller.host, 29999)) as link, link.makefile("rwb") as dashboard:

        def ask(line):
            dashboard.write(line + b"\n")
            dashboard.flush()
            return dashboard.readline()

        dashboard.readline()
        controller.fault("protective_stop_ages")
        until(lambda: b"releasing" in ask(b"unlock protective stop"), 10.0)
        until(lambda: rig.state.read().safety_mode == 1)
        at = rig.state.read().q_rad[0]
        assert ask(b"play").startswith(b"Failed")
    assert not rig.served.own.up
    assert rig.state.read().q_rad[0] == at


@pytest.mark.parametrize("stop", [2.0, 8.0])
@pytest.mark.parametrize("moving", [False, True])
def test_the_assessed_move_is_never_slower_than_the_stream(stop, moving):
    """The assessed move is at least as fast at every angle of the stream, however late the stream ends."""
    cell = CellParameters(stop_deceleration_rad_s2=stop)
    state = JointState(HOME, QD if moving else (0.0,) * 6, 7, 1)
    for acceleration in (0.5, 2.0, 20.0):
        move = stream_envelope(SpeedJ(state.q_rad, QD, acceleration, 0.5), cell, under_way=moving)
        profile = profile_of(move)
        way = move.target[0] - move.start[0]
        for holds_s in (0.05, 0.3, 0.5 + patience_s(stop)):  # ended early, or as late as the dead man ends it
            q, v, t, dt = state.q_rad[0], state.qd_rad_s[0], 0.0, 1e-3
            step = 3 * 0.4 * dt  # of the summation below
            while v > 0.0 or t < holds_s:
                around = [np.array([(q + off - move.start[0]) / way]) for off in (-step, step)]
                assert v <= profile.highest_rate(*around)[0] * way + 1e-9, (acceleration, holds_s, t)
                v = min(0.4, v + acceleration * dt) if t < holds_s + STOP_DELAY_S else v - stop * dt
                q, t = q + max(v, 0.0) * dt, t + dt
            assert q <= move.target[0] + step
