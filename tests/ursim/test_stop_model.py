"""The one stop model: how the simulated arm stands still, measured against what the cell's parameters promise."""

import pytest
from tests.ursim.cell import HOME, TICK_S
from tests.ursim.script.test_programs import command, finish, ur_rtde
from ursim.__main__ import _parser
from ursim.ports.launch import SimulatedController
from ursim.ports.server import Settings

from pep.pit import CellParameters

MODEL = CellParameters()
SPEEDS = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0)
MOVE_J, STOP_J = 1, 15  # ur_rtde's commands


def by_command(bench, deceleration):
    command(bench, STOP_J, [deceleration])


def by_ending_the_program(bench, deceleration):
    assert bench.robot.drive.stop_deceleration_rad_s2 == deceleration
    bench.controller.stop()


def stopped(stop, speed, deceleration):
    """Seconds and radians until an arm at `speed` stands still."""
    bench = ur_rtde(stop_deceleration=deceleration)
    command(bench, MOVE_J, (6.0, *HOME[1:], speed, 20.0), [1])
    finish(bench)
    bench.until(lambda: bench.now.qd[0] >= speed - 1e-9)
    began = bench.now.q[0]
    stop(bench, deceleration)
    ticks = bench.until(lambda: bench.now.at_rest)
    assert bench.now.q[0] < 6.0
    return ticks * TICK_S, bench.now.q[0] - began


@pytest.mark.parametrize("speed", SPEEDS)
@pytest.mark.parametrize("stop", [by_command, by_ending_the_program])
def test_every_stop_is_within_the_model(stop, speed):
    a, delay = MODEL.stop_deceleration_rad_s2, MODEL.stop_delay_s
    took_s, way_rad = stopped(stop, speed, a)
    assert took_s <= delay + speed / a
    assert way_rad <= speed * (delay + speed / (2 * a))


@pytest.mark.parametrize("stop", [by_command, by_ending_the_program])
def test_a_weaker_stop_is_not(stop):
    took_s, way_rad = stopped(stop, 3.0, MODEL.stop_deceleration_rad_s2 / 2)
    assert took_s > MODEL.stop_delay_s + 3.0 / MODEL.stop_deceleration_rad_s2
    assert way_rad > 3.0 * (MODEL.stop_delay_s + 3.0 / (2 * MODEL.stop_deceleration_rad_s2))


def test_the_simulator_stops_by_itself_as_the_model_says():
    asked = _parser().parse_args(["--host", "127.0.0.1"])
    launched = SimulatedController.start.__func__.__kwdefaults__
    assert {
        asked.stop_deceleration,
        Settings("127.0.0.1").stop_deceleration_rad_s2,
        launched["stop_deceleration_rad_s2"],
    } == {MODEL.stop_deceleration_rad_s2}
