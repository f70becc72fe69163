"""Any other arm by its URDF: the same arm that pinocchio reads, and nothing that could be read two ways."""

import math
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pinocchio
import pytest
from pep.pit.geometry.clearance import segment_segment
from pep.pit.proof.proof_document import document
from pep.pit.robot.enclosing_capsule import capsule_around
from pep.pit.robot.frames import angles_of
from pep.pit.robot.kinematics import link_frames
from pep.pit.robot.outfit import Apart, Outfit
from pep.pit.robot.self_clearance import proposed
from pep.pit.robot.urdf import Pose, UrdfBox, UrdfCylinder, UrdfSphere, described
from pep.pit.robot.urdf_robot import model_of, robot_of
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, SEED, empty, sweep, with_glass, with_person
from tests.pep.pit.urdfs import LIKE_UR3E, OUTFIT, STICK, capsule, inertial, joint, origin, random_arm, robot, ur3e

from pep.pit import Assessment, ModelError, MoveJ, assess
from pep.pit.checker import Verified, verify

UR3E = ur3e()


def arm_of(text, outfit=OUTFIT):
    """The arm without the word on its pairs: random ones overlap."""
    from pep.pit.robot.robot import Robot

    return Robot.from_model(model_of(described(text), outfit), tool=outfit.tools[0].name)


def ends_of(arm, q):
    """World ends of every capsule of the arm itself, by name, shape (n, 2, 3)."""
    rotation, at = link_frames(arm, q)
    return {
        c.name: np.stack([rotation[:, c.link] @ np.array(p) + at[:, c.link] for p in (c.a_m, c.b_m)], axis=1)
        for c in arm.model.capsules
    }


# --- the same arm ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(30))
def test_pinocchio_reads_the_same_arm(seed):
    """Every shape is where pinocchio has it, to 1e-9 m; every torque is pinocchio's, to 1e-9 Nm.

    The angles are random.
    """
    rng = np.random.default_rng(seed)
    text = random_arm(rng)
    arm = arm_of(text)
    model = pinocchio.buildModelFromXML(text)
    shapes = pinocchio.buildGeomFromUrdfString(model, text, pinocchio.GeometryType.COLLISION)
    assert [arm.pinocchio.names[k] for k in range(1, 7)] == [model.names[k] for k in range(1, 7)]
    assert len(shapes.geometryObjects) == len(arm.model.capsules) >= 7
    flange = model.frames[model.getFrameId("flange")]
    stick = pinocchio.Inertia(STICK.mass_kg, np.array(STICK.com_m), np.zeros((3, 3)))
    model.inertias[6] += flange.placement.act(stick)
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    assert np.abs(np.array(arm.position_ranges_rad) - (low, high)).max() == 0
    assert arm.speed_limits_rad_s.tolist() == model.velocityLimit.tolist()
    assert arm.torque_limits_nm.tolist() == model.effortLimit.tolist()
    q = rng.uniform(low, high, (20, 6))
    ends = ends_of(arm, q)
    rotation, at = link_frames(arm, q)
    data, placed, ours = model.createData(), shapes.createData(), arm.pinocchio.createData()
    for row, angles in enumerate(q):
        pinocchio.updateGeometryPlacements(model, data, shapes, placed, angles)
        for shape, pose in zip(shapes.geometryObjects, placed.oMg, strict=True):
            link, number = shape.name.rsplit("_", 1)
            several = f"{link}.{int(number) + 1}"
            found = ends[several if several in ends else link][row]
            half = shape.geometry.halfLength * pose.rotation[:, 2]
            theirs = np.array([pose.translation - half, pose.translation + half])
            assert min(np.abs(found - theirs).max(), np.abs(found - theirs[::-1]).max()) <= 1e-9
        pinocchio.framesForwardKinematics(model, data, angles)
        there = data.oMf[model.getFrameId("flange")]
        assert np.abs(rotation[row, 6] - there.rotation).max() <= 1e-9
        assert np.abs(at[row, 6] - there.translation).max() <= 1e-9
        v, a = rng.uniform(-2, 2, (2, 6))
        torque = pinocchio.rnea(model, data, angles, v, a)
        assert np.abs(pinocchio.rnea(arm.pinocchio, ours, angles, v, a) - torque).max() <= 1e-9 * max(
            1, abs(torque).max()
        )


