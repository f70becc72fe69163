"""Request of each command of a leased program: granted, free, or refused with its reason."""

import math
from dataclasses import replace

import pytest
from capabilities.values.chain import Refusal
from capabilities.values.scope import Grant, Limit, OneOf, Range
from capabilities.values.units import si
from hypothesis import given
from hypothesis import strategies as st
from pep.base.operation_row import Sent
from pep.base.operations import (
    MOVE_PATH,
    MOVE_UNTIL_CONTACT,
    MOVE_WAYPOINTS,
    SERVO_JOINT,
    SPEED_JOINT,
    operation_of,
    padded,
)
from pep.base.request_digest import digest_of
from pep.rtde.command.command_table import ROWS, CommandClass, decode
from pep.rtde.command.register_image import RegisterImage
from pep.rtde.command.rounding import on_grid
from pep.rtde.command.stream_bounds import StreamBounds
from pep.rtde.judge.command_requests import (
    load_of,
    CommandedOperation,
    NoDecisionNeeded,
    ToolSetup,
    as_granted,
    asked_of,
    request_of,
    stands_s,
)
from pep.rtde.script.move_path import PathMove, Waypoint
from pep.rtde.wire.recipes import DOUBLE, INT, WritableVariables
from pep.rtde.wire.refusal import InputRefusal
from pep.world.waypoints import through_waypoints
from policies.words.reason_table import Reason
from tests.pep.kit import AUDIENCE
from pep.world.held_object import DeclaredLoad

from pep.pit import JointLeg, LineLeg
from pep.rtde.command import command_values as v
from pep.rtde.command import io_commands as io

Q = (0.1, -1.2, 1.0, -1.1, -1.57, 0.2)
POSE = (0.3, -0.1, 0.25, 0.0, 3.14, 0.1)
X = (0.01, 0.02, 0.03, 0.04, 0.05, 0.06)
TCP, MASS, CENTRE = (0.0, 0.0, 0.163, 0.0, 0.0, 0.0), 0.925, (0.0, 0.0, 0.058)
FITTED = ToolSetup(TCP, MASS, CENTRE)
CUBE = DeclaredLoad("cube", 1.325, (0.0, 0.0, 0.09))
WAY = (Waypoint(PathMove.MOVEJ, False, Q, 0.5, 1.4, 0.0), Waypoint(PathMove.MOVEJ, False, X, 0.5, 1.4, 0.0))
AXES = (True,) * 6


def own_limits(made):
    return operation_of(made.object, made.operation).refuse(made)


