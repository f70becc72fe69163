"""Driving: how a motion ends, and that a stop ends everything, by the dashboard if it must."""

import asyncio
import contextlib
import threading
import time
from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace

import pytest
from capabilities.values.errors import Fault, FaultCode
from pep.base.clock import SystemClock
from pep.base.errors import ActuationRefusedError, PepFault, RobotError
from pep.base.operations import GRIPPER_MOVE, MOVE_JOINT, digest_of
from pep.base.ports import RemainingVerdict
from pep.perception.sensor_frames import Distrusted, FrameFault, RejectedFrame, Seen, Unseen
from pep.request.permit import Permit
from pep.rtde.motion.drive import Drive, MotionOutcome
from pep.rtde.motion.governed_move import SpeedControl, least_fraction, put_back
from pep.rtde.motion.permitted_control import PermittedControl
from pep.rtde.robot.gripper import GripResult
from pep.rtde.robot.newest_state import SILENCE_MS
from pep.rtde.robot.speed_slider import SpeedSlider
from pep.rtde.robot.state_receiver import JointState, Package
from pep.watch.governor import Governor, Offer, Pacing, ReportedSpeeds
from pep.watch.watch import Watch, WatchAges
from policies.words.reason_table import Reason
from tests.pep.kit import AUDIENCE

from pep.rtde.motion import drive as drive_module
from pep.rtde.motion import stop_ladder

pytestmark = pytest.mark.real_time

HERE = (0.0,) * 6
PACING = Pacing(delay_ms=400, change_ms=250, slowest=0.1, dwell_ms=100, gain=0.1)
THERE = (0.5, 0.0, 0.0, 0.0, 0.0, 0.0)


class Arm:
    """Moves its first joint towards a target, as fast as it is asked to."""

    def __init__(self):
        self.q, self.target, self.speed, self.asked = 0.0, None, 0.0, []
        self.deaf, self.silent, self.sticks = False, False, False
        self.unheard, self.decelerations = False, []
        self.mode, self.at = 1, time.monotonic()
        self.said = None
        self.slider, self.scaling, self.sliders, self.stuck, self.refuses = 1.0, 1.0, [], False, False
        self.lock = threading.Lock()

    def go_on(self):
        now = time.monotonic()
        self.scaling += max(-4 * (now - self.at), min(4 * (now - self.at), self.slider - self.scaling))
        step, self.at = self.speed * self.scaling * (now - self.at), now
        if self.target is not None and not self.sticks:
            way = self.target - self.q
            self.q += max(-step, min(step, way))
            if self.q == self.target:
                self.target = None

    # rtde_control
    def moveJ(self, q, speed, acceleration, asynchronous):
        with self.lock:
            self.go_on()
            self.asked.append("moveJ")
            self.target, self.speed = q[0], speed
        return not self.unheard

    def stopJ(self, a, asynchronous):
        self.asked.append("stopJ")
        self.decelerations.append(a)
        if self.deaf:
            raise RuntimeError("not connected")
        self.halt()

    def halt(self):
        with self.lock:
            self.go_on()
            self.target = None

    def stopScript(self):
        self.asked.append("stopScript")

    def disconnect(self):
        self.asked.append("disconnect")

    # state
    def read(self):
        time.sleep(0.001)
        if self.silent:
            raise RobotError(PepFault.ROBOT_STALLED)
        return self.here()

    def here(self):
        with self.lock:
            self.go_on()
            moving = self.target is not None and not self.sticks
            speed = self.speed * self.scaling if moving else 0.0
            state = JointState((self.q, *HERE[1:]), (speed, *HERE[1:]), 7, self.mode)
            return replace(state, slider=self.slider, scaling=self.scaling)

    # rtde_io
    def setSpeedSlider(self, fraction):
        with self.lock:
            self.go_on()
            self.sliders.append(fraction)
            if not self.stuck:
                self.slider = fraction
        return not self.refuses

    def newest(self):
        if not self.silent:
            self.said = Package(time.monotonic(), self.here())
        return self.said


class Fingers:
    def __init__(self):
        self.halted, self.moves = threading.Event(), []

    def move(self, *, stopped, **numbers):
        self.moves.append(numbers)
        self.halted.clear()  # as a gripper does that only knows its own last command
        while not stopped():
            self.halted.wait(0.01)
        return GripResult(40_000, object=False, arrived=False)

    def halt(self):
        self.halted.set()


