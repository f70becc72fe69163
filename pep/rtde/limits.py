"""The robot's own limits on parameters. They hold whatever a token says, and nobody can widen them by delegation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.chain import Refusal
from capabilities.errors import FaultCode
from capabilities.scope import Range
from capabilities.units import Unit
from pep.operations import (
    GRIPPER_ACTIVATE,
    GRIPPER_MOVE,
    JOINTS,
    MOVE_JOINT,
    MOVE_PATH,
    READ_STATE,
    ROBOT,
    SET_DIGITAL_OUTPUT,
    SPEED_JOINT,
    STOP,
    WAYPOINTS,
)
from pep.stopping import STREAM_SPEED_RAD_S

if TYPE_CHECKING:
    from collections.abc import Mapping

    from policies.model import Request

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
    2_000  # ours: twice what counts as standstill; a slower arm could not be told from a still one
)
LEAST_ACCELERATION_URAD_S2: Final = 10_000  # ours: past standstill within 0.1 s
STROKE_UM: Final = 85_000  # G1: 0 to 85 mm
FINGER_SPEED_UM_S: Final = (20_000, 150_000)  # G1: 20 to 150 mm/s
GRIP_MN: Final = (20_000, 235_000)  # G1: 20 to 235 N

STREAM_SPEED_URAD_S: Final = round(STREAM_SPEED_RAD_S * Unit.MICRORADIAN_PER_SECOND.per_si)
STREAM_MS: Final = (50, 2_000)  # ours: longer than a call takes on its way; short enough to wait for
OUTPUTS: Final = 8  # U12: standard digital outputs

_MOVE: Final[Mapping[str, Range]] = {
    **{f"q{joint}": Range(-FULL_TURN_URAD, FULL_TURN_URAD) for joint in range(6)},
    "speed": Range(LEAST_SPEED_URAD_S, JOINT_SPEED_URAD_S),
    "acceleration": Range(LEAST_ACCELERATION_URAD_S2, JOINT_ACCELERATION_URAD_S2),
}
_PATH: Final[Mapping[str, Range]] = {
    **{f"p{leg}_q{joint}": _MOVE[f"q{joint}"] for leg in range(WAYPOINTS) for joint in range(JOINTS)},
    "speed": _MOVE["speed"],
    "acceleration": _MOVE["acceleration"],
}
_GRIP: Final[Mapping[str, Range]] = {
    "width": Range(0, STROKE_UM),
    "speed": Range(*FINGER_SPEED_UM_S),
    "force": Range(*GRIP_MN),
}
_SPEED: Final[Mapping[str, Range]] = {
    **{f"qd{joint}": Range(-STREAM_SPEED_URAD_S, STREAM_SPEED_URAD_S) for joint in range(6)},
    "acceleration": Range(LEAST_ACCELERATION_URAD_S2, JOINT_ACCELERATION_URAD_S2),
    "duration": Range(*STREAM_MS),
}
_OUTPUT: Final[Mapping[str, Range]] = {"pin": Range(0, OUTPUTS - 1), "value": Range(0, 1)}
LIMITS: Final[Mapping[str, Mapping[str, Range]]] = {
    MOVE_JOINT.name: _MOVE,
    MOVE_PATH.name: _PATH,
    GRIPPER_MOVE.name: _GRIP,
    GRIPPER_ACTIVATE.name: {},
    SPEED_JOINT.name: _SPEED,
    SET_DIGITAL_OUTPUT.name: _OUTPUT,
    STOP.name: {},
    READ_STATE.name: {},
}


class Ur3eLimits:
    """The `RobotLimits` port of a UR3e with a Robotiq 2F-85."""

    def refuse(self, request: Request) -> Refusal | None:
        """The first parameter outside of the robot's limits, or None. An operation that it does not have is refused."""
        limits = LIMITS.get(request.operation) if request.object == ROBOT else None
        if limits is None:
            return Refusal(FaultCode.NOT_GRANTED, detail="the robot has no such operation")
        if tuple(value.name for value in request.values) != tuple(limits):
            return Refusal(FaultCode.PARAMETERS_WRONG, detail="not the operation's parameters")
        for value in request.values:
            bound = limits[value.name]
            if not bound.low <= value.value <= bound.high:
                return Refusal(
                    FaultCode.LIMIT_EXCEEDED_BY_REQUEST,
                    parameter=value.name,
                    value=value.value,
                    unit=value.unit,
                    bound=bound,
                    nearest=min(max(value.value, bound.low), bound.high),
                    detail="the robot's own limit",
                )
        return None
