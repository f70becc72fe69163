"""The arms beside the UR3e: the vendor's numbers, capsules around the vendor's meshes, and pairs that are left out."""

import math
import re
from dataclasses import replace

import numpy as np
import pinocchio
import pytest
from pep.pit.geometry.clearance import segment_segment
from pep.pit.geometry.triangle_mesh import mesh_of
from pep.pit.robot.kinematics import link_frames
from pep.pit.robot.mesh_cover import depths, excess_of, lines_of, uncovered
from tests.pep.pit.robot import vendor_urdf
from tests.pep.pit.robot.vendor_urdf import LINKS, ROBOTS, TURNING, read, refitted
from tests.shared_data import SHARED

from pep.pit import Robot

ARMS = ("ur5e", "ur10e", "ur16e")
needs_vendor = pytest.mark.skipif(
    not (SHARED / "ur16e").is_dir(), reason="vendor files are not beside the checkout (../shared/data)"
)
HALF = math.pi / 2


def kept(model, link):
    """Triangles of the vendor's mesh in the frame of the link: the vendor's macro, urdf/ur_macro.xacro."""
    meshes, offsets = read(model, "visual_parameters")["mesh_files"], read(model, "physical_parameters")["offsets"]
    place = {
        "base": ((0, 0, 0), (0, 0, math.pi)),
        "shoulder": ((0, 0, 0), (0, 0, math.pi)),
        "upper_arm": ((0, 0, offsets["shoulder_offset"]), (HALF, 0, -HALF)),
        "forearm": ((0, 0, offsets["elbow_offset"]), (HALF, 0, -HALF)),
        **{
            f"wrist_{k}": ((0, 0, meshes[f"wrist_{k}"]["visual_offset"]), (0 if k == 2 else HALF, 0, 0))
            for k in (1, 2, 3)
        },
    }
    xyz, rpy = place[link]
    file = SHARED / meshes[link]["collision"]["mesh"]["path"].removeprefix("meshes/")
    return mesh_of(file.read_bytes(), file.name) @ pinocchio.rpy.rpyToMatrix(*map(float, rpy)).T + np.array(xyz)


@needs_vendor
@pytest.mark.shared
@pytest.mark.parametrize("name", ARMS)
def test_every_point_of_the_vendors_meshes_is_in_a_capsule_of_its_link(name):
    """By proof, not by samples: and were the capsules 1 mm thinner, it would not be so."""
    robot = Robot.load(name)
    for number, link in enumerate(("base", *LINKS)):
        triangles = kept(name, link)
        lines = lines_of([c for c in robot.model.capsules if c.link == number])
        assert uncovered(triangles, lines) == 0, link
        deepest = np.max([depths(triangles.reshape(-1, 3), each) for each in lines], axis=0)
        assert deepest.min() >= 0.0005 - 1e-9
        if len(lines) == 1:  # where there are several, another one may have it
            assert uncovered(triangles, [(a, b, radius - 0.001) for a, b, radius in lines]) > 0, link


@needs_vendor
@pytest.mark.shared
@pytest.mark.parametrize(("name", "link"), [("ur5e", "wrist_3"), ("ur10e", "wrist_2"), ("ur16e", "base")])
def test_the_capsules_reach_no_farther_over_the_mesh_than_the_file_says(name, link):
    number = ("base", *LINKS).index(link)
    lines = lines_of([c for c in Robot.load(name).model.capsules if c.link == number])
    stated = re.search(rf"^#  +{link}: (\d+) mm", (ROBOTS / f"{name}.toml").read_text(), re.MULTILINE)
    found = excess_of(kept(name, link), lines)
    assert 1000 * found.most_m <= int(stated[1]) + 0.5
    assert 1000 * found.least_m >= int(stated[1]) - 3