def test_the_ur3e_as_a_urdf_is_the_ur3e():
    """The same capsules at the same places, the same limits, and the same answers about the paper's cells."""
    arm = robot_of(UR3E, LIKE_UR3E, tool="robotiq_2f85")
    q = np.random.default_rng(1).uniform(-math.pi, math.pi, (200, 6))
    ours, theirs = list(ends_of(ROBOT, q).values()), list(ends_of(arm, q).values())
    assert len(ours) == len(theirs) == 11
    assert max(np.abs(a - b).max() for a, b in zip(ours, theirs, strict=True)) <= 1e-9
    radii = zip(ROBOT.model.capsules, arm.model.capsules, strict=True)
    assert max(abs(a.radius_m - b.radius_m) for a, b in radii) <= 1e-9
    assert np.abs(arm.rotations - ROBOT.rotations).max() <= 1e-12
    assert np.abs(arm.offsets - ROBOT.offsets).max() == 0
    # All are watched until a person says otherwise; said as the shipped file says it, the answers are the same.
    assert len(arm.self_pairs) > len(ROBOT.self_pairs)
    assert assess(arm, empty(), sweep(), CELL, perception_age_s=0.1, touch=NOTHING, seed=SEED).index > 2
    arm = robot_of(UR3E, replace(LIKE_UR3E, apart=proposed(arm)), tool="robotiq_2f85")
    for scene in (empty(), with_glass(), with_person()):
        found, known = (
            assess(each, scene, sweep(), CELL, perception_age_s=0.1, touch=NOTHING, seed=SEED) for each in (arm, ROBOT)
        )
        assert isinstance(found, Assessment)
        assert (found.tier, found.violations) == (known.tier, known.violations)
        assert found.index == pytest.approx(known.index, abs=0.02)
        assert found.model_digest != known.model_digest


@pytest.mark.parametrize("seed", [3, 4])
def test_a_random_arm_is_assessed_and_the_engines_agree(seed):
    """The whole room works on it: an answer, and not the fault that disagreeing engines are."""
    arm = arm_of(random_arm(np.random.default_rng(seed)))
    low, high = arm.position_ranges_rad
    move = MoveJ(tuple(0.3 * low), tuple(0.3 * high), 0.5, 1.0)
    cell = replace(CELL, tool="stick")
    found = assess(arm, empty(), move, cell, perception_age_s=0.1, touch=NOTHING, seed=SEED)
    assert isinstance(found, Assessment), found


def test_its_certificate_is_verified():
    """The independent checker rebuilds the foreign arm from the document, with limits that differ either way."""
    text = UR3E.replace('lower="-6.283185307179586"', 'lower="-2.5"', 1)
    outfit = replace(LIKE_UR3E, apart=proposed(robot_of(text, LIKE_UR3E, tool="robotiq_2f85")))
    arm = robot_of(text, outfit, tool="robotiq_2f85")
    asked = {"perception_age_s": 0.1, "touch": NOTHING}
    answer = assess(arm, with_glass(), sweep(), CELL, seed=SEED, **asked)
    found = verify(document(answer, robot=arm, scene=with_glass(), motion=sweep(), cell=CELL, **asked))
    assert isinstance(found, Verified), found
    assert found.tier == answer.tier


def test_each_limit_counts_its_own_way():
    """Of a joint from -2.5 to 6.28 rad."""
    text = UR3E.replace('lower="-6.283185307179586"', 'lower="-2.5"', 1)
    arm = arm_of(text, LIKE_UR3E)
    for end, violations in ((-2.4, ()), (-2.6, ("joint_limit",)), (2.6, ()), (6.3, ("joint_limit",))):
        move = MoveJ(HOME, (end, *HOME[1:]), 0.5, 1.0)
        found = assess(arm, empty(), move, CELL, perception_age_s=0.1, touch=NOTHING, seed=SEED)
        assert found.violations == violations


def test_the_controllers_base_may_be_another_fixed_link():
    """The UR description's `base_link` is half a turn off the controller's base."""
    turned = UR3E.replace(
        "</robot>",
        '<link name="base"/>' + joint("to_base", "base_link", "base", origin((0.1, 0, 0.2), (0, 0, math.pi)), kind="fixed")
        + "</robot>",
    )  # fmt: skip
    arm = robot_of(turned, replace(LIKE_UR3E, base="base"), tool="robotiq_2f85")
    q = np.array([HOME])
    ours, theirs = list(ends_of(ROBOT, q).values()), list(ends_of(arm, q).values())
    half_turn = pinocchio.rpy.rpyToMatrix(0, 0, math.pi)
    for a, b in zip(ours, theirs, strict=True):
        assert np.abs((a - [0.1, 0, 0.2]) @ half_turn - b).max() <= 1e-9


