"""Motions of the tools: each is sent as decided, once, from its assessed start, and one at a time."""

import asyncio
import math
import threading

import pytest
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.units import Quantity, parse
from pep.base.errors import ActuationRefusedError, PepFault, RobotError
from pep.base.operation_row import OperationKind
from pep.base.operations import (
    GRIPPER_ACTIVATE,
    GRIPPER_MOVE,
    MOVE_JOINT,
    MOVE_LINEAR,
    MOVE_PATH,
    OPERATIONS,
    SET_DIGITAL_OUTPUT,
    SPEED_JOINT,
    padded,
)
from pep.rtde.command import command_values as v
from pep.rtde.motion.governed_move import SpeedControl
from pep.rtde.motion.motions import UNSEEN_MS, Motions
from pep.rtde.own.tool_motions import ToolMotions
from pep.rtde.robot.gripper import GripResult
from pep.watch.watch import MotionOutcome, WatchAges
from policies.evidence.model import Request
from policies.words.reason_table import Reason
from tests.pep.kit import AUDIENCE
from tests.pep.rtde.motion.moved_arm import HERE, PACING, THERE, Scene

REVOKED = Fault(FaultCode.REVOKED, "TOK-9")
QUICK = (2.0, 1.4)
MOVE = (*THERE, *QUICK)
PATH = tuple((x, *HERE[1:]) for x in (0.3, 0.1, 0.5))
QD = (0.4, 0.0, 0.0, 0.0, 0.0, 0.0)
SPEEDS = (*QD, 2.0, 0.5)
GRIP = (0.04, 0.1, 40.0)


def path(waypoints=PATH, timing=QUICK):
    return (*(q for point in padded(waypoints) for q in point), *timing)


class Lines:
    """The tools' line to the arm. From `untaken` on, counted in commands, none is taken."""

    def __init__(self, arm):
        self.arm, self.given, self.is_ready, self.untaken, self.ended = arm, [], True, math.inf, False
        self.before = lambda: None

    async def ready(self):
        return self.is_ready

    def give(self, command):
        self.before()
        if len(self.given) >= self.untaken:
            return False
        self.given.append(command)
        self.arm.take(command)
        return True

    def stop(self):
        self.arm.brake()

    def end(self):
        self.ended = True


class Fingers:
    """Move until they are told to stop, or for as long as a test wants."""

    def __init__(self):
        self.moves, self.halts, self.ends, self.raises = [], 0, None, None

    def move(self, *, stopped, **numbers):
        self.moves.append(numbers)
        if self.raises is not None:
            raise self.raises
        while not stopped() and self.ends is None:
            threading.Event().wait(0.002)
        return GripResult(40_000, object=False, arrived=self.ends is not None and not stopped())

    def activate(self, *, stopped):
        self.moves.append("activate")
        return GripResult(85_000, object=False, arrived=True)

    def halt(self):
        self.halts += 1


class Outputs:
    def __init__(self):
        self.sent = []

    async def set(self, pin, value, permit):
        self.sent.append((pin, value, permit))

    def close(self):
        pass


class Tools(Scene):
    """The tools over an arm, on a clock that their own follower advances."""

    def __init__(self):
        super().__init__()
        self.lines, self.fingers, self.outputs = Lines(self.arm), Fingers(), Outputs()
        self.gripped, self.hurried = [], []

    def made(self):
        async def gripped(grip):
            self.gripped.append(grip)

        self.motions = Motions(
            starts=self,
            hurry=lambda *, moving: self.hurried.append(moving),
            state=self.arm,
            stopper=self.arm,
            clock=self.clock,
            pause=self.pause,
        )
        self.tools = ToolMotions(
            self.lines,
            self.motions,
            gripper=self.fingers,
            outputs=self.outputs,
            watching=self.watching,
            speed=SpeedControl(self.arm, PACING),
            gripped=gripped,
            audience=AUDIENCE,
            clock=self.clock,
        )
        return self.tools

    def played(self, scenario):
        async def inside():
            tools = self.made()
            try:
                async with asyncio.timeout(20):
                    return await scenario(tools)
            finally:
                await tools.close()
                self.motions.close()

        return asyncio.run(inside())

    def act(self, operation=MOVE_JOINT, numbers=MOVE, permit=None):
        permit = permit or self.permit(operation, numbers)
        return self.played(lambda tools: tools.act(operation, numbers, permit))

    def refuses(self, reason, operation=MOVE_JOINT, numbers=MOVE, permit=None):
        with pytest.raises(ActuationRefusedError) as raised:
            self.act(operation, numbers, permit)
        assert raised.value.reason is reason
        assert (self.lines.given, self.fingers.moves) == ([], [])


