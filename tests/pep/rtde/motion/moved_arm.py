"""Arm whose first joint moves, on a clock that goes on only at looks, with its permits and watch."""

import threading
from concurrent.futures import Future
from dataclasses import replace

from pep.base.operations import MOVE_JOINT
from pep.base.request_digest import digest_of
from pep.base.ports import RemainingVerdict
from pep.perception.sensor_frames import Seen
from pep.request.permit import Permit
from pep.rtde.command import command_values as v
from pep.rtde.robot.state_receiver import JointState
from pep.watch.governor import Pacing
from pep.watch.watch import Watch, WatchAges
from policies.evidence.model import Request
from tests.pep.rtde.packages import package
from tests.pep.kit import AUDIENCE, ManualClock

HERE = (0.0,) * 6
THERE = (0.5, *HERE[1:])
PACING = Pacing(delay_ms=400, change_ms=250, slowest=0.1, dwell_ms=100, gain=0.1)


class Arm:
    """Moves its first joint towards a target or at a speed. Also `RobotState`, `Stopper` and `Slider`."""

    def __init__(self, clock):
        self.clock, self.lock = clock, threading.RLock()
        self.q, self.target, self.speed, self.at_ms = 0.0, None, 0.0, clock.mono
        self.mode, self.said, self.stopped_ms = 1, None, None
        self.silent = self.deaf = self.sticks = self.unstoppable = False
        self.stops, self.hard = [], []  # reasons of brakes, and of harder stops
        self.slider, self.scaling, self.sliders, self.stuck, self.failed = 1.0, 1.0, [], False, False

    def go_on(self):
        with self.lock:
            passed_s, self.at_ms = (self.clock.mono - self.at_ms) / 1000, self.clock.mono
            self.scaling += max(-4 * passed_s, min(4 * passed_s, self.slider - self.scaling))
            if self.target is not None and not self.sticks:
                step = self.speed * self.scaling * passed_s
                self.q += max(-step, min(step, self.target - self.q))
                if self.q == self.target:
                    self.target = None

    def take(self, command):
        """Takes the command, as the controller does."""
        with self.lock:
            self.go_on()
            if isinstance(command, v.MoveJ):
                self.target, self.speed = command.q_rad[0], command.speed_rad_s
            else:
                self.target, self.speed = 1e9, command.qd_rad_s[0]

    def halt(self):
        with self.lock:
            self.go_on()
            if not self.unstoppable:
                self.target = None

    def brake(self, reason=None):
        """A stop by registers."""
        self.stops.append(reason)
        self.stopped_ms = self.clock.mono
        if not self.deaf:
            self.halt()

    # Stopper
    def stop(self, reason):
        self.hard.append(reason)
        self.halt()

    # RobotState
    def read(self):
        with self.lock:
            self.go_on()
            moving = self.target is not None and not self.sticks
            state = JointState(
                (self.q, *HERE[1:]), (self.speed * self.scaling if moving else 0.0, *HERE[1:]), 7, self.mode
            )
            return replace(state, slider=self.slider, scaling=self.scaling)

    def newest(self):
        with self.lock:
            self.clock.mono += 1
            if not self.silent or self.said is None:
                self.said = package(self.read(), stamp_s=self.clock.mono / 1000, arrived_ms=self.clock.mono)
            return self.said

    # Slider
    def set(self, fraction):
        with self.lock:
            self.go_on()
            self.sliders.append(fraction)
            if not self.stuck:
                self.slider = fraction


class Scene:
    """Permits and watch of a motion. `events` on its way are pairs of a condition and an act."""

    def __init__(self):
        self.clock = ManualClock()
        self.arm = Arm(self.clock)
        self.fault, self.seen = None, Seen((), 20)
        self.rest = RemainingVerdict(holds=True, index_milli=900, cause="", fault="", age_ms=20)
        self.limits = WatchAges(view_ms=150, judged_ms=2_000, look_ms=2_000)
        self.events, self.watches = [], []
        self.starts = HERE

    def when(self, condition, event):
        """Adds an event that happens once its condition holds; each pause of the follower looks."""
        self.events.append((condition, event))

    def past(self, q, event):
        self.when(lambda: self.arm.q > q, event)

    def pause(self, seconds):
        self.clock.mono += round(1000 * seconds)
        self.arm.go_on()
        for each in [each for each in self.events if each[0]()]:
            self.events.remove(each)
            each[1]()

    def watching(self, permit, *, governor=None):
        watch = Watch(
            permit,
            remaining=self,
            views=self,
            limits=self.limits,
            clock=self.clock,
            submit=self.submit,
            governor=governor,
        )
        self.watches.append((watch, governor))
        return watch

    def submit(self, judge):
        judging = Future()
        try:
            judging.set_result(judge())
        except Exception as error:
            judging.set_exception(error)
        return judging

    def left(self, request, q_rad, *, authorised_milli, touch, running, oldest_ms):
        return self.rest

    def view(self, *, oldest_ms=None):
        return self.seen

    def start_of(self, request_id):
        return self.starts

    def permit(self, operation=MOVE_JOINT, numbers=(*THERE, 2.0, 1.4), *, name="r", agent="robotic", **changes):
        now = self.clock.monotonic_ms()
        return Permit(
            request_id=name,
            digest=digest_of(operation, numbers, audience=AUDIENCE),
            since_ms=now,
            deadline_ms=now + 50,
            clock=self.clock,
            standing=lambda: self.fault,
            request=Request(name, frozenset(), AUDIENCE, "ur3e", operation.name, (), 0.0),
            index_milli=1_000,
            agent=agent,
            **changes,
        )