def test_every_rotation_is_spelled_by_its_angles():
    """At the poles of the angles too, where others lose half of the digits."""
    rng = np.random.default_rng(5)
    for k in range(400):
        pitch = math.pi / 2 - rng.choice([0, 1e-16, 1e-9, 1e-8, 1e-6, 1e-3]) if k % 2 else rng.uniform(-2, 2)
        turn = pinocchio.rpy.rpyToMatrix(rng.uniform(-3, 3), rng.choice([-1, 1]) * pitch, rng.uniform(-3, 3))
        assert np.abs(pinocchio.rpy.rpyToMatrix(*angles_of(turn)) - turn).max() <= 1e-14


def test_the_digest_names_file_and_outfit():
    """Any other text, any other word on it, and the mounted tool: another digest."""
    texts = [UR3E, UR3E.replace("</robot>", "<!-- another file -->\n</robot>")]
    outfits = [LIKE_UR3E, replace(LIKE_UR3E, payload_limit_kg=2.0), replace(LIKE_UR3E, base="base_link")]
    digests = {robot_of(t, o, tool="robotiq_2f85").model_digest for t, o in product(texts, outfits[:2])}
    digests.add(robot_of(UR3E, LIKE_UR3E, tool="robotiq_hande").model_digest)
    assert len(digests) == 5
    assert robot_of(UR3E, outfits[2], tool="robotiq_2f85").model_digest in digests  # the same arm, said in more words


# --- shapes ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(40))
def test_a_capsule_contains_the_shape(seed):
    """Corners and rims, at random poses and proportions from plate to needle."""
    rng = np.random.default_rng(seed)
    pose = Pose(tuple(rng.uniform(-1, 1, 3)), tuple(rng.uniform(-3, 3, 3)))
    size = 10 ** rng.uniform(-3, 0, 3)
    turn, center = pinocchio.rpy.rpyToMatrix(*pose.rpy_rad), np.array(pose.xyz_m)
    angle = np.linspace(0, 2 * math.pi, 60)
    rim = np.stack([size[0] * np.cos(angle), size[0] * np.sin(angle), 0 * angle], axis=1)
    tips = [[0, 0, s * (size[1] / 2 + size[0])] for s in (-1, 1)]
    points = {
        UrdfBox(tuple(size)): np.array(list(product((-0.5, 0.5), repeat=3))) * size,
        UrdfCylinder(size[0], size[1], rounded=False): np.concatenate([rim + [0, 0, s * size[1] / 2] for s in (-1, 1)]),
        UrdfCylinder(size[0], size[1], rounded=True): np.concatenate([rim + [0, 0, size[1] / 2], rim - [0, 0, size[1] / 2], tips]),
        UrdfSphere(size[0]): np.concatenate([rim, rim[:, [2, 0, 1]], rim[:, [1, 2, 0]]]),
    }  # fmt: skip
    for shape, local in points.items():
        a, b, radius = capsule_around(pose, shape)
        world = local @ turn.T + center
        along = np.clip((world - a) @ (b - a) / max(((b - a) ** 2).sum(), 1e-30), 0, 1)
        reach = np.linalg.norm(world - a - along[:, None] * (b - a), axis=1)
        assert reach.max() <= radius
        # And no bigger than it must be: the farthest point is on the surface.
        assert reach.max() >= radius - 1e-8


def test_the_smallest_capsule_is_found():
    """Against a scan of all capsules along the same line."""
    for half, across in ((0.1, 0.03), (0.01, 0.06), (0.05, 0.05), (1.0, 0.01)):
        a, b, radius = capsule_around(Pose(), UrdfCylinder(across, 2 * half, rounded=False))

        def volume(x, half=half, across=across):
            r = math.hypot(across, x)
            return 2 * math.pi * r**2 * (half - x) + 4 / 3 * math.pi * r**3

        best = min(volume(half * k / 1000) for k in range(1001))
        assert math.pi * radius**2 * np.linalg.norm(b - a) + 4 / 3 * math.pi * radius**3 <= best * (1 + 1e-6)


