"""Operation as one declared row, of a robot or any other tool: mapping, limits, tiers and watch read it."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Final

from capabilities.values import bounds
from capabilities.values.arguments import kind_given, measured
from capabilities.values.chain import Refusal
from capabilities.values.errors import FaultCode
from capabilities.values.scope import Range, Tier
from capabilities.values.units import Sort

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from capabilities.values.arguments import Value
    from capabilities.values.scope import Bound
    from capabilities.values.units import Parameter
    from pep.base.tier_row import FactRow, TierRow
    from policies.evidence.fact_reading import FactReading
    from policies.evidence.model import Request

MILLION: Final = 1_000_000
"""Parts of a second, a radian and its rates, in the lists of a trajectory."""


class OperationKind(Enum):
    """Effect of an operation on the world."""

    READ = "read"
    """None."""
    MOTION = "motion"
    """Something moves: physics is computed, one at a time."""
    SWITCH = "switch"
    """Something wired to the robot is switched, and may move; one at a time."""
    STOP = "stop"
    """Motion ends. Never subject to a permit."""
    ACT = "act"
    """Something changes that is no robot's: no physics is computed, and it waits for no other act."""


class Moves(Enum):
    """Course of the thing that an operation moves."""

    NOTHING = "nothing"
    TO_JOINTS = "to_joints"
    """The arm, straight in joint space to six angles."""
    THROUGH_JOINTS = "through_joints"
    """The arm, straight in joint space from waypoint to waypoint, at rest at each."""
    ALONG_TRAJECTORY = "along_trajectory"
    """The arm, through joint angles at stated times, without a stop at each."""
    THROUGH_WAYPOINTS = "through_waypoints"
    """The arm, by joint moves and lines from waypoint to waypoint, cutting corners that have a blend."""
    TO_POSE = "to_pose"
    """The tool, straight to a pose."""
    AT_JOINT_SPEEDS = "at_joint_speeds"
    """The arm, for a time."""
    AT_TOOL_SPEED = "at_tool_speed"
    """The tool, for a time."""
    UNTIL_CONTACT = "until_contact"
    """The tool, at a speed until it touches something, or for a way."""
    AFTER_JOINTS = "after_joints"
    """The arm, after a stream of joint angles."""
    AFTER_POSES = "after_poses"
    """The arm, after a stream of tool poses."""
    BY_FORCE = "by_force"
    """The tool, wherever forces that are bounded let it go, for a time."""
    BY_HAND = "by_hand"
    """The arm, wherever a person's hand takes it, for a time."""
    FINGERS = "fingers"
    """The fingers, to an opening."""
    FINGERS_WHOLE = "fingers_whole"
    """The fingers, over their whole stroke."""
    OUTPUT = "output"
    """The device that is wired to a digital output."""
    STANDS = "stands"
    """Nothing moves, and the arm has to stand: later operations mean something else afterwards."""


class Sent(Enum):
    """Way of an operation to the robot."""

    NEVER = "never"
    ONCE = "once"
    """One command of the control script; a leased program may give it."""
    STREAM = "stream"
    """Likewise, and further values may follow it without a request of their own."""
    OUTPUT = "output"
    """Output registers beside the control script; likewise a leased program's."""
    STREAM_OF_OURS = "stream_of_ours"
    """A stream that the gateway itself writes: of the cell's tools alone."""
    GRIPPER = "gripper"
    """The gripper's own port, where the enforcement point itself sends what was decided."""


class ArgumentForm(Enum):
    """Form of a tool's argument; `pep.base.declaration` states it, `pep.mcp.mapping` reads and writes its values."""

    NUMBER = "number"
    INTEGER = "integer"
    """A whole number."""
    VECTOR = "vector"
    """A list of numbers, one for each parameter."""
    WAYPOINTS = "waypoints"
    """A list of 1 to `WAYPOINTS` lists of six numbers."""
    POINTS = "points"
    """A list of lists of six numbers, one list parameter for each of the six."""
    FLAG = "flag"
    """True or false, 1 or 0 in the request. A number is none."""
    VALUE = "value"
    """A flag, word, free value or list of them, as it is."""
    TEXT = "text"
    """A text that is a free value."""
    NUMBERS = "numbers"
    """A list of numbers of any length, one parameter."""
    INTEGERS = "integers"
    """A list of whole numbers, likewise."""


@dataclass(frozen=True, slots=True)
class ToolArgument:
    """An argument of a tool.

    Attributes:
        name: of it.
        form: of its value.
        parameters: so many of the operation's parameters, in their order, come from it.
        default: JSON of its value in a call that leaves it out; None where it must be given.
    """

    name: str
    form: ArgumentForm
    parameters: int = 1
    default: str | None = None