DOWN = (False, False, True, False, False, False)
PRESS = (0.0, 0.0, -10.0, 0.0, 0.0, 0.0)
SLOW = (0.0, 0.0, 0.01, 0.0, 0.0, 0.0)
FREE_AXES = (1.0,) * 6
ENDS = {
    "force_mode": {"duration": Range(100, 5_000), "distance": Range(1_000, 50_000)},
    "freedrive": {
        "tool_speed": Range(10_000, 250_000),
        "joint_speed": OneOf(frozenset({100_000, 300_000, 9_000_000})),
        "duration": Range(100, 60_000),
        "distance": Range(1_000, 300_000),
    },
}
ASKED = {
    1: (v.MoveJ(Q, 0.5, 1.4, False), "move_joint", (*Q, 0.5, 1.4)),
    8: (v.ZeroForceSensor(), "zero_force_sensor", ()),
    3: (v.MoveL(POSE, 0.1, 0.5, True), "move_linear", (*POSE, 0.1, 0.5)),
    9: (v.SpeedJ(X, 0.5, 0.4), "speed_joint", (*X, 0.5, 0.4)),
    10: (v.SpeedL(X, 0.5, 0.0), "speed_linear", (*X, 0.5, 2.0)),
    24: (v.ServoL(POSE, 0.002, 0.1, 300.0), "servo_linear", (*POSE, 0.002, 0.1, 300.0)),
    11: (v.ServoJ(Q, 0.002, 0.1, 300.0), "servo_joint", (*Q, 0.002, 0.1, 300.0)),
    6: (v.ForceMode(POSE, DOWN, PRESS, 2, SLOW), "force_mode", (*POSE, *PRESS, *SLOW, 5.0, 0.05)),
    18: (v.TeachMode(), "freedrive", (*FREE_AXES, 0.25, 0.3, 60.0, 0.3)),
    20: (v.SetForceDamping(0.5), "set_force_damping", (0.5,)),
    21: (v.SetForceGain(1.5), "set_force_gain", (1.5,)),
    52: (v.FreedriveMode((True, *(False,) * 5), (0.0,) * 6), "freedrive", (1.0, *(0.0,) * 5, 0.25, 0.3, 60.0, 0.3)),
    17: (v.SetPayload(MASS, (0.0,) * 3), "set_payload", (MASS, 0.0, 0.0, 0.0)),
    29: (v.SetTcp(TCP), "set_tcp", TCP),
    51: (v.MoveUntilContact(X, X, 0.5), "move_until_contact", (*X, 0.5, 0.3)),
    45: (v.MovePath(False), "move_path", (*Q, *X, *X, *X, 0.5, 1.4)),
}
NOT_GRANTED = [
    v.MoveJIk(POSE, 0.5, 1.4, False),
    v.MoveLFk(Q, 0.1, 0.5, False),
    v.ServoC(POSE, 0.1, 0.5, 0.0),
    v.SetWatchdog(10.0),
    v.JogStart(X, v.JogFrame.BASE, 0.5, POSE),
    v.SetExternalWrench(X),
    v.ForceInput(True, 0.1, (0.0,) * 3, (0.0,) * 3),
    v.ExternalForceSensor(True, 0.1, (0.0,) * 3, (0.0,) * 3),
    v.SetGravity((0.0, 0.0, 9.82)),
    v.StartContactDetection(X),
    v.StopContactDetection(),
    v.SetTargetPayload(MASS, CENTRE, X),
    v.DirectTorque(X),
    io.SetAnalogOutput(0, io.Quantity.VOLTAGE, 0.5),
    io.SetInputInteger(18, 1),
    io.SetInputDouble(18, 1.0),
    io.SetDigitalOutputs(io.Bank.TOOL, 1, 1),
    io.SetDigitalOutputs(io.Bank.CONFIGURABLE, 1, 1),
    io.SetDigitalOutputs(io.Bank.STANDARD, 3, 1),
]
FREE = [
    v.Clear(),
    v.StopJ(2.0, False),
    v.StopL(2.0, False),
    v.SpeedStop(2.0),
    v.ServoStop(2.0),
    *(v.End(what) for what in v.StopKind),
    *(v.Read(what) for what in v.Reading),
    v.ToolContact(X),
    v.JointHistory(1),
    v.InverseKinematics(POSE, Q, 0.0, 0.0),
    v.InverseKinematicsNearest(POSE),
    v.Reachable(POSE, Q, 0.0, 0.0),
    v.ReachableNearest(POSE),
    v.PoseWithinLimits(POSE),
    v.JointsWithinLimits(Q),
    v.PoseTrans(POSE, POSE),
    v.ForwardKinematics(Q, TCP),
]
pytestmark = pytest.mark.clause("LSD-1")


def granted(operation):
    """The robot's own limits, but for how long, how far and how fast a force or a hand may lead."""
    ends = ENDS.get(operation.name, {})
    limits = (Limit(each.parameter, ends.get(each.parameter.name, each.bound)) for each in operation.limits)
    return Grant(operation.object, operation.name, tuple(limits))


def asked(command, *, path=WAY, fitted=FITTED, granted=granted):
    return asked_of(command, path=path, fitted=fitted, granted=granted)


def request(command, **changes):
    return request_of(asked(command, **changes), request_id="r", audience=AUDIENCE, at=0.0)


def test_every_row_of_the_table_of_commands_has_its_answer_here():
    from pep.rtde.command.command_table import row_of

    seen = {row_of(c).id for c in [*(c for c, *_ in ASKED.values()), *NOT_GRANTED, *FREE] if not _io(c)}
    assert seen == set(ROWS)
    free = {row_of(c).id for c in FREE}
    assert free == {i for i, r in ROWS.items() if r.command_class in (CommandClass.STOP, CommandClass.GETTER)} | {0}


def _io(command):
    return type(command).__module__ == io.__name__


@pytest.mark.parametrize("number", ASKED, ids=lambda n: ROWS[n].name)
def test_what_an_operation_stands_for_is_asked_in_its_very_numbers(number):
    command, operation, numbers = ASKED[number]
    found = asked(command)
    assert (found.operation.name, found.numbers) == (operation, numbers)
    assert found.stream is (number in {6, 9, 10, 11, 18, 24, 52})
    made = request(command)
    assert made.digest == digest_of(found.operation, numbers, audience=AUDIENCE)
    assert tuple(value.name for value in made.values) == tuple(each.name for each in found.operation.parameters)
    assert own_limits(made) is None
    assert found.operation.sent in (Sent.ONCE, Sent.STREAM, Sent.OUTPUT)