# --- pairs -----------------------------------------------------------------------------------------------------------


def test_every_pair_of_no_neighbours_is_watched():
    arm = robot_of(UR3E, LIKE_UR3E, tool="robotiq_2f85")
    watched = {(inner.name, arm.bodies[body].name) for body, inner in arm.self_pairs}
    assert watched == {(i.name, o.name) for i, o in product(arm.capsules, repeat=2) if o.link - i.link >= 2}


def leaving(*apart):
    return replace(LIKE_UR3E, apart=apart)


def test_a_pair_that_never_meets_may_be_left_out():
    """The sampled claim holds: one capsule of the upper arm stays clear of the wrist's two links out."""
    apart = Apart("shoulder_pan_link", "elbow_link.1", "never")
    with_it, without = (robot_of(UR3E, o, tool="robotiq_2f85") for o in (LIKE_UR3E, leaving(apart)))
    assert len(without.self_pairs) == len(with_it.self_pairs) - 1
    assert without.model_digest != with_it.model_digest


@pytest.mark.parametrize(
    "apart",
    [
        Apart("base_link", "wrist_3_link", "never"),  # they meet
        Apart("base_link", "wrist_3_link", "always"),  # they do not always
        Apart("shoulder_pan_link", "elbow_link.1", "always"),
        Apart("base_link", "shoulder_pan_link", "never"),  # neighbours
        Apart("wrist_3_link", "base_link", "never"),  # the wrong way round
        Apart("base_link", "nowhere", "never"),
        Apart("base_link", "gripper_body", "never"),  # the tool's capsules count too
    ],
)
def test_a_word_that_is_not_so_is_refused(apart):
    with pytest.raises(ModelError) as caught:
        robot_of(UR3E, leaving(apart), tool="robotiq_2f85")
    assert caught.value.reason == "PHYSICS_FAULT"


def test_a_pair_is_named_once():
    apart = Apart("shoulder_pan_link", "elbow_link.1", "never")
    with pytest.raises(ModelError):
        robot_of(UR3E, leaving(apart, apart), tool="robotiq_2f85")


def test_a_pair_that_never_comes_apart_is_refused_until_it_is_named():
    """A ball around the elbow that reaches over it: silence would make every motion one into itself."""
    ball = '<collision><geometry><sphere radius="0.2"/></geometry></collision></link>'
    i = UR3E.index('<link name="elbow_link">')
    fat = UR3E[:i] + UR3E[i:].replace("</link>", ball, 1)
    with pytest.raises(ModelError):
        robot_of(fat, LIKE_UR3E, tool="robotiq_2f85")
    always = Apart("shoulder_pan_link", "elbow_link.4", "always")
    pairs = robot_of(fat, leaving(always), tool="robotiq_2f85").self_pairs
    assert "shoulder_pan_link" not in [inner.name for body, inner in pairs if body == "elbow_link.4"]


@pytest.mark.long
def test_what_is_proposed_is_what_the_shipped_file_leaves_out():
    """Of the UR3e's pairs, each that the file leaves out; and nothing that ten times the samples find touching."""
    arm = robot_of(UR3E, LIKE_UR3E, tool="robotiq_2f85")
    name = {ours.name: theirs.name for ours, theirs in zip(arm.model.capsules, ROBOT.model.capsules, strict=True)}
    listed = {(inner.name, ROBOT.bodies[body].name) for body, inner in ROBOT.self_pairs}
    told = proposed(arm)
    assert {a.why for a in told} == {"never"}
    every = {
        (name.get(i.name, i.name), name.get(o.name, o.name))
        for i, o in product(arm.capsules, repeat=2)
        if o.link - i.link >= 2
    }
    proposal = {(name.get(a.inner, a.inner), name.get(a.outer, a.outer)) for a in told}
    assert proposal >= every - listed
    q = np.random.default_rng(9).uniform(-math.pi, math.pi, (40_000, 6))
    rotation, at = link_frames(arm, q)
    for each in told:
        pair = [next(c for c in arm.capsules if c.name == n) for n in (each.inner, each.outer)]
        ends = [rotation[:, c.link] @ np.array(p) + at[:, c.link] for c in pair for p in (c.a_m, c.b_m)]
        on_one, on_other = segment_segment(*ends)
        assert np.linalg.norm(on_one - on_other, axis=1).min() > pair[0].radius_m + pair[1].radius_m


