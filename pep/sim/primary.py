"""The frames of the primary, secondary and real-time interfaces. Layouts: UR client interface guide."""

from __future__ import annotations

import struct
import time
from typing import TYPE_CHECKING, Final

from pep.sim.arm import AXES
from pep.sim.robot import MAIN_VOLTAGE_V, TEMPERATURE_C, TICK_S, RuntimeState, SafetyMode
from pep.sim.spatial import to_pose

if TYPE_CHECKING:
    from pep.rtde.messages import ControlVersion
    from pep.sim.robot import Robot

STATE, MESSAGE = 16, 20  # frame types
SOURCE: Final = -2  # of messages: the controller
VERSION, ERROR_CODE, KEY, EXCEPTION = 3, 6, 7, 10  # message kinds
READ_ONLY: Final = 210  # error code of a script sent to a controller that takes none
_DEFAULTS: Final = (
    1.05,
    1.4,
    0.25,
    1.2,
    0.1,
)  # configuration: joint v, a; tool v, a; equivalent radius; UR's own defaults
_UR3_TYPE, _E_SERIES = 4, 1
REALTIME_DOUBLES: Final = 152  # 1220 bytes with the length, as PolyScope 5.11 sends


def _frame(kind: int, body: bytes) -> bytes:
    return struct.pack(">iB", 5 + len(body), kind) + body


def _message(kind: int, body: bytes) -> bytes:
    return _frame(MESSAGE, struct.pack(">Qbb", time.time_ns() // 1000, SOURCE, kind) + body)


def version_message(version: ControlVersion) -> bytes:
    """The greeting of 30001 and 30002."""
    name = b"URControl"
    body = (
        struct.pack(">b", len(name))
        + name
        + struct.pack(">BBii", version.major, version.minor, version.bugfix, version.build)
    )
    return _message(VERSION, body + b"01-04-2022, 00:00:00\0")


def key_message(title: str, text: str) -> bytes:
    """A program has started or stopped."""
    shown = title.encode()
    return _message(KEY, struct.pack(">iiB", 0, 0, len(shown)) + shown + text.encode())


def exception_message(line: int, text: str) -> bytes:
    """A program has failed."""
    return _message(EXCEPTION, struct.pack(">ii", line, 0) + text.encode())


def error_message(code: int) -> bytes:
    """An error by its number; UR's client library looks for 210."""
    return _message(ERROR_CODE, struct.pack(">iiiII", code, 0, 1, 0, 0))


def state_message(robot: Robot) -> bytes:
    """The robot state of 30001 and 30002, ten times a second."""
    now = robot.drive.now
    tool, offset = robot.tool_pose, to_pose(robot.tcp)
    a, d, alpha = robot.arm.dh
    zero = (0.0,) * AXES
    limits = [x for joint in robot.arm.joints for x in (-joint.position_limit_rad, joint.position_limit_rad)]
    tops = [x for joint in robot.arm.joints for x in (joint.speed_limit_rad_s, robot.arm.acceleration_limit_rad_s2)]
    running = robot.runtime is RuntimeState.PLAYING
    paused = robot.runtime is RuntimeState.PAUSED
    emergency = robot.safety is SafetyMode.ROBOT_EMERGENCY_STOP
    protective = robot.safety is SafetyMode.PROTECTIVE_STOP
    powered = robot.mode >= 4
    joints = b"".join(
        struct.pack(">dddffffB", q, q, qd, 0.0, MAIN_VOLTAGE_V, TEMPERATURE_C, TEMPERATURE_C, 253)
        for q, qd in zip(now.q, now.qd, strict=True)
    )
    mode = struct.pack(">Q7B", robot.step * 2000, 1, 1, powered, emergency, protective, running, paused)
    mode += struct.pack(">BBdddB", robot.mode, 0, robot.drive.slider, robot.drive.scaling, 1.0, 0)
    board = struct.pack(">iibbddbbdd", 0, robot.digital_out, 0, 0, 0.0, 0.0, 0, 0, 0.0, 0.0)
    board += struct.pack(">ffffBBB", TEMPERATURE_C, MAIN_VOLTAGE_V, 0.0, 0.0, robot.safety, 0, 0)
    parts = {
        0: mode,
        1: joints,
        2: struct.pack(">bbddfBffB", 0, 0, 0.0, 0.0, 0.0, 0, 0.0, TEMPERATURE_C, 253),
        3: board + struct.pack(">IBBB", 0, 0, 1, 0),
        4: struct.pack(">12d", *tool, *offset),
        5: struct.pack(">6I24dI", *(0,) * AXES, *zero, *a, *d, *alpha, 0),
        6: struct.pack(">12d12d5d24d", *limits, *tops, *_DEFAULTS, *a, *d, *alpha, *zero)
        + struct.pack(">4i", 0, 0, _UR3_TYPE, _E_SERIES),
        7: struct.pack(">7d", *zero, 0.0),
        8: struct.pack(">BBB", 0, 0, 0),
    }
    return _frame(STATE, b"".join(_frame(kind, body) for kind, body in parts.items()))


def realtime_message(robot: Robot) -> bytes:
    """The state of 30003, every tick."""
    now = robot.drive.now
    zero = (0.0,) * AXES
    tool, speed = robot.tool_pose, robot.tool_speed()
    moment = robot.holding_torques()
    values = [
        *(robot.step * TICK_S, *now.q, *now.qd, *now.qdd, *zero, *moment),
        *(*now.q, *now.qd, *zero, *zero, *tool, *speed, *zero, *tool, *speed),
        *(0.0, *(TEMPERATURE_C,) * AXES, 0.0, 0.0, float(robot.mode), *(253.0,) * AXES, float(robot.safety), *zero),
        *(0.0, 0.0, 0.0, *zero, robot.drive.scaling, 0.0, 0.0, 0.0, MAIN_VOLTAGE_V, MAIN_VOLTAGE_V, 0.0),
        *((MAIN_VOLTAGE_V,) * AXES + (float(robot.digital_out), float(robot.runtime), *zero, float(robot.safety))),
        *(0.0, 0.0, 0.0, robot.payload_kg, *robot.payload_cog_m, *robot.payload_inertia),
    ]
    return struct.pack(f">i{REALTIME_DOUBLES}d", 4 + 8 * REALTIME_DOUBLES, *values)
