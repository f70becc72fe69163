"""The compiled recursion of Newton and Euler beside pinocchio's."""

import numpy as np
import pinocchio
import pytest
from pep.pit.search.kernel.arithmetic.joint_torques import masses_of, torques
from pep.pit.search.torques import Torques, carried_kg
from tests.model.pit.torques import by_pinocchio
from tests.pep.pit.scenes import CELL, ROBOT

from pep.pit import Robot

NEAR = 1e-9


@pytest.mark.parametrize("tool", ["robotiq_2f85", "robotiq_hande"])
@pytest.mark.parametrize("carried_kg", [0.0, 2.0])
def test_torques_are_those_of_pinocchio(tool, carried_kg):
    rng = np.random.default_rng(12)
    model = pinocchio.Model(Robot.load("ur3e", tool=tool).pinocchio)
    model.inertias[6] += pinocchio.Inertia(carried_kg, np.array([0.03, -0.02, 0.16]), np.eye(3) * 1e-3 * carried_kg)
    q, dq, ddq = rng.uniform(-6, 6, (200, 6)), rng.uniform(-4, 4, (200, 6)), rng.uniform(-9, 9, (200, 6))
    for ours, theirs in zip(torques(masses_of(model), q, dq, ddq), by_pinocchio(model, q, dq, ddq), strict=True):
        assert ours == pytest.approx(theirs, abs=NEAR)
        assert np.abs(theirs).max() > 1


@pytest.mark.parametrize("count", [1, 2, 7, 8, 9, 16, 19])
def test_torques_of_places_side_by_side_are_to_the_last_bit_those_of_each(count):
    rng, masses = np.random.default_rng(16), masses_of(ROBOT.pinocchio)
    asked = [rng.uniform(-6, 6, (count, 6)) for _ in range(3)]
    alone = [torques(masses, *(each[n : n + 1] for each in asked)) for n in range(count)]
    for run, together in enumerate(torques(masses, *asked)):
        assert (together == np.concatenate([each[run] for each in alone])).all()


def test_gravity_is_the_models_own():
    """An arm on a wall: what holds it turns with gravity, what pushes it does not."""
    model = pinocchio.Model(ROBOT.pinocchio)
    model.gravity.linear = np.array([9.81, 0.0, 0.0])
    q = np.random.default_rng(13).uniform(-3, 3, (20, 6))
    still = np.zeros_like(q)
    ours = torques(masses_of(model), q, still, still)
    assert ours[0] == pytest.approx(by_pinocchio(model, q, still, still)[0], abs=NEAR)
    assert np.abs(ours[0] - torques(masses_of(ROBOT.pinocchio), q, still, still)[0]).max() > 1


def test_an_infinite_or_missing_angle_gives_no_number():
    for bad in (np.nan, np.inf):
        q = np.zeros((1, 6))
        q[0, 2] = bad
        hold, _, _ = torques(masses_of(ROBOT.pinocchio), q, np.ones((1, 6)), np.zeros((1, 6)))
        assert np.isnan(hold).any()


def test_the_worst_torque_is_that_of_the_hardest_moment_of_any_timing():
    """Beside pinocchio's torque at every s'' between the two greatest, at rest and at the full rate."""
    rng = np.random.default_rng(14)
    q, dq, ddq = (rng.uniform(-2, 2, (7, 6)) for _ in range(3))
    rate, forward, backward = rng.uniform(0, 2, 7), 3.0, 5.0
    told = Torques(ROBOT, CELL, q, dq, ddq).ratio(rate, forward=forward, backward=backward)
    model = pinocchio.Model(ROBOT.pinocchio)
    model.inertias[6] += pinocchio.Inertia(carried_kg(ROBOT, CELL), np.array(ROBOT.tool.tcp_m), np.zeros((3, 3)))
    scratch, worst = model.createData(), 0.0
    for a, b, c, r in zip(q, dq, ddq, rate, strict=True):
        for push in np.linspace(-backward, forward, 9):
            for s in (0.0, r):
                torque = pinocchio.rnea(model, scratch, a, b * s, b * push + c * s * s)
                worst = max(worst, float((np.abs(torque) / ROBOT.torque_limits_nm).max()))
    assert told == pytest.approx(worst, abs=NEAR)


def test_a_torque_that_is_no_number_is_beyond_every_limit():
    q = np.zeros((2, 6))
    q[1, 3] = np.nan
    still = np.zeros((2, 6))
    assert Torques(ROBOT, CELL, q, still, still).ratio(np.zeros(2), forward=1.0, backward=1.0) == np.inf
