"""Gripper's own numbers in the room: stroke, force, speed, pads."""

from dataclasses import replace

import numpy as np
import pytest
from pep.pit.robot.kinematics import link_frames
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, SEED, empty

from pep.pit import Assessment, GripperMove, Robot, Sphere, Thing, assess, gripped

HAND_E = Robot.load("ur3e", tool="robotiq_hande")


def asked(robot, move, scene=None, **numbers):
    """The index of each kind, in thousandths."""
    scene, cell = empty() if scene is None else scene, replace(CELL, tool=robot.tool.name, **numbers)
    found = assess(robot, scene, move, cell, perception_age_s=0.1, touch=NOTHING, seed=SEED)
    assert isinstance(found, Assessment)
    return {c.kind: c.index_milli for c in found.contributions}


def at_tool(robot, z, radius):
    """A ball on the tool's axis, `z` from the flange, in the base frame."""
    rotation, origin = link_frames(robot, np.array([HOME]))
    return Sphere(tuple((rotation[0, -1] @ [0, 0, z] + origin[0, -1]).tolist()), radius)


@pytest.mark.parametrize(
    ("move", "kind"),
    [
        (GripperMove(HOME, 0.060, 0.05, 100.0), "width"),
        (GripperMove(HOME, 0.040, 0.05, 190.0), "force"),
    ],
)
def test_what_one_gripper_can_is_too_much_for_the_other(move, kind):
    assert asked(HAND_E, move)[kind] == 4000
    assert asked(ROBOT, move).get(kind, 0) <= 2000


@pytest.mark.parametrize("robot", [ROBOT, HAND_E], ids=["2F-85", "Hand-E"])
def test_asked_for_less_than_its_least_it_presses_with_that(robot):
    """A gripper asked for 1 N closes with its least force: a thing at its fingers feels that."""
    egg = Thing("egg", "fragile", at_tool(robot, robot.tool.tcp_m[2] + 0.03, 0.02), 0.001)
    scene = replace(empty(), objects=(*empty().objects, egg))

    def index(force_n):
        return asked(robot, GripperMove(HOME, 0.0, 0.02, force_n), scene, fragile_break_force_n=100.0)["fragile"]

    least = robot.tool.force_min_n
    assert index(1.0) == index(least) == 1000 + round(10 * least)
    assert index(least + 10) == index(least) + 100


def test_where_the_pads_are_is_the_tools_own():
    """A part 30 mm behind the tool point lies between one's long pads, behind the other's short ones."""
    for robot, held in ((ROBOT, True), (HAND_E, False)):
        part = Thing("part", "rigid", at_tool(robot, robot.tool.tcp_m[2] - 0.034, 0.002), 0.0)
        assert (gripped(robot, HOME, [part], CELL) is not None) is held
        near = Thing("part", "rigid", at_tool(robot, robot.tool.tcp_m[2] - 0.010, 0.002), 0.0)
        assert gripped(robot, HOME, [near], CELL).object == "part"
