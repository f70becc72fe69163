"""Operations of a UR3e cell, one declared row each: mapping, limits, requests, physics and watch read these rows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeVar

from capabilities.values.scope import Each, Range, Tier
from capabilities.values.units import DeclaredUnit, ListOf, Parameter, Unit
from capabilities.values.well_formed import LIST_LENGTH
from pep.base.operation_row import (
    MILLION,
    ArgumentForm,
    BoundedParameter,
    Moves,
    Operation,
    OperationKind,
    RobotPart,
    Sent,
    ToolArgument,
)
from pep.base.stop_model import STREAM_SPEED_RAD_S

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from capabilities.values.chain import Chain

ROBOT: Final = "ur3e"
T = TypeVar("T")


ARM: Final = frozenset(
    {
        Moves.TO_JOINTS,
        Moves.THROUGH_JOINTS,
        Moves.ALONG_TRAJECTORY,
        Moves.THROUGH_WAYPOINTS,
        Moves.TO_POSE,
        Moves.AT_JOINT_SPEEDS,
        Moves.AT_TOOL_SPEED,
        Moves.UNTIL_CONTACT,
        Moves.AFTER_JOINTS,
        Moves.AFTER_POSES,
        Moves.BY_FORCE,
        Moves.BY_HAND,
    }
)
"""Courses after which the arm stands elsewhere."""
JOINTS: Final = 6
WAYPOINTS_MOST: Final = 256
"""Waypoints of a leased program's path, each of its own kind; as many as a list of a request holds."""
WAYPOINTS: Final = 4
"""Waypoints of a path.

A token that limits each of four still fits its carriage. A shorter path repeats its last.
"""

# Sources: U2 is UR's UR3e technical specification (joint ranges and speeds), U12 the ur_rtde C++ client's own caps,
# G1 Robotiq's 2F-85 manual.
FULL_TURN_URAD: Final = (
    6_283_185  # U2: 360 deg, rounded inwards; the last joint turns without end, a command is kept to one turn
)
JOINT_SPEED_URAD_S: Final = (
    3_140_000  # U12: 3.14 rad/s, the leading axis may be any; U2 has 180 deg/s = 3.1416 for joints 1 to 3
)
JOINT_ACCELERATION_URAD_S2: Final = 40_000_000  # U12: 40 rad/s2
LEAST_SPEED_URAD_S: Final = (
    2_000  # ours: twice the bound of standstill; a slower arm could not be told from a still one
)
LEAST_ACCELERATION_URAD_S2: Final = 10_000  # ours: past standstill within 0.1 s
STROKE_UM: Final = 85_000  # G1: 0 to 85 mm
FINGER_SPEED_UM_S: Final = (20_000, 150_000)  # G1: 20 to 150 mm/s
GRIP_MN: Final = (20_000, 235_000)  # G1: 20 to 235 N
REACH_UM: Final = 1_000_000  # ours: beyond a stretched UR3e with any tool that it can carry (U2: 500 mm reach)
TOOL_SPEED_UM_S: Final = 3_000_000  # U12: 3 m/s
TOOL_ACCELERATION_UM_S2: Final = 150_000_000  # U12: 150 m/s2
LEAST_TOOL_SPEED_UM_S: Final = 1_000  # ours: as `LEAST_SPEED_URAD_S`, at a lever of half a metre
LEAST_TOOL_ACCELERATION_UM_S2: Final = 5_000  # ours: likewise
SERVO_PERIOD_MS: Final = (1, 100)  # ours: from the controller's 2 ms, rounded down, to ten targets a second
LOOKAHEAD_MS: Final = (30, 200)  # U12: 0.03 to 0.2 s
GAIN: Final = (100, 2_000)  # U12
PAYLOAD_G: Final = 3_000  # U2: 3 kg
CONTACT_WAY_UM: Final = (1_000, 300_000)  # ours: a third of the reach in search of a contact
BLEND_UM: Final = 200_000  # ours: a fifth of the reach; U12 would send 2 m
STREAM_SPEED_URAD_S: Final = round(STREAM_SPEED_RAD_S * Unit.MICRORADIAN_PER_SECOND.per_si)
STREAM_MS: Final = (50, 2_000)  # ours: longer than a call takes on its way; short enough to wait for
TRAJECTORY_US: Final = 120_000_000  # ours: two minutes; a longer trajectory is several
OUTPUTS: Final = 8  # U12: standard digital outputs
FORCE_MN: Final = 100_000  # ours: above what a UR3e holds when its payload of 3 kg is pushed at thrice its weight
TORQUE_MN_M: Final = 10_000  # ours: below the 12 Nm of a UR3e's wrists (U2)
YIELD_SPEED_UM_S: Final = 250_000  # U5: 250 mm/s, as for all that people approve
YIELD_TURN_URAD_S: Final = 1_000_000  # ours: as `STREAM_SPEED_URAD_S`
YIELD_MS: Final = (100, 300_000)  # ours: shorter is no use; longer is asked anew, as a stream is
YIELD_UM: Final = (1_000, REACH_UM)  # ours: from a millimetre to anywhere that the workspace lets the tool go
HAND_SPEED_UM_S: Final = (10_000, YIELD_SPEED_UM_S)  # ours: a hand cannot lead an arm more slowly than 1 cm/s
HAND_TURN_URAD_S: Final = (20_000, STREAM_SPEED_URAD_S)  # ours: likewise
DAMPING_PERMILLE: Final = 1_000  # URScript manual, force_mode_set_damping
FORCE_GAIN_PERMILLE: Final = 2_000  # URScript manual, force_mode_set_gain_scaling


