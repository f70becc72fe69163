"""The operations of a UR3e cell as the gate knows them: object, name, parameters in order, and the kind of effect."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Final, TypeVar

from capabilities.values.errors import QuantityError
from capabilities.values.units import Parameter, Quantity, Unit, parse
from policies.evidence.model import Request

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capabilities.values.chain import Chain

ROBOT: Final = "ur3e"


class Kind(Enum):
    """What an operation does to the world."""

    READ = "read"
    """Nothing."""
    MOTION = "motion"
    """It moves something: physics is computed, one at a time."""
    SWITCH = "switch"
    """It switches something that the cell has wired to the robot: whatever that moves, one at a time."""
    STOP = "stop"
    """It ends motion. Never subject to a permit."""


@dataclass(frozen=True, slots=True)
class Operation:
    """One operation.

    Attributes:
        object: the thing acted on.
        name: of the operation.
        parameters: in order; a request gives exactly these.
        kind: see there.
    """

    object: str
    name: str
    parameters: tuple[Parameter, ...]
    kind: Kind


JOINTS: Final = 6
WAYPOINTS: Final = 4
"""Waypoints of a path: with them a token that limits each still fits its carriage. A shorter path repeats its last."""
_LEADING_AXIS: Final = (
    Parameter("speed", Unit.MICRORADIAN_PER_SECOND),
    Parameter("acceleration", Unit.MICRORADIAN_PER_SECOND2),
)
MOVE_JOINT: Final = Operation(
    ROBOT, "move_joint", (*(Parameter(f"q{i}", Unit.MICRORADIAN) for i in range(JOINTS)), *_LEADING_AXIS), Kind.MOTION
)
MOVE_PATH: Final = Operation(
    ROBOT,
    "move_path",
    (
        *(Parameter(f"p{leg}_q{i}", Unit.MICRORADIAN) for leg in range(WAYPOINTS) for i in range(JOINTS)),
        *_LEADING_AXIS,
    ),
    Kind.MOTION,
)
GRIPPER_MOVE: Final = Operation(
    ROBOT,
    "gripper_move",
    (
        Parameter("width", Unit.MICROMETRE),
        Parameter("speed", Unit.MICROMETRE_PER_SECOND),
        Parameter("force", Unit.MILLINEWTON),
    ),
    Kind.MOTION,
)
GRIPPER_ACTIVATE: Final = Operation(ROBOT, "gripper_activate", (), Kind.MOTION)
SPEED_JOINT: Final = Operation(
    ROBOT,
    "speed_joint",
    (
        *(Parameter(f"qd{i}", Unit.MICRORADIAN_PER_SECOND) for i in range(JOINTS)),
        Parameter("acceleration", Unit.MICRORADIAN_PER_SECOND2),
        Parameter("duration", Unit.MILLISECOND),
    ),
    Kind.MOTION,
)
_POSE: Final = (
    *(Parameter(axis, Unit.MICROMETRE) for axis in "xyz"),
    *(Parameter(f"r{axis}", Unit.MICRORADIAN) for axis in "xyz"),
)
"""Of the tool in the base frame, or of the tool centre point on the flange: position and rotation vector."""
MOVE_LINEAR: Final = Operation(
    ROBOT,
    "move_linear",
    (
        *_POSE,
        Parameter("speed", Unit.MICROMETRE_PER_SECOND),
        Parameter("acceleration", Unit.MICROMETRE_PER_SECOND2),
    ),
    Kind.MOTION,
)
SPEED_LINEAR: Final = Operation(
    ROBOT,
    "speed_linear",
    (
        *(Parameter(f"v{axis}", Unit.MICROMETRE_PER_SECOND) for axis in "xyz"),
        *(Parameter(f"w{axis}", Unit.MICRORADIAN_PER_SECOND) for axis in "xyz"),
        Parameter("acceleration", Unit.MICROMETRE_PER_SECOND2),
        Parameter("duration", Unit.MILLISECOND),
    ),
    Kind.MOTION,
)
SERVO_JOINT: Final = Operation(
    ROBOT,
    "servo_joint",
    (
        *(Parameter(f"q{i}", Unit.MICRORADIAN) for i in range(JOINTS)),
        Parameter("period", Unit.MILLISECOND),
        Parameter("lookahead", Unit.MILLISECOND),
        Parameter("gain", Unit.COUNT),
    ),
    Kind.MOTION,
)
"""A stream of joint angles. The limits of a token hold for each of them, not for the first alone."""
SET_SPEED_SLIDER: Final = Operation(ROBOT, "set_speed_slider", (Parameter("fraction", Unit.PERMILLE),), Kind.SWITCH)
SET_PAYLOAD: Final = Operation(
    ROBOT,
    "set_payload",
    (Parameter("mass", Unit.GRAM), *(Parameter(f"c{axis}", Unit.MICROMETRE) for axis in "xyz")),
    Kind.SWITCH,
)
SET_TCP: Final = Operation(ROBOT, "set_tcp", _POSE, Kind.SWITCH)
SET_DIGITAL_OUTPUT: Final = Operation(
    ROBOT, "set_digital_output", (Parameter("pin", Unit.COUNT), Parameter("value", Unit.COUNT)), Kind.SWITCH
)
STOP: Final = Operation(ROBOT, "stop", (), Kind.STOP)
READ_STATE: Final = Operation(ROBOT, "read_state", (), Kind.READ)
TOUCH: Final = "touch"
"""Granted on an object of the cell: contact with it may be meant. No tool and no request has this name."""


def touchable(chain: Chain) -> frozenset[str]:
    """The objects that every hop of the chain lets the arm touch on purpose."""
    return frozenset(grant.object for grant in chain.scope.grants if grant.operation == TOUCH)


T = TypeVar("T")


def padded(waypoints: Sequence[T]) -> tuple[T, ...]:
    """A path's waypoints, 1 to `WAYPOINTS` of them, with the last repeated until there are as many as a request has.

    Raises:
        ValueError: none, or too many.
    """
    if not 1 <= len(waypoints) <= WAYPOINTS:
        raise ValueError(f"a path has 1 to {WAYPOINTS} waypoints")
    return (*waypoints, *(waypoints[-1] for _ in range(WAYPOINTS - len(waypoints))))


def waypoints_of(values: Sequence[T]) -> tuple[tuple[T, ...], ...]:
    """The waypoints in a `move_path` request's values, without those that only repeat the one before."""
    every = [tuple(values[first : first + JOINTS]) for first in range(0, WAYPOINTS * JOINTS, JOINTS)]
    return tuple(point for at, point in enumerate(every) if at == 0 or point != every[at - 1])


def digest_of(operation: Operation, numbers: Sequence[float], *, audience: str) -> str:
    """`Request.digest` of what sending these numbers would do; "" when they are no such request.

    Args:
        operation: that is about to be sent.
        numbers: its parameters in order, in SI units: the very values that go to the device.
        audience: canonical URL of the server that decided.
    """
    if len(numbers) != len(operation.parameters):
        return ""
    try:
        values = tuple(
            Quantity(parameter.name, parameter.unit, parse(number, parameter.unit))
            for parameter, number in zip(operation.parameters, numbers, strict=True)
        )
    except QuantityError:
        return ""
    return Request("", frozenset(), audience, operation.object, operation.name, values, 0.0).digest
