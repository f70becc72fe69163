"""Streams of joint speeds on the real controller: each way to end, without the others or leftovers."""

import asyncio
import gc
import socket
import threading
from concurrent.futures import Future

import numpy as np
import pytest
from capabilities.values.errors import Fault, FaultCode
from pep.base.clock import SystemClock
from pep.base.errors import ActuationRefusedError
from pep.base.operations import MOVE_JOINT, SPEED_JOINT, digest_of
from pep.base.ports import RemainingVerdict
from pep.base.stop_model import STOP_DELAY_S, patience_s
from pep.perception.sensor_frames import Seen
from pep.pit.base.motion import profile_of
from pep.pit.search.speed_envelope import stream_envelope
from pep.request.permit import Permit
from pep.rtde.motion.drive import Drive
from pep.rtde.motion.jog import Jog
from pep.rtde.motion.permitted_control import PermittedControl
from pep.rtde.robot.dashboard import stop_program
from pep.rtde.robot.state_receiver import JointState, ReceivedState
from pep.watch.watch import MotionOutcome, Watch, WatchAges
from policies.evidence.model import Request
from policies.words.reason_table import Reason
from tests.pep.kit import AUDIENCE
from tests.ursim.cell import HOME
from ursim.ports.launch import SimulatedController

from pep.pit import CellParameters, SpeedJ

rtde_control = pytest.importorskip("rtde_control", reason="ur_rtde is not installed")
pytestmark = pytest.mark.e2e

QD = (0.4, 0.0, 0.0, 0.0, 0.0, -0.2)
STOP = 8.0
THERE = (0.1, *HOME[1:])


@pytest.fixture(scope="module")
def controller():
    """One controller for those that leave it as it was."""
    with SimulatedController.start(joints=HOME) as one:
        yield one


def submit(judge):
    judging = Future()
    judging.set_result(judge())
    return judging


class Rig:
    """Drive, jog and guard on a real controller."""

    def __init__(self, host):
        self.clock, self.host, self.fault = SystemClock(), host, None
        self.state = ReceivedState(host)
        self.raw = rtde_control.RTDEControlInterface(host)
        self.control = PermittedControl(
            self.raw, audience=AUDIENCE, clock=self.clock, raise_refusals=True, stop_deceleration_rad_s2=STOP
        )
        self.starts = {}
        self.drive = Drive(
            control=self.control,
            state=self.state,
            gripper=NoFingers(),
            dashboard_stop=lambda: stop_program(host),
            start_of=self.starts.get,
            watching=self.watching,
            hurry=lambda *, moving: None,
            audience=AUDIENCE,
            clock=self.clock,
        )
        self.seen, self.rest = (
            Seen((), 20),
            RemainingVerdict(holds=True, index_milli=900, cause="", fault="", age_ms=20),
        )
        self.jog = Jog(self.drive, self.control, start_of=self.starts.get, clock=self.clock)

    def watching(self, permit, governor=None):
        # How late the watch may be is tested elsewhere, without a controller that shares this machine.
        return Watch(
            permit,
            remaining=self,
            views=self,
            limits=WatchAges(view_ms=150, judged_ms=2_000, look_ms=2_000),
            clock=self.clock,
            submit=submit,
        )

    def left(self, request, q_rad, *, authorised_milli, touch, running):
        return self.rest

    def view(self):
        return self.seen

    def permit(self, name="r", *, qd=QD, duration=0.5, agent="robotic", here=True):
        now = self.clock.monotonic_ms()
        if here:
            self.starts[name] = self.state.read().q_rad
        return Permit(
            request_id=name,
            digest=digest_of(SPEED_JOINT, (*qd, 2.0, duration), audience=AUDIENCE),
            since_ms=now,
            deadline_ms=now + 5_000,
            clock=self.clock,
            standing=lambda: self.fault,
            agent=agent,
            request=Request(name, frozenset(), AUDIENCE, "ur3e", SPEED_JOINT.name, (), 0.0),
            index_milli=1_000,
        )

    def go(self, permit, *, qd=QD, duration=0.5):
        return asyncio.create_task(self.jog.speed_joint(qd, 2.0, duration, permit))

    @property
    def q0(self):
        return self.state.read().q_rad[0]

    @property
    def speed(self):
        return self.state.read().qd_rad_s[0]

    async def moving(self, task):
        await seen(lambda: task.done() or self.speed > 0.3)
        assert not task.done(), await task


class NoFingers:
    def halt(self):
        pass


async def seen(condition, deadline_s=10.0):
    async with asyncio.timeout(deadline_s):
        while not condition():
            await asyncio.sleep(0.005)


def jogged(controller, scenario):
    async def inside():
        rig = Rig(controller.host)
        try:
            async with asyncio.timeout(40):
                return await scenario(rig)
        finally:
            await rig.drive.close()
            rig.jog.close()
            rig.state.close()

    try:
        return asyncio.run(inside())
    finally:
        # ur_rtde's destructors wait for their threads and let nobody else run: not in the middle of the next stream.
        gc.collect()