@pytest.fixture
def world():
    return Tools()


async def until(seen):
    async with asyncio.timeout(10):
        while not seen():
            await asyncio.sleep(0.001)


# ------------------------------------------------------------------------------------------- what was decided, and once


def test_with_its_permit_exactly_these_numbers_are_sent(world):
    permit = world.permit()
    end = world.act(permit=permit)
    assert (end.end, permit.spent) == (MotionOutcome.REACHED, True)
    assert world.lines.given == [v.MoveJ(THERE, 2.0, 1.4, asynchronous=True)]
    assert (world.hurried, world.lines.ended) == ([True, False], True)


CASES = [(MOVE_JOINT, MOVE), (MOVE_PATH, path()), (SPEED_JOINT, SPEEDS), (GRIPPER_MOVE, GRIP)]


@pytest.mark.parametrize(
    ("operation", "numbers", "index"),
    [(operation, numbers, index) for operation, numbers in CASES for index in range(len(numbers))],
    ids=lambda each: getattr(each, "name", str(each) if isinstance(each, int) else ""),
)
def test_one_unit_off_in_any_number_is_something_else(world, operation, numbers, index):
    unit = 1 / operation.parameters[index].unit.per_si
    off = tuple(number + unit * (at == index) for at, number in enumerate(numbers))
    world.refuses(Reason.NOT_WHAT_WAS_DECIDED, operation, off, world.permit(operation, numbers))


@pytest.mark.parametrize("number", [0.5 + 1e-7, math.nan, math.inf])
@pytest.mark.parametrize(("operation", "numbers"), [(MOVE_JOINT, MOVE), (SPEED_JOINT, SPEEDS)])
def test_what_is_no_whole_unit_is_something_else(world, number, operation, numbers):
    off = (number, *numbers[1:])
    world.refuses(Reason.NOT_WHAT_WAS_DECIDED, operation, off, world.permit(operation, numbers))


@pytest.mark.parametrize("other", [PATH[:2], (PATH[1], PATH[0], PATH[2])])
def test_a_permit_is_for_its_own_waypoints(world, other):
    world.refuses(Reason.NOT_WHAT_WAS_DECIDED, MOVE_PATH, path(other), world.permit(MOVE_PATH, path()))


@pytest.mark.parametrize(("operation", "numbers"), CASES)
def test_too_late(world, operation, numbers):
    permit = world.permit(operation, numbers)
    permit.deadline_ms = world.clock.mono - 1
    world.refuses(Reason.VERDICT_EXPIRED, operation, numbers, permit)


@pytest.mark.parametrize(("operation", "numbers"), CASES)
def test_a_stop_voids_what_was_asked_for_before(world, operation, numbers):
    permit = world.permit(operation, numbers)
    world.arm.stopped_ms = permit.since_ms
    world.refuses(Reason.VERDICT_EXPIRED, operation, numbers, permit)


@pytest.mark.parametrize("start", [None, (0.003, *HERE[1:])])
@pytest.mark.parametrize(("operation", "numbers"), CASES[:3])
def test_an_arm_that_is_elsewhere_than_assessed_does_not_move(world, operation, numbers, start):
    world.starts = start
    permit = world.permit(operation, numbers)
    world.refuses(Reason.NOT_WHAT_WAS_DECIDED, operation, numbers, permit)
    assert not permit.spent


