"""The frames of the real-time interface (30003, 30013): `int32 length` and doubles, strict and without IO.

Layout: the vendor's real-time interface 5.10, which current e-Series controllers send.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import ClassVar, Final

from pep.rtde.wire.layouts import Record, Vector

REALTIME_SIZE: Final = 1220  # bytes of a frame, its length included


@dataclass(frozen=True, slots=True)
class RealtimeState(Record):
    """State that 30003 and 30013 send every two milliseconds: doubles alone, bits as numbers."""

    LAYOUT: ClassVar[str] = (
        "d 6d 6d 6d 6d 6d 6d 6d 6d 6d 6d 6d 6d 6d 6d d 6d d d d 6d d 6d 3d 6d d d d d d d d 6d d d 3d 3d d 3d d 3d 6d"
    )

    time_s: float
    q_target: Vector
    qd_target: Vector
    qdd_target: Vector
    current_target: Vector
    moment_target: Vector
    q: Vector
    qd: Vector
    current: Vector
    current_control: Vector
    tool_pose: Vector
    tool_speed: Vector
    tool_force: Vector
    tool_pose_target: Vector
    tool_speed_target: Vector
    digital_in: float
    motor_temperatures: Vector
    controller_time: float
    test_value: float
    robot_mode: float
    joint_modes: Vector
    safety_mode: float
    reserved: Vector
    tool_acceleration: Vector
    reserved_2: Vector
    speed_scaling: float
    momentum: float
    reserved_3: float
    reserved_4: float
    main_voltage: float
    robot_voltage: float
    robot_current: float
    joint_voltages: Vector
    digital_out: float
    program_state: float
    elbow_position: Vector
    elbow_velocity: Vector
    safety_status: float
    reserved_5: Vector
    payload_mass: float
    payload_cog: Vector
    payload_inertia: Vector


def encode_realtime(state: RealtimeState) -> bytes:
    """The bytes of a state, its length first."""
    return struct.pack(">i", REALTIME_SIZE) + state.pack()
