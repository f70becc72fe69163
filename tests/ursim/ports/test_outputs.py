"""Outputs that the vendor knows for these versions: each is there by name and type, and tells the truth.

The names are those of `tests/resources/exhaustive_rtde_output_recipe.txt` of UniversalRobots/Universal_Robots_Client_Library,
the types those of its `tests/fake_rtde_server.cpp`, which its maintainers compare with the vendor's RTDE guide. What is
younger than 5.22 there is in `YOUNGER`. Both lists are written out: the simulator's own table is what is tried.
"""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pep.rtde.wire.codec import Recipe
from pep.rtde.wire.variables import OUTPUTS, OUTPUTS_SINCE
from tests.ursim.cell import HOME, Bench
from tests.ursim.plain import Plain
from ursim.motion.arm import Arm
from ursim.motion.dynamics import acceleration
from ursim.motion.motion import Kinetic
from ursim.motion.spatial import IDENTITY
from ursim.ports.launch import SimulatedController

from pep.rtde.wire import messages as m

ARM = Arm.load()
sixes = st.tuples(*[st.floats(-3.0, 3.0)] * 6)
VENDOR = {
    "DOUBLE": """timestamp actual_execution_time target_execution_time speed_scaling target_speed_fraction actual_momentum
        actual_main_voltage actual_robot_voltage actual_robot_current standard_analog_input0 standard_analog_input1
        standard_analog_output0 standard_analog_output1 io_current euromap67_24V_voltage euromap67_24V_current
        tool_analog_input0 tool_analog_input1 tool_output_current tool_temperature tcp_force_scalar
        joint_position_deviation_ratio collision_detection_ratio payload""",
    "VECTOR6D": """target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current
        actual_current_window joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force target_TCP_pose
        target_TCP_speed tcp_offset actual_TCP_acceleration target_TCP_acceleration joint_temperatures actual_joint_voltage
        ft_raw_wrench wrench_calc_from_currents payload_inertia target_base_acceleration""",
    "VECTOR3D": "actual_tool_accelerometer elbow_position elbow_velocity payload_cog",
    "VECTOR6INT32": "joint_mode",
    "UINT64": """actual_digital_input_bits actual_configurable_digital_input_bits actual_digital_output_bits
        actual_configurable_digital_output_bits""",
    "UINT32": """runtime_state robot_status_bits safety_status_bits analog_io_types euromap67_input_bits euromap67_output_bits
        tool_mode tool_analog_input_types script_control_line""",
    "INT32": "robot_mode safety_mode safety_status encoder0_raw encoder1_raw tool_output_voltage time_scale_source",
    "UINT8": "tool_output_mode tool_digital_output0_mode tool_digital_output1_mode",
}
YOUNGER = (
    "actual_current_as_torque", "control_step", "target_gravity", "target_base_wrench", "actual_robot_energy_consumed",
    "actual_robot_braking_energy_dissipated",
)  # fmt: skip
REGISTERS = {
    f"{way}_{name}": kind
    for way in ("input", "output")
    for name, kind in (
        ("bit_registers0_to_31", "UINT32"),
        ("bit_registers32_to_63", "UINT32"),
        *((f"bit_register_{index}", "BOOL") for index in range(64, 128)),
        *((f"int_register_{index}", "INT32") for index in range(48)),
        *((f"double_register_{index}", "DOUBLE") for index in range(48)),
    )
}
NAMED = {name: kind for kind, names in VENDOR.items() for name in names.split()}


def test_the_table_is_the_vendors():
    assert len(NAMED) == 76
    assert {name: str(kind) for name, kind in OUTPUTS.items()} == NAMED | REGISTERS
    assert set(OUTPUTS_SINCE) == set(YOUNGER)
    assert min(OUTPUTS_SINCE.values()) > 22


