"""Lease, an obedient arm, and the judge in between: gate, authority and journal are real."""

import asyncio
import threading
import time
from concurrent.futures import Future
from dataclasses import dataclass, field, replace

from capabilities.values.scope import Grant, Limit, Tier
from pep.base.clock import SystemClock
from pep.base.operations import (
    MOVE_LINEAR,
    MOVE_UNTIL_CONTACT,
    MOVE_WAYPOINTS,
    OPERATIONS,
    SERVO_JOINT,
    SERVO_LINEAR,
    SET_PAYLOAD,
    SET_SPEED_SLIDER,
    SET_TCP,
    SPEED_LINEAR,
    ZERO_FORCE_SENSOR,
)
from pep.base.request_digest import digest_of
from pep.base.ports import RemainingVerdict
from pep.gate.motion_slot import Slot
from pep.perception.sensor_frames import Seen
from pep.rtde.judge.command_judge import LeasedJudge
from pep.rtde.judge.command_requests import ToolSetup
from pep.rtde.judge.execution import LeasedEffects
from pep.rtde.motion.motions import Motions
from pep.rtde.lease.lease import Lease
from pep.rtde.robot.gripper import GripResult
from pep.rtde.robot.state_receiver import JointState
from pep.rtde.wire.client_texts import fits
from pep.watch.watch import Watch, WatchAges
from pep.world.cell_stream import Judged, Shown
from pep.world.held_object import CommittedGrip, DeclaredLoad
from pep.world.tool_poses import ToolPoses
from policies.words.parameters import Parameters
from tests.pep.kit import AUDIENCE, Rig, full_scope, reading
from tests.pep.pit.scenes import CELL, ROBOT
from tests.pep.rtde.packages import package

from pep.rtde.command import command_values as v

