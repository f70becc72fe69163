"""Held object: committed from the gripper's own word and the sensors' view, with its effect on the arm."""

import asyncio
import math
from dataclasses import replace

import numpy as np
import pinocchio
import pytest
from pep.base.errors import PepFault, RobotError
from pep.perception.sensor_frames import Seen
from pep.pit.scene.cell import Part
from pep.rtde.robot.gripper import GripResult
from pep.world.held_object import CommittedGrip
from pep.world.world import tool_position

from pep.pit import CellParameters, Robot, Sphere, Thing
from ztpm.point import robot as composition

ARM = Robot.load("ur3e")
Q = (0.0, -1.6595, 1.8752, -1.7865, -1.57, 0.0)
STRETCHED = (0.0,) * 6
CELL = CellParameters(parts=(Part("part-1", 0.4, blunt=True),))


def between_the_fingers(name="part-1"):
    return Thing(name, "rigid", Sphere(tool_position(ARM, Q), 0.02), 0.002)


def test_a_known_part_between_the_fingers_is_held_with_its_mass():
    holding = CommittedGrip(ARM, CELL)
    empty_kg, empty_model = holding.carried_kg, holding.robot.model_digest
    holding.closed_on(Q, [between_the_fingers(), Thing("far", "rigid", Sphere((2.0, 0.0, 0.0), 0.02), 0.0)])
    assert (holding.held.object, holding.held.mass_kg) == ("part-1", 0.4)
    assert holding.carried_kg == pytest.approx(empty_kg + 0.4)
    assert holding.robot.model_digest != empty_model
    assert holding.centre_m[2] > ARM.tool.com_m[2]
    holding.released()
    assert (holding.held, holding.carried_kg, holding.robot.model_digest) == (None, empty_kg, empty_model)
    assert holding.centre_m == pytest.approx(ARM.tool.com_m)


@pytest.mark.clause("LSD-13")
def test_a_program_may_say_which_declared_part_it_holds():
    part = Part("part-1", 0.4, centre_m=(0.0, 0.02, 0.2))
    holding = CommittedGrip(ARM, CellParameters(parts=(part,)))
    empty, loaded = holding.loads
    assert (empty.object, empty.mass_kg) == ("", holding.carried_kg)
    assert empty.centre_m == pytest.approx(ARM.tool.com_m)
    holding.declared(loaded)
    assert (holding.held.object, holding.held.mass_kg) == ("part-1", 0.4)
    assert (holding.carried_kg, holding.centre_m) == (loaded.mass_kg, loaded.centre_m)
    moments = [
        ARM.tool.mass_kg * own + part.mass_kg * at for own, at in zip(ARM.tool.com_m, part.centre_m, strict=True)
    ]
    assert loaded.centre_m == pytest.approx([moment / loaded.mass_kg for moment in moments])
    shape = holding.held.shape
    for point in (ARM.tool.tcp_m, part.centre_m):
        assert math.dist(holding.held.center_m, point) + CELL.unknown_part_m <= shape.radius_m + 1e-12
    assert holding.loads == (empty, loaded), "it may be put down"
    holding.declared(empty)
    assert holding.held is None


def gravity_nm(robot, q):
    return pinocchio.computeGeneralizedGravity(robot.pinocchio, robot.pinocchio.createData(), np.array(q))


@pytest.mark.clause("LSD-13")
def test_a_declared_load_turns_the_joints_more():
    holding = CommittedGrip(ARM, CellParameters(parts=(Part("part-1", 1.4),)))
    before = gravity_nm(holding.robot, STRETCHED)
    holding.declared(holding.loads[1])
    more_nm = np.abs(gravity_nm(holding.robot, STRETCHED)) - np.abs(before)
    out_m = abs(tool_position(ARM, STRETCHED)[0])
    assert more_nm[1] == pytest.approx(1.4 * 9.81 * out_m, rel=0.05)


@pytest.mark.clause("LSD-13")
def test_what_the_gripper_tells_is_not_said_otherwise():
    holding = CommittedGrip(ARM, CELL)
    empty, loaded = holding.loads
    holding.closed_on_unknown()
    assert holding.loads == ()
    for load in (empty, loaded):
        holding.declared(load)
    assert (holding.held.object, holding.held.mass_kg) == ("", None)
    holding.released()
    assert holding.loads == (empty, loaded)
    assert CommittedGrip(ARM, replace(CELL, payload_kg=None)).loads == (), "nobody knows what is mounted"