def _limit(name: str, unit: Unit, low: int, high: int) -> BoundedParameter:
    return BoundedParameter(Parameter(name, unit), Range(low, high))


def _listed(name: str, unit: Unit, low: int, high: int) -> BoundedParameter:
    """One value for each waypoint of some kind."""
    return BoundedParameter(Parameter(name, ListOf(unit)), Each(Range(low, high), 0, WAYPOINTS_MOST))


def _angles(*names: str) -> tuple[BoundedParameter, ...]:
    return tuple(_limit(name, Unit.MICRORADIAN, -FULL_TURN_URAD, FULL_TURN_URAD) for name in names)


def _lengths(*names: str) -> tuple[BoundedParameter, ...]:
    return tuple(_limit(name, Unit.MICROMETRE, -REACH_UM, REACH_UM) for name in names)


def _timed(name: str, unit: Unit | DeclaredUnit, each: Range, *, least: int) -> BoundedParameter:
    """List of as many numbers as a request may have, each rounded to the grid of its unit."""
    return BoundedParameter(Parameter(name, ListOf(unit)), Each(each, least, LIST_LENGTH), scale=MILLION, exact=False)


_JOINT_ANGLES: Final = _angles(*(f"q{i}" for i in range(JOINTS)))
_JOINT_ACCELERATION: Final = _limit(
    "acceleration", Unit.MICRORADIAN_PER_SECOND2, LEAST_ACCELERATION_URAD_S2, JOINT_ACCELERATION_URAD_S2
)
_LEADING_AXIS: Final = (
    _limit("speed", Unit.MICRORADIAN_PER_SECOND, LEAST_SPEED_URAD_S, JOINT_SPEED_URAD_S),
    _JOINT_ACCELERATION,
)
_TOOL_ACCELERATION: Final = _limit(
    "acceleration", Unit.MICROMETRE_PER_SECOND2, LEAST_TOOL_ACCELERATION_UM_S2, TOOL_ACCELERATION_UM_S2
)
_TOOL_SPEED: Final = (
    *(_limit(f"v{axis}", Unit.MICROMETRE_PER_SECOND, -TOOL_SPEED_UM_S, TOOL_SPEED_UM_S) for axis in "xyz"),
    *(_limit(f"w{axis}", Unit.MICRORADIAN_PER_SECOND, -JOINT_SPEED_URAD_S, JOINT_SPEED_URAD_S) for axis in "xyz"),
)
_DURATION: Final = _limit("duration", Unit.MILLISECOND, *STREAM_MS)
_POSE: Final = (*_lengths(*"xyz"), *_angles("rx", "ry", "rz"))
"""Of the tool in the base frame, or of the tool centre point on the flange: position and rotation vector."""
_LEADING_ARGUMENTS: Final = (
    ToolArgument("speed_rad_s", ArgumentForm.NUMBER),
    ToolArgument("acceleration_rad_s2", ArgumentForm.NUMBER),
)

