"""The robot's own limits on parameters. They hold whatever a token says, and nobody can widen them by delegation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.values.chain import Refusal
from capabilities.values.errors import FaultCode
from capabilities.values.scope import Grant, Limit, Range
from capabilities.values.units import Unit
from pep.base.operations import (
    GRIPPER_ACTIVATE,
    GRIPPER_MOVE,
    JOINTS,
    MOVE_JOINT,
    MOVE_LINEAR,
    MOVE_PATH,
    READ_STATE,
    ROBOT,
    SERVO_JOINT,
    SET_DIGITAL_OUTPUT,
    SET_PAYLOAD,
    SET_SPEED_SLIDER,
    SET_TCP,
    SPEED_JOINT,
    SPEED_LINEAR,
    STOP,
    WAYPOINTS,
)
from pep.base.stop_model import STREAM_SPEED_RAD_S

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pep.base.operations import Operation
    from policies.evidence.model import Request

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
REACH_UM: Final = 1_000_000  # ours: beyond a stretched UR3e with any tool that it can carry (U2: 500 mm reach)
TOOL_SPEED_UM_S: Final = 3_000_000  # U12: 3 m/s
TOOL_ACCELERATION_UM_S2: Final = 150_000_000  # U12: 150 m/s2
LEAST_TOOL_SPEED_UM_S: Final = 1_000  # ours: as `LEAST_SPEED_URAD_S`, at a lever of half a metre
LEAST_TOOL_ACCELERATION_UM_S2: Final = 5_000  # ours: likewise
OFFSET_M: Final = 1e-4  # ours: a tool centre point that differs by less is the same, but for the wire's rounding
OFFSET_RAD: Final = 1e-3  # ours: likewise, of its turn
SERVO_PERIOD_MS: Final = (1, 100)  # ours: from the controller's 2 ms, rounded down, to ten targets a second
LOOKAHEAD_MS: Final = (30, 200)  # U12: 0.03 to 0.2 s
GAIN: Final = (100, 2_000)  # U12
PAYLOAD_G: Final = 3_000  # U2: 3 kg

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
_POSE: Final[Mapping[str, Range]] = {
    **dict.fromkeys("xyz", Range(-REACH_UM, REACH_UM)),
    **dict.fromkeys(("rx", "ry", "rz"), Range(-FULL_TURN_URAD, FULL_TURN_URAD)),
}
_LINE: Final[Mapping[str, Range]] = {
    **_POSE,
    "speed": Range(LEAST_TOOL_SPEED_UM_S, TOOL_SPEED_UM_S),
    "acceleration": Range(LEAST_TOOL_ACCELERATION_UM_S2, TOOL_ACCELERATION_UM_S2),
}
_TWIST: Final[Mapping[str, Range]] = {
    **dict.fromkeys(("vx", "vy", "vz"), Range(-TOOL_SPEED_UM_S, TOOL_SPEED_UM_S)),
    **dict.fromkeys(("wx", "wy", "wz"), Range(-JOINT_SPEED_URAD_S, JOINT_SPEED_URAD_S)),
    "acceleration": Range(LEAST_TOOL_ACCELERATION_UM_S2, TOOL_ACCELERATION_UM_S2),
    "duration": Range(*STREAM_MS),
}
_SERVO: Final[Mapping[str, Range]] = {
    **{f"q{joint}": _MOVE[f"q{joint}"] for joint in range(JOINTS)},
    "period": Range(*SERVO_PERIOD_MS),
    "lookahead": Range(*LOOKAHEAD_MS),
    "gain": Range(*GAIN),
}
_PAYLOAD: Final[Mapping[str, Range]] = {
    "mass": Range(0, PAYLOAD_G),
    **dict.fromkeys(("cx", "cy", "cz"), Range(-REACH_UM, REACH_UM)),
}
_OUTPUT: Final[Mapping[str, Range]] = {"pin": Range(0, OUTPUTS - 1), "value": Range(0, 1)}
LIMITS: Final[Mapping[str, Mapping[str, Range]]] = {
    MOVE_JOINT.name: _MOVE,
    MOVE_PATH.name: _PATH,
    GRIPPER_MOVE.name: _GRIP,
    GRIPPER_ACTIVATE.name: {},
    SPEED_JOINT.name: _SPEED,
    SET_DIGITAL_OUTPUT.name: _OUTPUT,
    MOVE_LINEAR.name: _LINE,
    SPEED_LINEAR.name: _TWIST,
    SERVO_JOINT.name: _SERVO,
    SET_SPEED_SLIDER.name: {"fraction": Range(0, 1_000)},
    SET_PAYLOAD.name: _PAYLOAD,
    SET_TCP.name: _POSE,
    STOP.name: {},
    READ_STATE.name: {},
}


def widest(operation: Operation) -> Grant:
    """The grant of an operation with the robot's own limits: no token that is any use has a wider one."""
    own = LIMITS[operation.name]
    return Grant(operation.object, operation.name, tuple(Limit(p, own[p.name]) for p in operation.parameters))


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