class World:
    def __init__(self):
        self.clock, self.arm, self.fingers = SystemClock(), Arm(), Fingers()
        self.fault, self.dashboard = None, []
        self.starts = {"r": HERE}
        self.deceleration = 6.0
        self.hurried = []
        self.rest = RemainingVerdict(holds=True, index_milli=900, cause="", fault="", age_ms=20)
        self.seen = Seen((), 20)

    def drive(self):
        def by_dashboard():
            self.dashboard.append("stop")
            self.arm.halt()

        return Drive(
            control=PermittedControl(
                self.arm,
                audience=AUDIENCE,
                clock=self.clock,
                raise_refusals=True,
                stop_deceleration_rad_s2=self.deceleration,
            ),
            state=self.arm,
            gripper=self.fingers,
            dashboard_stop=by_dashboard,
            start_of=self.starts.get,
            watching=self.watching,
            hurry=lambda *, moving: self.hurried.append(moving),
            audience=AUDIENCE,
            clock=self.clock,
            speed=SpeedControl(SpeedSlider(self.arm), PACING),
        )

    def watching(self, permit, governor=None):
        return Watch(
            permit,
            remaining=self,
            views=self,
            limits=WatchAges(view_ms=150, judged_ms=2_000, look_ms=2_000),
            clock=self.clock,
            submit=self.submit,
            governor=governor,
        )

    def submit(self, judge):
        judging = Future()
        judging.set_result(judge())
        return judging

    def left(self, request, q_rad, *, authorised_milli, touch, running):
        return self.rest

    def view(self):
        return self.seen

    def permit(self, operation=MOVE_JOINT, numbers=(*THERE, 2.0, 1.4), lifetime_ms=5_000, **changes):
        now = self.clock.monotonic_ms()
        return Permit(
            request_id="r",
            digest=digest_of(operation, numbers, audience=AUDIENCE),
            since_ms=now,
            deadline_ms=now + lifetime_ms,
            clock=self.clock,
            standing=lambda: self.fault,
            request=object(),
            index_milli=1_000,
            **changes,
        )


@pytest.fixture
def world():
    return World()


def driven(world, scenario):
    async def inside():
        drive = world.drive()
        async with asyncio.timeout(20):
            end = await scenario(drive)
            await drive.close()
            return end

    return asyncio.run(inside())


async def until(seen):
    while not seen():
        await asyncio.sleep(0.002)


def test_it_arrives(world):
    end = driven(world, lambda drive: drive.move_joint(THERE, 2.0, 1.4, world.permit()))
    assert (end.end, end.q_rad[0]) == (MotionOutcome.REACHED, pytest.approx(0.5, abs=1e-3))


def test_a_stop_ends_it(world):
    async def scenario(drive):
        moving = asyncio.create_task(drive.move_joint(THERE, 0.2, 1.4, world.permit(numbers=(*THERE, 0.2, 1.4))))
        await until(lambda: world.arm.target is not None)
        stopped = await drive.stop()
        return stopped, await moving

    stopped, moving = driven(world, scenario)
    assert stopped.end is moving.end is MotionOutcome.STOPPED
    assert world.arm.q < 0.5
    assert world.arm.decelerations[0] == 6.0
    assert world.dashboard == []


def test_lost_authority_ends_it(world):
    async def scenario(drive):
        moving = asyncio.create_task(drive.move_joint(THERE, 0.2, 1.4, world.permit(numbers=(*THERE, 0.2, 1.4))))
        await until(lambda: world.arm.target is not None)
        world.fault = Fault(FaultCode.REVOKED, "TOK-9")
        return await moving

    end = driven(world, scenario)
    assert (end.end, end.reason) == (MotionOutcome.AUTHORITY_LOST, "REVOKED")
    assert world.arm.target is None


def test_a_cancelled_caller_ends_it(world):
    async def scenario(drive):
        moving = asyncio.create_task(drive.move_joint(THERE, 0.2, 1.4, world.permit(numbers=(*THERE, 0.2, 1.4))))
        await until(lambda: world.arm.target is not None)
        moving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await moving
        assert world.arm.target is None

    driven(world, scenario)