@dataclass(frozen=True, slots=True)
class BoundedParameter:
    """Parameter with the operation's own bound, which holds beside every token.

    Attributes:
        parameter: its name and kind.
        bound: its values.
        scale: so many of the unit make one of the argument's numbers; None for those of SI, exactly.
        exact: a number off the unit's grid is refused; else it is rounded to it, before anything is decided.
        tiers: values that raise the tier.
        destination: it says where the effect goes, which no text may that is not from a principal.
        root: directory of this machine that stands for "/" in a path, which is decided on by its real place beneath;
            empty for a path that is a word like another.
    """

    parameter: Parameter
    bound: Bound
    scale: int | None = None
    exact: bool = True
    tiers: tuple[TierRow, ...] = ()
    destination: bool = False
    root: str = ""

    @property
    def range(self) -> Range:
        """Lowest and highest value of a number without a set.

        Raises:
            TypeError: when it is none.
        """
        if isinstance(self.bound, Range):
            return self.bound
        raise TypeError("not a number in a range")


@dataclass(frozen=True, slots=True)
class RobotPart:
    """A robot's part of an operation: the course of what it moves, and its way to the robot."""

    moves: Moves
    sent: Sent


@dataclass(frozen=True, slots=True)
class Operation:
    """One operation.

    Attributes:
        object: the thing acted on.
        name: of the operation.
        limits: each parameter in order, with the operation's own bound; a request gives exactly these.
        kind: of its effect.
        base_tier: least tier; the registry may ask for a higher one.
        robot: a robot's part of it; None for a tool without one, whose tier comes from class and rows alone.
        arguments: of the tool of its name, in the parameters' order; None without a tool.
        facts: facts of sensors that its tier depends on, each once.
        parameters: the parameters of `limits`.
    """

    object: str
    name: str
    limits: tuple[BoundedParameter, ...]
    kind: OperationKind
    base_tier: Tier
    robot: RobotPart | None = None
    arguments: tuple[ToolArgument, ...] | None = None
    facts: tuple[FactRow, ...] = ()
    parameters: tuple[Parameter, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", tuple(each.parameter for each in self.limits))

    @property
    def moves(self) -> Moves:
        """Course of what it moves."""
        return Moves.NOTHING if self.robot is None else self.robot.moves

    @property
    def destinations(self) -> frozenset[str]:
        """Names of the parameters that say where its effect goes."""
        return frozenset(each.parameter.name for each in self.limits if each.destination)

    @property
    def sent(self) -> Sent:
        """Way to the robot."""
        return Sent.NEVER if self.robot is None else self.robot.sent

    def refuse(self, request: Request) -> Refusal | None:
        """First parameter outside of the operation's own limits, or None. A request for another one is refused."""
        if (request.object, request.operation) != (self.object, self.name):
            return Refusal(FaultCode.NOT_GRANTED, detail="not the operation")
        if [(v.name, kind_given(v)) for v in request.values] != [(each.name, each.kind) for each in self.parameters]:
            return Refusal(FaultCode.PARAMETERS_WRONG, detail="not the operation's parameters")
        for value, limit in zip(request.values, self.limits, strict=True):
            kind, given = limit.parameter.kind, measured(value)
            if not bounds.permits(limit.bound, given):
                return Refusal(
                    FaultCode.LIMIT_EXCEEDED_BY_REQUEST,
                    parameter=value.name,
                    value=given,
                    unit=kind,
                    bound=limit.bound,
                    nearest=None if kind is Sort.FREE else bounds.nearest(limit.bound, given),
                    detail="the operation's own limit",
                )
        return None

    def stated(self) -> Iterator[tuple[ToolArgument, tuple[BoundedParameter, ...]]]:
        """Each argument of the tool with its parameters, in their order."""
        left = self.limits
        for argument in self.arguments or ():
            yield argument, left[: argument.parameters]
            left = left[argument.parameters :]

    def tier_of(self, values: Sequence[Value], facts: Sequence[FactReading] = ()) -> tuple[Tier, tuple[str, ...]]:
        """Tier that the row gives, and the parameters and facts that raised it above the base tier.

        Args:
            values: of the parameters, in their order.
            facts: readings of the facts that it depends on; one that is not among them is missing.
        """
        read = {each.fact: each for each in facts}
        raised = [
            (row.tier, value.name)
            for limit, value in zip(self.limits, values, strict=True)
            for row in limit.tiers
            if any(row.values.low <= number <= row.values.high for number in _numbers(value))
        ]
        raised += [(row.tier_of(read.get(row.fact)), row.fact) for row in self.facts]
        tier = max((self.base_tier, *(each for each, _ in raised)))
        return tier, tuple(dict.fromkeys(name for each, name in raised if each == tier > self.base_tier))


def _numbers(value: Value) -> tuple[int, ...]:
    """Integers of a parameter: of a quantity its own, of a list each member's."""
    given = measured(value)
    return given if isinstance(given, tuple) else (given,)  # type: ignore[return-value]  # only numbers have tiers
