"""Files as makers write them: joints without end, several turns, foreign attributes, a gripper in the arm's file."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pep.pit.robot.outfit import Apart, Outfit, StatedRange, ToolFile
from pep.pit.robot.urdf import described
from pep.pit.robot.urdf_robot import model_of, robot_of
from tests.pep.pit.scenes import CELL, HOME, NOTHING, SEED, empty
from tests.pep.pit.urdfs import LIKE_UR3E, STICK, capsule, inertial, joint, origin, ur3e

from pep.pit import Assessment, ModelError, MoveJ, assess

UR3E = ur3e()
LAST = "wrist_3"


def refusal(text, outfit=LIKE_UR3E):
    with pytest.raises(ModelError) as caught:
        model_of(described(text, outfit), outfit)
    assert caught.value.reason == "PHYSICS_FAULT"
    return caught.value.detail


def last_joint(edit):
    """The UR3e with its last joint edited."""
    at = UR3E.index(f'<joint name="{LAST}"')
    return UR3E[:at] + edit(UR3E[at:])


def endless():
    return last_joint(lambda text: text.replace('type="revolute"', 'type="continuous"', 1))


def ranged(low, high, joint_name=LAST):
    return replace(LIKE_UR3E, ranges=(StatedRange(joint_name, low, high),))


# --- joints without end, several turns -------------------------------------------------------------------------------


def test_a_joint_without_end_needs_a_stated_range():
    found = refusal(endless())
    assert LAST in found
    assert "ranges" in found
    model = model_of(described(endless(), ranged(-9.0, 30.0)), ranged(-9.0, 30.0))
    assert model.joints[5].range_rad == (-9.0, 30.0)
    # What a file says there means nothing, as the format has it, and may be missing.
    whole = endless()
    at = whole.rindex("<limit")
    bare = whole[:at] + whole[at:].replace('lower="-6.283185307179586" upper="6.283185307179586"', "")
    assert len(bare) < len(whole)
    assert model_of(described(bare, ranged(-9.0, 30.0)), ranged(-9.0, 30.0)).joints == model.joints


def test_several_turns_are_computed_with():
    """Eight turns of the last joint, one after the other: an answer, a limit, and the same dynamics each turn."""
    outfit = ranged(-16 * math.pi, 16 * math.pi)
    outfit = replace(outfit, apart=tuple(a for a in proposals(outfit)))
    arm = robot_of(endless(), outfit, tool="robotiq_2f85")
    assert arm.position_ranges_rad[1][5] == 16 * math.pi
    far = MoveJ(HOME, (*HOME[:5], 15.9 * math.pi), 3.0, 5.0)
    found = assess(arm, empty(), far, CELL, perception_age_s=0.1, touch=NOTHING, seed=SEED)
    assert isinstance(found, Assessment), found
    assert found.violations == ()
    beyond = MoveJ(HOME, (*HOME[:5], 16.1 * math.pi), 3.0, 5.0)
    found = assess(arm, empty(), beyond, CELL, perception_age_s=0.1, touch=NOTHING, seed=SEED)
    assert found.violations == ("joint_limit",)


def proposals(outfit):
    from pep.pit.robot.robot import Robot
    from pep.pit.robot.self_clearance import proposed

    return proposed(Robot.from_model(model_of(described(endless(), outfit), outfit), tool="robotiq_2f85"))


@pytest.mark.parametrize(
    ("outfit", "said"),
    [
        (ranged(-1.0, 200.0), "turns"),  # degrees, or more turns than a person means
        (ranged(0.1, 3.0), "position limits"),  # zero is no place of it
        (ranged(3.0, -3.0), "position limits"),
        (ranged(math.nan, 3.0), "limits"),
    ],
)
def test_a_range_that_cannot_be_is_refused(outfit, said):
    assert said in refusal(endless(), outfit)


def test_a_range_may_narrow_a_files_and_never_widen_it():
    outfit = ranged(-1.0, 2.0)
    assert model_of(described(UR3E, outfit), outfit).joints[5].range_rad == (-1.0, 2.0)
    assert "wider" in refusal(UR3E, ranged(-7.0, 2.0))
    several = last_joint(lambda text: text.replace("6.283185307179586", "20.0"))
    assert "degrees" in refusal(several)
    assert model_of(described(several, ranged(-20.0, 20.0)), ranged(-20.0, 20.0)).joints[5].range_rad == (-20.0, 20.0)


# --- other namespaces ------------------------------------------------------------------------------------------------


FOREIGN = UR3E.replace('<joint name="wrist_3"', '<joint drake:kind="x" name="wrist_3"', 1).replace(
    "<robot ", '<robot xmlns:drake="http://drake.example" ', 1
)


def test_attributes_of_another_namespace_are_named_and_left_out_on_request():
    found = refusal(FOREIGN)
    assert "drake:kind" in found
    assert "vocabularies_left_out" in found
    outfit = replace(LIKE_UR3E, vocabularies_left_out=("drake",))
    assert model_of(described(FOREIGN, outfit), outfit).joints == model_of(described(UR3E), LIKE_UR3E).joints
    elements = UR3E.replace("</robot>", '<drake:gear ratio="3"/></robot>')
    assert "drake:gear" in refusal(elements)
    assert model_of(described(elements, outfit), outfit).capsules


def test_macros_are_never_left_out():
    with pytest.raises(ModelError) as caught:
        Outfit.from_toml(
            'schema = 1\nflange = "f"\npayload_limit_kg = 1.0\nacceleration_limit_rad_s2 = 1.0\n'
            'vocabularies_left_out = ["xacro"]'
        )
    assert "xacro" in caught.value.detail


# --- a gripper in the arm's file -------------------------------------------------------------------------------------


def with_gripper():
    """The UR3e with a gripper of two fingers, one of which mimics the other, and a slide."""
    shape = capsule((0, 0, 0), (0, 0, 0.05), 0.02) + inertial(0.1, (0, 0, 0), (1e-4, 0, 0, 1e-4, 0, 1e-4))
    links = "".join(f'<link name="{name}">{shape}</link>' for name in ("hand", "left", "right", "slide"))
    follows = joint("right_joint", "hand", "right").replace("</joint>", '<mimic joint="left_joint"/></joint>')
    joints = (
        joint("mount", "wrist_3_link", "hand", origin((0, 0, 0.01)), kind="fixed")
        + joint("left_joint", "hand", "left") + follows
        + joint("slide_joint", "left", "slide").replace('"revolute"', '"prismatic"')
    )  # fmt: skip
    return UR3E.replace("</robot>", links + joints + "</robot>")


def test_a_grippers_joints_are_named_and_left_out_on_request():
    found = refusal(with_gripper())
    assert "right_joint" in found
    assert "left_out" in found
    for name in ("mount", "left_joint"):  # all of it, or what hangs on one joint alone
        outfit = replace(LIKE_UR3E, left_out=(name,))
        if name == "left_joint":
            assert "right_joint" in refusal(with_gripper(), outfit)
            outfit = replace(LIKE_UR3E, left_out=("left_joint", "right_joint"))
        model = model_of(described(with_gripper(), outfit), outfit)
        assert model.joints[:5] == model_of(described(UR3E), LIKE_UR3E).joints[:5]
        assert ("hand" in [c.name for c in model.capsules]) is (name == "left_joint")
        assert not {"left", "right", "slide"} & {c.name for c in model.capsules}


def test_only_joints_of_the_file_can_be_left_out():
    found = refusal(with_gripper(), replace(LIKE_UR3E, left_out=("finger",)))
    assert "finger is no joint" in found
    assert "left_joint" in found


def test_an_arm_cannot_be_left_out():
    """Six joints with a flange must be left."""
    assert refusal(with_gripper(), replace(LIKE_UR3E, left_out=("wrist_2",)))
    assert refusal(UR3E, replace(LIKE_UR3E, left_out=("shoulder_pan",)))


# --- a tool in a file of its own -------------------------------------------------------------------------------------


TOOL = """
schema = 1