async def usable(rig):
    """The control script is alive after the watchdog's patience, and moves the arm."""
    since = rig.clock.monotonic_ms()
    await seen(lambda: rig.clock.monotonic_ms() - since > 2_000 * patience_s(STOP))
    assert rig.control.isProgramRunning()
    assert rig.raw.moveJ(list(HOME), 1.0, 4.0)


def test_it_ends_by_itself_inside_what_was_assessed_and_leaves_nothing_behind(controller):
    async def scenario(rig):
        start = rig.state.read()
        end = await rig.go(rig.permit())
        assert (end.end, end.reason) == (MotionOutcome.ENDED, "")
        travelled = end.q_rad[0] - start.q_rad[0]
        envelope = stream_envelope(SpeedJ(start.q_rad, QD, 2.0, 0.5), CellParameters(), under_way=False)
        assert 0.02 < travelled < envelope.target[0] - start.q_rad[0]  # its time counts from before it is sent
        assert end.q_rad[5] - start.q_rad[5] == pytest.approx(-travelled / 2, abs=1e-6)
        await usable(rig)

    jogged(controller, scenario)


def test_a_stop_ends_it_as_the_stop_model_says_and_the_script_lives_on(controller):
    async def scenario(rig):
        moving = rig.go(rig.permit(duration=2.0), duration=2.0)
        await rig.moving(moving)
        at, speed = rig.q0, rig.speed
        stopped = await rig.drive.stop()
        end = await moving
        assert stopped.end is end.end is MotionOutcome.STOPPED
        room = speed * (STOP_DELAY_S + 0.1) + speed**2 / (2 * STOP)  # 0.1 s: a loaded host reads late
        assert 0.0 <= rig.q0 - at <= room
        await usable(rig)

    jogged(controller, scenario)


def test_lost_authority_ends_it(controller):
    async def scenario(rig):
        moving = rig.go(rig.permit(duration=2.0), duration=2.0)
        await rig.moving(moving)
        rig.fault = Fault(FaultCode.REVOKED, "TOK-9")
        end = await moving
        assert (end.end, end.reason) == (MotionOutcome.AUTHORITY_LOST, "REVOKED")
        await usable(rig)

    jogged(controller, scenario)


def test_a_world_that_changes_ends_it(controller):
    async def scenario(rig):
        moving = rig.go(rig.permit(duration=2.0), duration=2.0)
        await rig.moving(moving)
        rig.rest = RemainingVerdict(holds=False, index_milli=2_900, cause="person", fault="", age_ms=20)
        end = await moving
        assert (end.end, end.reason) == (MotionOutcome.WORLD_CHANGED, "IMPACT_ROSE")
        rig.rest = RemainingVerdict(holds=True, index_milli=900, cause="", fault="", age_ms=20)
        await usable(rig)

    jogged(controller, scenario)


def test_an_earlier_permit_that_falls_ends_a_stream_that_another_prolonged(controller):
    async def scenario(rig):
        first = rig.permit("first", duration=0.5)
        moving = rig.go(first)
        await rig.moving(moving)
        later = asyncio.create_task(rig.jog.speed_joint(QD, 2.0, 1.5, rig.permit("second", duration=1.5, here=False)))
        while len(rig.jog._stream.permits) < 2:
            await asyncio.sleep(0.005)
        first.standing = lambda: Fault(FaultCode.REVOKED, "TOK-9")
        ends = await asyncio.gather(moving, later)
        assert {(end.end, end.reason) for end in ends} == {(MotionOutcome.AUTHORITY_LOST, "REVOKED")}
        await usable(rig)

    jogged(controller, scenario)


def test_a_caller_who_goes_away_ends_it(controller):
    async def scenario(rig):
        moving = rig.go(rig.permit(duration=2.0), duration=2.0)
        await rig.moving(moving)
        moving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await moving
        assert rig.state.read().still
        await usable(rig)

    jogged(controller, scenario)


def test_a_stream_that_nobody_looks_at_ends(controller):
    async def scenario(rig):
        started = threading.Event()
        newest = rig.state.newest

        def blind():
            if started.is_set():
                threading.Event().wait(1.0)
            return newest()

        rig.state.newest = blind
        moving = rig.go(rig.permit(duration=2.0), duration=2.0)
        await rig.moving(moving)
        at = rig.q0
        started.set()
        end = await moving
        rig.state.newest = newest
        assert (end.end, end.reason) == (MotionOutcome.ROBOT_FAILED, "nobody looked")
        assert end.q_rad[0] - at < 0.4 * 0.8  # by the end of its time it would have been twice as far
        await usable(rig)

    jogged(controller, scenario)