MOVE_JOINT: Final = Operation(
    ROBOT,
    "move_joint",
    (*_JOINT_ANGLES, *_LEADING_AXIS),
    OperationKind.MOTION,
    Tier.REVERSIBLE,
    RobotPart(Moves.TO_JOINTS, Sent.ONCE),
    (ToolArgument("q_rad", ArgumentForm.VECTOR, JOINTS), *_LEADING_ARGUMENTS),
)
MOVE_PATH: Final = Operation(
    ROBOT,
    "move_path",
    (*_angles(*(f"p{leg}_q{i}" for leg in range(WAYPOINTS) for i in range(JOINTS))), *_LEADING_AXIS),
    OperationKind.MOTION,
    Tier.REVERSIBLE,
    RobotPart(Moves.THROUGH_JOINTS, Sent.ONCE),
    (ToolArgument("waypoints_rad", ArgumentForm.WAYPOINTS, WAYPOINTS * JOINTS), *_LEADING_ARGUMENTS),
)
FOLLOW_TRAJECTORY: Final = Operation(
    ROBOT,
    "follow_trajectory",
    (
        _timed("t", DeclaredUnit("x-us", MILLION), Range(0, TRAJECTORY_US), least=2),
        *(_timed(f"q{i}", Unit.MICRORADIAN, Range(-FULL_TURN_URAD, FULL_TURN_URAD), least=2) for i in range(JOINTS)),
        *(
            _timed(f"qd{i}", Unit.MICRORADIAN_PER_SECOND, Range(-JOINT_SPEED_URAD_S, JOINT_SPEED_URAD_S), least=0)
            for i in range(JOINTS)
        ),
        *_LEADING_AXIS,
    ),
    OperationKind.MOTION,
    Tier.REVERSIBLE,
    RobotPart(Moves.ALONG_TRAJECTORY, Sent.STREAM_OF_OURS),
    (
        ToolArgument("times_s", ArgumentForm.NUMBERS),
        ToolArgument("positions_rad", ArgumentForm.POINTS, JOINTS),
        ToolArgument("velocities_rad_s", ArgumentForm.POINTS, JOINTS, default="[]"),
        *_LEADING_ARGUMENTS,
    ),
)
MOVE_WAYPOINTS: Final = Operation(
    ROBOT,
    "move_waypoints",
    (
        *(_listed(f"q{i}", Unit.MICRORADIAN, -FULL_TURN_URAD, FULL_TURN_URAD) for i in range(JOINTS)),
        _listed("joint_speed", Unit.MICRORADIAN_PER_SECOND, LEAST_SPEED_URAD_S, JOINT_SPEED_URAD_S),
        _listed(
            "joint_acceleration", Unit.MICRORADIAN_PER_SECOND2, LEAST_ACCELERATION_URAD_S2, JOINT_ACCELERATION_URAD_S2
        ),
        *(_listed(axis, Unit.MICROMETRE, -REACH_UM, REACH_UM) for axis in "xyz"),
        *(_listed(axis, Unit.MICRORADIAN, -FULL_TURN_URAD, FULL_TURN_URAD) for axis in ("rx", "ry", "rz")),
        _listed("speed", Unit.MICROMETRE_PER_SECOND, LEAST_TOOL_SPEED_UM_S, TOOL_SPEED_UM_S),
        _listed("acceleration", Unit.MICROMETRE_PER_SECOND2, LEAST_TOOL_ACCELERATION_UM_S2, TOOL_ACCELERATION_UM_S2),
        _listed("blend", Unit.MICROMETRE, 0, BLEND_UM),
        _listed("line", Unit.COUNT, 0, 1),
    ),
    OperationKind.MOTION,
    Tier.REVERSIBLE,
    # Each list in the waypoints' order: angles, speed and acceleration of the joint moves, pose, speed and acceleration
    # of the lines, blend and kind of all.
    RobotPart(Moves.THROUGH_WAYPOINTS, Sent.ONCE),
)
STOP: Final = Operation(ROBOT, "stop", (), OperationKind.STOP, Tier.NO_EFFECT, RobotPart(Moves.NOTHING, Sent.NEVER), ())
GRIPPER_MOVE: Final = Operation(
    ROBOT,
    "gripper_move",
    (
        _limit("width", Unit.MICROMETRE, 0, STROKE_UM),
        _limit("speed", Unit.MICROMETRE_PER_SECOND, *FINGER_SPEED_UM_S),
        _limit("force", Unit.MILLINEWTON, *GRIP_MN),
    ),
    OperationKind.MOTION,
    Tier.REVERSIBLE,
    RobotPart(Moves.FINGERS, Sent.GRIPPER),
    (
        ToolArgument("width_m", ArgumentForm.NUMBER),
        ToolArgument("speed_m_s", ArgumentForm.NUMBER),
        ToolArgument("force_n", ArgumentForm.NUMBER),
    ),
)
GRIPPER_ACTIVATE: Final = Operation(
    ROBOT,
    "gripper_activate",
    (),
    OperationKind.MOTION,
    Tier.CONSEQUENTIAL,  # the fingers make a full stroke, also with an object between them
    RobotPart(Moves.FINGERS_WHOLE, Sent.GRIPPER),
    (),
)
SPEED_JOINT: Final = Operation(
    ROBOT,
    "speed_joint",
    (
        *(
            _limit(f"qd{i}", Unit.MICRORADIAN_PER_SECOND, -STREAM_SPEED_URAD_S, STREAM_SPEED_URAD_S)
            for i in range(JOINTS)
        ),
        _JOINT_ACCELERATION,
        _DURATION,
    ),
    OperationKind.MOTION,
    Tier.REVERSIBLE,
    RobotPart(Moves.AT_JOINT_SPEEDS, Sent.STREAM),
    (
        ToolArgument("qd_rad_s", ArgumentForm.VECTOR, JOINTS),
        ToolArgument("acceleration_rad_s2", ArgumentForm.NUMBER),
        ToolArgument("duration_s", ArgumentForm.NUMBER),
    ),
)
SET_DIGITAL_OUTPUT: Final = Operation(
    ROBOT,
    "set_digital_output",
    (_limit("pin", Unit.COUNT, 0, OUTPUTS - 1), _limit("value", Unit.COUNT, 0, 1)),
    OperationKind.SWITCH,
    Tier.REVERSIBLE,
    RobotPart(Moves.OUTPUT, Sent.OUTPUT),
    (ToolArgument("pin", ArgumentForm.NUMBER), ToolArgument("value", ArgumentForm.FLAG)),
)
READ_STATE: Final = Operation(
    ROBOT, "read_state", (), OperationKind.READ, Tier.NO_EFFECT, RobotPart(Moves.NOTHING, Sent.NEVER), ()
)
MOVE_LINEAR: Final = Operation(
    ROBOT,
    "move_linear",
    (
        *_POSE,
        _limit("speed", Unit.MICROMETRE_PER_SECOND, LEAST_TOOL_SPEED_UM_S, TOOL_SPEED_UM_S),
        _TOOL_ACCELERATION,
    ),
    OperationKind.MOTION,
    Tier.REVERSIBLE,
    RobotPart(Moves.TO_POSE, Sent.ONCE),
)
SPEED_LINEAR: Final = Operation(
    ROBOT,
    "speed_linear",
    (
        *_TOOL_SPEED,
        _TOOL_ACCELERATION,
        _DURATION,
    ),
    OperationKind.MOTION,
    Tier.REVERSIBLE,
    RobotPart(Moves.AT_TOOL_SPEED, Sent.STREAM),
)
_SERVO: Final = (
    _limit("period", Unit.MILLISECOND, *SERVO_PERIOD_MS),
    _limit("lookahead", Unit.MILLISECOND, *LOOKAHEAD_MS),
    _limit("gain", Unit.COUNT, *GAIN),
)
MOVE_UNTIL_CONTACT: Final = Operation(
    ROBOT,
    "move_until_contact",
    (*_TOOL_SPEED, _TOOL_ACCELERATION, _limit("distance", Unit.MICROMETRE, *CONTACT_WAY_UM)),
    OperationKind.MOTION,
    Tier.REVERSIBLE,
    RobotPart(Moves.UNTIL_CONTACT, Sent.ONCE),  # a program does not say how far: it is as far as its token lets it
)
SERVO_JOINT: Final = Operation(
    ROBOT,
    "servo_joint",
    (*_JOINT_ANGLES, *_SERVO),
    OperationKind.MOTION,
    Tier.REVERSIBLE,
    RobotPart(
        Moves.AFTER_JOINTS, Sent.STREAM
    ),  # the limits of a token hold for each of the angles, not for the first alone
)
SERVO_LINEAR: Final = Operation(
    ROBOT,
    "servo_linear",
    (*_POSE, *_SERVO),
    OperationKind.MOTION,
    Tier.REVERSIBLE,
    RobotPart(Moves.AFTER_POSES, Sent.STREAM),  # likewise, for each of the poses
)
SET_SPEED_SLIDER: Final = Operation(
    ROBOT,
    "set_speed_slider",
    (_limit("fraction", Unit.PERMILLE, 0, 1_000),),
    OperationKind.SWITCH,
    Tier.REVERSIBLE,
    RobotPart(Moves.STANDS, Sent.OUTPUT),
)
SET_PAYLOAD: Final = Operation(
    ROBOT,
    "set_payload",
    (_limit("mass", Unit.GRAM, 0, PAYLOAD_G), *_lengths("cx", "cy", "cz")),
    OperationKind.SWITCH,
    Tier.CONSEQUENTIAL,  # it changes the meaning of later commands
    RobotPart(Moves.STANDS, Sent.ONCE),
)
SET_TCP: Final = Operation(
    ROBOT,
    "set_tcp",
    _POSE,
    OperationKind.SWITCH,
    Tier.CONSEQUENTIAL,  # likewise
    RobotPart(Moves.STANDS, Sent.ONCE),
)
ZERO_FORCE_SENSOR: Final = Operation(
    ROBOT,
    "zero_force_sensor",
    (),
    OperationKind.SWITCH,
    Tier.REVERSIBLE,  # what the sensor feels now counts as nothing from now on; no motion of ours depends on it
    RobotPart(Moves.STANDS, Sent.ONCE),
)
_UNTIL: Final = (_limit("duration", Unit.MILLISECOND, *YIELD_MS), _limit("distance", Unit.MICROMETRE, *YIELD_UM))
"""Ends of a motion that no target ends: its time, and the tool's distance from where it began."""
FORCE_MODE: Final = Operation(
    ROBOT,
    "force_mode",
    (
        *_POSE,
        *(_limit(f"f{axis}", Unit.MILLINEWTON, -FORCE_MN, FORCE_MN) for axis in "xyz"),
        *(_limit(f"t{axis}", Unit.MILLINEWTON_METRE, -TORQUE_MN_M, TORQUE_MN_M) for axis in "xyz"),
        *(_limit(f"v{axis}", Unit.MICROMETRE_PER_SECOND, 0, YIELD_SPEED_UM_S) for axis in "xyz"),
        *(_limit(f"w{axis}", Unit.MICRORADIAN_PER_SECOND, 0, YIELD_TURN_URAD_S) for axis in "xyz"),
        *_UNTIL,
    ),
    OperationKind.MOTION,
    Tier.HIGH_CONSEQUENCE,  # DESIGN section 8: forces and hands say where the arm goes
    RobotPart(Moves.BY_FORCE, Sent.STREAM),
)
"""Force mode: the task frame, and along and about each of its axes the force and the highest speed.

An axis is compliant where its speed is more than 0; where it is held, its force is 0 too.
"""
FREEDRIVE: Final = Operation(
    ROBOT,
    "freedrive",
    (
        *(_limit(f"free_{axis}", Unit.COUNT, 0, 1) for axis in ("x", "y", "z", "rx", "ry", "rz")),
        _limit("tool_speed", Unit.MICROMETRE_PER_SECOND, *HAND_SPEED_UM_S),
        _limit("joint_speed", Unit.MICRORADIAN_PER_SECOND, *HAND_TURN_URAD_S),
        *_UNTIL,
    ),
    OperationKind.MOTION,
    Tier.HIGH_CONSEQUENCE,  # likewise
    RobotPart(Moves.BY_HAND, Sent.STREAM),
)
"""Leading by hand along the free axes of the base.

The arm is stopped where it is faster, farther or longer at it.
"""
SET_FORCE_DAMPING: Final = Operation(
    ROBOT,
    "set_force_damping",
    (_limit("damping", Unit.PERMILLE, 0, DAMPING_PERMILLE),),
    OperationKind.SWITCH,
    Tier.CONSEQUENTIAL,  # it changes what a force that is asked for later does
    RobotPart(Moves.STANDS, Sent.ONCE),
)
SET_FORCE_GAIN: Final = Operation(
    ROBOT,
    "set_force_gain",
    (_limit("gain", Unit.PERMILLE, 0, FORCE_GAIN_PERMILLE),),
    OperationKind.SWITCH,
    Tier.CONSEQUENTIAL,  # likewise
    RobotPart(Moves.STANDS, Sent.ONCE),
)
OPERATIONS: Final = (
    MOVE_JOINT,
    MOVE_PATH,
    FOLLOW_TRAJECTORY,
    MOVE_WAYPOINTS,
    STOP,
    GRIPPER_MOVE,
    GRIPPER_ACTIVATE,
    SPEED_JOINT,
    SET_DIGITAL_OUTPUT,
    READ_STATE,
    MOVE_LINEAR,
    SPEED_LINEAR,
    MOVE_UNTIL_CONTACT,
    SERVO_JOINT,
    SERVO_LINEAR,
    SET_SPEED_SLIDER,
    SET_PAYLOAD,
    SET_TCP,
    ZERO_FORCE_SENSOR,
    FORCE_MODE,
    FREEDRIVE,
    SET_FORCE_DAMPING,
    SET_FORCE_GAIN,
)
"""Every operation of the robot."""
_BY_NAME: Final[Mapping[tuple[str, str], Operation]] = {(each.object, each.name): each for each in OPERATIONS}
TOUCH: Final = "touch"
"""Grant on an object of the cell that the arm may touch on purpose.

No tool and no request has this name.
"""