# --- guards ----------------------------------------------------------------------------------------------------------


def simple(**changes):
    """A small arm of six joints, each part by its name, so that a test may say it otherwise."""
    mass = inertial(1.0, (0, 0, 0.05), (0.01, 0, 0, 0.01, 0, 0.01))
    rod = capsule((0, 0, 0.03), (0, 0, 0.07), 0.02)
    parts = {"l0": f'<link name="l0">{rod}</link>'}
    for k in range(1, 7):
        parts[f"l{k}"] = f'<link name="l{k}">{mass}{rod}</link>'
        axis = (0, 0, 1) if k % 2 else (0, 1, 0)
        parts[f"j{k}"] = joint(f"j{k}", f"l{k - 1}", f"l{k}", origin((0.02, 0, 0.2)), axis)
    parts["j6"] = joint("j6", "l5", "l6", origin((0, 0, 0.2)), (0, 0, 1))
    parts["flange"] = '<link name="flange"/>' + joint("jf", "l6", "flange", origin((0, 0, 0.08)), kind="fixed")
    head = {key: changes.pop(key) for key in ("version", "name") if key in changes}
    return robot(*(parts | changes).values(), **head)


@cache
def plain():
    return simple()


def reads(text, outfit=OUTFIT):
    return robot_of(text, outfit, tool="stick")


def test_the_small_arm_is_good():
    assert reads(plain()).model.name == "arm"


def swapped(old, new):
    assert old in plain()
    return plain().replace(old, new, 1)


LINK3 = simple().split('<link name="l3">')[1].split("</link>")[0]


def link3(inside):
    return simple(l3=f'<link name="l3">{inside}</link>')


MASS = inertial(1.0, (0, 0, 0.05), (0.01, 0, 0, 0.01, 0, 0.01))
SHAPE = "<collision><geometry>{}</geometry></collision>"