@pytest.mark.e2e
@pytest.mark.parametrize("version", ["5.11", "5.22"])
def test_every_output_of_the_version_and_no_younger_one(version):
    with SimulatedController.start(joints=HOME, version=version) as cell:
        with Plain(cell.host) as client:
            told = client.ask(m.AskControlVersion())
            assert f"{told.major}.{told.minor}" == version
            for name in (*YOUNGER, "no_such_output", "input_int_register_48"):
                found = client.ask(m.SetupOutputs(("timestamp", name), 500.0))
                assert found.types == ("DOUBLE", "NOT_FOUND")
                assert client.ask(m.Start()) == m.StartAnswer(False)
            for name, kind in NAMED.items():
                found = client.ask(m.SetupOutputs((name,), 500.0))
                assert (found.types, found.recipe) == ((kind,), 1), name
            names = tuple(NAMED)
            recipe = Recipe(names, client.ask(m.SetupOutputs(names, 500.0)).types)  # all at once, and read
            assert client.ask(m.Start()) == m.StartAnswer(True)
            values = client.values(recipe)
        flat = [x for value in values.values() for x in (value if isinstance(value, tuple) else (value,))]
        assert all(map(math.isfinite, flat))
        assert (values["robot_mode"], values["safety_mode"], values["actual_q"]) == (7, 1, pytest.approx(HOME))


@settings(deadline=None, max_examples=50)
@given(sixes, sixes, sixes, st.tuples(*[st.floats(-0.5, 0.5)] * 3))
def test_the_tools_acceleration_is_the_change_of_its_speed(q, qd, qdd, offset):
    """Of any motion about all axes at once, with a tool that stands off: against differences of its speed."""
    tcp, step = (offset, IDENTITY), 1e-5

    def speed(t):
        then = [a + b * t + 0.5 * c * t * t for a, b, c in zip(q, qd, qdd, strict=True)]
        rates = [b + c * t for b, c in zip(qd, qdd, strict=True)]
        return ARM.twist(ARM.frames(then), rates, tcp)

    measured = [(b - a) / (2 * step) for a, b in zip(speed(-step), speed(step), strict=True)]
    assert acceleration(ARM.frames(q), Kinetic(q, qd, qdd), tcp) == pytest.approx(measured, abs=1e-4)


def test_the_tools_acceleration_is_told_while_it_lasts():
    bench = Bench()
    radius = math.hypot(*bench.robot.tool_pose[:2])
    bench.load("def t():\n speedj([1, 0, 0, 0, 0, 0], a=2, t=2)\n stopj(2)\nend\n")
    bench.tick(100)  # about the base alone, at 2 rad/s2
    for name in ("actual_TCP_acceleration", "target_TCP_acceleration"):
        told, speed = bench.robot.read(name), bench.now.qd[0]
        assert 0.1 < speed < 1.0
        assert math.hypot(*told[:2]) == pytest.approx(radius * math.hypot(2.0, speed**2))
        assert told[2:] == pytest.approx((0.0, 0.0, 0.0, 2.0))
    bench.tick(700)
    assert bench.robot.read("actual_TCP_acceleration")[5] == 0.0  # at one speed: towards the axis alone
    assert math.hypot(*bench.robot.read("actual_TCP_acceleration")[:2]) == pytest.approx(radius)
    bench.until(lambda: bench.now.at_rest)
    assert bench.robot.read("actual_TCP_acceleration") == (0.0,) * 6


def test_configurable_outputs_are_told_by_themselves_too():
    bench = Bench()
    bench.load("def t():\n set_configurable_digital_out(3, True)\n set_standard_digital_out(1, True)\nend\n")
    bench.tick(3)
    assert bench.robot.read("actual_configurable_digital_output_bits") == 1 << 3
    assert bench.robot.read("actual_digital_output_bits") == 1 << 11 | 1 << 1
    assert bench.robot.read("actual_configurable_digital_input_bits") == 0


def test_a_wrench_that_a_client_feeds_in_is_in_no_current():
    """The force of a sensor is not felt by the joints of an arm that nothing touches."""
    bench = Bench()
    bench.load("def t():\n enable_external_ft_sensor(True, 0.1, [0, 0, 0], [0, 0, 0])\n sleep(1)\nend\n")
    bench.tick(2)
    bench.controller.write({"external_force_torque": (3.0, 4.0, 0.0, 0.1, 0.2, 0.3)})
    bench.tick()
    assert bench.robot.read("actual_TCP_force")[:2] == (3.0, 4.0)
    assert bench.robot.read("wrench_calc_from_currents") == (0.0,) * 6
    assert bench.robot.read("target_base_acceleration") == (0.0,) * 6
