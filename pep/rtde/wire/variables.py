"""The names that RTDE knows, their types, and since which PolyScope 5 minor version.

Sources: the vendor's RTDE guide, the variable table of ur_rtde 1.6.5, and the vendor's client library.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Final

REGISTERS: Final = 48  # integer and double registers each way; 0..23 shared with field buses, 24..47 for clients
FIRST_BIT, BITS = 64, 128  # bit registers that have a name each; the first 64 come as two words


class VariableType(StrEnum):
    """A type name as it stands on the wire, or one of the two refusals that stand in its place."""

    BOOL = "BOOL"
    UINT8 = "UINT8"
    UINT32 = "UINT32"
    UINT64 = "UINT64"
    INT32 = "INT32"
    DOUBLE = "DOUBLE"
    VECTOR3D = "VECTOR3D"
    VECTOR6D = "VECTOR6D"
    VECTOR6INT32 = "VECTOR6INT32"
    VECTOR6UINT32 = "VECTOR6UINT32"
    NOT_FOUND = "NOT_FOUND"
    IN_USE = "IN_USE"


T = VariableType

LAYOUT: Final = {
    T.BOOL: "?",
    T.UINT8: "B",
    T.UINT32: "I",
    T.UINT64: "Q",
    T.INT32: "i",
    T.DOUBLE: "d",
    T.VECTOR3D: "3d",
    T.VECTOR6D: "6d",
    T.VECTOR6INT32: "6i",
    T.VECTOR6UINT32: "6I",
}
WIDTH: Final = {T.VECTOR3D: 3, T.VECTOR6D: 6, T.VECTOR6INT32: 6, T.VECTOR6UINT32: 6}


def _table(*groups: tuple[VariableType, str]) -> dict[str, VariableType]:
    return {name: kind for kind, names in groups for name in names.split()}


def _registers(direction: str) -> dict[str, VariableType]:
    table = {f"{direction}_bit_registers0_to_31": T.UINT32, f"{direction}_bit_registers32_to_63": T.UINT32}
    table |= {f"{direction}_bit_register_{index}": T.BOOL for index in range(FIRST_BIT, BITS)}
    table |= {f"{direction}_int_register_{index}": T.INT32 for index in range(REGISTERS)}
    return table | {f"{direction}_double_register_{index}": T.DOUBLE for index in range(REGISTERS)}


INPUTS: Final = _table(
    (T.UINT32, "speed_slider_mask"),
    (T.DOUBLE, "speed_slider_fraction standard_analog_output_0 standard_analog_output_1"),
    (T.UINT8, "standard_digital_output_mask standard_digital_output"),
    (T.UINT8, "configurable_digital_output_mask configurable_digital_output"),
    (T.UINT8, "tool_digital_output_mask tool_digital_output"),
    (T.UINT8, "standard_analog_output_mask standard_analog_output_type"),
    (T.VECTOR6D, "external_force_torque"),
) | _registers("input")

OUTPUTS: Final = (
    _table(
        (T.DOUBLE, "timestamp actual_execution_time target_execution_time speed_scaling target_speed_fraction"),
        (T.DOUBLE, "actual_momentum actual_main_voltage actual_robot_voltage actual_robot_current tcp_force_scalar"),
        (T.DOUBLE, "collision_detection_ratio joint_position_deviation_ratio payload io_current"),
        (T.DOUBLE, "standard_analog_input0 standard_analog_input1 standard_analog_output0 standard_analog_output1"),
        (T.DOUBLE, "tool_analog_input0 tool_analog_input1 tool_output_current tool_temperature"),
        (T.DOUBLE, "euromap67_24V_voltage euromap67_24V_current"),
        (T.VECTOR6D, "target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current"),
        (T.VECTOR6D, "actual_current_window joint_control_output joint_temperatures actual_joint_voltage"),
        (T.VECTOR6D, "actual_TCP_pose target_TCP_pose actual_TCP_speed target_TCP_speed actual_TCP_force"),
        (T.VECTOR6D, "ft_raw_wrench wrench_calc_from_currents payload_inertia tcp_offset"),
        (T.VECTOR6D, "actual_TCP_acceleration target_TCP_acceleration target_base_acceleration"),
        (T.VECTOR6INT32, "joint_mode"),
        (T.VECTOR3D, "actual_tool_accelerometer elbow_position elbow_velocity payload_cog"),
        (T.UINT64, "actual_digital_input_bits actual_digital_output_bits"),
        (T.UINT64, "actual_configurable_digital_input_bits actual_configurable_digital_output_bits"),
        (T.UINT32, "runtime_state robot_status_bits safety_status_bits analog_io_types tool_mode"),
        (T.UINT32, "tool_analog_input_types script_control_line euromap67_input_bits euromap67_output_bits"),
        (T.INT32, "robot_mode safety_mode safety_status tool_output_voltage encoder0_raw encoder1_raw"),
        (T.INT32, "time_scale_source"),
        (T.UINT8, "tool_output_mode tool_digital_output0_mode tool_digital_output1_mode"),
    )
    | _registers("output")
    | _registers("input")
)

# Output names younger than PolyScope 5.11; an older controller answers NOT_FOUND. The first four are in the tests of
# the vendor's client library, the first in ur_rtde too; of the last two only that they are younger than 5.22 is known.
OUTPUTS_SINCE: Final[dict[str, int]] = {
    "actual_current_as_torque": 23,
    "control_step": 26,
    "target_gravity": 26,
    "target_base_wrench": 26,
    "actual_robot_energy_consumed": 23,
    "actual_robot_braking_energy_dissipated": 23,
}