@pytest.mark.parametrize("command", NOT_GRANTED, ids=lambda c: type(c).__name__)
def test_what_no_operation_stands_for_is_refused(command):
    found = asked(command)
    assert isinstance(found, InputRefusal)
    assert found.reason is Reason.NOT_GRANTED


@pytest.mark.parametrize("command", FREE, ids=lambda c: type(c).__name__)
def test_what_stops_or_asks_needs_no_decision(command):
    assert asked(command) == NoDecisionNeeded()


@pytest.mark.parametrize(
    ("command", "operation", "numbers"),
    [
        (io.SetDigitalOutputs(io.Bank.STANDARD, 8, 8), "set_digital_output", (3, 1)),
        (io.SetDigitalOutputs(io.Bank.STANDARD, 1, 0), "set_digital_output", (0, 0)),
        (io.SetSpeedSlider(0.25), "set_speed_slider", (0.25,)),
    ],
)
def test_what_is_switched_without_a_command_is_asked_too(command, operation, numbers):
    found = asked(command)
    assert (found.operation.name, found.numbers) == (operation, numbers)
    assert own_limits(request(command)) is None


# --------------------------------------------------------------------------------------- tool and payload of the model


@pytest.mark.clause("LSD-4")
@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize(("by", "taken"), [(9e-5, True), (1.1e-3, False)])
def test_a_tool_centre_point_may_be_said_again_and_not_changed(axis, by, taken):
    pose = (*TCP[:axis], TCP[axis] + by, *TCP[axis + 1 :])
    found = asked(v.SetTcp(pose))
    assert isinstance(found, CommandedOperation) is taken
    assert taken or found.reason is Reason.FRAMES_MISMATCH


@pytest.mark.clause("LSD-4")
@pytest.mark.parametrize(
    ("mass", "centre", "taken"),
    [
        (MASS, CENTRE, True),
        (MASS, (0.0005, 0.0, 0.058), True),
        (MASS + 0.001, CENTRE, False),
        (MASS - 0.001, (0.0,) * 3, False),
        (MASS, (0.002, 0.0, 0.058), False),
        (math.nextafter(MASS, 1), CENTRE, True),
    ],
)
def test_a_payload_may_be_said_again_and_not_changed(mass, centre, taken):
    found = asked(v.SetPayload(mass, centre))
    assert isinstance(found, CommandedOperation) is taken
    assert taken or found.reason is Reason.PAYLOAD_MISMATCH


@pytest.mark.clause("LSD-13")
@pytest.mark.parametrize(
    ("mass", "centre", "load"),
    [
        (CUBE.mass_kg, CUBE.centre_m, CUBE),
        (CUBE.mass_kg, (0.0,) * 3, CUBE),
        (CUBE.mass_kg, (0.0, 0.0005, 0.09), CUBE),
        (CUBE.mass_kg, CENTRE, None),
        (CUBE.mass_kg + 0.001, CUBE.centre_m, None),
    ],
)
def test_a_declared_load_may_be_said(mass, centre, load):
    command, fitted = v.SetPayload(mass, centre), ToolSetup(TCP, MASS, CENTRE, (CUBE,))
    found = asked(command, fitted=fitted)
    assert load_of(command, fitted) == load
    if load is None:
        assert found.reason is Reason.PAYLOAD_MISMATCH
    else:
        assert (found.operation.name, found.numbers) == ("set_payload", (mass, *centre))
    assert asked(command).reason is Reason.PAYLOAD_MISMATCH, "nobody has declared it"
    assert load_of(v.SetPayload(MASS, CENTRE), fitted) is None


# -------------------------------------------------------------------------------------------------------------- paths


@pytest.mark.parametrize(
    "path",
    [
        (),
        WAY * 129,
        (WAY[0], replace(WAY[1], blend_m=0.01)),
        (replace(WAY[0], move=PathMove.MOVEL),),
        (replace(WAY[0], is_pose=True),),
    ],
)
def test_a_path_that_the_operation_cannot_say_is_refused(path):
    assert asked(v.MovePath(False), path=path).reason is Reason.PARAMETERS_WRONG


LINE = Waypoint(PathMove.MOVEL, True, POSE, 0.1, 0.5, 0.0)


