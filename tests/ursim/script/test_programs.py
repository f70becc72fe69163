"""Programs on the controller, tick by tick, without a socket or a clock: the real upload, and bad programs."""

import pytest
from tests.ursim.cell import HOME, TICK_S, Bench, upload
from ursim.motion.robot import RobotMode, RuntimeState, SafetyMode
from ursim.ports.script_ports import compile_text
from ursim.script.compiler import CompileError, CompileFault


def ur_rtde(offset=0, path=(), **options):
    bench = Bench(**options)
    bench.load(upload(offset=offset, path=path))
    bench.until(lambda: bench.robot.values[f"output_int_register_{offset}"] == 1)
    return bench


def command(bench, number, doubles=(), integers=(), offset=0):
    """Writes the registers of one command as ur_rtde does."""
    values = {f"input_double_register_{offset + i}": float(x) for i, x in enumerate(doubles)}
    values |= {f"input_int_register_{offset + i + 1}": x for i, x in enumerate(integers)}
    bench.controller.write({f"input_int_register_{offset}": number, **values})


def finish(bench, offset=0):
    done = bench.until(lambda: bench.robot.values[f"output_int_register_{offset}"] == 2)
    command(bench, 0, offset=offset)
    bench.until(lambda: bench.robot.values[f"output_int_register_{offset}"] == 1)
    return done


TARGET = (0.5, *HOME[1:])


@pytest.mark.parametrize("offset", [0, 24])
def test_the_uploaded_script_moves_the_arm_in_the_time_of_its_trapezoid(offset):
    bench = ur_rtde(offset)
    command(bench, 1, [*TARGET, 1.0, 2.0], [0], offset)
    ticks = finish(bench, offset)
    assert bench.now.q == TARGET
    assert ticks * TICK_S == pytest.approx(0.5 / 1.0 + 1.0 / 2.0, abs=3 * TICK_S)
    assert bench.exceptions == []


def test_an_async_move_reports_its_progress_and_stopj_brakes_it():
    bench = ur_rtde()
    command(bench, 1, [*TARGET, 1.0, 4.0], [1])
    assert finish(bench) < 5
    assert bench.out(2) & 1 << 15
    bench.tick(200)
    assert bench.now.qd[0] == pytest.approx(1.0)
    at = bench.now.q[0]
    command(bench, 34, [3.0], [0])
    ticks = finish(bench)
    assert not bench.out(2) & 1 << 15
    assert bench.now.at_rest
    assert ticks * TICK_S == pytest.approx(1.0 / 3.0, abs=3 * TICK_S)
    assert bench.now.q[0] - at == pytest.approx(1.0 / 6.0, abs=3 * TICK_S)


def test_the_arm_keeps_moving_while_its_command_register_stays():
    bench = ur_rtde()
    command(bench, 9, [0.3, 0, 0, 0, 0, 0, 1.0, 0.0])
    bench.tick(2000)  # four seconds in which nobody writes anything
    assert bench.now.qd[0] == pytest.approx(0.3)
    command(bench, 15, [2.0])
    finish(bench)
    assert bench.now.at_rest
    assert bench.robot.runtime is RuntimeState.PLAYING


def test_another_motion_beside_a_running_speed_thread_ends_the_program_and_the_arm_brakes():
    bench = ur_rtde()
    command(bench, 9, [1.0, 0, 0, 0, 0, 0, 8.0, 0.0])
    bench.tick(200)
    command(bench, 34, [0.1], [0])
    at = bench.now.q[0]
    bench.until(lambda: bench.robot.runtime is RuntimeState.STOPPED)
    assert bench.now.at_rest
    assert bench.now.q[0] - at < 1.0 / 16 + 2 * TICK_S
    assert len(bench.exceptions) == 1


