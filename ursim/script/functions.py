"""The built-in functions of URScript: one declared row each, at the end of this file.

Those that take time are written in `ursim.script.motion_functions`, those for inputs and outputs in
`ursim.script.io_functions`, others here.

Nothing is in this arm's way but the surfaces that a test puts there, on which only its tool point presses; a hand that
leads it is a test's, too.
"""

# ruff: noqa: PLR0917  the signatures are URScript's

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from pep.rtde.wire.variables import FIRST_BIT, INPUTS
from ursim.motion.arm import AXES
from ursim.motion.motion import ZERO
from ursim.motion.robot import TEMPERATURE_C, TICK_S
from ursim.motion.spatial import to_frame, to_pose
from ursim.motion.values import (
    INT_HIGH,
    INT_LOW,
    Pose,
    ScriptRuntimeError,
    Value,
    Vector,
    as_text,
    interpolate_pose,
    logarithm,
    norm,
    number,
    point_dist,
    pose_add,
    pose_inv,
    pose_sub,
    pose_trans,
    positive,
    power,
    rotvec2rpy,
    rpy2rotvec,
    six,
    three,
)
from ursim.script import io_functions, led_functions, motion_functions, socket_functions, text_functions
from ursim.script.builtin import Function, plain, row

if TYPE_CHECKING:
    from collections.abc import Callable

    from ursim.motion.arm import Joints
    from ursim.motion.motion import Kinetic
    from ursim.script.program import Execution


# ----------------------------------------------------------------------------------------------------- what the arm is


def _now(run: Execution) -> Kinetic:
    return run.robot.drive.now


def _history(run: Execution, steps: Value = 0) -> Vector:
    back = int(number(steps, "steps"))
    past = run.robot.drive.history
    if not 0 <= back <= len(past):
        raise ScriptRuntimeError("that far back nothing is remembered")
    return Vector(_now(run).q if back == 0 else past[-back])


def _forward(run: Execution, q: Value = None, tcp: Value = None) -> Pose:
    robot = run.robot
    joints = robot.drive.now.q if q is None else six(q, "q")
    return Pose(robot.forward(joints, robot.tcp if tcp is None else to_frame(six(tcp, "tcp"))))


def _inverse(
    run: Execution,
    x: Value,
    qnear: Value = None,
    max_position_error: Value = 1e-10,
    max_orientation_error: Value = 1e-10,
    tcp: Value = None,
) -> Vector:
    found = _solve(run, x, qnear, max_position_error, max_orientation_error, tcp)
    if found is None:
        raise ScriptRuntimeError("no inverse kinematics solution")
    return Vector(found)


def _has_inverse(
    run: Execution,
    x: Value,
    qnear: Value = None,
    max_position_error: Value = 1e-10,
    max_orientation_error: Value = 1e-10,
    tcp: Value = None,
) -> bool:
    return _solve(run, x, qnear, max_position_error, max_orientation_error, tcp) is not None


def _solve(run: Execution, x: Value, qnear: Value, position: Value, orientation: Value, tcp: Value) -> Joints | None:
    robot = run.robot
    near = robot.drive.now.q if qnear is None else six(qnear, "qnear")
    tool = robot.tcp if tcp is None else to_frame(six(tcp, "tcp"))
    asked = min(positive(position, "maxPositionError"), positive(orientation, "maxOrientationError"))
    return robot.arm.reach(to_frame(six(x, "x")), near, tool, tolerance=max(asked, 1e-10))


def _joint_temperature(run: Execution, j: Value) -> float:
    del run
    if isinstance(j, bool) or not isinstance(j, int) or not 0 <= j < AXES:
        raise ScriptRuntimeError("there is no such joint")
    return TEMPERATURE_C


def _within_limits(run: Execution, target: Value) -> bool:
    if type(target) is Pose:
        return _solve(run, target, None, 1e-6, 1e-6, None) is not None
    return run.robot.arm.inside(six(target, "q"))


