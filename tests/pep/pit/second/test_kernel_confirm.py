"""The second engine's compiled arithmetic beside its twin in numpy: the same clearances, speeds and doubts."""

from dataclasses import replace

import numpy as np
import pytest
from pep.pit.base.tier import MOVING
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.separation import stopping
from pep.pit.search.certify import VIOLATION_RESOLUTION_M
from pep.pit.second.second_engine import DISTANCE_TOLERANCE_M, SecondWorld
from pep.pit.second.straight_check import look
from tests.model.pit.sight import look as twin_look
from tests.pep.pit.scenes import CELL, ROBOT, random_scene

from pep.pit import Robot, Workspace, adult_at_distance

NEAR = 1e-9
MEASURED = 2
STOP = stopping(CELL, perception_age_s=0.1, joint_speed_rad_s=1.0)
ROOMS = (None, Workspace((-0.6, -0.6, -0.1), (0.6, 0.6, 0.9)))


def sights(rng, room, *, robot=ROBOT, wrong=0.0, since=0, upper=MOVING):
    """Sights of both at a few random places, and the pairs; the first engine's clearances are off by `wrong`."""
    scene = replace(random_scene(rng), people=(adult_at_distance(0.7, bearing_rad=0.4),), workspace=room)
    pairs = pairs_of(robot, scene, CELL, grown_m=0.0)
    places = [(rng.uniform(-2, 2, 6), rng.uniform(-1, 1, 6)) for _ in range(5)]
    world = SecondWorld(robot, scene, pairs)
    exact, _ = world.ask_all(places)
    kernel = exact[:MEASURED].copy()
    kernel[1, rng.integers(len(pairs))] += wrong
    q, qd = np.array(places).swapaxes(0, 1)
    ours = look(world, q, qd, kernel, stop=STOP, since=since, upper=upper)
    theirs = twin_look(world, q, qd, kernel, stop=STOP, since=since, upper=upper)
    return ours, theirs, exact, pairs, world


@pytest.mark.long
@pytest.mark.parametrize("room", ROOMS)
@pytest.mark.parametrize("upper", [MOVING, 2.0, 2.9])
def test_clearances_speeds_and_doubts_are_the_twins(room, upper):
    rng = np.random.default_rng(94)
    doubts = calm = settled = 0
    for _ in range(12):
        ours, theirs, exact, pairs, world = sights(rng, room, upper=upper)
        assert ours.near == pytest.approx(theirs.near, abs=NEAR)
        assert ours.speed == pytest.approx(theirs.speed, abs=NEAR)
        assert (ours.near <= exact + DISTANCE_TOLERANCE_M).all()
        assert ours.agrees
        assert theirs.agrees
        # Whatever may count more than it should is a doubt of both.
        found, known = ({tuple(row) for row in each.open.tolist()} for each in (ours, theirs))
        assert known <= found
        assert {row for row in found if row[0] >= MEASURED} == {row for row in known if row[0] >= MEASURED}
        every = np.arange(len(pairs))
        for place, clearance in enumerate(exact):
            index = pairs.index(every, clearance, ours.speed[place, pairs.body], STOP)
            most = MOVING if place < MEASURED else upper
            assert {(place, pair) for pair in np.flatnonzero(index > most + NEAR).tolist()} <= known
            if place >= MEASURED:
                wrong = np.flatnonzero(clearance < pairs.violated_below - VIOLATION_RESOLUTION_M)
                assert {(place, pair) for pair in wrong.tolist()} <= known
                may = set(np.flatnonzero(index > MOVING + NEAR).tolist())
                settled += len(may - {pair for at, pair in found if at == place})
        world.measure(ours, ours.open)
        for place, pair in ours.open.tolist():
            assert ours.near[place, pair] == pytest.approx(exact[place, pair], abs=2e-6)
        doubts, calm = doubts + len(found), calm + exact.size - len(found)
    assert min(doubts, calm) > 1000
    assert (settled > 100) == (upper > MOVING)


def test_what_is_open_counts_from_the_place_that_is_said():
    ours, theirs, *_ = sights(np.random.default_rng(95), None, since=MEASURED)
    for each in (ours, theirs):
        assert each.open[:, 0].min() >= MEASURED


@pytest.mark.parametrize("wrong", [1e-5, -1e-5, np.nan])
def test_a_clearance_that_is_another_one_is_found_by_both(wrong):
    ours, theirs, *_ = sights(np.random.default_rng(96), None, wrong=wrong)
    assert (ours.agrees, theirs.agrees) == (False, False)


def test_another_tool_has_other_bodies():
    robot = Robot.load("ur3e", tool="robotiq_hande")
    ours, theirs, *_ = sights(np.random.default_rng(97), ROOMS[1], robot=robot)
    assert ours.near == pytest.approx(theirs.near, abs=NEAR)
    assert ours.speed == pytest.approx(theirs.speed, abs=NEAR)
