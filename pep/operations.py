"""The operations of a UR3e cell as the gate knows them: object, name, parameters in order, and the kind of effect."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Final

from capabilities.errors import QuantityError
from capabilities.units import Parameter, Quantity, Unit, parse
from policies.model import Request

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capabilities.chain import Chain

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


MOVE_JOINT: Final = Operation(
    ROBOT,
    "move_joint",
    (
        *(Parameter(f"q{i}", Unit.MICRORADIAN) for i in range(6)),
        Parameter("speed", Unit.MICRORADIAN_PER_SECOND),
        Parameter("acceleration", Unit.MICRORADIAN_PER_SECOND2),
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
        *(Parameter(f"qd{i}", Unit.MICRORADIAN_PER_SECOND) for i in range(6)),
        Parameter("acceleration", Unit.MICRORADIAN_PER_SECOND2),
        Parameter("duration", Unit.MILLISECOND),
    ),
    Kind.MOTION,
)
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
