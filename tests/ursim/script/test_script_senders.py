"""Programs that clients of the script ports send, word for word, and their reading of the answers.

The lines are those of urx 0.11.0 (`urrobot.py`, `ursecmon.py`), UR_py_ctl 0.1.7 (`urscript_commands.py`) and
ursocket 0.2 (`UR.py`), for which no package is needed here. The functions among them that the vendor's script manual
calls deprecated are still there in PolyScope 5.
"""

import math
import socket
import struct

import pytest
from tests.ursim.cell import HOME, TICK_S, Bench
from ursim.motion.arm import Arm
from ursim.motion.motion import ZERO, Kinetic
from ursim.motion.spatial import IDENTITY, compose, from_vector, to_frame, to_vector, transpose
from ursim.ports.launch import SimulatedController
from ursim.ports.script_ports import compile_text
from ursim.script.compiler import CompileError, CompileFault

ARM = Arm.load()
FLANGE = ((0.0, 0.0, 0.0), IDENTITY)


def run(text, bench=None):
    """The bench after a program, which did not fail."""
    bench = bench or Bench()
    assert bench.load(text) is None
    bench.until(lambda: [event for event, _ in bench.events][-1:] == ["STOPPED"])
    assert bench.exceptions == []
    bench.events.clear()
    return bench


def fails(text):
    bench = Bench()
    bench.load(text)
    bench.until(lambda: [event for event, _ in bench.events][-1:] == ["STOPPED"])
    return len(bench.exceptions) == 1


# ------------------------------------------------------------------------------------------------- inputs and outputs


@pytest.mark.parametrize(("number", "bit"), [(0, 0), (7, 7), (8, 16), (9, 17)])
@pytest.mark.parametrize("words", ["digital_out[{}]={}", "set_digital_out({}, {})"])
def test_the_older_outputs_are_eight_standard_ones_and_two_of_the_tool(words, number, bit):
    bench = run(words.format(number, "True") + "\n")
    assert bench.robot.read("actual_digital_output_bits") == 1 << bit
    run(words.format(number, "False") + "\n", bench)
    assert bench.robot.read("actual_digital_output_bits") == 0


@pytest.mark.parametrize("text", ["digital_out[10]=True\n", "digital_out[-1]=True\n", "set_digital_out(10, True)\n"])
def test_there_is_no_eleventh(text):
    assert fails(text)


def test_a_variable_of_that_name_is_the_programs_own():
    bench = run(
        "def own():\n digital_out=[1, 2]\n digital_out[0]=5\n write_output_integer_register(0, digital_out[0])\nend\n"
    )
    assert bench.out(0) == 5
    assert bench.robot.read("actual_digital_output_bits") == 0


def test_a_digital_output_is_read_where_it_was_set():
    bench = run(
        "def p():\n set_standard_digital_out(1, True)\n set_configurable_digital_out(2, True)\n"
        " set_tool_digital_out(1, True)\n a = 0\n"
        " if get_standard_digital_out(1) and get_digital_out(1) and get_configurable_digital_out(2):\n  a = a + 1\n end\n"
        " if get_tool_digital_out(1) and get_digital_out(9) and digital_out[9]:\n  a = a + 2\n end\n"
        " if get_standard_digital_out(2) or get_tool_digital_out(0) or get_digital_out(8):\n  a = a + 4\n end\n"
        " write_output_integer_register(0, a)\nend\n"
    )
    assert bench.out(0) == 3


def test_nothing_is_wired_to_the_inputs():
    bench = run(
        "def p():\n a = 0\n if get_digital_in(9) or get_standard_digital_in(7) or get_configurable_digital_in(0):\n"
        "  a = 1\n end\n if get_tool_digital_in(1):\n  a = 2\n end\n"
        " write_output_float_register(0, get_analog_in(3)+get_standard_analog_in(1)+get_tool_analog_in(1))\n"
        " write_output_integer_register(0, a + 10)\nend\n"
    )
    assert bench.out(0) == 10
    assert bench.robot.values["output_double_register_0"] == 0.0