# ------------------------------------------------------------------------------------------------------------ settings


def _set_payload(run: Execution, m: Value, cog: Value = None) -> None:
    run.robot.set_payload(_mass(run, m), run.robot.payload_cog_m if cog is None else three(cog, "cog"))


def _mass(run: Execution, m: Value) -> float:
    mass = number(m, "m")
    if not 0.0 <= mass <= run.robot.arm.payload_limit_kg:
        raise ScriptRuntimeError("a payload outside the limits")
    return mass


def _set_target_payload(run: Execution, m: Value, cog: Value, inertia: Value = None) -> None:
    run.robot.set_payload(_mass(run, m), three(cog, "cog"), ZERO if inertia is None else six(inertia, "inertia"))


def _set_tcp(run: Execution, pose: Value, tcp_name: Value = "") -> None:
    del tcp_name
    run.robot.set_tcp(six(pose, "pose"))


def _set_gravity(run: Execution, d: Value) -> None:
    run.robot.set_gravity(three(d, "d"))


def _transition_hardness(run: Execution, type_: Value) -> None:
    """Kind of the torques after a change of the safety mode, which make no difference here."""
    del run
    if isinstance(type_, bool) or type_ not in (0, 1):
        raise ScriptRuntimeError("a transition is soft (0) or hard (1)")


def _force_input(run: Execution, enable: Value, mass: Value = 0.0, offset: Value = None, cog: Value = None) -> None:
    """The wrench comes from a client; unless a watchdog is set, the program pauses when it comes below 10 Hz."""
    _mass(run, mass)
    for value in (offset, cog):
        if value is not None:
            three(value, "sensor")
    run.robot.force_from_client = bool(enable)
    run.watch_force(enabled=bool(enable))


def _tool_contact(run: Execution, direction: Value = None) -> int:
    """Number of steps back to just before the tool touched what is in that direction; 0 when it touches nothing.

    A touch that a test tells of is in every direction.
    """
    robot = run.robot
    since = robot.touching_since((0.0, 0.0, 0.0) if direction is None else six(direction, "direction")[:3])
    return 0 if since is None else min(robot.step - since + 1, len(robot.drive.history))


# ----------------------------------------------------------------------------------------------------------- registers


def _reader(prefix: str) -> Callable[..., Value]:
    def call(run: Execution, address: Value) -> Value:
        return run.robot.values[f"{prefix}_register_{address}"]  # an address outside is a KeyError: a runtime exception

    return call


def _write_int(run: Execution, address: Value, value: Value) -> None:
    name = f"output_int_register_{address}"
    if isinstance(value, bool) or not isinstance(value, int) or not INT_LOW <= value <= INT_HIGH:
        raise ScriptRuntimeError("an integer register takes a 32-bit integer")
    run.robot.values[name]
    run.robot.values[name] = value


def _write_float(run: Execution, address: Value, value: Value) -> None:
    name = f"output_double_register_{address}"
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ScriptRuntimeError("a float register takes a number")
    run.robot.values[name]
    run.robot.values[name] = float(value)


def _read_bit(direction: str) -> Callable[..., bool]:
    def call(run: Execution, address: Value) -> bool:
        name, bit = _bit(direction, address)
        value = run.robot.values[name]
        return bool(value) if bit is None else bool(int(number(value, name)) >> bit & 1)

    return call


def _write_bit(run: Execution, address: Value, value: Value) -> None:
    name, bit = _bit("output", address)
    if bit is None:
        run.robot.values[name] = bool(value)
    else:
        word = int(number(run.robot.values[name], name)) & ~(1 << bit)
        run.robot.values[name] = word | (1 << bit if value else 0)


def _bit(direction: str, address: Value) -> tuple[str, int | None]:
    if isinstance(address, bool) or not isinstance(address, int) or not 0 <= address < 2 * FIRST_BIT:
        raise ScriptRuntimeError("there is no such bit register")
    if address >= FIRST_BIT:
        return f"{direction}_bit_register_{address}", None
    return f"{direction}_bit_registers{'0_to_31' if address < 32 else '32_to_63'}", address % 32