@needs_vendor
@pytest.mark.shared
@pytest.mark.parametrize("name", ARMS)
def test_kinematics_masses_and_limits_are_the_vendors(name):
    robot, masses = Robot.load(name), read(name, "physical_parameters")["inertia_parameters"]
    assert [j.mass_kg for j in robot.model.joints] == [masses[f"{link}_mass"] for link in LINKS]
    limits = list(read(name, "joint_limits")["joint_limits"].values())
    assert [each["max_effort"] for each in limits] == robot.torque_limits_nm.tolist()
    assert [each["max_velocity"] for each in limits] == pytest.approx(robot.speed_limits_rad_s.tolist())
    assert [each["max_position"] for each in limits] == pytest.approx(
        [j.position_limit_rad for j in robot.model.joints]
    )
    chain = read(name, "default_kinematics")["kinematics"]
    frame = np.eye(4)
    q = np.random.default_rng(1).uniform(-3, 3, 6)
    for link, angle in zip(LINKS, q, strict=True):
        k = chain[link]
        step = np.eye(4)
        step[:3, :3] = pinocchio.rpy.rpyToMatrix(k["roll"], k["pitch"], k["yaw"]) @ pinocchio.rpy.rpyToMatrix(
            0, 0, angle
        )
        step[:3, 3] = k["x"], k["y"], k["z"]
        frame = frame @ step
    rotation, origin = link_frames(robot, q[None])
    assert np.abs(rotation[0, 6] - frame[:3, :3]).max() <= 1e-9
    assert np.abs(origin[0, 6] - frame[:3, 3]).max() <= 1e-9


@pytest.mark.campaign
@needs_vendor
@pytest.mark.shared
@pytest.mark.long
def test_the_file_is_what_a_fit_makes_of_the_vendors_files():
    """Every number of the UR5e, and its pairs; of what a search finds the last digits may differ."""
    found, shipped = refitted("ur5e").model, Robot.load("ur5e").model
    assert [replace(j, position_low_rad=None) for j in found.joints] == list(shipped.joints)
    assert found.tools == shipped.tools
    assert found.self_pairs == shipped.self_pairs
    for ours, theirs in zip(found.capsules, shipped.capsules, strict=True):
        assert (ours.name, ours.link) == (theirs.name, theirs.link)
        assert ours.radius_m == pytest.approx(theirs.radius_m, abs=0.0003)
        assert np.abs(np.array([ours.a_m, ours.b_m]) - [theirs.a_m, theirs.b_m]).max() <= 0.003


@pytest.mark.parametrize("tool", ["robotiq_2f85", "robotiq_hande"])
@pytest.mark.parametrize("name", ARMS)
def test_pairs_left_out_do_not_come_to_touch(name, tool):
    """Fresh random poses keep them apart.

    Links with one link between them, whose joints turn all the way round, are left out for that reason.
    """
    robot = Robot.load(name, tool=tool)
    listed = {(robot.bodies[body].name, inner.name) for body, inner in robot.self_pairs}
    q = np.random.default_rng(6).uniform(*robot.position_ranges_rad, (3000, 6))
    rotation, origin = link_frames(robot, q)
    turning = {(each.inner, each.outer) for each in TURNING}

    def ends(c):
        return [rotation[:, c.link] @ np.array(p) + origin[:, c.link] for p in (c.a_m, c.b_m)]

    left = 0
    for outer in robot.capsules:
        for inner in robot.capsules:
            if outer.link - inner.link < 2 or (outer.name, inner.name) in listed:
                continue
            if (inner.name.partition(".")[0], outer.name.partition(".")[0]) in turning:
                low, high = robot.position_ranges_rad
                assert (high - low)[inner.link : outer.link].min() >= 2.5 * math.pi
                continue
            left += 1
            on_outer, on_inner = segment_segment(*ends(outer), *ends(inner))
            gap = np.linalg.norm(on_outer - on_inner, axis=1) - outer.radius_m - inner.radius_m
            assert gap.min() > 0, (outer.name, inner.name)
    assert left >= 1


def test_every_arm_has_its_licence_beside_it():
    text = (ROBOTS / "LICENSE.universal-robots").read_text()
    assert "Redistribution and use in source and binary forms" in text
    assert vendor_urdf.PAYLOAD_KG.keys() == {*ARMS}