@pytest.mark.parametrize("name", ["set_analog_out", "set_standard_analog_out"])
def test_an_analog_output_is_a_share_of_its_range(name):
    bench = run(f"def p():\n {name}(0, 0.5)\n set_analog_outputdomain(1, 0)\n {name}(1, 1)\nend\n")
    assert bench.robot.read("standard_analog_output0") == 5.0
    assert bench.robot.read("standard_analog_output1") == 0.020
    assert bench.robot.read("analog_io_types") == 1 << 2
    bench = run("write_output_float_register(0, get_standard_analog_out(0) + get_analog_out(1))\n", bench)
    assert bench.robot.values["output_double_register_0"] == 1.5


@pytest.mark.parametrize("text", ["set_analog_out(2, 0.5)\n", "set_analog_out(0, 1.01)\n", "set_tool_voltage(5)\n"])
def test_what_an_output_cannot_be_ends_the_program(text):
    assert fails(text)


def test_the_tool_has_the_voltage_asked_for():
    assert run("set_tool_voltage(24)\n").robot.read("tool_output_voltage") == 24


# ------------------------------------------------------------------------------------------------------------- motion


def seen(bench, text):
    """The tool's positions at every tick of a program, and the bench after it."""
    assert bench.load(text) is None
    there = []
    bench.until(lambda: there.append(bench.robot.tool) or "STOPPED" in [event for event, _ in bench.events])
    assert bench.exceptions == []
    bench.events.clear()
    return there


def arc(bench, mode=0):
    """A quarter of a circle of 5 cm in the plane of x and z, and its centre."""
    (x, y, z), rotation = bench.robot.tool
    centre = (x + 0.05, y, z)
    half = math.sqrt(0.5) * 0.05
    turn = to_vector(rotation)
    via = f"p{[x + 0.05 - half, y, z - half, *turn]}"
    to = f"p{[x + 0.05, y, z - 0.05, *turn]}"
    return f"movec({via}, {to}, a=1, v=0.1, r=0" + (f", mode={mode})\n" if mode else ")\n"), centre


def test_movec_goes_round_through_the_way_point():
    bench = Bench()
    text, centre = arc(bench)
    start = bench.robot.tool
    there = seen(bench, text)
    assert all(math.dist(position, centre) == pytest.approx(0.05, abs=1e-8) for position, _ in there)
    assert there[-1][0] == pytest.approx((centre[0], centre[1], centre[2] - 0.05), abs=1e-8)
    assert there[-1][1] == pytest.approx(start[1], abs=1e-8)
    assert bench.now.at_rest
    # The arc's length at 0.1 m/s, and a tenth of a second for the two ramps.
    assert len(there) * TICK_S == pytest.approx(0.05 * math.pi / 2 / 0.1 + 0.1, abs=0.02)


def test_movec_in_fixed_mode_keeps_the_tool_to_the_tangent():
    bench = Bench()
    text, _ = arc(bench, mode=1)
    start = bench.robot.tool[1]
    end = seen(bench, text)[-1][1]
    turned = to_vector(compose(end, transpose(start)))
    assert turned == pytest.approx((0.0, -math.pi / 2, 0.0), abs=1e-8)


def test_movec_takes_joint_angles_too():
    bench = Bench()
    via, to = ARM.tool((0.1, *HOME[1:]), FLANGE)[0], ARM.tool((0.2, *HOME[1:]), FLANGE)[0]
    there = seen(bench, f"movec({[0.1, *HOME[1:]]}, {[0.2, *HOME[1:]]}, a=1, v=0.2)\n")
    assert min(math.dist(position, via) for position, _ in there) < 5e-4
    assert there[-1][0] == pytest.approx(to, abs=1e-8)