def operation_of(object: str, name: str) -> Operation | None:  # noqa: A002 - the word of a request
    """The row of that object and operation; None where the robot has none."""
    return _BY_NAME.get((object, name))


def targets_of(operation: Operation | None, numbers: Sequence[T]) -> tuple[tuple[T, ...], ...]:
    """Joint angles to which a request sends the arm, waypoint by waypoint.

    Args:
        operation: of the request; None where the robot has none.
        numbers: values of its parameters in order; of a trajectory its last point first (`pep.world.motion_history`).

    Returns:
        () where the operation names no such place.
    """
    match operation.moves if operation is not None else Moves.NOTHING:
        case Moves.TO_JOINTS | Moves.ALONG_TRAJECTORY:
            return (tuple(numbers[:JOINTS]),)
        case Moves.THROUGH_JOINTS:
            every = [tuple(numbers[first : first + JOINTS]) for first in range(0, WAYPOINTS * JOINTS, JOINTS)]
            # A waypoint that repeats the one before only fills the request.
            return tuple(point for at, point in enumerate(every) if at == 0 or point != every[at - 1])
        case _:
            return ()


def touchable(chain: Chain) -> frozenset[str]:
    """The objects that every hop of the chain lets the arm touch on purpose."""
    return frozenset(grant.object for grant in chain.scope.grants if grant.operation == TOUCH)


def padded(waypoints: Sequence[T]) -> tuple[T, ...]:
    """Waypoints of a path, the last repeated up to `WAYPOINTS`, as a request has them.

    Raises:
        ValueError: none, or too many.
    """
    if not 1 <= len(waypoints) <= WAYPOINTS:
        raise ValueError(f"a path has 1 to {WAYPOINTS} waypoints")
    return (*waypoints, *(waypoints[-1] for _ in range(WAYPOINTS - len(waypoints))))
