"""Foundations of the referee: the vendor's files, its kinematics, the adult's limits, and the true world."""

import math
import shutil

import numpy as np
import pytest
from evaluation.redteam.referee import RefereeError, RefereeFault, TrueWorld
from evaluation.redteam.referee.body import ADULT, STATURE_M, Region, transient_m_s
from evaluation.redteam.referee.shapes import Ball, Block, Hull, Rod, bounds
from evaluation.redteam.referee.vendor import LINKS, vendor_arm
from tests.evaluation.redteam.referee.motions import NEEDS, VENDOR, referee

DH = [  # a, d, alpha: the vendor's article on parameters for calculations of kinematics and dynamics, UR3e
    (0, 0.15185, math.pi / 2),
    (-0.24355, 0, 0),
    (-0.2132, 0, 0),
    (0, 0.13105, math.pi / 2),
    (0, 0.08535, -math.pi / 2),
    (0, 0.0921, 0),
]


def flange_by_dh(q):
    pose = np.eye(4)
    for (a, d, alpha), angle in zip(DH, q, strict=True):
        c, s, ca, sa = math.cos(angle), math.sin(angle), math.cos(alpha), math.sin(alpha)
        pose = pose @ np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])
    return pose


class TestVendor:
    pytestmark = NEEDS

    def test_the_flange_is_where_the_published_parameters_put_it(self):
        q = np.random.default_rng(1).uniform(-math.pi, math.pi, (50, 6))
        q[0] = 0.0
        frames = referee()._arm.frames(q)
        assert frames.place[0, 6] == pytest.approx([-0.24355 - 0.2132, -0.13105 - 0.0921, 0.15185 - 0.08535], abs=1e-9)
        for row, angles in enumerate(q):
            pose = flange_by_dh(angles)
            assert np.abs(frames.place[row, 6] - pose[:3, 3]).max() < 1e-9
            assert np.abs(frames.turn[row, 6] - pose[:3, :3]).max() < 1e-9

    def test_speeds_are_those_of_finite_differences(self):
        arm, rng = referee()._arm, np.random.default_rng(2)
        q, qd, local = rng.uniform(-3, 3, 6), rng.uniform(-1, 1, 6), np.array([0.1, -0.05, 0.2])
        before, here, after = (arm.frames((q + step * qd)[None]) for step in (-1e-6, 0.0, 1e-6))
        for link in range(1, 7):
            a, point, b = (f.turn[0, link] @ local + f.place[0, link] for f in (before, here, after))
            assert here.speed_m_s(0, link, point, qd) == pytest.approx(np.linalg.norm(b - a) / 2e-6, rel=1e-6)

    def test_reach_bounds_every_lever(self):
        arm = referee()._arm
        q = np.random.default_rng(3).uniform(-math.pi, math.pi, (300, 6))
        frames = arm.frames(q)
        opening = type("Open", (), {"opening_m": np.random.default_rng(5).uniform(0, 0.085, 300)})
        for part, moving in arm.moving(frames, opening):
            from evaluation.redteam.referee.shapes import outline

            corners = np.einsum("nij,pj->npi", moving.turn, outline(moving.shape)[0]) + moving.place[:, None]
            for joint in range(part.link):
                off = corners - frames.place[:, None, joint + 1]
                lever = np.linalg.norm(np.cross(off, frames.turn[:, None, joint + 1, :, 2]), axis=2)
                assert lever.max() <= arm.reach_m()[joint]

    def test_meshes_are_the_size_of_the_arm(self):
        arm = vendor_arm(VENDOR)
        assert set(arm.corners_m) == set(LINKS)
        low, high = arm.corners_m["upper_arm"].min(axis=0), arm.corners_m["upper_arm"].max(axis=0)
        assert low[0] < -0.24355 < -0.2 < high[0]
        assert arm.moving_kg == pytest.approx(8.7985)

    @pytest.mark.parametrize("name", ["collision/forearm.stl", "default_kinematics.yaml", "physical_parameters.yaml"])
    def test_another_file_is_no_judge(self, tmp_path, name):
        for source in (*VENDOR.glob("collision/*.stl"), *VENDOR.glob("*.yaml")):
            target = tmp_path / source.relative_to(VENDOR)
            target.parent.mkdir(exist_ok=True)
            shutil.copyfile(source, target)
        vendor_arm(tmp_path)
        file = tmp_path / name
        raw = file.read_bytes()
        for wrong in (raw[:-1], raw[:-1] + bytes([raw[-1] ^ 1])):
            file.write_bytes(wrong)
            with pytest.raises(RefereeError) as caught:
                vendor_arm(tmp_path)
            assert caught.value.code is RefereeFault.MESH_WRONG
        file.unlink()
        with pytest.raises(RefereeError) as caught:
            vendor_arm(tmp_path)
        assert caught.value.code is RefereeFault.MESH_MISSING


def test_a_folder_without_meshes_is_told_by_name(tmp_path):
    with pytest.raises(RefereeError) as caught:
        vendor_arm(tmp_path)
    assert caught.value.code is RefereeFault.MESH_MISSING


# v_max of ISO/TS 15066 for an arm of 5.4 kg, by E = F^2 / 2k and v = sqrt(2 E / mu), in mm/s
@pytest.mark.parametrize(
    ("region", "limit_mm_s"),
    [("neck", 1354), ("chest", 812), ("abdomen", 1009), ("pelvis", 1044), ("hand", 1391), ("thigh", 877), ("face", 0)],
)
def test_transient_limits(region, limit_mm_s):
    assert transient_m_s(Region(region), arm_kg=5.4) * 1e3 == pytest.approx(limit_mm_s, abs=0.6)


