"""The built-in functions of URScript: one declared row each, at the end of this file.

Those that take time are written in `pep.sim.moves`, all others here.

Nothing is ever in this arm's way: force mode, freedrive and teaching are taken, checked and answered as by a robot that
nobody pushes, which holds still.
"""

# ruff: noqa: PLR0917  the signatures are URScript's

from __future__ import annotations

import inspect
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pep.rtde.variables import FIRST_BIT, INPUTS
from pep.sim import moves
from pep.sim.motion import ZERO
from pep.sim.robot import TICK_S
from pep.sim.spatial import to_frame, to_pose
from pep.sim.values import (
    INT_HIGH,
    INT_LOW,
    Pose,
    ScriptRuntimeError,
    Value,
    Vector,
    norm,
    number,
    pose_add,
    pose_inv,
    pose_sub,
    pose_trans,
    positive,
    six,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.sim.arm import Joints
    from pep.sim.motion import Kinetic
    from pep.sim.program import Execution


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter as URScript names it, and as the Python function does."""

    name: str
    local: str


@dataclass(frozen=True, slots=True)
class Function:
    """One built-in. `call` takes the execution first; one that takes time is a generator that yields once a tick."""

    name: str
    parameters: tuple[Parameter, ...]
    required: tuple[str, ...]
    call: Callable[..., Any]
    takes_time: bool


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


def _within_limits(run: Execution, target: Value) -> bool:
    if type(target) is Pose:
        return _solve(run, target, None, 1e-6, 1e-6, None) is not None
    return run.robot.arm.inside(six(target, "q"))


# ------------------------------------------------------------------------------------------------------------ settings


def _set_payload(run: Execution, m: Value, cog: Value = None) -> None:
    run.robot.set_payload(_mass(run, m), run.robot.payload_cog_m if cog is None else _three(cog, "cog"))


def _mass(run: Execution, m: Value) -> float:
    mass = number(m, "m")
    if not 0.0 <= mass <= run.robot.arm.payload_limit_kg:
        raise ScriptRuntimeError("a payload outside the limits")
    return mass


def _set_target_payload(run: Execution, m: Value, cog: Value, inertia: Value = None) -> None:
    run.robot.set_payload(_mass(run, m), _three(cog, "cog"), ZERO if inertia is None else six(inertia, "inertia"))


def _three(value: Value, name: str) -> tuple[float, float, float]:
    if not isinstance(value, list) or len(value) != 3:
        raise ScriptRuntimeError(f"{name} must have three numbers")
    x, y, z = (number(item, name) for item in value)
    return x, y, z


def _set_tcp(run: Execution, pose: Value, tcp_name: Value = "") -> None:
    del tcp_name
    run.robot.set_tcp(six(pose, "pose"))


def _set_gravity(run: Execution, d: Value) -> None:
    run.robot.set_gravity(_three(d, "d"))


def _force_mode(
    run: Execution, task_frame: Value, selection_vector: Value, wrench: Value, type_: Value, limits: Value
) -> None:
    del run
    for value, name in ((task_frame, "task_frame"), (wrench, "wrench"), (limits, "limits")):
        six(value, name)
    if any(each not in (0, 1) for each in six(selection_vector, "selection_vector")):
        raise ScriptRuntimeError("an axis is compliant (1) or not (0)")
    if type_ not in (1, 2, 3):
        raise ScriptRuntimeError("a force mode type that does not exist")


def _freedrive(run: Execution, axes: Value = None, feature: Value = None) -> None:
    del run
    if axes is not None and any(each not in (0, 1) for each in six(axes, "freeAxes")):
        raise ScriptRuntimeError("an axis is free (1) or not (0)")
    if feature is not None and feature not in ("base", "tool"):
        six(feature, "feature")


def _scale(low: float, high: float) -> Callable[..., None]:
    def call(run: Execution, value: Value) -> None:
        del run
        if not low <= number(value, "value") <= high:
            raise ScriptRuntimeError(f"a value outside {low} to {high}")

    return call


def _force_input(run: Execution, enable: Value, mass: Value = 0.0, offset: Value = None, cog: Value = None) -> None:
    """The wrench comes from a client; unless a watchdog is set, the program pauses when it comes below 10 Hz."""
    _mass(run, mass)
    for value in (offset, cog):
        if value is not None:
            _three(value, "sensor")
    run.robot.force_from_client = bool(enable)
    run.watch_force(enabled=bool(enable))


def _tool_contact(run: Execution, direction: Value = None) -> int:
    """Steps back to just before the tool touched, whatever the direction; 0 when it touches nothing."""
    if direction is not None:
        six(direction, "direction")
    robot = run.robot
    return 0 if robot.touched_at is None else min(robot.step - robot.touched_at + 1, len(robot.drive.history))


def _set_digital_out(shift: int, count: int) -> Callable[..., None]:
    def call(run: Execution, n: Value, b: Value) -> None:
        if not 0 <= number(n, "n") < count:
            raise ScriptRuntimeError("there is no such output")
        bit = 1 << int(n) + shift
        run.robot.set_digital_out(bit, bit if b else 0)

    return call


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


def _text(value: Value) -> str:
    if isinstance(value, list):
        return ("p" if type(value) is Pose else "") + "[" + ", ".join(map(_text, value)) + "]"
    return str(value)


def _textmsg(run: Execution, s1: Value, s2: Value = "") -> None:
    """Goes to the pendant's log, which nobody reads here; it is still computed, as its arguments may fail."""
    del run
    _text(s1) + _text(s2)


def _length(run: Execution, v: Value) -> int:
    del run
    if not isinstance(v, list | str):
        raise ScriptRuntimeError("only lists and strings have a length")
    return len(v)


def _plain(call: Callable[..., Value]) -> Callable[..., Value]:
    """A function of its arguments alone."""

    def wrapped(run: Execution, *arguments: Value) -> Value:
        del run
        return call(*arguments)

    return wrapped


def _nothing(run: Execution, *arguments: Value, **named: Value) -> None:
    """A setting that changes nothing observable on an arm without contact, force or hand guidance."""
    del run, arguments, named


def _row(name: str, parameters: str, call: Callable[..., Any]) -> Function:
    """A row from URScript's own signature; a parameter in brackets may be left out."""
    words = parameters.split()
    names = [word.strip("[]") for word in words]
    local = list(inspect.signature(call).parameters)[1 : 1 + len(names)]
    pairs = names if len(local) != len(names) else local
    return Function(
        name=name,
        parameters=tuple(Parameter(a, b) for a, b in zip(names, pairs, strict=True)),
        required=tuple(word for word in words if not word.startswith("[")),
        call=call,
        takes_time=inspect.isgeneratorfunction(call),
    )


_SENSOR: Final = "[sensor_mass] [sensor_measuring_offset] [sensor_cog]"
_IK: Final = "x [qnear] [maxPositionError] [maxOrientationError] [tcp]"

FUNCTIONS: Final[dict[str, Function]] = {
    row.name: row
    for row in (
        # motion
        _row("movej", "q [a] [v] [t] [r]", moves.movej),
        _row("movel", "pose [a] [v] [t] [r]", moves.movel),
        _row("speedj", "qd [a] [t]", moves.speedj),
        _row("speedl", "xd [a] [t] [aRot]", moves.speedl),
        _row("servoc", "pose [a] [v] [r]", moves.servoc),
        _row("servoj", "q [a] [v] [t] [lookahead_time] [gain]", moves.servoj),
        _row("stopj", "[a]", moves.stopj),
        _row("stopl", "[a] [aRot]", moves.stopl),
        _row("protective_stop", "", moves.protective_stop),
        _row("sleep", "t", moves.sleep),
        _row("sync", "", moves.sync),
        # state of the arm
        _row("is_steady", "", lambda run: not run.robot.drive.moving),
        _row("get_steptime", "", lambda run: TICK_S),  # noqa: ARG005
        _row("get_actual_joint_positions", "", lambda run: Vector(_now(run).q)),
        _row("get_target_joint_positions", "", lambda run: Vector(_now(run).q)),
        _row("get_actual_joint_speeds", "", lambda run: Vector(_now(run).qd)),
        _row("get_target_joint_speeds", "", lambda run: Vector(_now(run).qd)),
        _row("get_actual_joint_positions_history", "[steps]", _history),
        _row("get_actual_tcp_pose", "", lambda run: Pose(run.robot.tool_pose)),
        _row("get_target_tcp_pose", "", lambda run: Pose(run.robot.tool_pose)),
        _row("get_target_waypoint", "", lambda run: Pose(run.robot.waypoint)),
        _row("get_actual_tool_flange_pose", "", lambda run: Pose(to_pose(run.robot.flange()))),
        _row("get_actual_tcp_speed", "", lambda run: Pose(run.robot.tool_speed())),
        _row("get_target_tcp_speed", "", lambda run: Pose(run.robot.tool_speed())),
        # Corrected by what the robot itself needs, as the vendor's manual says; there is nothing else here.
        _row("get_joint_torques", "", lambda run: Vector(ZERO)),  # noqa: ARG005
        _row("get_tcp_force", "", lambda run: Pose(run.robot.tool_force())),
        _row("force", "", lambda run: math.hypot(*run.robot.tool_force()[:3])),
        _row("get_forward_kin", "[q] [tcp]", _forward),
        _row("get_inverse_kin", _IK, _inverse),
        _row("get_inverse_kin_has_solution", _IK, _has_inverse),
        _row("is_within_safety_limits", "pose", _within_limits),
        _row("tool_contact", "[direction]", _tool_contact),
        _row("get_freedrive_status", "", lambda run: 0),  # noqa: ARG005  normal: no singularity is near
        # settings
        _row("set_tcp", "pose [tcp_name]", _set_tcp),
        _row("get_tcp_offset", "", lambda run: Pose(to_pose(run.robot.tcp))),
        _row("set_payload", "m [cog]", _set_payload),
        _row("set_target_payload", "m cog [inertia]", _set_target_payload),
        _row("get_target_payload", "", lambda run: run.robot.payload_kg),
        _row("get_target_payload_cog", "", lambda run: Vector(run.robot.payload_cog_m)),
        _row("get_target_payload_inertia", "", lambda run: Vector(run.robot.payload_inertia)),
        _row("set_gravity", "d", _set_gravity),
        _row("set_digital_out", "n b", _set_digital_out(0, 8)),
        _row("set_standard_digital_out", "n b", _set_digital_out(0, 8)),
        _row("set_configurable_digital_out", "n b", _set_digital_out(8, 8)),
        _row("set_tool_digital_out", "n b", _set_digital_out(16, 2)),
        _row("zero_ftsensor", "", _nothing),
        _row("force_mode", "task_frame selection_vector wrench type limits", _force_mode),
        _row("force_mode_set_damping", "damping", _scale(0.0, 1.0)),
        _row("force_mode_set_gain_scaling", "scaling", _scale(0.0, 2.0)),
        _row("end_force_mode", "", _nothing),
        _row("teach_mode", "", _nothing),
        _row("end_teach_mode", "", _nothing),
        _row("freedrive_mode", "[freeAxes] [feature]", _freedrive),
        _row("end_freedrive_mode", "", _nothing),
        _row("ft_rtde_input_enable", f"enable {_SENSOR}", _force_input),
        _row("enable_external_ft_sensor", f"enable {_SENSOR}", _force_input),
        # registers
        _row("read_input_integer_register", "address", _reader("input_int")),
        _row("read_input_float_register", "address", _reader("input_double")),
        _row("read_input_boolean_register", "address", _read_bit("input")),
        _row("read_output_integer_register", "address", _reader("output_int")),
        _row("read_output_float_register", "address", _reader("output_double")),
        _row("read_output_boolean_register", "address", _read_bit("output")),
        _row("write_output_integer_register", "address value", _write_int),
        _row("write_output_float_register", "address value", _write_float),
        _row("write_output_boolean_register", "address value", _write_bit),
        _row("rtde_set_watchdog", "variable_name min_frequency [action]", _watchdog),
        # arithmetic
        _row("pose_trans", "p_from p_from_to", _plain(pose_trans)),
        _row("pose_inv", "p_from", _plain(pose_inv)),
        _row("pose_add", "p_1 p_2", _plain(pose_add)),
        _row("pose_sub", "p_to p_from", _plain(pose_sub)),
        _row("norm", "a", _plain(norm)),
        _row("sin", "f", _plain(math.sin)),
        _row("cos", "f", _plain(math.cos)),
        _row("tan", "f", _plain(math.tan)),
        _row("atan2", "x y", _plain(math.atan2)),
        _row("sqrt", "f", _plain(math.sqrt)),
        _row("floor", "f", _plain(math.floor)),
        _row("ceil", "f", _plain(math.ceil)),
        _row("d2r", "d", _plain(math.radians)),
        _row("r2d", "r", _plain(math.degrees)),
        _row("length", "v", _length),
        _row("to_str", "val", _plain(_text)),
        _row("str_cat", "op1 op2", _plain(lambda a, b: _text(a) + _text(b))),
        _row("textmsg", "s1 [s2]", _textmsg),
    )
}