@pytest.mark.parametrize("mode", [0, 1])
def test_a_paused_arc_goes_on_along_the_same_circle(mode):
    bench = Bench()
    text, centre = arc(bench, mode)
    end = seen(Bench(), text)[-1]
    assert bench.load(text) is None
    bench.until(lambda: bench.robot.tool[0][2] < centre[2] - 0.045)  # past the way point
    assert bench.controller.pause()
    bench.until(lambda: not bench.robot.drive.moving)
    assert bench.controller.play()
    places = []
    bench.until(lambda: places.append(bench.robot.tool[0]) or "STOPPED" in [event for event, _ in bench.events])
    assert bench.exceptions == []
    assert bench.robot.alarm is None
    assert max(abs(math.dist(position, centre) - 0.05) for position in places) < 1e-3  # it braked beside the circle
    assert max(map(math.dist, places, places[1:])) < 1.01 * 0.1 * TICK_S
    assert bench.robot.tool[0] == pytest.approx(end[0], abs=1e-8)
    assert bench.robot.tool[1] == pytest.approx(end[1], abs=1e-8)


def test_movep_ends_at_its_pose():
    bench = Bench()
    x, y, z, *turn = bench.robot.tool_pose
    there = seen(bench, f"movep(p{[x, y, z + 0.01, *turn]}, a=1, v=0.1, r=0)\n")
    assert there[-1][0] == pytest.approx((x, y, z + 0.01), abs=1e-8)
    assert all(position[:2] == pytest.approx((x, y), abs=1e-8) for position, _ in there)
    assert bench.now == Kinetic(bench.now.q, ZERO, ZERO)


def test_speedl_with_the_parameter_of_older_controllers_is_refused():
    """As PolyScope 5 does: `speedl() got an unexpected keyword argument 't_min'`, in python-urx issue 91."""
    with pytest.raises(CompileError) as caught:
        compile_text("speedl([0.0,0.0,0.05,0.0,0.0,0.0], a=1, t_min=1.0)\n")
    assert caught.value.code is CompileFault.ARGUMENTS


# --------------------------------------------------------------------------------------------------- settings, numbers


def test_payload_is_set_in_parts():
    bench = run("def p():\n set_payload(0.5, [0, 0, 0.05])\n set_payload_mass(1.5)\nend\n")
    assert bench.robot.read("payload") == 1.5
    assert bench.robot.read("payload_cog") == (0.0, 0.0, 0.05)
    run("set_payload_cog([0.01, 0, 0])\n", bench)
    assert bench.robot.read("payload") == 1.5
    assert bench.robot.read("payload_cog") == (0.01, 0.0, 0.0)


def test_a_popup_that_nobody_has_to_answer_holds_nothing_up():
    run('def p():\n  popup("hi")\n  popup("hi", title="T", warning=True, error=False)\nend\n')


def test_a_blocking_popup_waits_for_a_person_who_is_not_there():
    bench = Bench()
    bench.load('popup("hi", blocking=True)\n')
    bench.tick(1000)
    assert bench.events == [("STARTED", "unnamed")]
    bench.controller.stop()
    bench.until(lambda: bench.events[-1] == ("STOPPED", "unnamed"))


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("acos(0.5)", math.acos(0.5)),
        ("asin(0.5)", math.asin(0.5)),
        ("atan(2)", math.atan(2)),
        ("pow(2, 10)", 1024.0),
        ("log(2, 8)", 3.0),
        ("point_dist(p[1,0,0,0,0,0], p[1,3,4,2,0,0])", 5.0),
        ("interpolate_pose(p[0,0,0,0,0,0], p[0.2,0.4,0.6,0.8,0,0], 0.25)[3]", 0.2),
        ("interpolate_pose(p[0,0,0,0,0,0], p[0.2,0.4,0.6,0.8,0,0], 0.25)[1]", 0.1),
        ("rpy2rotvec([0, 0.5, 0])[1]", 0.5),
        ("rotvec2rpy([0, 0, 0.5])[2]", 0.5),
        ("get_controller_temp() - get_joint_temp(0)", 0.0),
    ],
)
def test_what_is_computed(expression, value):
    bench = run(f"write_output_float_register(0, {expression})\n")
    assert bench.robot.values["output_double_register_0"] == pytest.approx(value, abs=1e-12)