def test_the_watchdog_stops_the_program_when_its_register_is_not_written():
    bench = ur_rtde()
    command(bench, 35, [10.0])
    finish(bench)
    for _ in range(20):  # kicked every 60 ms, faster than 10 Hz
        bench.tick(30)
        command(bench, 0)
    assert bench.robot.runtime is RuntimeState.PLAYING
    command(bench, 9, [1.0, 0, 0, 0, 0, 0, 8.0, 0.0])
    ticks = bench.until(lambda: bench.robot.runtime is not RuntimeState.PLAYING)
    assert 50 <= ticks <= 53
    bench.until(lambda: bench.robot.runtime is RuntimeState.STOPPED)
    assert bench.now.at_rest


def test_a_path_goes_through_its_waypoints():
    path = [f"movej([{x},-1.5708,1.5708,-1.5708,-1.5708,0],a=4,v=2,r=0)" for x in (0.2, -0.1)]
    bench = ur_rtde(path=path)
    command(bench, 45, [], [0])
    reached = [0.0]
    while bench.out(0) != 2:
        bench.tick()
        reached.append(bench.now.q[0])
    assert max(reached) == pytest.approx(0.2)
    assert bench.now.q[0] == pytest.approx(-0.1)


def test_nan_in_a_path_does_not_load():
    with pytest.raises(CompileError) as caught:
        compile_text(upload(path=["movej([nan,0,0,0,0,0],a=1,v=1,r=0)"]))
    assert caught.value.code is CompileFault.VARIABLE_UNKNOWN


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1e308])
def test_a_target_that_is_no_place_moves_nothing(bad):
    bench = ur_rtde()
    command(bench, 1, [bad, *HOME[1:], 1.0, 1.0], [0])
    bench.tick(50)
    assert bench.now.q == HOME
    stopped = bench.robot.runtime is RuntimeState.STOPPED or bench.robot.safety is SafetyMode.PROTECTIVE_STOP
    assert stopped


def test_a_protective_stop_pauses_and_play_goes_on_after_the_unlock():
    bench = ur_rtde()
    command(bench, 1, [*TARGET, 1.0, 4.0], [0])
    bench.tick(200)
    bench.robot.alarm = "a person says so"
    at = bench.now.q[0]
    bench.until(lambda: bench.robot.runtime is RuntimeState.PAUSED)
    assert bench.now.q[0] - at == pytest.approx(1 / 16, abs=2 * TICK_S)
    assert bench.robot.read("safety_status_bits") & 1 << 2
    controller = bench.controller
    assert not controller.unlock_protective_stop()
    assert not controller.play()
    assert controller.load(compile_text("movej([0,0,0,0,0,0])\n")) is not None
    bench.tick(2501)
    assert controller.unlock_protective_stop()
    assert controller.play()
    finish(bench)
    assert bench.now.q == TARGET


def test_stopping_a_program_brakes_finitely_and_the_next_one_waits_for_that():
    bench = Bench()
    bench.load("movej([3,-1.5708,1.5708,-1.5708,-1.5708,0], a=8, v=2)\n")
    bench.tick(300)
    at = bench.now.q[0]
    bench.load("def next():\n movej([0,-1.5708,1.5708,-1.5708,-1.5708,0])\nend\n")
    assert bench.robot.runtime is RuntimeState.STOPPING
    bench.until(lambda: bench.robot.runtime is RuntimeState.PLAYING)
    assert bench.now.at_rest
    assert bench.now.q[0] - at == pytest.approx(2.0**2 / 16, abs=1e-6)
    assert bench.controller.program_name == "next"


def test_power_off_brakes_first_and_power_comes_back_in_steps():
    bench = Bench()
    bench.load("movej([3,-1.5708,1.5708,-1.5708,-1.5708,0], a=8, v=2)\n")
    bench.tick(300)
    bench.controller.power_off()
    bench.tick()
    assert bench.robot.mode is RobotMode.RUNNING  # still braking
    bench.until(lambda: bench.robot.mode is RobotMode.POWER_OFF)
    assert bench.now.at_rest
    assert bench.load("sync()\n") is not None
    bench.controller.brake_release()
    bench.until(lambda: bench.robot.mode is RobotMode.RUNNING)
    assert bench.load("sync()\n") is None