def test_a_silent_arm_is_stopped(world):
    async def scenario(drive):
        moving = asyncio.create_task(drive.move_joint(THERE, 0.2, 1.4, world.permit(numbers=(*THERE, 0.2, 1.4))))
        await until(lambda: world.arm.target is not None)
        world.arm.silent = True
        await until(lambda: "stopJ" in world.arm.asked)
        world.arm.silent = False
        return await moving

    end = driven(world, scenario)
    assert (end.end, end.reason) == (MotionOutcome.ROBOT_FAILED, "ROBOT_STALLED")


def test_an_arm_that_does_not_begin_is_stopped(world):
    world.arm.sticks = True
    end = driven(world, lambda drive: drive.move_joint(THERE, 2.0, 1.4, world.permit()))
    assert end.end is MotionOutcome.ROBOT_FAILED
    assert world.arm.target is None


def test_a_protective_stop_is_told_at_once(world):
    world.arm.mode, world.arm.sticks = 3, True
    assert (
        driven(world, lambda drive: drive.move_joint(THERE, 2.0, 1.4, world.permit())).end is MotionOutcome.ROBOT_FAILED
    )


@pytest.mark.parametrize("start", [None, (0.003, *HERE[1:])])
def test_an_arm_that_is_elsewhere_than_assessed_does_not_move(world, start):
    world.starts = {"r": start}

    async def scenario(drive):
        with pytest.raises(ActuationRefusedError) as raised:
            await drive.move_joint(THERE, 2.0, 1.4, world.permit())
        assert raised.value.reason is Reason.NOT_WHAT_WAS_DECIDED

    driven(world, scenario)
    assert "moveJ" not in world.arm.asked


def test_the_dashboard_stops_what_the_control_connection_cannot(world):
    async def scenario(drive):
        moving = asyncio.create_task(drive.move_joint(THERE, 0.05, 1.4, world.permit(numbers=(*THERE, 0.05, 1.4))))
        await until(lambda: world.arm.target is not None)
        world.arm.deaf = True
        end = await drive.stop()
        await moving
        return end

    assert driven(world, scenario).end is MotionOutcome.STOPPED
    assert "stop" in world.dashboard
    assert world.arm.target is None


def test_closing_stops_a_moving_arm(world):
    async def scenario(drive):
        asyncio.create_task(drive.move_joint(THERE, 0.05, 1.4, world.permit(numbers=(*THERE, 0.05, 1.4))))
        await until(lambda: world.arm.target is not None)

    driven(world, scenario)
    assert world.arm.target is None
    assert world.arm.asked[-2:] == ["stopScript", "disconnect"]


GRIP = (0.04, 0.1, 40.0)


def test_the_fingers_get_what_was_decided_and_stop_with_authority(world):
    async def scenario(drive):
        moving = asyncio.create_task(drive.gripper_move(*GRIP, world.permit(GRIPPER_MOVE, GRIP)))
        await until(lambda: world.fingers.moves)
        world.fault = Fault(FaultCode.REVOKED, "TOK-9")
        return await moving

    driven(world, scenario)
    assert world.fingers.moves == [{"width_um": 40_000, "speed_um_s": 100_000, "force_mn": 40_000}]
    assert world.fingers.halted.is_set()


def test_a_stop_between_the_permit_and_the_fingers_is_not_lost(world):
    async def scenario(drive):
        free = threading.Event()
        drive._fingers.submit(free.wait, 10)  # the worker is busy when the permit is spent
        permit = world.permit(GRIPPER_MOVE, GRIP)
        moving = asyncio.create_task(drive.gripper_move(*GRIP, permit))
        await until(lambda: permit.spent)
        await drive.stop()
        free.set()
        with pytest.raises(ActuationRefusedError) as raised:
            await moving
        assert raised.value.reason is permit.refusal is Reason.VERDICT_EXPIRED

    driven(world, scenario)
    assert world.fingers.moves == []


def test_an_arm_that_may_have_heard_an_unacknowledged_command_is_stopped(world):
    world.arm.unheard = True

    async def scenario(drive):
        with pytest.raises(ActuationRefusedError) as raised:
            await drive.move_joint(THERE, 2.0, 1.4, world.permit())
        assert raised.value.reason is Reason.EFFECT_FAILED
        assert world.arm.target is None

    driven(world, scenario)


def test_the_fingers_do_not_move_for_another_decision(world):
    async def scenario(drive):
        with pytest.raises(ActuationRefusedError) as raised:
            await drive.gripper_move(0.04, 0.1, 41.0, world.permit(GRIPPER_MOVE, GRIP))
        assert raised.value.reason is Reason.NOT_WHAT_WAS_DECIDED

    driven(world, scenario)
    assert world.fingers.moves == []