[[tools]]
name = "stick"
mass_kg = 0.5
com_m = [0.0, 0.01, 0.05]
tcp_m = [0.0, 0.0, 0.1]
shape = "edge"
width_limit_m = 0.05
force_min_n = 1.0
force_limit_n = 10.0
finger_speed_min_m_s = 0.01
finger_speed_limit_m_s = 0.1
pad_m = 0.01
capsules = [{ name = "stick_rod", a_m = [0.0, 0.0, 0.02], b_m = [0.0, 0.01, 0.1], radius_m = 0.02 }]
"""


def test_a_tool_may_be_in_a_file_of_its_own():
    tools = ToolFile.from_toml(TOOL).tools
    assert tools == (STICK,)
    bare = replace(LIKE_UR3E, tools=())
    arm = robot_of(UR3E, bare.fitted_with(tools), tool="stick")
    assert arm.tool == STICK
    assert arm.model_digest == robot_of(UR3E, replace(LIKE_UR3E, tools=tools), tool="stick").model_digest
    with pytest.raises(ModelError):  # the same tool twice
        robot_of(UR3E, bare.fitted_with((*tools, *tools)), tool="stick")
    with pytest.raises(ModelError):  # none at all
        robot_of(UR3E, bare, tool="stick")


@pytest.mark.parametrize(
    "edit", [("schema = 1", "schema = 2"), ("schema = 1", ""), ("[[tools]]", "[[tool]]"), ("0.5", "nan")]
)
def test_a_file_of_tools_of_another_form_is_refused(edit):
    with pytest.raises(ModelError) as caught:
        ToolFile.from_toml(TOOL.replace(*edit, 1))
    assert caught.value.reason == "PHYSICS_FAULT"


# --- pairs whose joints turn all the way round -----------------------------------------------------------------------


def test_links_whose_two_joints_turn_all_the_way_round_may_be_left_out():
    """A link's name stands for its capsules; a joint that is held back, or a third one, contradicts it."""
    turns = replace(LIKE_UR3E, apart=(Apart("base_link", "shoulder_lift_link", "turns"),))
    arm = robot_of(UR3E, turns, tool="robotiq_2f85")
    watched = {(inner.name, arm.bodies[body].name) for body, inner in arm.self_pairs}
    assert not any(i == "base_link" and o.startswith("shoulder_lift_link") for i, o in watched)
    held_back = UR3E.replace('lower="-6.283185307179586"', 'lower="0.0"', 1).replace(
        'upper="6.283185307179586"', 'upper="6.2"', 1
    )
    for text, apart in (
        (held_back, Apart("base_link", "shoulder_lift_link", "turns")),
        (UR3E, Apart("shoulder_pan_link", "elbow_link", "turns")),  # the elbow has half a turn either way
        (UR3E, Apart("base_link", "elbow_link", "turns")),  # three joints between
    ):
        with pytest.raises(ModelError):
            robot_of(text, replace(LIKE_UR3E, apart=(apart,)), tool="robotiq_2f85")


def test_ranges_are_stated_once():
    text = 'schema = 1\nflange = "f"\npayload_limit_kg = 1.0\nacceleration_limit_rad_s2 = 1.0\n'
    one = '[[ranges]]\njoint = "a"\nlow_rad = -1.0\nhigh_rad = 1.0\n'
    assert Outfit.from_toml(text + one).ranges == (StatedRange("a", -1.0, 1.0),)
    with pytest.raises(ModelError):
        Outfit.from_toml(text + one + one)
    assert np.isfinite(Outfit.from_toml(text + one).ranges[0].low_rad)