HERE = (0.0,) * 6
THERE = (0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
LOAD = DeclaredLoad("cube", 1.325, (0.0, 0.0, 0.09))
FITTED = ToolSetup((0.0, 0.0, 0.163, 0.0, 0.0, 0.0), 0.925, (0.0, 0.0, 0.058), (LOAD,))
POSES = ToolPoses(CommittedGrip(ROBOT, CELL))
LIMITS = {each.name: {one.parameter.name: one.bound for one in each.limits} for each in OPERATIONS}
LEASED = (
    MOVE_LINEAR,
    MOVE_UNTIL_CONTACT,
    MOVE_WAYPOINTS,
    SPEED_LINEAR,
    SERVO_JOINT,
    SERVO_LINEAR,
    SET_SPEED_SLIDER,
    SET_PAYLOAD,
    SET_TCP,
    ZERO_FORCE_SENSOR,
)


def leased_scope(at, *, without=(), limits=None, **changes):
    """As `full_scope`, with all that a leased program can ask for, and without the trajectory of a tool."""
    scope = full_scope(at, **changes)
    own = {**LIMITS, **(limits or {})}
    more = [
        Grant("ur3e", each.name, tuple(Limit(p, own[each.name][p.name]) for p in each.parameters)) for each in LEASED
    ]
    grants = [grant for grant in (*scope.grants, *more) if grant.operation not in {*without, "follow_trajectory"}]
    return replace(scope, grants=tuple(sorted(grants, key=lambda grant: grant.operation)))


class Arm:
    """Its first joint goes to a target, or at a speed; also what stops it."""

    def __init__(self):
        self.q, self.target, self.speed = 0.0, None, 0.0
        self.mode, self.sticks, self.silent, self.deaf = 1, False, False, False
        self.at, self.lock = time.monotonic(), threading.Lock()
        self.stopped_ms, self.stops, self.hard, self.said = None, [], [], None
        self.clock = SystemClock()

    def go_on(self):
        now = time.monotonic()
        step, self.at = abs(self.speed) * (now - self.at), now
        if self.sticks:
            return
        if self.target is not None:
            self.q += max(-step, min(step, self.target - self.q))
            if self.q == self.target:
                self.target, self.speed = None, 0.0
        else:
            self.q += step if self.speed > 0 else -step

    def take(self, command):
        with self.lock:
            self.go_on()
            match command:
                case v.MoveJ(q, speed):
                    self.target, self.speed = q[0], speed
                case v.MoveL(pose, speed):
                    self.target, self.speed = pose[0], speed
                case v.ServoJ(q):
                    self.target, self.speed = q[0], 2.0
                case v.SpeedJ(qd):
                    self.target, self.speed = None, qd[0]
                case v.SpeedL(xd):
                    self.target, self.speed = None, xd[0]
                case _:
                    pass

    def halt(self):
        """Stops the arm, by its program or another party."""
        with self.lock:
            self.go_on()
            self.target, self.speed = None, 0.0
            self.stopped_ms = self.clock.monotonic_ms()

    def brake(self, reason):
        """By the line, because of what was forwarded."""
        self.stops.append(reason)
        self.stopped_ms = self.clock.monotonic_ms()
        if not self.deaf:
            self.halt()

    # Stopper
    def stop(self, reason):
        self.hard.append(reason)
        self.halt()

    # RobotState
    def here(self):
        with self.lock:
            self.go_on()
            moving = 0.0 if self.sticks else self.speed
            return JointState((self.q, *HERE[1:]), (moving, *HERE[1:]), 7, self.mode)

    def read(self):
        return self.here()

    def newest(self):
        if not self.silent or self.said is None:
            self.said = package(self.here(), stamp_s=time.monotonic())
        return self.said


@dataclass(eq=False)
class Held:
    """A command of a program, and what came of it."""

    arm: Arm
    lease: Lease
    command: object
    path: tuple = ()
    waits: bool = True
    answers: list = field(default_factory=list)
    denied: str = ""  # with this line
    steps: object = None
    before: object = None
    written: object = None

    def forward(self, steps=None, *, written=None):
        if not self.waits:
            return False
        self.written = written or self.command
        self.answers.append("forward")
        self.steps = steps
        if self.before is not None:
            self.before()
        self.arm.take(self.written)
        return True

    carried_out = False

    def deny(self, reason, told):
        assert told.startswith(str(reason))
        assert fits(told)
        self.answers.append(reason)
        self.denied = told

    def defer(self, told):
        self.answers.append("defer")

    def stop(self, reason, told):
        assert self.forwarded
        assert told.startswith(str(reason))
        self.arm.brake(reason)

    @property
    def forwarded(self):
        return "forward" in self.answers


class Certifying:
    """Says of each value of a stream what a test says."""

    def __init__(self):
        self.answer = Judged(900, (), 0.1, 0.0)
        self.shown, self.values, self.seen = Shown(10, "all"), [], 0

    def see(self, q_rad):
        self.seen += 1
        return self.shown

    def judge(self, value, state, *, authorised_milli, seed):
        self.values.append((value, state, authorised_milli))
        return self.answer() if callable(self.answer) else self.answer

    def strays(self, state):
        return ""


class House(Rig):
    """A robot with a judge before it, and a lease. The gate's physics says what a test says."""

    def __init__(self, tmp):
        super().__init__(tmp, clock=SystemClock())

    def __post_init__(self):
        self.arm, self.certifying, self.hurried, self.loads, self.grips = Arm(), Certifying(), [], [], []
        self.rest = RemainingVerdict(holds=True, index_milli=900, cause="", fault="", age_ms=20)
        self.seen, self.starts = Seen((), 20), HERE
        super().__post_init__()
        self.slot = Slot()
        self.build()
        self.holder = self.agent(scope=leased_scope(self.clock.wall_s()))
        self.physics.answer = reading(1, 900)

    def build(self, journal=None):
        """With verdicts that last: a loaded host is slow, and no test here is about that."""
        super().build(journal)
        made = self.gate._permit

        def lasting(*arguments):
            permit = made(*arguments)
            permit.deadline_ms += 10_000
            return permit

        self.gate._permit = lasting
        return self

    def lease(self, holder=None):
        return Lease(b"l" * 16, "robotic", self.credentials(holder or self.holder), None, 2**40)

    def judge(self):
        effects = LeasedEffects(
            motions=Motions(
                starts=self,
                hurry=lambda *, moving: self.hurried.append(moving),
                state=self.arm,
                stopper=self.arm,
                clock=self.clock,
                pause=time.sleep,
            ),
            acts=self,
            remaining=self,
            certifying=self.begin_stream,
            posing=POSES,
            declared=self.loads.append,
            watching=self.watching,
            fingers=self,
            record=self.gate.record,
            parameters=Parameters(),
            audience=AUDIENCE,
            clock=self.clock,
        )
        return LeasedJudge(
            gate=self.gate,
            effects=effects,
            asks=self.asks,
            readiness=self.readiness,
            registry=self.registry,
            stopper=self.arm,
            fitted=lambda: FITTED,
            audience=AUDIENCE,
            clock=self.clock,
        )

    def begin_stream(self, touch, led=None):
        return self.certifying

    async def grip(self, operation, numbers, permit, *, begun):
        """As `ToolMotions.grip`, of fingers that are there at once."""
        permit.spend(digest=digest_of(operation, numbers, audience=AUDIENCE), stopped_ms=self.arm.stopped_ms)
        begun()
        self.grips.append((operation.name, numbers))
        return GripResult(85_000, object=False, arrived=True)

    def watching(self, permit, *, remaining):
        return Watch(
            permit,
            remaining=remaining,
            views=self,
            limits=WatchAges(view_ms=150, judged_ms=5_000, look_ms=5_000),
            clock=self.clock,
            submit=self.submit,
        )

    def submit(self, judge):
        judging = Future()
        try:
            judging.set_result(judge())
        except Exception as error:
            judging.set_exception(error)
        return judging

    def view(self, *, oldest_ms=None):
        return self.seen

    def left(self, request, q_rad, *, authorised_milli, touch, running, oldest_ms):
        return self.rest

    def start_of(self, request_id):
        return self.starts

    def arrived(self, request_id, q_rad):
        return abs(q_rad[0] - THERE[0]) <= 1e-3

    def held(self, command, holder=None, **changes):
        return Held(self.arm, self.lease(holder), command, **changes)

    def outcomes(self):
        return [record["body"] for record in self.records("outcome")]


def played(house, scenario):
    """Result of `scenario(judge)`, with the arm standing afterwards."""

    async def inside():
        # The end of the one before is a stop, which counts for requests of the same millisecond, too.
        since_ms = time.monotonic_ns() // 1_000_000
        await until(lambda: time.monotonic_ns() // 1_000_000 > since_ms)
        judge = house.judge()
        try:
            async with asyncio.timeout(30):
                return await scenario(judge)
        finally:
            await judge.close()

    return asyncio.run(inside())


async def until(seen):
    """It is so."""
    async with asyncio.timeout(20):
        while not seen():
            await asyncio.sleep(0.002)


HIGH = Tier.HIGH_CONSEQUENCE