GUARDS = {
    # XML
    "no XML": "arm",
    "nothing": "",
    "cut short": plain()[:-12],
    "a second robot": plain() + "<robot name='x'/>",
    "no robot": "<sdf version='1.6'/>",
    "no text": plain() + "\ud800",
    "a NUL": plain().replace("arm", "a\0m"),
    "too long": plain() + "\n" * 1_100_000,
    "too deep": simple(more="<gazebo>" + "<a>" * 20 + "</a>" * 20 + "</gazebo>"),
    "too many elements": simple(more="<gazebo>" + "<a/>" * 21_000 + "</gazebo>"),
    "a document type": plain().replace("<robot", "<!DOCTYPE robot><robot", 1),
    "entities": plain().replace("<robot", '<!DOCTYPE r [<!ENTITY a "1">]><robot', 1),
    "an outer entity": plain().replace("<robot", '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot', 1),
    "an outer document type": plain().replace("<robot", '<!DOCTYPE r SYSTEM "http://example.org/r.dtd"><robot', 1),
    "an entity that is not there": plain().replace('name="arm"', 'name="&arm;"', 1),
    "a style sheet": plain().replace("<robot", '<?xml-stylesheet href="http://example.org/x"?><robot', 1),
    "an attribute twice": swapped('name="l3"', 'name="l3" name="l3"'),
    # what is not read
    "an unexpanded macro": simple(more='<xacro:include filename="other.xacro"/>'),
    "an inclusion": simple(more='<include href="other.urdf"/>'),
    "another version": simple(version=' version="2.0"'),
    "an unknown attribute": swapped('<link name="l3">', '<link name="l3" scale="2">'),
    "a quaternion": swapped('rpy="0.0 0.0 0.0"', 'quat_xyzw="0 0 0 1"'),
    "stray text": swapped('<link name="l3">', '<link name="l3">text'),
    "a name that is none": simple(name="a/b"),
    # shapes
    "a mesh": link3(MASS + SHAPE.format('<mesh filename="package://x/l3.stl"/>')),
    "a mesh beside a shape": link3(LINK3 + SHAPE.format('<mesh filename="l3.stl"/>')),
    "an unknown shape": link3(MASS + SHAPE.format('<cone radius="1" length="1"/>')),
    "no shape": link3(MASS + SHAPE.format("")),
    "two shapes in one": link3(MASS + SHAPE.format('<sphere radius="0.1"/><sphere radius="0.1"/>')),
    "a link without shape": link3(MASS),
    "a base without shape": simple(l0='<link name="l0"/>'),
    "a picture only": link3(MASS + '<visual><geometry><sphere radius="0.1"/></geometry></visual>'),
    "capsules of version 1.0": simple(version=' version="1.0"'),
    "capsules of no version": simple(version=""),
    "a ball of no size": link3(MASS + SHAPE.format('<sphere radius="0"/>')),
    "a ball inside out": link3(MASS + SHAPE.format('<sphere radius="-0.1"/>')),
    "a rod of no length": link3(MASS + SHAPE.format('<cylinder radius="0.1" length="0"/>')),
    "a rod without length": link3(MASS + SHAPE.format('<cylinder radius="0.1"/>')),
    "a flat box": link3(MASS + SHAPE.format('<box size="0.1 0 0.1"/>')),
    "a box of two edges": link3(MASS + SHAPE.format('<box size="0.1 0.1"/>')),
    "a ball in millimetres": link3(MASS + SHAPE.format('<sphere radius="100"/>')),
    "too many shapes": link3(MASS + 70 * SHAPE.format('<sphere radius="0.02"/>')),
    # masses
    "no mass": link3(LINK3.replace(MASS, "")),
    "a mass of nothing": link3(LINK3.replace('value="1.0"', 'value="0"')),
    "a mass below nothing": link3(LINK3.replace('value="1.0"', 'value="-1"')),
    "a mass that is no number": link3(LINK3.replace('value="1.0"', 'value="nan"')),
    "a mass without end": link3(LINK3.replace('value="1.0"', 'value="inf"')),
    "a mass too large to be": link3(LINK3.replace('value="1.0"', 'value="1e400"')),
    "a mass in another unit": link3(LINK3.replace('value="1.0"', 'value="1e-6"')),
    "an inertia too large to be": link3(LINK3.replace('ixx="0.01"', 'ixx="9e5"').replace('iyy="0.01"', 'iyy="9e5"')),
    "a ball of the largest number": link3(MASS + SHAPE.format('<box size="1e308 1e308 1e308"/>')),
    "an inertia without end": link3(LINK3.replace('ixx="0.01"', 'ixx="1e400"')),
    "an inertia that is no number": link3(LINK3.replace('ixx="0.01"', 'ixx="nan"')),
    "an inertia below nothing": link3(LINK3.replace('ixx="0.01"', 'ixx="-0.01"')),
    "an inertia that no body has": link3(LINK3.replace('ixx="0.01"', 'ixx="0.03"')),
    "products that no body has": link3(LINK3.replace('ixy="0.0"', 'ixy="0.02"')),
    "half an inertia": link3(LINK3.replace('ixy="0.0" ', "")),
    "two inertias": link3(MASS + LINK3),
    # joints
    "a joint without end": swapped('type="revolute"', 'type="continuous"'),
    "a sliding joint": swapped('type="revolute"', 'type="prismatic"'),
    "a floating joint": swapped('type="revolute"', 'type="floating"'),
    "a mimicked joint": swapped("<limit", '<mimic joint="j1"/><limit'),
    "no limits": simple(j3=joint("j3", "l2", "l3").replace('<limit lower="-2.0" upper="2.0" velocity="3.0" effort="50.0"/>', "")),
    "no lower limit": swapped('lower="-2.0" ', ""),
    "no speed": swapped('velocity="3.0"', 'velocity="0"'),
    "no torque": swapped('effort="50.0"', 'effort="0"'),
    "limits the wrong way round": swapped('lower="-2.0" upper="2.0"', 'lower="2.0" upper="-2.0"'),
    "limits that leave nothing": swapped('lower="-2.0" upper="2.0"', 'lower="0" upper="0"'),
    "limits beside nought": swapped('lower="-2.0"', 'lower="0.5"'),
    "limits in degrees": swapped('upper="2.0"', 'upper="120"'),
    "a limit that is no number": swapped('upper="2.0"', 'upper="nan"'),
    "a limit in words": swapped('upper="2.0"', 'upper="pi"'),
    "an axis without direction": swapped('<axis xyz="0.0 0.0 1.0"/>', '<axis xyz="0 0 0"/>'),
    "an axis of noise": swapped('<axis xyz="0.0 0.0 1.0"/>', '<axis xyz="0 1e-320 0"/>'),
    "an axis of two numbers": swapped('<axis xyz="0.0 0.0 1.0"/>', '<axis xyz="0 1"/>'),
    "two axes": swapped("<axis", '<axis xyz="1 0 0"/><axis'),
    "two parents": swapped("<parent", '<parent link="l5"/><parent'),
    "no child": swapped('<child link="l3"/>', ""),
    "offsets in millimetres": swapped('xyz="0.02 0.0 0.2"', 'xyz="20 0 200"'),
    # the chain
    "five joints": simple(j6=joint("j6", "l5", "l6", kind="fixed")),
    "seven joints": simple(
        l7=f'<link name="l7">{LINK3}</link>', j7=joint("j7", "l6", "l7", origin((0, 0, 0.2)))
    ),
    "a fork": simple(j6=joint("j6", "l4", "l6", origin((0, 0, 0.2)))),
    "a link that is not there": swapped('<child link="l3"/>', '<child link="l9"/>'),
    "a link on two joints": simple(more=joint("again", "l1", "l5", kind="fixed")),
    "a link on two joints beside one on itself": simple(
        more='<link name="x"/><link name="y"/>'
        + joint("xx", "x", "x", kind="fixed")
        + joint("y1", "l1", "y", kind="fixed")
        + joint("y2", "l2", "y", kind="fixed")
    ),
    "a link on nothing": simple(more='<link name="alone"/>'),
    "a ring": simple(more='<link name="a"/><link name="b"/>' + joint("ab", "a", "b", kind="fixed") + joint("ba", "b", "a", kind="fixed")),
    "a link twice": simple(more='<link name="l3"/>'),
    "the same link twice": simple(more=f'<link name="l3">{LINK3}</link>'),
    "the same joint twice": simple(more=joint("j3", "l2", "l3", origin((0.02, 0, 0.2)))),
    "a joint twice": simple(more='<link name="x"/>' + joint("j3", "l0", "x", kind="fixed")),
    "a capsule that is taken for the tool point": plain().replace('"l3"', '"tcp"'),
    "a capsule that is taken for a mass": plain().replace('"l3"', '"com_j3"'),
    "a capsule that is taken for the part": plain().replace('"l3"', '"payload"'),
    "a capsule of the tool's name": plain().replace('"l3"', '"stick_rod"'),
    "shapes with the same name": simple(
        l3=f'<link name="l3">{LINK3}{SHAPE.format(chr(60) + "sphere radius=" + chr(34) + "0.01" + chr(34) + "/>")}</link>',
        more=f'<link name="l3.1">{SHAPE.format(chr(60) + "sphere radius=" + chr(34) + "0.01" + chr(34) + "/>")}</link>'
        + joint("x", "l3", "l3.1", kind="fixed"),
    ),
    # the flange
    "no flange": plain().replace('"flange"', '"hand"'),
    "a flange beside the axis": swapped('xyz="0.0 0.0 0.08"', 'xyz="0.001 0.0 0.08"'),
    "a flange across the axis": swapped('xyz="0.0 0.0 0.08" rpy="0.0 0.0 0.0"', 'xyz="0.0 0.0 0.08" rpy="0.001 0.0 0.0"'),
    "a flange that looks back": swapped('xyz="0.0 0.0 0.08" rpy="0.0 0.0 0.0"', f'xyz="0.0 0.0 0.08" rpy="{math.pi} 0.0 0.0"'),
    "a flange before the last joint": simple(flange='<link name="flange"/>' + joint("jf", "l5", "flange", kind="fixed")),
}  # fmt: skip