def test_a_permit_is_spent_once(world):
    permit = world.permit()
    permit.deadline_ms += 10_000
    world.act(permit=permit)
    world.starts, world.lines.given = THERE, []
    world.refuses(Reason.NOT_WHAT_WAS_DECIDED, permit=permit)


@pytest.mark.parametrize(("operation", "numbers"), CASES[:3])
@pytest.mark.parametrize("how", ["not ready", "not taken"])
def test_a_controller_that_takes_no_command(world, operation, numbers, how):
    world.lines.is_ready, world.lines.untaken = how != "not ready", 0
    permit = world.permit(operation, numbers)
    world.refuses(Reason.EFFECT_FAILED, operation, numbers, permit)
    assert permit.spent is (how == "not taken")


@pytest.mark.parametrize(
    "operation",
    [each for each in OPERATIONS if each.kind is not OperationKind.STOP and each.arguments is None],
    ids=lambda each: each.name,
)
def test_what_no_tool_stands_for_is_refused(world, operation):
    world.refuses(Reason.NOT_GRANTED, operation, (0.1,) * len(operation.parameters))
    assert MOVE_LINEAR.arguments is None


def test_an_output_is_given_to_the_outputs(world):
    permit = world.permit(SET_DIGITAL_OUTPUT, (2, 1))
    world.act(SET_DIGITAL_OUTPUT, (2, 1), permit)
    assert world.outputs.sent == [(2, True, permit)]


# ---------------------------------------------------------------------------------------------------- one at a time


def test_one_holder_at_a_time(world):
    async def scenario(tools):
        assert tools.reserve("a")
        assert not tools.reserve("b")
        tools.release("b")
        assert not tools.reserve("b")
        tools.release("a")
        assert tools.reserve("b")

    world.played(scenario)


def test_a_stop_ends_it_and_is_told_when_the_arm_stands(world):
    async def scenario(tools):
        moving = asyncio.create_task(tools.act(MOVE_JOINT, MOVE, world.permit()))
        await until(lambda: world.arm.target is not None)
        return await tools.stop(), await moving

    world.pause = lambda seconds: (Scene.pause(world, seconds), threading.Event().wait(0.001))
    stopped, end = world.played(scenario)
    assert stopped.end is end.end is MotionOutcome.STOPPED
    assert (world.arm.target, world.arm.hard) == (None, [])
    assert world.arm.q < THERE[0]
    assert world.fingers.halts >= 1


def test_a_caller_who_goes_away_leaves_it_standing(world):
    async def scenario(tools):
        moving = asyncio.create_task(tools.act(MOVE_JOINT, MOVE, world.permit()))

        async def left():
            moving.cancel()
            for _ in range(10):  # turns of the loop in which the follower is told
                await asyncio.sleep(0)

        world.past(0.1, lambda: asyncio.run_coroutine_threadsafe(left(), loop).result(10))
        loop = asyncio.get_running_loop()
        with pytest.raises(asyncio.CancelledError):
            await moving
        assert world.arm.target is None, "not before it stands"
        assert world.hurried == [True, False]

    world.pause = lambda seconds: (Scene.pause(world, seconds), threading.Event().wait(0.001))
    world.played(scenario)
    assert 0.1 < world.arm.q < THERE[0]


def test_a_motion_that_nobody_looks_at_is_stopped_by_who_waits(world):
    """The thread that looks hangs; the event loop stops the arm."""
    slow = (*THERE, 0.5, 1.4)
    hangs, free = threading.Event(), threading.Event()
    world.limits = WatchAges(view_ms=150, judged_ms=2_000, look_ms=150)

    def hang():
        hangs.set()
        free.wait(10)

    async def scenario(tools):
        moving = asyncio.create_task(tools.act(MOVE_JOINT, slow, world.permit(numbers=slow)))
        await until(hangs.is_set)
        assert world.arm.stops == []
        world.clock.mono += UNSEEN_MS + 5
        await until(lambda: world.arm.stops)
        free.set()
        return await moving

    world.past(0.1, hang)
    end = world.played(scenario)
    assert (end.end, end.reason) == (MotionOutcome.WORLD_CHANGED, Reason.WATCH_LATE)
    assert world.arm.q < THERE[0]