def _watchdog(run: Execution, variable_name: Value, min_frequency: Value, action: Value = "pause") -> None:
    frequency = number(min_frequency, "min_frequency")
    if variable_name not in INPUTS or frequency < 0.0 or action not in ("ignore", "pause", "stop"):
        raise ScriptRuntimeError("this watchdog cannot be set")
    if action == "ignore":
        frequency = 0.0
    run.watch(variable_name, frequency, pauses=action == "pause")


# ------------------------------------------------------------------------------------------------------------ the rest


def _textmsg(run: Execution, s1: Value, s2: Value = "") -> None:
    """Goes to the pendant's log, which nobody reads here; it is still computed, as its arguments may fail."""
    del run
    as_text(s1) + as_text(s2)


def _nothing(run: Execution, *arguments: Value, **named: Value) -> None:
    """A setting that changes nothing observable on an arm without contact, force or hand guidance."""
    del run, arguments, named


_SENSOR: Final = "[sensor_mass] [sensor_measuring_offset] [sensor_cog]"
_IK: Final = "x [qnear] [maxPositionError] [maxOrientationError] [tcp]"

FUNCTIONS: Final[dict[str, Function]] = {
    each.name: each
    for each in (
        *io_functions.ROWS,
        *led_functions.ROWS,
        *socket_functions.ROWS,
        *text_functions.ROWS,
        # motion
        row("movej", "q [a] [v] [t] [r]", motion_functions.movej),
        row("movel", "pose [a] [v] [t] [r]", motion_functions.movel),
        row("movep", "pose [a] [v] [r]", motion_functions.movep),
        row("movec", "pose_via pose_to [a] [v] [r] [mode]", motion_functions.movec),
        row("speedj", "qd [a] [t]", motion_functions.speedj),
        row("speedl", "xd [a] [t] [aRot]", motion_functions.speedl),
        row("servoc", "pose [a] [v] [r]", motion_functions.servoc),
        row("servoj", "q [a] [v] [t] [lookahead_time] [gain]", motion_functions.servoj),
        row("stopj", "[a]", motion_functions.stopj),
        row("stopl", "[a] [aRot]", motion_functions.stopl),
        row("protective_stop", "", motion_functions.protective_stop),
        row("sleep", "t", motion_functions.sleep),
        row("sync", "", motion_functions.sync),
        # state of the arm
        row("is_steady", "", lambda run: not run.robot.drive.moving),
        row("get_steptime", "", lambda run: TICK_S),  # noqa: ARG005
        row("get_actual_joint_positions", "", lambda run: Vector(_now(run).q)),
        row("get_joint_positions", "", lambda run: Vector(_now(run).q)),
        row("get_target_joint_positions", "", lambda run: Vector(_now(run).q)),
        row("get_actual_joint_speeds", "", lambda run: Vector(_now(run).qd)),
        row("get_target_joint_speeds", "", lambda run: Vector(_now(run).qd)),
        row("get_actual_joint_positions_history", "[steps]", _history),
        row("get_actual_tcp_pose", "", lambda run: Pose(run.robot.tool_pose)),
        row("get_target_tcp_pose", "", lambda run: Pose(run.robot.tool_pose)),
        row("get_target_waypoint", "", lambda run: Pose(run.robot.waypoint)),
        row("get_actual_tool_flange_pose", "", lambda run: Pose(to_pose(run.robot.flange()))),
        row("get_actual_tcp_speed", "", lambda run: Pose(run.robot.tool_speed())),
        row("get_target_tcp_speed", "", lambda run: Pose(run.robot.tool_speed())),
        # Corrected by the robot's own need, as the vendor's manual says; there is nothing else here.
        row("get_joint_torques", "", lambda run: Vector(ZERO)),  # noqa: ARG005
        row("get_tcp_force", "", lambda run: Pose(run.robot.tool_force())),
        row("force", "", lambda run: math.hypot(*run.robot.tool_force()[:3])),
        row("get_forward_kin", "[q] [tcp]", _forward),
        row("get_inverse_kin", _IK, _inverse),
        row("get_inverse_kin_has_solution", _IK, _has_inverse),
        row("is_within_safety_limits", "pose", _within_limits),
        row("get_controller_temp", "", lambda run: TEMPERATURE_C),  # noqa: ARG005
        row("get_joint_temp", "j", _joint_temperature),
        row("tool_contact", "[direction]", _tool_contact),
        # settings
        row("set_tcp", "pose [tcp_name]", _set_tcp),
        row("get_tcp_offset", "", lambda run: Pose(to_pose(run.robot.tcp))),
        row("set_payload", "m [cog]", _set_payload),
        row("set_payload_mass", "m", _set_payload),
        row("set_payload_cog", "CoG", lambda run, cog: run.robot.set_payload(run.robot.payload_kg, three(cog, "CoG"))),
        row("set_target_payload", "m cog [inertia]", _set_target_payload),
        row("get_target_payload", "", lambda run: run.robot.payload_kg),
        row("get_target_payload_cog", "", lambda run: Vector(run.robot.payload_cog_m)),
        row("get_target_payload_inertia", "", lambda run: Vector(run.robot.payload_inertia)),
        row("set_safety_mode_transition_hardness", "type", _transition_hardness),
        row("set_gravity", "d", _set_gravity),
        row("zero_ftsensor", "", _nothing),
        row("ft_rtde_input_enable", f"enable {_SENSOR}", _force_input),
        row("enable_external_ft_sensor", f"enable {_SENSOR}", _force_input),
        # registers
        row("read_input_integer_register", "address", _reader("input_int")),
        row("read_input_float_register", "address", _reader("input_double")),
        row("read_input_boolean_register", "address", _read_bit("input")),
        row("read_output_integer_register", "address", _reader("output_int")),
        row("read_output_float_register", "address", _reader("output_double")),
        row("read_output_boolean_register", "address", _read_bit("output")),
        row("write_output_integer_register", "address value", _write_int),
        row("write_output_float_register", "address value", _write_float),
        row("write_output_boolean_register", "address value", _write_bit),
        row("rtde_set_watchdog", "variable_name min_frequency [action]", _watchdog),
        # arithmetic
        row("pose_trans", "p_from p_from_to", plain(pose_trans)),
        row("pose_inv", "p_from", plain(pose_inv)),
        row("pose_add", "p_1 p_2", plain(pose_add)),
        row("pose_sub", "p_to p_from", plain(pose_sub)),
        row("point_dist", "p_from p_to", plain(point_dist)),
        row("interpolate_pose", "p_from p_to alpha", plain(interpolate_pose)),
        row("rotvec2rpy", "rotation_vector", plain(rotvec2rpy)),
        row("rpy2rotvec", "rpy_vector", plain(rpy2rotvec)),
        row("norm", "a", plain(norm)),
        row("sin", "f", plain(math.sin)),
        row("cos", "f", plain(math.cos)),
        row("tan", "f", plain(math.tan)),
        row("asin", "f", plain(math.asin)),
        row("acos", "f", plain(math.acos)),
        row("atan", "f", plain(math.atan)),
        row("pow", "base exponent", plain(power)),
        row("log", "b f", plain(logarithm)),
        row("atan2", "x y", plain(math.atan2)),
        row("sqrt", "f", plain(math.sqrt)),
        row("floor", "f", plain(math.floor)),
        row("ceil", "f", plain(math.ceil)),
        row("d2r", "d", plain(math.radians)),
        row("r2d", "r", plain(math.degrees)),
        row("popup", "s [title] [warning] [error] [blocking]", motion_functions.popup),
        row("textmsg", "s1 [s2]", _textmsg),
    )
}