@pytest.mark.parametrize("name", GUARDS)
def test_what_could_be_read_two_ways_is_refused(name):
    assert GUARDS[name] != plain()
    with pytest.raises(ModelError) as caught:
        reads(GUARDS[name])
    assert caught.value.reason == "PHYSICS_FAULT"


@pytest.mark.parametrize("seed", range(60))
def test_no_damage_is_more_than_a_refusal(seed):
    """Characters lost, doubled, changed, numbers made huge or tiny: a model that was validated, or a refusal."""
    rng = np.random.default_rng(seed)
    refused = 0
    for _ in range(20):
        text = random_arm(rng) if rng.random() < 0.3 else plain()
        for _ in range(rng.integers(1, 4)):
            at = int(rng.integers(len(text)))
            cut = int(rng.integers(0, 3))
            new = rng.choice(
                ["", "<", ">", '"', "&", "-", "0", "9", "e308", "e-308", "nan", "inf", " ", "\0", "é", "l3"]
            )
            text = text[:at] + str(new) + text[at + cut :]
        try:
            model = model_of(described(text), OUTFIT)
        except ModelError as error:
            refused += error.reason == "PHYSICS_FAULT"
        else:
            assert all(math.isfinite(x) for j in model.joints for x in (*j.offset_m, *j.rpy_rad, *j.com_m))
    assert refused >= 10