def test_readers_of_the_state_delay_no_look(world):
    hang, honest = threading.Event(), world.arm.read

    def read():
        if threading.current_thread().name.startswith("state"):
            hang.wait(10)
        return honest()

    world.arm.read = read

    async def scenario(tools):
        reads = [asyncio.create_task(tools.read_state()) for _ in range(20)]
        await asyncio.sleep(0)
        try:
            return await tools.act(MOVE_JOINT, MOVE, world.permit())
        finally:
            hang.set()
            await asyncio.gather(*reads)

    assert world.played(scenario).end is MotionOutcome.REACHED


# ------------------------------------------------------------------------------------------------------------- paths


def test_a_path_goes_through_every_waypoint_in_order(world):
    end = world.act(MOVE_PATH, path())
    assert (end.end, end.q_rad[0]) == (MotionOutcome.REACHED, pytest.approx(0.5, abs=1e-3))
    assert world.lines.given == [v.MoveJ(point, *QUICK, asynchronous=True) for point in PATH]


def in_the_second_leg(world, change):
    world.when(lambda: len(world.lines.given) == 2 and world.arm.q < 0.25, change)
    end = world.act(MOVE_PATH, path())
    assert [command.q_rad[0] for command in world.lines.given] == [0.3, 0.1]
    assert world.arm.target is None
    return end


def test_a_stop_in_a_leg_ends_the_path(world):
    assert in_the_second_leg(world, world.arm.brake).end is MotionOutcome.STOPPED


def test_lost_authority_in_a_leg_ends_the_path(world):
    end = in_the_second_leg(world, lambda: setattr(world, "fault", REVOKED))
    assert (end.end, end.reason) == (MotionOutcome.AUTHORITY_LOST, "REVOKED")


def test_after_a_stop_no_leg_is_sent(world):
    world.when(lambda: world.arm.q == 0.3, world.arm.brake)
    assert world.act(MOVE_PATH, path()).end is MotionOutcome.STOPPED
    assert len(world.lines.given) == 1


def test_a_leg_that_the_controller_does_not_take_ends_the_path(world):
    world.lines.untaken = 1
    end = world.act(MOVE_PATH, path())
    assert (end.end, end.reason) == (MotionOutcome.ROBOT_FAILED, "a leg was not taken")
    assert len(world.lines.given) == 1


def test_a_move_is_governed_and_a_path_is_not(world):
    """PHY-50: nobody asks about another speed of a path, and none is set."""
    world.act()
    world.starts = THERE
    world.act(MOVE_PATH, path())
    assert [governor is not None for _, governor in world.watches] == [True, False]


# ------------------------------------------------------------------------------------------------------------ speeds


def test_speeds_last_for_their_time(world):
    end = world.act(SPEED_JOINT, SPEEDS)
    assert (end.end, end.reason) == (MotionOutcome.ENDED, "")
    assert world.lines.given == [v.SpeedJ(QD, 2.0, 0.0)]
    assert end.q_rad[0] == pytest.approx(0.4 * 0.5, abs=0.01)


def request(qd, operation=SPEED_JOINT):
    values = tuple(
        Quantity(p.name, p.unit, parse(n, p.unit)) for n, p in zip((*qd, 2.0, 0.5), SPEED_JOINT.parameters, strict=True)
    )
    return Request("x", frozenset(), AUDIENCE, "ur3e", operation.name, values, 0.0)