@pytest.mark.clause("LSD-16")
@pytest.mark.parametrize(
    "path",
    [
        WAY * 3,
        WAY * 128,
        (WAY[0], replace(WAY[1], speed=0.6)),
        (WAY[0], replace(WAY[1], acceleration=1.5)),
        (replace(WAY[0], blend_m=0.01), WAY[1]),
        (LINE,),
        (replace(LINE, blend_m=0.02), WAY[0], replace(LINE, move=PathMove.MOVEP, speed=0.2)),
    ],
)
def test_any_other_path_lists_its_waypoints(path):
    found = asked(v.MovePath(False), path=path)
    assert found.operation is MOVE_WAYPOINTS
    made = request(v.MovePath(False), path=path)
    assert own_limits(made) is None
    assert made.digest == digest_of(found.operation, found.numbers, audience=AUDIENCE)
    motion = through_waypoints(made, Q)
    assert motion.start == Q
    for leg, point in zip(motion.legs, path, strict=True):
        assert isinstance(leg, JointLeg if point.move is PathMove.MOVEJ else LineLeg)
        speed, acceleration = (
            (leg.speed_rad_s, leg.acceleration_rad_s2)
            if isinstance(leg, JointLeg)
            else (leg.speed_m_s, leg.acceleration_m_s2)
        )
        assert (leg.target, speed, acceleration, leg.blend_m) == (
            point.target, point.speed, point.acceleration, point.blend_m,
        )  # fmt: skip


@pytest.mark.clause("LSD-16")
def test_lists_that_do_not_fit_each_other_are_no_path():
    made = request(v.MovePath(False), path=(LINE, WAY[0]))
    assert through_waypoints(made, Q) is not None
    for at, value in enumerate(made.values):
        fewer = replace(value, value=value.value[:-1])
        assert through_waypoints(replace(made, values=(*made.values[:at], fewer, *made.values[at + 1 :])), Q) is None


def test_a_path_is_that_of_the_script():
    found = asked(v.MovePath(True), path=WAY[:1])
    assert (found.operation, found.numbers[:24]) == (MOVE_PATH, tuple(q for point in padded([Q]) for q in point))


# ------------------------------------------------------------------------------------------------------------ numbers


@pytest.mark.parametrize(
    "command", [v.MoveJ((0.1234567, *Q[1:]), 0.5, 1.4, False), v.MoveL(POSE, 0.1000001, 0.5, False)]
)
def test_a_number_off_its_grid_is_refused_where_it_is_not_a_streams(command):
    assert request(command).reason is Reason.NOT_ON_GRID


@pytest.mark.clause("LSD-3")
@given(st.lists(st.floats(-3, 3), min_size=6, max_size=6).map(tuple))
def test_a_streams_angles_are_spelt_to_half_a_microradian(q):
    found = asked(v.ServoJ(q, 0.002, 0.1, 300.0))
    made = request(v.ServoJ(q, 0.002, 0.1, 300.0))
    assert found.numbers[:6] == q
    assert all(abs(a - si(b.value, b.unit)) <= 0.5000001e-6 for a, b in zip(q, made.values, strict=False))
    assert made.digest == digest_of(SERVO_JOINT, found.spelt, audience=AUDIENCE)


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    "make", [lambda n: v.ServoJ((n, *Q[1:]), 0.002, 0.1, 300.0), lambda n: v.MoveJ((n, *Q[1:]), 0.5, 1.4, False)]
)
def test_what_is_no_number_is_refused(make, number):
    assert request(make(number)).reason is Reason.NOT_FINITE