def test_one_holder_at_a_time(world):
    async def scenario(drive):
        assert drive.reserve("a")
        assert not drive.reserve("b")
        drive.release("b")
        assert not drive.reserve("b")
        drive.release("a")
        assert drive.reserve("b")

    driven(world, scenario)


# ------------------------------------------------------------------------------------------------------- the watch

SLOW = (*THERE, 0.2, 1.4)


def begun(drive, world, **changes):
    permit = world.permit(numbers=SLOW, **changes)
    return permit, asyncio.create_task(drive.move_joint(THERE, 0.2, 1.4, permit))


@pytest.mark.parametrize(
    ("cause", "reason"),
    [
        (lambda w: setattr(w, "seen", Seen((), 151)), Reason.WATCH_BLIND),
        (lambda w: setattr(w, "seen", Distrusted(RejectedFrame(FrameFault.UNTRUSTED, "c"))), Reason.PERCEPTION_INVALID),
        (lambda w: setattr(w, "rest", RemainingVerdict(False, 2_400, "person bob", "", 20)), Reason.IMPACT_ROSE),
        (
            lambda w: setattr(w, "rest", RemainingVerdict(False, None, "", "ENGINES_DISAGREE", 20)),
            Reason.ENGINES_DISAGREE,
        ),
    ],
)
def test_a_changed_world_ends_it_and_tells_the_record_what_was_seen(world, cause, reason):
    async def scenario(drive):
        permit, moving = begun(drive, world)
        await until(lambda: world.arm.q > 0.01)
        cause(world)
        return permit, await moving

    permit, end = driven(world, scenario)
    assert (end.end, end.reason) == (MotionOutcome.WORLD_CHANGED, reason)
    assert world.arm.target is None
    assert 0.01 < world.arm.q < 0.5
    watched = permit.watched
    assert (watched["outcome"], watched["reason"], watched["authorised_milli"]) == ("world_changed", reason, 1_000)
    assert watched["index_milli"] == (2_400 if reason is Reason.IMPACT_ROSE else None)
    assert 0.01 < watched["q_at_stop_rad"][0] <= watched["q_at_standstill_rad"][0] == world.arm.q
    assert watched["t_seen_ms"] <= world.clock.monotonic_ms()


def test_a_motion_that_ends_by_itself_leaves_no_trace_of_the_watch(world):
    permit = world.permit()
    assert driven(world, lambda drive: drive.move_joint(THERE, 2.0, 1.4, permit)).end is MotionOutcome.REACHED
    assert permit.watched is None
    assert world.hurried == [True, False]


def test_a_motion_that_the_watch_cannot_follow_in_time_ends(world):
    def late(permit, governor=None):
        return Watch(
            permit,
            remaining=world,
            views=world,
            limits=WatchAges(150, 2_000, 0),
            clock=world.clock,
            submit=world.submit,
        )

    world.watching = late
    end = driven(world, lambda drive: begun(drive, world)[1])
    assert (end.end, end.reason) == (MotionOutcome.WORLD_CHANGED, Reason.WATCH_LATE)


def test_a_blocked_event_loop_delays_no_stop(world):
    async def scenario(drive):
        _, moving = begun(drive, world)
        await until(lambda: world.arm.q > 0.01)
        world.fault, lost = Fault(FaultCode.REVOKED, "TOK-9"), time.monotonic()
        while time.monotonic() - lost < 3 and "stopJ" not in world.arm.asked:
            time.sleep(0.001)  # the loop belongs to somebody else
        assert "stopJ" in world.arm.asked
        return await moving

    assert driven(world, scenario).end is MotionOutcome.AUTHORITY_LOST


def test_readers_of_the_state_delay_no_look(world):
    """Every call of `read` hangs; the watch goes by the newest package and is not in the queue behind them."""
    hang = threading.Event()

    async def scenario(drive):
        _, moving = begun(drive, world)
        await until(lambda: world.arm.q > 0.01)
        honest = world.arm.read

        def slow():
            if threading.current_thread().name.startswith("state"):
                hang.wait(20)
            return honest()

        world.arm.read = slow
        reads = [asyncio.create_task(drive.read_state()) for _ in range(20)]
        world.fault = Fault(FaultCode.REVOKED, "TOK-9")
        try:
            return await moving
        finally:
            hang.set()
            await asyncio.gather(*reads)

    assert driven(world, scenario).end is MotionOutcome.AUTHORITY_LOST