def streaming(world, scenario):
    """That, once the arm moves at its speeds and stands in a pause of its follower until `go` is set."""
    moves, go = threading.Event(), threading.Event()
    world.past(0.1, lambda: (moves.set(), go.wait(10)))

    async def inside(tools):
        first = asyncio.create_task(tools.act(SPEED_JOINT, SPEEDS, world.permit(SPEED_JOINT, SPEEDS, name="first")))
        await until(moves.is_set)
        try:
            return await scenario(tools, first, go)
        finally:
            go.set()

    return world.played(inside)


def test_they_are_prolonged_by_the_same_agent_and_nobody_else(world):
    async def scenario(tools, first, go):
        assert tools.joins(request(QD), agent="robotic")
        assert not tools.joins(request(QD), agent="vision")
        assert not tools.joins(request(QD), agent="")
        assert not tools.joins(request((0.4, 0.0, 0.0, 0.0, 0.0, -0.1)), agent="robotic")
        assert not tools.joins(request(QD, operation=MOVE_JOINT), agent="robotic")
        for qd, agent in ((QD, "vision"), ((0.1,) * 6, "robotic")):
            numbers = (*qd, 2.0, 0.5)
            with pytest.raises(ActuationRefusedError) as raised:
                await tools.act(SPEED_JOINT, numbers, world.permit(SPEED_JOINT, numbers, agent=agent))
            assert raised.value.reason is Reason.BUSY
        longer = (*QD, 2.0, 1.0)
        permit = world.permit(SPEED_JOINT, longer, name="second")
        second = asyncio.create_task(tools.act(SPEED_JOINT, longer, permit))
        await until(lambda: permit.spent)
        go.set()
        ends = await asyncio.gather(first, second)
        assert not tools.joins(request(QD), agent="robotic")
        return ends

    ends = streaming(world, scenario)
    assert [end.end for end in ends] == [MotionOutcome.ENDED, MotionOutcome.ENDED]
    assert len(world.lines.given) == 1
    assert world.arm.q == pytest.approx(0.4 * (0.25 + 1.0), abs=0.02), "from the arrival of the second"


def test_an_earlier_permit_that_falls_ends_what_another_prolonged(world):
    async def scenario(tools, first, go):
        world.watches[0][0]._permit.standing = lambda: REVOKED
        permit = world.permit(SPEED_JOINT, SPEEDS, name="second")
        second = asyncio.create_task(tools.act(SPEED_JOINT, SPEEDS, permit))
        await until(lambda: permit.spent)
        go.set()
        return await asyncio.gather(first, second), permit

    ends, permit = streaming(world, scenario)
    assert {(end.end, end.reason) for end in ends} == {(MotionOutcome.AUTHORITY_LOST, "REVOKED")}
    assert permit.watched["reason"] == "REVOKED", "each record tells it"


def test_whoever_prolonged_them_and_goes_away_ends_them(world):
    async def scenario(tools, first, go):
        permit = world.permit(SPEED_JOINT, SPEEDS, name="second")
        second = asyncio.create_task(tools.act(SPEED_JOINT, SPEEDS, permit))
        await until(lambda: permit.spent)
        second.cancel()
        await until(lambda: world.arm.stops)
        go.set()
        with pytest.raises(asyncio.CancelledError):
            await second
        assert world.arm.target is None
        return await first

    assert streaming(world, scenario).end is MotionOutcome.STOPPED


def test_what_would_prolong_speeds_that_have_ended_moves_nothing(world):
    async def scenario(tools):
        assert tools.reserve("other")
        with pytest.raises(ActuationRefusedError) as raised:
            await tools.act(SPEED_JOINT, SPEEDS, world.permit(SPEED_JOINT, SPEEDS))
        assert raised.value.reason is Reason.VERDICT_EXPIRED

    world.played(scenario)
    assert world.lines.given == []


def test_speeds_whose_end_has_been_told_are_not_prolonged(world):
    async def scenario(tools, first, go):
        tools._speeds.course._over = True
        with pytest.raises(ActuationRefusedError) as raised:
            await tools.act(SPEED_JOINT, SPEEDS, world.permit(SPEED_JOINT, SPEEDS, name="second"))
        assert raised.value.reason is Reason.VERDICT_EXPIRED
        go.set()
        return await first

    assert streaming(world, scenario).end is MotionOutcome.ENDED