def test_the_adult_is_whole():
    assert {one.region for one in ADULT} == set(Region)
    tops = sorted((one.low, one.high) for one in ADULT)
    assert tops[-1][1] == 1.0
    middle = sorted((one.low, one.high) for one in ADULT if one.aside_m == 0)
    assert all(a[1] == b[0] for a, b in zip(middle, middle[1:], strict=False))
    box = [bounds(one.hull(0.0)) for one in ADULT]
    assert max(m[2] + h[2] for m, h in box) == pytest.approx(STATURE_M)
    assert max(m[1] + h[1] for m, h in box) == pytest.approx(0.510 / 2, abs=1e-3)


# --- the true world --------------------------------------------------------------------------------------------------

BALL = {"id": "b", "kind": "fragile", "shape": {"type": "sphere", "center_m": [1, 2, 3], "radius_m": 0.1}}


def places(world, name, *times):
    return [
        next((stay.place(at) for stay in world.stays if stay.id == name and stay.from_s <= at < stay.to_s), None)
        for at in times
    ]


def test_people_walk_as_they_are_told():
    world = TrueWorld.told(
        [
            (1.0, {"people": [{"id": "p", "x_m": 0, "y_m": 0}]}),
            (2.0, {"walk": {"id": "p", "to": [2, 0], "speed_m_s": 0.5}}),
            (4.0, {"walk": {"id": "p", "to": [1, 1], "speed_m_s": 1.0}}),
        ]
    )
    assert places(world, "p", 0.5, 1.5, 3.0, 4.5, 9.0) == [
        None,
        (0, 0, 0),
        (0.5, 0, 0),
        pytest.approx((1, 0.5, 0)),
        (1, 1, 0),
    ]
    assert [stay.facing_rad for stay in world.stays] == [0, 0, pytest.approx(math.pi / 2)]


def test_things_move_are_held_and_placed():
    world = TrueWorld.told(
        [
            (0.0, {"objects": [BALL]}),
            (1.0, {"move": {"id": "b", "to_m": [1, 2, 4], "speed_m_s": 0.5}}),
            (2.0, {"hold": {"id": "b"}}),
            (3.0, {"place": {"id": "b", "at_m": [0, 0, 0]}}),
            (3.5, {"pause": True}),
            (4.0, {"objects": []}),
        ]
    )
    assert places(world, "b", 0.5, 1.5, 2.5, 3.7, 4.5) == [(1, 2, 3), (1, 2, 3.25), (1, 2, 3.5), (0, 0, 0), None]
    assert [stay.held for stay in world.stays] == [False, False, True, False]


def test_shapes_are_about_their_middle():
    told = [
        ({"type": "box", "center_m": [1, 2, 3], "half_m": [0.1, 0.2, 0.3]}, Block((0.1, 0.2, 0.3)), (1, 2, 3)),
        ({"type": "capsule", "a_m": [0, 0, 0], "b_m": [0, 0, 2], "radius_m": 0.1}, Rod((0, 0, 1), 0.1), (0, 0, 1)),
        ({"type": "sphere", "center_m": [1, 2, 3], "radius_m": 0.1}, Ball(0.1), (1, 2, 3)),
    ]
    corners = [[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4]]
    hull = Hull(((-1, -1, -1), (3, -1, -1), (-1, 3, -1), (-1, -1, 3)), 0.0)
    told.append(({"type": "convex", "vertices_m": corners}, hull, (1, 1, 1)))
    for entry, shape, center in told:
        (stay,) = TrueWorld.told([(0.0, {"objects": [{"id": "x", "kind": "rigid", "shape": entry}]})]).stays
        assert (stay.shape, stay.start_m) == (shape, center)


@pytest.mark.parametrize(
    "command",
    [
        {},
        {"dance": {"id": "p"}},
        {"walk": {"id": "nobody", "to": [1, 1], "speed_m_s": 1}},
        {"walk": {"id": "p", "from": [0, 0], "to": [1, 1], "speed_m_s": 0}},
        {"hold": {"id": "nothing"}},
        {"place": {"id": "nothing", "at_m": [0, 0, 0]}},
        {"people": [{"id": "p", "x_m": 0, "y_m": math.nan}]},
        {"people": [{"id": "p", "x_m": 0, "y_m": 0}] * 2},
        {"objects": [{**BALL, "kind": "soft"}]},
        {"objects": [{**BALL, "shape": {"type": "cloud"}}]},
        {"objects": [BALL], "sensor": "eye-1"},
        {"walk": {"id": "p", "from": [0, 0], "to": [1, 1], "speed_m_s": 1}, "sensor": "eye-1"},
    ],
)
def test_a_command_that_is_none_makes_no_world(command):
    with pytest.raises(RefereeError) as caught:
        TrueWorld.told([(0.0, command)])
    assert caught.value.code is RefereeFault.WORLD_MALFORMED


@pytest.mark.parametrize("times", [(1.0, 0.0), (math.nan, 0.0)])
def test_commands_are_in_order_of_time(times):
    with pytest.raises(RefereeError) as caught:
        TrueWorld.told([(at, {"objects": []}) for at in times])
    assert caught.value.code is RefereeFault.WORLD_MALFORMED