OUT, OFF, LIMIT = Reason.OUT_OF_RANGE, Reason.NOT_ON_GRID, Reason.LIMIT_EXCEEDED_BY_REQUEST
ODD = {
    # What a command is of a number, that number in the request, and what comes of: 1e308, -0.0, and less than any unit.
    "angle": (lambda n: v.MoveJ((n, *Q[1:]), 0.5, 1.4, False), "q0", OUT, 0, 0),
    "speed": (lambda n: v.MoveJ(Q, n, 1.4, False), "speed", OUT, LIMIT, LIMIT),
    "acceleration": (lambda n: v.MoveJ(Q, 0.5, n, False), "acceleration", OUT, LIMIT, LIMIT),
    "place": (lambda n: v.MoveL((n, *POSE[1:]), 0.1, 0.5, True), "x", OUT, 0, 0),
    "turn": (lambda n: v.MoveL((*POSE[:5], n), 0.1, 0.5, True), "rz", OUT, 0, 0),
    "tool's speed": (lambda n: v.MoveL(POSE, n, 0.5, True), "speed", OUT, LIMIT, LIMIT),
    "joint's speed in a stream": (lambda n: v.SpeedJ((n, *X[1:]), 0.5, 0.4), "qd0", OUT, 0, 0),
    "time of a speed": (lambda n: v.SpeedJ(X, 0.5, n), "duration", OUT, 2_000, 50),
    "speed of the tool": (lambda n: v.SpeedL((n, *X[1:]), 0.5, 0.4), "vx", OUT, 0, 0),
    "time of that": (lambda n: v.SpeedL(X, 0.5, n), "duration", OUT, 2_000, 2_000),
    "angle in a stream": (lambda n: v.ServoJ((n, *Q[1:]), 0.002, 0.1, 300.0), "q0", OUT, 0, 0),
    "period": (lambda n: v.ServoJ(Q, n, 0.1, 300.0), "period", OUT, LIMIT, OFF),
    "lookahead": (lambda n: v.ServoJ(Q, 0.002, n, 300.0), "lookahead", OUT, LIMIT, OFF),
    "gain": (lambda n: v.ServoJ(Q, 0.002, 0.1, n), "gain", OUT, LIMIT, OFF),
    "tool centre point": (lambda n: v.SetTcp((n, *TCP[1:])), "x", Reason.FRAMES_MISMATCH, 0, 0),
    "mass": (lambda n: v.SetPayload(n, CENTRE), "mass", *[Reason.PAYLOAD_MISMATCH] * 3),
    "centre": (lambda n: v.SetPayload(MASS, (n, *CENTRE[1:])), "cx", Reason.PAYLOAD_MISMATCH, 0, 0),
    "slider": (io.SetSpeedSlider, "fraction", OUT, 0, OFF),
}


def taken(command, parameter):
    """The integer that is asked for, or why nothing is."""
    found = asked(command if _io(command) else on_grid(command))
    if isinstance(found, InputRefusal):
        return found.reason
    made = request_of(found, request_id="r", audience=AUDIENCE, at=0.0)
    if isinstance(made, InputRefusal):
        return made.reason
    refused = own_limits(made)
    if refused is not None:
        assert refused.parameter == parameter
        return Reason(refused.code)
    return next(value.value for value in made.values if value.name == parameter)


@pytest.mark.parametrize("what", ODD)
def test_a_number_that_is_hardly_one_has_its_exact_answer(what):
    make, parameter, huge, nothing, least = ODD[what]
    numbers = {1e308: huge, -1e308: huge, -0.0: nothing, math.ulp(0.0): least, 1e-310: least}
    if parameter == "duration":
        del numbers[-1e308]  # no command has such a time (RTDE-4)
    assert {number: taken(make(number), parameter) for number in numbers} == numbers


@pytest.mark.parametrize("number", [-0.0, math.ulp(0.0), -math.ulp(0.0), 1e-310])
def test_what_is_less_than_any_unit_is_written_as_the_zero_that_was_judged(number):
    q = on_grid(v.MoveJ((number,) * 6, 0.5, 1.4, False)).q_rad
    assert [math.copysign(1.0, angle) for angle in q] == [1.0] * 6
    assert q == (0.0,) * 6


@pytest.mark.clause("LSD-3")
@pytest.mark.parametrize(
    ("number", "angle", "period"),
    [
        (1e308, LIMIT, LIMIT),
        (-1e308, LIMIT, LIMIT),
        (-0.0, None, Reason.ROBOT_LIMIT),
        (math.ulp(0.0), None, Reason.ROBOT_LIMIT),
    ],
)
def test_each_later_value_of_a_stream_has_that_answer_too(number, angle, period):
    bounds = StreamBounds(SERVO_JOINT, grant(SERVO_JOINT))
    assert bounds.outside(asked(v.ServoJ((number, *Q[1:]), 0.002, 0.1, 300.0)).numbers) is angle
    assert bounds.outside(asked(v.ServoJ(Q, number, 0.1, 300.0)).numbers) is period


HARDLY = st.sampled_from((1e308, -1e308, -0.0, math.ulp(0.0), 1e-310, 0.0, 1.0, MASS)) | st.floats()