@pytest.mark.parametrize("base", ["l1", "flange", "nowhere"])
def test_the_base_is_fixed(base):
    with pytest.raises(ModelError):
        reads(plain(), replace(OUTFIT, base=base))


def test_others_drop_the_capsules_that_we_refuse():
    """Reason for a version: pinocchio reads the same text as an arm without any shape."""
    text = simple(version="")
    model = pinocchio.buildModelFromXML(text)
    assert len(pinocchio.buildGeomFromUrdfString(model, text, pinocchio.GeometryType.COLLISION).geometryObjects) == 0
    with pytest.raises(ModelError):
        reads(text)


def test_what_says_nothing_of_geometry_is_skipped():
    """Pictures, with files that are not there; simulation, transmissions; names of macros that were expanded."""
    more = (
        '<visual><geometry><mesh filename="package://x/none.dae"/></geometry></visual>'
        + '<visual><geometry><mesh filename="http://example.org/none.dae"/></geometry></visual>'
    )
    text = simple(
        l3=f'<link name="l3">{more}{LINK3}</link>',
        more='<gazebo reference="l3"><material>x</material></gazebo><transmission name="t"/><material name="m"/>',
    ).replace("<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"')
    for version in ("1.1", "1.2"):
        found = reads(text.replace('version="1.1"', f'version="{version}"')).model
        assert found.capsules == reads(plain()).model.capsules
        assert found.joints == reads(plain()).model.joints


def test_a_file_without_capsules_needs_no_version():
    text = simple(version="")
    for old in ("capsule ",):
        text = text.replace(f"<{old}", "<cylinder ")
    assert len(reads(text).model.capsules) == 7


def test_the_axis_is_x_where_none_is_stated():
    text = plain().replace('<axis xyz="0.0 1.0 0.0"/>', "", 1)
    model = pinocchio.buildModelFromXML(text)
    q = np.full((1, 6), 0.4)
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, q[0])
    rotation, _ = link_frames(reads(text), q)
    assert np.abs(rotation[0, 6] - data.oMf[model.getFrameId("flange")].rotation).max() <= 1e-12


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("schema = 1", "schema = 2"),
        ("schema = 1", "schema = 1\nmore = 1"),
        ('flange = "flange"', ""),
        ('flange = "flange"', "flange = 1"),
        ("payload_limit_kg = 3.0", "payload_limit_kg = nan"),
        ("payload_limit_kg = 3.0", "payload_limit_kg = 0.0"),
        ("payload_limit_kg = 3.0", 'payload_limit_kg = "3"'),
        ("acceleration_limit_rad_s2 = 40.0", "acceleration_limit_rad_s2 = -1.0"),
        ('shape = "edge"', 'shape = "round"'),
        ("mass_kg = 0.5", "mass_kg = 0.0"),
        ('why = "never"', 'why = "sometimes"'),
        ('why = "never"', ""),
        ("schema = 1", "schema = "),
        ("schema = 1", "schema = 1 #" + "x" * 300_000),
    ],
)
def test_an_outfit_of_another_form_is_refused(old, new):
    text = """
schema = 1
flange = "flange"
payload_limit_kg = 3.0
acceleration_limit_rad_s2 = 40.0

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

[[tools.capsules]]
name = "stick_rod"
a_m = [0.0, 0.0, 0.02]
b_m = [0.0, 0.01, 0.1]
radius_m = 0.02

[[apart]]
inner = "l0"
outer = "l2"
why = "never"
"""
    assert Outfit.from_toml(text) == replace(OUTFIT, apart=(Apart("l0", "l2", "never"),))
    assert old in text
    with pytest.raises(ModelError) as caught:
        reads(plain(), Outfit.from_toml(text.replace(old, new, 1)))
    assert caught.value.reason == "PHYSICS_FAULT"


def test_a_tool_that_is_not_there_is_refused():
    with pytest.raises(ModelError):
        robot_of(plain(), OUTFIT, tool="claw")
