"""Loads of a straight move by the kernel and the numpy twin: the same ratios, speeds and slower speeds."""

from dataclasses import replace

import numpy as np
import pytest
from pep.pit.base.errors import WorkLimitError
from pep.pit.base.motion import profile_of
from pep.pit.base.tier import tier_of
from pep.pit.search.engine import chosen
from pep.pit.search.question import as_run
from tests.model.pit.demands import Demands
from tests.model.pit.path import NumpyPath
from tests.pep.pit.scenes import CELL, HOME, ROBOT
from tests.pep.pit.search.test_speeds import fast, limited

from pep.pit import CellParameters, MoveJ, Robot

NEAR = 1e-9
SLOWEST = 0.01


def both(move, cell, robot=ROBOT):
    """The twin, the kernel's, the run and its profile."""
    run = as_run(move, cell)
    engine = chosen()
    return Demands(NumpyPath(robot, run), cell), engine.demands(engine.path(robot, run), cell), run, profile_of(run)


def in_time():
    """No limit."""


def held_together(move, cell, robot=ROBOT):
    """Both sides' ratios and speeds are the same; the highest index of the twin's."""
    twin, kernel, _, profile = both(move, cell, robot)
    ours, theirs = kernel.ratios(profile), twin.ratios(profile)
    assert [each.name for each in ours] == [each.name for each in theirs]
    for one, other in zip(ours, theirs, strict=True):
        assert one.ratio == pytest.approx(other.ratio, abs=NEAR, rel=NEAR), one.name
        assert tier_of(one.index) == tier_of(other.index), one.name
    seen = np.array([body.reference == 0 for body in robot.bodies])
    speeds, known = kernel.surface_speed_m_s(profile), twin.surface_speed_m_s(profile)
    assert speeds[seen] == pytest.approx(known[seen], abs=NEAR)
    assert (speeds[~seen] >= known[~seen] - NEAR).all()  # of how the arm passes itself a rough bound serves
    return max(each.index for each in theirs)


@pytest.mark.parametrize("seed", range(6))
def test_ratios_and_speeds_are_the_twins(seed):
    rng = np.random.default_rng([91, seed])
    decided = 0
    for _ in range(8):
        move = fast(rng)
        decided += held_together(move, limited(rng, move)) > 1
        held_together(move, CELL)
    assert decided > 1


@pytest.mark.parametrize("tool", ["robotiq_2f85", "robotiq_hande"])
def test_another_tool_and_what_it_carries_count_alike(tool):
    robot, cell = Robot.load("ur3e", tool=tool), CellParameters(tool=tool, payload_kg=1.7)
    rng = np.random.default_rng(92)
    for _ in range(5):
        held_together(fast(rng), cell, robot)


@pytest.mark.parametrize("seed", range(6))
def test_the_slower_speed_is_the_twins(seed):
    rng = np.random.default_rng([93, seed])
    found = 0
    for _ in range(6):
        move = fast(rng)
        cell = limited(rng, move)
        twin, kernel, run, profile = both(move, cell)
        target = float(tier_of(max(each.index for each in twin.ratios(profile))) - 1)
        if target < 1:
            continue
        theirs = twin.fastest(run, target, slowest=SLOWEST, check_time=in_time)
        ours = kernel.fastest(run, target, slowest=SLOWEST, check_time=in_time)
        assert ours == theirs
        if ours is not None:
            found += 1
            assert kernel.at_most(profile_of(run, ours), target)
            assert not kernel.at_most(profile, target)
    assert found


def test_a_speed_that_no_slower_one_mends_is_none():
    twin, kernel, run, _ = both(MoveJ(HOME, (HOME[0] + 1, *HOME[1:]), 1.0, 1.4), replace(CELL, payload_kg=2.5))
    for each in (twin, kernel):
        assert each.fastest(run, 1.0, slowest=SLOWEST, check_time=in_time) is None


def test_without_time_no_slower_speed_is_named():
    def late():
        raise WorkLimitError("PHYSICS_FAULT", "no answer in time")

    cell = replace(CELL, tcp_speed_limit_m_s=0.3)
    twin, kernel, run, _ = both(MoveJ(HOME, (HOME[0] + 1, *HOME[1:]), 1.0, 1.4), cell)
    for each in (twin, kernel):
        assert each.fastest(run, 1.0, slowest=SLOWEST, check_time=in_time) is not None
        assert each.fastest(run, 1.0, slowest=SLOWEST, check_time=late) is None


def test_a_slower_speed_is_sought_only_below_the_commanded_one():
    move = MoveJ(HOME, (HOME[0] + 1, *HOME[1:]), SLOWEST / 2, 1.4)
    for each in both(move, CELL)[:2]:
        assert each.fastest(as_run(move, CELL), 1.0, slowest=SLOWEST, check_time=in_time) is None


def test_a_short_move_that_asks_for_a_forbidden_speed_breaks_the_limit_though_it_never_reaches_it():
    move = MoveJ(HOME, (HOME[0] + 0.01, *HOME[1:]), 4.0, 1.4)
    for each in both(move, CELL)[:2]:
        told = {ratio.name: ratio.ratio for ratio in each.ratios(both(move, CELL)[3])}
        assert told["joint_speed"] == pytest.approx(4.0 / ROBOT.speed_limits_rad_s[0])
        assert told["tcp_speed"] < 0.5