@given(
    st.sampled_from(sorted(ROWS)),
    st.lists(HARDLY, min_size=18, max_size=18),
    st.lists(st.integers(0, 3), min_size=7, max_size=7),
)
def test_nothing_that_a_client_can_write_breaks_what_is_asked(number, doubles, ints):
    written = {INT[0]: number, **dict(zip(INT[1:], ints, strict=False)), **dict(zip(DOUBLE, doubles, strict=False))}
    command = decode(RegisterImage.blank(WritableVariables.of(0, control=True, io=False)).merge(written))
    if isinstance(command, InputRefusal):
        return
    found = asked(on_grid(command))
    assert isinstance(found, CommandedOperation | NoDecisionNeeded | InputRefusal)
    if isinstance(found, CommandedOperation):
        made = request_of(found, request_id="r", audience=AUDIENCE, at=0.0)
        assert isinstance(made, InputRefusal) or isinstance(own_limits(made), Refusal | None)


@pytest.mark.parametrize(
    ("said", "stands"), [(0.0, 2.0), (0.002, 0.05), (0.05, 0.05), (1.5, 1.5), (2.0, 2.0), (9.0, 9.0)]
)
def test_a_speed_without_a_time_stands_for_the_longest_there_is(said, stands):
    assert stands_s(said) == stands


def test_a_speed_that_would_stand_for_longer_is_refused_by_the_robots_limit():
    assert own_limits(request(v.SpeedJ(X, 0.5, 9.0))).parameter == "duration"


# ------------------------------------------------------------------------------------------- later values of a stream


def grant(operation, **bounds):
    wide = Range(-(10**9), 10**9)
    return Grant("ur3e", operation.name, tuple(Limit(p, bounds.get(p.name, wide)) for p in operation.parameters))


@pytest.mark.clause("LSD-3")
@pytest.mark.parametrize(
    ("command", "granted", "reason"),
    [
        (v.ServoJ(Q, 0.002, 0.1, 300.0), {}, None),
        (v.ServoJ((0.1000001, *Q[1:]), 0.002, 0.1, 300.0), {"q0": Range(0, 100_000)}, Reason.LIMIT_EXCEEDED_BY_REQUEST),
        (v.ServoJ(Q, 0.002, 0.1, 300.0), {"gain": OneOf(frozenset({200, 300}))}, None),
        (v.ServoJ(Q, 0.002, 0.1, 301.0), {"gain": OneOf(frozenset({200, 300}))}, Reason.LIMIT_EXCEEDED_BY_REQUEST),
        (v.ServoJ((6.3, *Q[1:]), 0.002, 0.1, 300.0), {}, Reason.ROBOT_LIMIT),
        (v.ServoJ((-6.3, *Q[1:]), 0.002, 0.1, 300.0), {}, Reason.ROBOT_LIMIT),
        (v.ServoJ(Q, 0.002, 0.3, 300.0), {}, Reason.ROBOT_LIMIT),
        (v.ServoJ((math.nan, *Q[1:]), 0.002, 0.1, 300.0), {}, Reason.NOT_FINITE),
    ],
)
def test_each_value_of_a_stream_is_inside_what_was_granted(command, granted, reason):
    bounds = StreamBounds(SERVO_JOINT, grant(SERVO_JOINT, **granted))
    assert bounds.outside(asked(command).numbers) is reason


@pytest.mark.clause("LSD-3")
def test_each_speed_of_a_stream_is_too():
    fast = v.SpeedJ((1.01, *X[1:]), 0.5, 0.1)
    for granted, reason in ({}, Reason.ROBOT_LIMIT), ({"qd0": Range(0, 1)}, Reason.LIMIT_EXCEEDED_BY_REQUEST):
        bounds = StreamBounds(SPEED_JOINT, grant(SPEED_JOINT, **granted))
        assert bounds.outside(asked(fast).numbers) is reason


@pytest.mark.clause("LSD-17")
def test_a_way_until_a_contact_is_as_long_as_the_token_grants():
    asked_for = asked(v.MoveUntilContact((0.0, 0.0, -0.03, 0.0, 0.0, 0.0), X, 0.25))
    assert asked_for.operation is MOVE_UNTIL_CONTACT
    assert asked_for.numbers[-1] == 0.3
    limits = [Limit(each.parameter, each.bound) for each in MOVE_UNTIL_CONTACT.limits]
    limits[-1] = replace(limits[-1], bound=Range(1_000, 40_000))
    grant = Grant("ur3e", "move_until_contact", tuple(limits))

    class Chained:
        class scope:
            @staticmethod
            def find(_, operation):
                return grant if operation == grant.operation else None

    assert as_granted(asked_for, Chained).numbers == (*asked_for.numbers[:-1], 0.04)
    other = asked(v.MoveJ(Q, 0.5, 1.4, False))
    assert as_granted(other, Chained) is other