# ----------------------------------------------------------------------------------------------------------- fingers


def gripping(world, during, permit=None):
    """The end of a grip during which something happens."""
    permit = permit or world.permit(GRIPPER_MOVE, GRIP)
    world.pause = lambda seconds: (Scene.pause(world, seconds), threading.Event().wait(0.001))

    async def scenario(tools):
        moving = asyncio.create_task(tools.act(GRIPPER_MOVE, GRIP, permit))
        await until(lambda: world.fingers.moves)
        await during(tools)
        return await moving

    return world.played(scenario)


def test_the_fingers_get_what_was_decided_and_what_they_hold_is_told(world):
    async def arrive(tools):
        world.fingers.ends = True

    grip = gripping(world, arrive)
    assert world.fingers.moves == [{"width_um": 40_000, "speed_um_s": 100_000, "force_mn": 40_000}]
    assert (grip.end, world.gripped) == (MotionOutcome.REACHED, [grip])


@pytest.mark.parametrize(
    ("change", "outcome", "reason"),
    [
        (lambda w: setattr(w, "fault", REVOKED), MotionOutcome.AUTHORITY_LOST, "REVOKED"),
        (
            lambda w: setattr(w, "left", lambda *_, **__: 1 / 0),
            MotionOutcome.WORLD_CHANGED,
            Reason.PHYSICS_FAULT,
        ),
    ],
)
def test_what_the_watch_sees_stops_the_fingers(world, change, outcome, reason):
    async def happens(tools):
        change(world)

    permit = world.permit(GRIPPER_MOVE, GRIP)
    grip = gripping(world, happens, permit)
    assert (grip.end, grip.reason, world.gripped) == (outcome, reason, [grip])
    assert world.fingers.halts >= 1
    assert permit.watched["reason"] == reason


def test_fingers_that_a_stop_ended_say_so(world):
    async def stop(tools):
        await tools.stop()

    assert gripping(world, stop).end is MotionOutcome.STOPPED


def test_a_stop_between_the_permit_and_the_fingers_is_not_lost(world):
    async def scenario(tools):
        free = threading.Event()
        tools._fingers.submit(free.wait, 10)  # the worker is busy when the permit is spent
        permit = world.permit(GRIPPER_MOVE, GRIP)
        moving = asyncio.create_task(tools.act(GRIPPER_MOVE, GRIP, permit))
        await until(lambda: permit.spent)
        await tools.stop()
        free.set()
        with pytest.raises(ActuationRefusedError) as raised:
            await moving
        assert raised.value.reason is permit.refusal is Reason.VERDICT_EXPIRED

    world.played(scenario)
    assert world.fingers.moves == []


def test_a_gripper_that_does_not_answer_is_stopped(world):
    """A move of the fingers without an acknowledgement may yet begin, so they are stopped."""
    world.fingers.raises = RobotError(PepFault.GRIPPER_UNREACHABLE, "as tested")

    async def scenario(tools):
        with pytest.raises(RobotError):
            await tools.act(GRIPPER_MOVE, GRIP, world.permit(GRIPPER_MOVE, GRIP))
        return world.fingers.halts

    assert world.played(scenario) >= 1


def test_no_number_of_stops_keeps_one_from_going_out(world):
    """Fingers that cannot be halted hold nobody up, however often it is tried."""
    hang = threading.Event()
    world.fingers.halt = lambda: hang.wait(10)

    async def scenario(tools):
        for _ in range(20):
            await tools.stop()
        assert len(world.arm.stops) == 20
        hang.set()

    world.played(scenario)


def test_the_gripper_is_made_ready(world):
    grip = world.act(GRIPPER_ACTIVATE, ())
    assert (world.fingers.moves, grip.arrived, world.gripped) == (["activate"], True, [grip])