def test_an_emergency_stop_ends_the_program_and_takes_the_power():
    bench = ur_rtde()
    command(bench, 1, [*TARGET, 1.0, 4.0], [0])
    bench.tick(200)
    at = bench.now.q[0]
    bench.controller.emergency_stop()
    bench.until(lambda: bench.robot.mode is RobotMode.POWER_OFF)
    assert bench.now.q[0] - at == pytest.approx(1 / 16, abs=2 * TICK_S)
    assert bench.robot.read("safety_status_bits") & (1 << 6 | 1 << 7)
    bench.controller.brake_release()
    bench.tick(2000)
    assert bench.robot.mode is RobotMode.POWER_OFF
    bench.controller.release_emergency_stop()
    bench.controller.brake_release()
    bench.until(lambda: bench.robot.mode is RobotMode.RUNNING)
    assert bench.robot.runtime is RuntimeState.STOPPED


def register(bench, text, ticks=20):
    bench.load(f"def t():\n{text}\nend\n")
    bench.tick(ticks)
    return bench.out(0)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a = [1, 2]\nb = a\nb[0] = 9\nwrite_output_integer_register(0, a[0])", 1),
        ("def f(x):\nx[0] = 9\nend\na = [1]\nf(a)\nwrite_output_integer_register(0, a[0])", 1),
        ("def f(n=3):\nreturn n + 1\nend\nwrite_output_integer_register(0, f() * f(n=1))", 8),
        ("def f():\ng = 5\nend\ng = 1\nf()\nwrite_output_integer_register(0, g)", 5),
        ("def f():\nlocal h = 5\nend\nh = 1\nf()\nwrite_output_integer_register(0, h)", 1),
        ("x = 0\nwhile True:\nx = x + 1\nif x == 7:\nbreak\nend\nend\nwrite_output_integer_register(0, x)", 7),
        ("thread t1():\nsync()\ny = 4\nend\ny = 0\nh = run t1()\njoin h\nwrite_output_integer_register(0, y)", 4),
        (
            "thread t1():\nz = 4\nend\nz = 0\nh = run t1()\nkill h\nsync()\nsync()\nwrite_output_integer_register(0, z)",
            0,
        ),
        ("write_output_integer_register(0, floor(norm(p[3, 4, 0, 0, 0, 0]) + 0.5))", 5),
        ("if True xor True or not False and 2 ^ 3 == 8:\nwrite_output_integer_register(0, 6)\nend", 6),
        ("q = pose_trans(p[1, 0, 0, 0, 0, 0], p[2, 0, 0, 0, 0, 0])\nwrite_output_integer_register(0, floor(q[0]))", 3),
        ("write_output_integer_register(value=2, address=0)", 2),
    ],
)
def test_what_programs_mean(text, value):
    bench = Bench()
    assert register(bench, text) == value
    assert bench.exceptions == []


def test_a_critical_section_lasts_until_something_takes_time():
    """The vendor's script manual, Threads: another thread may run while a command in it takes time."""
    bench = Bench()
    text = "n = 0\nthread t1():\nwhile True:\nn = n + 1\nsync()\nend\nend\nh = run t1()\nenter_critical\n"
    count = "i = 0\nwhile i < 1000:\ni = i + 1\nend\nwrite_output_integer_register(0, n + 1)\n"
    assert register(bench, text + count + "exit_critical\nsleep(1)", 3) == 1
    assert register(bench, text + "sleep(0.1)\nwrite_output_integer_register(0, n)\nexit_critical\nsleep(1)", 60) > 40