def test_no_number_of_stops_keeps_one_from_going_out(world):
    """Fingers that cannot be halted hold nobody up, however often it is tried."""
    hang = threading.Event()
    world.fingers.halt = lambda: hang.wait(20)

    async def scenario(drive):
        for _ in range(20):
            await drive.stop()
        asked, stopped_ms = world.arm.asked.count("stopJ"), world.clock.monotonic_ms()
        await until(lambda: world.clock.monotonic_ms() > stopped_ms)
        _, moving = begun(drive, world)
        await until(lambda: world.arm.q > 0.01)
        world.fault = Fault(FaultCode.REVOKED, "TOK-9")
        try:
            assert (await moving).end is MotionOutcome.AUTHORITY_LOST
        finally:
            hang.set()
        assert world.arm.asked.count("stopJ") > asked

    driven(world, scenario)


def test_what_ends_while_the_command_is_handed_over_does_not_move_afterwards(world):
    """The controller is slow to take the command; the alarm comes before it has."""
    taken, free = threading.Event(), threading.Event()
    honest = world.arm.moveJ

    def slow(*arguments):
        taken.set()
        free.wait(20)
        return honest(*arguments)

    world.arm.moveJ = slow

    async def scenario(drive):
        _, moving = begun(drive, world)
        await until(taken.is_set)
        world.fault = Fault(FaultCode.REVOKED, "TOK-9")
        await until(lambda: "stopJ" in world.arm.asked)
        free.set()
        end = await moving
        assert world.arm.asked[-1] == "stopJ"
        assert world.arm.target is None
        return end

    assert driven(world, scenario).end is MotionOutcome.AUTHORITY_LOST


def test_the_dashboard_ends_what_the_watch_cannot_stop(world):
    async def scenario(drive):
        _, moving = begun(drive, world)
        await until(lambda: world.arm.q > 0.01)
        world.arm.deaf, world.seen = True, Unseen()
        return await moving

    end = driven(world, scenario)
    assert (end.end, end.reason) == (MotionOutcome.WORLD_CHANGED, Reason.WATCH_BLIND)
    assert "stop" in world.dashboard
    assert world.arm.target is None


def test_what_was_permitted_unseen_goes_on_unseen(world):
    world.seen = Unseen()
    end = driven(world, lambda drive: drive.move_joint(THERE, 2.0, 1.4, world.permit(sighted=False)))
    assert end.end is MotionOutcome.REACHED


def test_people_near_the_fingers_stop_them(world):
    async def scenario(drive):
        permit = world.permit(GRIPPER_MOVE, GRIP)
        moving = asyncio.create_task(drive.gripper_move(*GRIP, permit))
        await until(lambda: world.fingers.moves)
        world.rest = RemainingVerdict(holds=False, index_milli=3_000, cause="person bob", fault="", age_ms=20)
        return permit, await moving

    permit, grip = driven(world, scenario)
    assert (grip.end, grip.reason) == (MotionOutcome.WORLD_CHANGED, Reason.IMPACT_ROSE)
    assert world.fingers.halted.is_set()
    assert permit.watched["index_milli"] == 3_000


def test_fingers_that_a_stop_ended_say_so(world):
    async def scenario(drive):
        moving = asyncio.create_task(drive.gripper_move(*GRIP, world.permit(GRIPPER_MOVE, GRIP)))
        await until(lambda: world.fingers.moves)
        await drive.stop()
        return await moving

    assert driven(world, scenario).end is MotionOutcome.STOPPED


@pytest.mark.parametrize("where", ["view", "left", "standing"])
def test_a_watch_that_breaks_leaves_nothing_moving(world, where):
    async def scenario(drive):
        permit, moving = begun(drive, world)
        await until(lambda: world.arm.q > 0.01)

        def broken(*_, **__):
            raise ZeroDivisionError

        if where == "standing":
            permit._standing = broken
        else:
            setattr(world, where, broken)
        with contextlib.suppress(ZeroDivisionError):
            await moving
        assert world.arm.target is None
        assert 0.01 < world.arm.q < 0.5

    driven(world, scenario)