def test_it_is_prolonged_by_the_same_agent_and_nobody_else(controller):
    async def scenario(rig):
        start = rig.q0
        first = rig.go(rig.permit("a", duration=0.6), duration=0.6)
        await rig.moving(first)
        assert rig.jog.joins(request(QD), agent="robotic")
        assert not rig.jog.joins(request(QD), agent="vision")
        assert not rig.jog.joins(request((0.4, 0.0, 0.0, 0.0, 0.0, -0.1)), agent="robotic")
        assert not rig.jog.joins(request(QD, operation=MOVE_JOINT), agent="robotic")
        for name, qd, agent in (("b", QD, "vision"), ("c", (0.1,) * 6, "robotic")):
            with pytest.raises(ActuationRefusedError) as raised:
                await rig.go(rig.permit(name, qd=qd, agent=agent, here=False), qd=qd)
            assert raised.value.reason is Reason.BUSY
        second = rig.go(rig.permit("d", duration=1.0, here=False), duration=1.0)
        ends = await asyncio.gather(first, second)
        assert [end.end for end in ends] == [MotionOutcome.ENDED, MotionOutcome.ENDED]
        assert rig.q0 - start > 0.4 * 0.9
        assert not rig.jog.joins(request(QD), agent="robotic")
        await usable(rig)

    jogged(controller, scenario)


def request(qd, operation=SPEED_JOINT):
    from capabilities.values.units import Quantity, parse

    numbers = (*qd, 2.0, 0.5)
    values = tuple(
        Quantity(p.name, p.unit, parse(n, p.unit)) for n, p in zip(numbers, SPEED_JOINT.parameters, strict=True)
    )
    return Request("x", frozenset(), AUDIENCE, "ur3e", operation.name, values, 0.0)


def test_what_would_prolong_a_stream_that_has_ended_moves_nothing(controller):
    async def scenario(rig):
        assert rig.drive.reserve("other")
        before = rig.q0
        with pytest.raises(ActuationRefusedError) as raised:
            await rig.go(rig.permit("late"))
        assert raised.value.reason is Reason.VERDICT_EXPIRED
        assert rig.q0 == before

    jogged(controller, scenario)


@pytest.mark.parametrize("start", [None, (0.003, *HOME[1:])])
def test_an_arm_that_is_elsewhere_than_assessed_does_not_move(controller, start):
    async def scenario(rig):
        permit = rig.permit()
        rig.starts["r"] = start if start is None else tuple(q + 0.003 for q in rig.state.read().q_rad)
        with pytest.raises(ActuationRefusedError) as raised:
            await rig.go(permit)
        assert raised.value.reason is Reason.NOT_WHAT_WAS_DECIDED
        assert not permit.spent
        await usable(rig)

    jogged(controller, scenario)


def test_when_the_sender_stalls_the_controller_stops_the_arm_by_itself():
    async def scenario(rig):
        stalled, enough = threading.Event(), threading.Event()
        send = rig.control.hold_speed

        def hold():
            if stalled.is_set():
                enough.wait(20)
            return send()

        rig.control.hold_speed = hold
        moving = rig.go(rig.permit(duration=2.0), duration=2.0)
        await rig.moving(moving)
        at = rig.q0
        stalled.set()
        await seen(lambda: rig.state.read().still, deadline_s=1.5)  # not by the end of its time, which is later
        assert rig.q0 - at <= 0.4 * (patience_s(STOP) + STOP_DELAY_S + 0.1) + 0.4**2 / (2 * STOP)
        assert not rig.control.isProgramRunning()
        enough.set()
        assert (await moving).end is MotionOutcome.ROBOT_FAILED

    with SimulatedController.start(joints=HOME) as controller:
        jogged(controller, scenario)


def test_after_a_protective_stop_nothing_is_taken_up_again():
    async def scenario(rig, controller):
        moving = rig.go(rig.permit(duration=2.0), duration=2.0)
        await rig.moving(moving)
        controller.fault("protective_stop")
        end = await moving
        assert end.end is MotionOutcome.ROBOT_FAILED
        with socket.create_connection((controller.host, 29999)) as link, link.makefile("rwb") as dashboard:

            def ask(line):
                dashboard.write(line + b"\n")
                dashboard.flush()
                return dashboard.readline()

            dashboard.readline()
            await seen(lambda: b"releasing" in ask(b"unlock protective stop"))
            await seen(lambda: rig.state.read().safety_mode == 1)
            at = rig.q0
            assert ask(b"play").startswith(b"Failed")
        assert not rig.control.isProgramRunning()
        assert rig.q0 == at

    with SimulatedController.start(joints=HOME) as controller:
        jogged(controller, lambda rig: scenario(rig, controller))


@pytest.mark.parametrize("stop", [2.0, 8.0])
@pytest.mark.parametrize("moving", [False, True])
def test_the_assessed_move_is_never_slower_than_the_stream(stop, moving):
    """The assessed move is at least as fast as the stream at every joint angle, at any end."""
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