def test_a_thread_that_ends_inside_a_critical_section_blocks_nobody():
    text = "thread t1():\nenter_critical\nend\nh = run t1()\nsync()\nsync()\nwrite_output_integer_register(0, 3)"
    assert register(Bench(), text) == 3


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("x = 1\nwhile True:\nx = 2\nend", 3),
        ("def f():\nreturn f()\nend\nf()", None),
        ("x = [1]\ny = x[1]", 3),
        ("x = [1]\ny = x[-1]", 3),
        ("if False:\nx = 1\nend\ny = x", 5),
        ("x = 1 / 0", 2),
        ("x = 2000000000\nx = x * x", 3),
        ('s = "ab"\nwhile True:\ns = str_cat(s, s)\nend', 4),
        ("movej([0, 0, 0])", 2),
        ("movej([0, 0, 0, 0, 0, 0], v=0)", 2),
        ("stopj(-1)", 2),
        ("write_output_integer_register(48, 1)", 2),
        ("write_output_integer_register(0, 1.5)", 2),
        ("force_mode(p[0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0], 4, [0, 0, 0, 0, 0, 0])", 2),
        ("thread t1():\nwhile True:\nsync()\nend\nend\nwhile True:\nh = run t1()\nend", 8),
    ],
)
def test_a_bad_program_ends_alone(text, line):
    bench = Bench()
    register(bench, text)
    assert bench.robot.runtime is RuntimeState.STOPPED
    ((at, _),) = bench.exceptions
    assert line is None or at == line
    assert register(bench, "write_output_integer_register(0, 77)") == 77


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("def t():\nno_such_thing()\nend\n", CompileFault.FUNCTION_UNKNOWN),
        ("def t():\nrun sync()\nend\n", CompileFault.FUNCTION_UNKNOWN),
        ("def t():\nx = y\nend\n", CompileFault.VARIABLE_UNKNOWN),
        ("def t():\nmovej()\nend\n", CompileFault.ARGUMENTS),
        ("def t():\nmovej([0], b=1)\nend\n", CompileFault.ARGUMENTS),
        ("def t():\nsync(1)\nend\n", CompileFault.ARGUMENTS),
        ("def t():\ndef movej():\nend\nend\n", CompileFault.DEFINED_TWICE),
        ("def t():\nbreak\nend\n", CompileFault.PLACE),
        ("thread t():\nend\n", CompileFault.PLACE),
        ("def t(a):\nend\n", CompileFault.PLACE),
        ("def t():\nsec s():\nend\nend\n", CompileFault.PLACE),
    ],
)
def test_what_does_not_load(text, code):
    with pytest.raises(CompileError) as caught:
        compile_text(text)
    assert caught.value.code is code


def test_words_of_a_program_never_become_code():
    bench = Bench()
    hostile = "__import__ = 1\nclass_ = 2\nimport = 3\nx = '\\'\nG = 4\nR = 5\nwrite_output_integer_register(0, G + R)"
    assert register(bench, hostile) == 9
    with pytest.raises(CompileError):
        compile_text("def t():\n__import__('os')\nend\n")


def test_a_secondary_program_runs_beside_the_primary_one():
    bench = ur_rtde()
    bench.load("sec s():\nset_standard_digital_out(3, True)\nend\n")
    bench.tick()
    assert bench.robot.read("actual_digital_output_bits") == 8
    assert bench.robot.runtime is RuntimeState.PLAYING
    bench.load("sec s():\nsleep(1)\nend\n")
    assert len(bench.exceptions) == 1
    assert bench.robot.runtime is RuntimeState.PLAYING


def test_unmasked_and_impossible_inputs_change_nothing():
    bench = Bench()
    bench.controller.write(
        {
            "speed_slider_mask": 1,
            "speed_slider_fraction": float("nan"),
            "standard_analog_output_mask": 1,
            "standard_analog_output_type": 0,
            "standard_analog_output_0": 0.5,
            "standard_analog_output_1": float("nan"),
        }
    )
    bench.tick()
    assert bench.robot.drive.slider == 1.0
    assert bench.robot.read("standard_analog_output0") == 0.010  # half of 20 mA
    assert bench.robot.read("standard_analog_output1") == 0.0