FULL_SPEED = RemainingVerdict(holds=True, index_milli=900, cause="", fault="", age_ms=20, pace=1.0)
NOT_SO_FAST = RemainingVerdict(holds=False, index_milli=2_100, cause="person", fault="", age_ms=20, pace=0.4)
SLOW_IS_WELL = RemainingVerdict(holds=True, index_milli=900, cause="", fault="", age_ms=20, pace=0.4)


def test_a_move_is_slowed_and_arrives_and_the_slider_is_where_it_was(world):
    world.arm.slider = world.arm.scaling = 0.9  # where a person has it
    speeds = []

    def left(request, q_rad, *, authorised_milli, touch, running):
        speeds.append(running)
        if 0.05 < q_rad[0] and running > 0.4:
            return NOT_SO_FAST
        return SLOW_IS_WELL if running < 1.0 else FULL_SPEED

    world.left = left
    permit = world.permit()
    end = driven(world, lambda drive: drive.move_joint(THERE, 0.5, 1.4, replaced(permit, world, (*THERE, 0.5, 1.4))))
    assert end.end is MotionOutcome.REACHED
    assert [(c.fraction, c.cause) for c in end.changes] == [(0.4, "person"), (1.0, "ended")]
    assert all(c.confirmed_ms is not None for c in end.changes)
    assert world.arm.sliders == [pytest.approx(0.399), 0.9]
    assert world.arm.slider == 0.9
    assert speeds[0] == 1.0
    assert speeds[-1] == 0.4


def replaced(permit, world, numbers):
    permit.digest = digest_of(MOVE_JOINT, numbers, audience=AUDIENCE)
    return permit


def slowed(world, told=NOT_SO_FAST):
    """A move that is told to be slower, and its permit."""
    permit = replaced(world.permit(), world, (*THERE, 0.3, 1.4))

    def left(request, q_rad, *, authorised_milli, touch, running):
        if q_rad[0] <= 0.02:
            return FULL_SPEED
        return told if running > 0.4 else world.rest

    world.rest = SLOW_IS_WELL
    world.left = left
    return permit, lambda drive: drive.move_joint(THERE, 0.3, 1.4, permit)


def test_the_record_tells_every_change_of_speed(world):
    permit, move = slowed(world)
    assert driven(world, move).end is MotionOutcome.REACHED
    watched = permit.watched
    assert watched["outcome"] == "reached"
    assert [(c["percent"], c["cause"]) for c in watched["speed"]] == [(40, "person"), (100, "ended")]
    assert watched["speed"][0]["t_ms"] <= watched["speed"][0]["t_confirmed_ms"] <= world.clock.monotonic_ms()


def test_a_slider_that_does_nothing_ends_the_move(world):
    world.arm.stuck = True
    permit, move = slowed(world)
    end = driven(world, move)
    assert (end.end, end.reason) == (MotionOutcome.WORLD_CHANGED, Reason.IMPACT_ROSE)
    assert "not slowed" in permit.watched["seen"]
    assert permit.watched["speed"][0]["t_confirmed_ms"] is None
    assert 0 < world.arm.q < THERE[0]


def test_a_slider_that_refuses_ends_the_move(world):
    world.arm.stuck = world.arm.refuses = True
    permit, move = slowed(world)
    assert driven(world, move).reason == Reason.IMPACT_ROSE
    assert "not set" in permit.watched["seen"]


def test_nothing_slower_ends_the_move_and_no_slider_is_touched(world):
    permit, move = slowed(world, replace(NOT_SO_FAST, pace=None))
    end = driven(world, move)
    assert (end.end, end.reason, end.changes) == (MotionOutcome.WORLD_CHANGED, Reason.IMPACT_ROSE, ())
    assert world.arm.sliders == []
    assert "speed" not in permit.watched


def test_a_slowed_move_that_is_stopped_or_forsaken_leaves_the_slider_where_it_was(world):
    async def stopped(drive):
        moving = asyncio.ensure_future(slowed(world)[1](drive))
        await until(lambda: world.arm.scaling < 0.41)
        await drive.stop()
        assert world.arm.target is None
        return await moving

    assert driven(world, stopped).end is MotionOutcome.STOPPED
    assert world.arm.sliders[1:] == [1.0]
    world.arm.__init__()

    async def forsaken(drive):
        moving = asyncio.ensure_future(slowed(world)[1](drive))
        await until(lambda: world.arm.scaling < 0.41)
        moving.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await moving
        assert world.arm.target is None
        return world.arm.slider

    assert driven(world, forsaken) == 1.0
    assert world.arm.asked.index("stopJ") >= 0


