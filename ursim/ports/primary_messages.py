"""Messages of the controller on its primary, secondary and real-time interfaces, in the forms of `pep.rtde`."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from pep.rtde.wire import primary_frames as f
from pep.rtde.wire import primary_state as state
from pep.rtde.wire import realtime_frames as realtime
from ursim.motion.arm import AXES
from ursim.motion.motion import ZERO
from ursim.motion.robot import MAIN_VOLTAGE_V, POWERED, TEMPERATURE_C, TICK_S, RuntimeState, SafetyMode
from ursim.motion.spatial import to_pose

if TYPE_CHECKING:
    from pep.rtde.wire.messages import ControlVersion
    from ursim.motion.robot import Robot
    from ursim.ports.arm_kinds import ArmKind

SOURCE: Final = -2  # of messages: the controller
BUILT: Final = "01-04-2022, 00:00:00\0"
_DEFAULTS: Final = (1.05, 1.4, 0.25, 1.2, 0.1)  # joint v, a; tool v, a; equivalent radius: UR's own defaults
_E_SERIES = 1
_EMERGENCY: Final = frozenset([SafetyMode.ROBOT_EMERGENCY_STOP, SafetyMode.SYSTEM_EMERGENCY_STOP])
_NONE: Final = (0.0, 0.0, 0.0)


def _message(content: f.Content) -> bytes:
    return f.encode_primary(f.PrimaryMessage(time.time_ns() // 1000, SOURCE, content))


def version_message(version: ControlVersion) -> bytes:
    """The greeting of 30001 and 30002."""
    return _message(f.Version("URControl", version.major, version.minor, version.bugfix, version.build, BUILT))


def key_message(title: str, text: str) -> bytes:
    """A program has started or stopped."""
    return _message(f.Key(0, 0, title, text))


def exception_message(line: int, text: str) -> bytes:
    """A program has failed."""
    return _message(f.RuntimeException(line, 0, text))


def error_message(code: int, argument: int = 0) -> bytes:
    """An error by its number; UR's client library looks for 210."""
    return _message(f.ErrorCode(code, argument, 1, 0, 0, ""))


def state_message(robot: Robot, kind: ArmKind) -> bytes:
    """The robot state of 30001 and 30002, ten times a second."""
    now, read = robot.drive.now, robot.joint_mode
    a, d, alpha = robot.arm.dh
    joints = robot.arm.joints
    parts: tuple[state.Part, ...] = (
        state.RobotMode(
            timestamp_us=round(robot.step * TICK_S * 1e6),
            connected=True,
            enabled=True,
            powered=robot.mode in POWERED,
            emergency_stopped=robot.safety in _EMERGENCY,
            protective_stopped=robot.safety is SafetyMode.PROTECTIVE_STOP,
            program_running=robot.runtime is RuntimeState.PLAYING,
            program_paused=robot.runtime is RuntimeState.PAUSED,
            robot_mode=robot.mode,
            control_mode=0,
            target_speed_fraction=robot.drive.slider,
            speed_scaling=robot.drive.scaling,
            speed_fraction_limit=1.0,
            reserved=0,
        ),
        state.Joints(
            tuple(
                state.Joint(q, q, qd, 0.0, MAIN_VOLTAGE_V, TEMPERATURE_C, TEMPERATURE_C, read)
                for q, qd in zip(now.q, now.qd, strict=True)
            )
        ),
        state.Tool(0, 0, 0.0, 0.0, 0.0, robot.tool_voltage_v, 0.0, TEMPERATURE_C, read),
        state.Masterboard(
            digital_in=0,
            digital_out=robot.digital_out,
            analog_in_range_0=0,
            analog_in_range_1=0,
            analog_in_0=0.0,
            analog_in_1=0.0,
            analog_out_domain_0=robot.analog_domain & 1,
            analog_out_domain_1=robot.analog_domain >> 1,
            analog_out_0=robot.analog_out(0),
            analog_out_1=robot.analog_out(1),
            temperature=TEMPERATURE_C,
            robot_voltage=MAIN_VOLTAGE_V,
            robot_current=0.0,
            io_current=0.0,
            safety_mode=robot.safety,
            reduced=int(robot.safety is SafetyMode.REDUCED),
            euromap=0,
            reserved=0,
            operational_mode=robot.operational,
            enabling_device=1,  # none is configured: as one that is always held
            reserved_too=0,
        ),
        state.Cartesian(robot.tool_pose, to_pose(robot.tcp)),
        state.Kinematics((0,) * AXES, ZERO, a, d, alpha, 0),
        state.Configuration(
            tuple(x for joint in joints for x in (-joint.position_limit_rad, joint.position_limit_rad)),
            tuple(x for joint in joints for x in (joint.speed_limit_rad_s, robot.arm.acceleration_limit_rad_s2)),
            *_DEFAULTS,
            a,
            d,
            alpha,
            ZERO,
            0,
            0,
            kind.number,
            _E_SERIES,
        ),
        state.Force(robot.tool_force(), 0.0),
        state.Additional(0, 0, 0),
    )
    return f.encode_primary(f.PrimaryState(parts))


def realtime_message(robot: Robot) -> bytes:
    """The state of 30003, every tick."""
    now = robot.drive.now
    pose, speed = robot.tool_pose, robot.tool_speed()
    elbow = robot.elbow()
    return realtime.encode_realtime(
        realtime.RealtimeState(
            time_s=robot.step * TICK_S,
            q_target=now.q,
            qd_target=now.qd,
            qdd_target=now.qdd,
            current_target=ZERO,
            moment_target=robot.torques(),
            q=now.q,
            qd=now.qd,
            current=ZERO,
            current_control=ZERO,
            tool_pose=pose,
            tool_speed=speed,
            tool_force=robot.tool_force(),
            tool_pose_target=pose,
            tool_speed_target=speed,
            digital_in=0.0,
            motor_temperatures=(TEMPERATURE_C,) * AXES,
            controller_time=0.0,
            test_value=0.0,
            robot_mode=float(robot.mode),
            joint_modes=(float(robot.joint_mode),) * AXES,
            safety_mode=float(robot.safety),
            reserved=ZERO,
            tool_acceleration=robot.accelerometer(),
            reserved_2=ZERO,
            speed_scaling=robot.drive.scaling,
            momentum=robot.momentum(),
            reserved_3=0.0,
            reserved_4=0.0,
            main_voltage=MAIN_VOLTAGE_V,
            robot_voltage=MAIN_VOLTAGE_V,
            robot_current=0.0,
            joint_voltages=(MAIN_VOLTAGE_V,) * AXES,
            digital_out=float(robot.digital_out),
            program_state=float(robot.runtime),
            elbow_position=elbow[0],
            elbow_velocity=elbow[1],
            safety_status=float(robot.safety),
            reserved_5=_NONE,
            payload_mass=robot.payload_kg,
            payload_cog=robot.payload_cog_m,
            payload_inertia=robot.payload_inertia,
        )
    )