@pytest.mark.parametrize("shown", [[], [between_the_fingers("part-1"), between_the_fingers("part-2")]])
def test_what_nobody_can_name_counts_as_the_whole_payload(shown):
    holding = CommittedGrip(ARM, CELL)
    holding.closed_on(Q, shown)
    assert (holding.held.object, holding.held.mass_kg) == ("", None)
    assert holding.carried_kg == pytest.approx(ARM.model.payload_limit_kg)


def test_an_unknown_part_that_is_mounted_counts_as_the_whole_payload():
    holding = CommittedGrip(ARM, replace(CELL, payload_kg=None))
    assert holding.carried_kg == pytest.approx(ARM.model.payload_limit_kg)


class Physics:
    def __init__(self, holding):
        self.holding = holding

    def grip_ended(self, *, on_something, arrived):
        if on_something:
            self.holding.closed_on(Q, [between_the_fingers()])
        else:
            self.holding.released()


class Control:
    def __init__(self):
        self.told = []

    async def equip(self, payload_kg, centre_m):
        self.told.append(round(payload_kg, 3))
        return True


def test_the_controller_is_told_what_is_carried_whenever_that_changes():
    holding, control = CommittedGrip(ARM, CELL), Control()
    own = round(holding.carried_kg, 3)
    for something in (False, True, True, False, False):
        grip = GripResult(40_000, object=something, arrived=True)
        asyncio.run(composition.committed(Physics(holding), control, holding, grip))
    assert control.told == [round(own + 0.4, 3), own]


def test_an_arm_that_says_nothing_holds_something_unknown(monkeypatch):
    monkeypatch.setattr("pep.world.world.scene_of", lambda seen, cell: cell.surveyed)
    from pep.world.world import CellPhysics

    class Silent:
        def read(self):
            raise RobotError(PepFault.ROBOT_STALLED, "")

    class Frames:
        def view(self):
            return Seen((), 0)

    holding = CommittedGrip(ARM, CELL)
    physics = CellPhysics(holding=holding, cell=CELL, valid_until_s=2**40, frames=Frames(), state=Silent(), clock=None)
    with pytest.raises(RobotError):
        physics.grip_ended(on_something=True, arrived=True)
    assert holding.held.mass_kg is None


class Cell:
    """The physics of a cell that sees the one thing between the fingers."""

    def __init__(self, holding):
        from pep.world.world import CellPhysics

        self.holding = holding
        self.physics = CellPhysics(
            holding=holding, cell=CELL, valid_until_s=2**40, frames=self, state=self, clock=None
        )  # fmt: skip

    def view(self):
        return None

    def grip(self, *, on_something, arrived):
        self.physics.grip_ended(on_something=on_something, arrived=arrived)
        return self.holding.held


def test_fingers_that_were_halted_while_opening_still_hold():
    holding = CommittedGrip(ARM, CELL)
    cell = Cell(holding)
    assert cell.grip(on_something=False, arrived=False) is None  # empty, and halted on the way
    holding.closed_on(Q, [between_the_fingers()])
    held = holding.held
    assert cell.grip(on_something=False, arrived=False) is held
    assert cell.grip(on_something=False, arrived=True) is None
    assert cell.grip(on_something=True, arrived=True).mass_kg is None


def test_fingers_that_were_halted_on_something_hold_it_whatever_it_is():
    holding = CommittedGrip(ARM, CELL)
    assert Cell(holding).grip(on_something=True, arrived=False).mass_kg is None


class Fingers:
    def __init__(self, word):
        self.word = word

    def holds(self):
        if isinstance(self.word, Exception):
            raise self.word
        return self.word


@pytest.mark.parametrize(
    ("word", "whole"), [(True, True), (False, False), (RobotError(PepFault.GRIPPER_UNREACHABLE, ""), False)]
)
def test_what_was_held_before_the_start_is_an_unknown_part(word, whole):
    holding = CommittedGrip(ARM, CELL)
    composition.found_holding(holding, Fingers(word))
    assert (holding.carried_kg == pytest.approx(ARM.model.payload_limit_kg)) == whole
    assert (holding.held is not None) == whole