def test_an_arm_that_may_still_move_is_not_let_faster(world, monkeypatch):
    """No standstill was seen: the slider stays low, and the record says so."""
    monkeypatch.setattr(stop_ladder, "STOP_LIMIT_MS", 300)
    permit, move = slowed(world)

    async def scenario(drive):
        moving = asyncio.ensure_future(move(drive))
        await until(lambda: world.arm.scaling < 0.41)
        world.arm.silent = True
        return await moving

    end = driven(world, scenario)
    assert end.end is MotionOutcome.ROBOT_FAILED
    assert [change.cause for change in end.changes] == ["person"]
    assert world.arm.sliders == [pytest.approx(0.399)]


def test_an_arm_that_goes_on_after_every_stop_is_not_let_faster(world, monkeypatch):
    """It is heard, and it moves: neither the command nor the dashboard has stopped it."""
    monkeypatch.setattr(stop_ladder, "STOP_LIMIT_MS", 300)
    monkeypatch.setattr(world.arm, "halt", lambda: None)
    permit, move = slowed(world)

    async def scenario(drive):
        moving = asyncio.ensure_future(move(drive))
        await until(lambda: world.arm.scaling < 0.41)
        world.rest = replace(NOT_SO_FAST, pace=None)
        world.seen = Seen((), 21)
        end = await moving
        world.arm.target = None
        return end

    end = driven(world, scenario)
    assert end.end is MotionOutcome.ROBOT_FAILED
    assert [change.cause for change in end.changes] == ["person"]
    assert world.arm.sliders == [pytest.approx(0.399)]


def test_a_watch_that_breaks_after_it_slowed_down_stops_the_arm_before_it_may_be_faster(world):
    _, move = slowed(world)

    async def scenario(drive):
        moving = asyncio.ensure_future(move(drive))
        await until(lambda: world.arm.scaling < 0.41)

        def broken():
            raise ZeroDivisionError

        world.view = broken
        with pytest.raises(ZeroDivisionError):
            await moving

    driven(world, scenario)
    assert world.arm.target is None
    assert world.arm.sliders == [pytest.approx(0.399), 1.0]


@pytest.mark.parametrize(("silent_ms", "put"), [(SILENCE_MS, True), (SILENCE_MS + 1, False)])
def test_an_arm_that_stood_when_it_was_last_heard_may_move_by_now(world, silent_ms, put):
    governor = Governor(SpeedSlider(world.arm), pacing=PACING, least=0.0, speeds=ReportedSpeeds(1.0, 1.0, 0), now_ms=0)
    governor.take(Offer(False, 0.4, 2_100, "person"), running=1.0, heard_ms=0, now_ms=0)
    arm = SimpleNamespace(
        look=lambda: True, silent_ms=silent_ms, state=world.arm.here(), speeds=ReportedSpeeds(1.0, 1.0, 0)
    )
    put_back(governor, arm, clock=world.clock)
    assert [change.cause for change in governor.changes] == ["person", *(["ended"] if put else [])]


def test_a_slowed_move_may_take_its_time(world, monkeypatch):
    """At a tenth of its speed it takes ten times as long, and is not too slow."""
    monkeypatch.setattr(drive_module, "SLACK_MS", 200)
    permit = replaced(world.permit(), world, (*THERE, 2.0, 40.0))
    tenth = replace(NOT_SO_FAST, pace=0.1)
    world.left = lambda request, q_rad, *, authorised_milli, touch, running: (
        tenth if running > 0.1 else replace(SLOW_IS_WELL, pace=0.1)
    )
    began = time.monotonic()
    end = driven(world, lambda drive: drive.move_joint(THERE, 2.0, 40.0, permit))
    assert end.end is MotionOutcome.REACHED
    assert [change.fraction for change in end.changes] == [0.1, 1.0]
    assert time.monotonic() - began > 1.5 * 0.3 + 0.2, "it was not slowed"


@pytest.mark.parametrize(
    ("speed", "acceleration", "least"), [(1.0, 1.4, 0.0189), (0.004, 1.4, 0.5), (1.0, 0.01, 0.2236), (0.002, 1.4, 1.0)]
)
def test_a_move_is_not_slowed_to_what_looks_like_standstill(speed, acceleration, least):
    assert least_fraction(speed, acceleration) == pytest.approx(least, abs=1e-4)