@pytest.mark.parametrize("expression", ["acos(2)", "asin(-2)", "log(0, 2)", "pow(10, 400)", "get_joint_temp(6)"])
def test_what_has_no_value_ends_the_program(expression):
    assert fails(f"write_output_float_register(0, {expression})\n")


def test_angles_come_back_from_a_rotation_vector():
    angles = (0.3, -0.7, 1.1)
    bench = run(
        f"def p():\n v = rotvec2rpy(rpy2rotvec({list(angles)}))\n"
        + "".join(f" write_output_float_register({i}, v[{i}])\n" for i in range(3))
        + "end\n"
    )
    assert [bench.robot.values[f"output_double_register_{i}"] for i in range(3)] == pytest.approx(angles)
    # R = Rz(yaw) Ry(pitch) Rx(roll), as the vendor's manual says.
    about = [from_vector(tuple(a if i == axis else 0.0 for i in range(3))) for axis, a in enumerate(angles)]
    run(f"set_tcp(p[0,0,0,{','.join(map(repr, to_vector(compose(about[2], compose(about[1], about[0])))))}])\n", bench)
    assert to_frame(bench.robot.read("tcp_offset"))[1] == pytest.approx(
        to_frame((0, 0, 0, *to_vector(compose(about[2], compose(about[1], about[0])))))[1]
    )


# ------------------------------------------------------------------------------------------------- the secondary port


@pytest.mark.e2e
@pytest.mark.parametrize("version", ["5.11", "5.22"])
def test_urx_finds_its_state_behind_the_greeting_and_its_output_in_it(version):
    """Its way of reading: byte by byte to the first thing like a state below 2000 bytes.

    It reads in pieces of 1024.
    """
    with (
        SimulatedController.start(joints=HOME, version=version) as cell,
        socket.create_connection((cell.host, 30002), 5) as port,
    ):
        held, deadline = b"", 200

        def state():
            nonlocal held
            for _ in range(deadline):
                while len(held) >= 5:
                    size, kind = struct.unpack_from(">iB", held)
                    if not 5 <= size <= 2000 or kind != 16:
                        held = held[1:]
                    elif len(held) < size:
                        break
                    else:
                        parts, held = held[5:size], held[size:]
                        return parts
                held += port.recv(1024)
            raise AssertionError("no state")

        def parts():
            rest, found = state(), {}
            while rest:
                size, kind = struct.unpack_from(">iB", rest)
                found[kind], rest = rest[:size], rest[size:]
            return found

        first = parts()
        assert len(first[0]) == 47
        assert struct.unpack_from(">7?B", first[0], 13) == (True, True, True, False, False, False, False, 7)
        port.sendall(b"digital_out[2]=True\n")
        assert any(struct.unpack_from(">i", parts()[3], 9)[0] == 1 << 2 for _ in range(20))
        port.sendall(b"set_tool_voltage(12)\n")
        assert any(struct.unpack_from(">bbddfB", parts()[2], 5)[5] == 12 for _ in range(20))
        port.sendall(b"movej([0.3,-1.5708,1.5708,-1.5708,-1.5708,0], a=2, v=1, r=0)\n")
        assert any(struct.unpack_from(">d", parts()[1], 5)[0] == pytest.approx(0.3) for _ in range(50))


@pytest.mark.e2e
def test_the_gripper_acknowledges_with_three_bytes():
    """The URCap's preamble reads exactly three, and the Python clients of the gripper compare with exactly `ack`."""
    with SimulatedController.start(joints=HOME) as cell, socket.create_connection((cell.host, 63352), 5) as gripper:
        for _ in range(3):
            gripper.sendall(b"SET ACT 0 ATR 0\n")
            assert gripper.recv(1024) == b"ack"
        gripper.sendall(b"GET STA\n")
        assert gripper.recv(1024).split() == [b"STA", b"0"]
