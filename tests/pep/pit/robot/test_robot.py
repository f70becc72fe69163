"""The model file, what is derived from it, and what a model must not be."""

from tests.shared_data import SHARED
import math
import re
import struct
from dataclasses import replace
from importlib import resources

import numpy as np
import pinocchio
import pytest
from pep.pit.robot.kinematics import layout, link_frames, poses
from pep.pit.scene.pairs import pairs_of
from tests.model.pit.path import NumpyPath
from tests.pep.pit.scenes import CELL, ROBOT, random_move

from pep.pit import ModelError, MoveJ, Robot, Scene

pytestmark = pytest.mark.version

TEXT = (resources.files("pep.pit") / "robots" / "ur3e.toml").read_text()
VENDOR = SHARED / "ur3e"
needs_vendor = pytest.mark.skipif(
    not VENDOR.is_dir(), reason="vendor meshes are not beside the checkout (../shared/data/ur3e)"
)

DH = [  # a, d, alpha: the vendor's article on DH parameters
    (0, 0.15185, math.pi / 2),
    (-0.24355, 0, 0),
    (-0.2132, 0, 0),
    (0, 0.13105, math.pi / 2),
    (0, 0.08535, -math.pi / 2),
    (0, 0.0921, 0),
]


def dh_flange(q):
    pose = np.eye(4)
    for (a, d, alpha), angle in zip(DH, q, strict=True):
        c, s, ca, sa = math.cos(angle), math.sin(angle), math.cos(alpha), math.sin(alpha)
        pose = pose @ np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])
    return pose


def test_forward_kinematics_equals_the_vendors_dh_chain():
    q = np.random.default_rng(1).uniform(-2 * math.pi, 2 * math.pi, (200, 6))
    rotation, origin = link_frames(ROBOT, q)
    for row in range(len(q)):
        flange = dh_flange(q[row])
        assert np.abs(rotation[row, 6] - flange[:3, :3]).max() <= 1e-12
        assert np.abs(origin[row, 6] - flange[:3, 3]).max() <= 1e-12


def test_pinocchio_is_built_from_the_same_numbers():
    model, data = ROBOT.pinocchio, ROBOT.pinocchio.createData()
    for q in np.random.default_rng(2).uniform(-3, 3, (50, 6)):
        pinocchio.framesForwardKinematics(model, data, q)
        flange = data.oMf[model.getFrameId("flange")].homogeneous
        assert np.abs(flange - dh_flange(q)).max() <= 1e-12
    assert sum(i.mass for i in model.inertias) == pytest.approx(8.7985 + 1.0)


def test_reach_bounds_every_lever():
    """At any pose no body end is farther from a joint's axis than `reach`; and the bound is not idle."""
    q = np.random.default_rng(3).uniform(-2 * math.pi, 2 * math.pi, (4000, 6))
    rotation, origin = link_frames(ROBOT, q)
    plan = layout(ROBOT)
    ends = np.einsum("nbij,bej->nbei", rotation[:, plan.link], plan.ends) + origin[:, plan.link, None]
    for k in range(1, 7):
        lever = np.linalg.norm(np.cross(ends - origin[:, k, None, None], rotation[:, k, None, None, :, 2]), axis=-1)
        worst = lever.max(axis=(0, 2))
        moved = plan.moved_by[:, k - 1] > 0
        assert (worst[moved] <= ROBOT.reach[moved, k - 1] + 1e-12).all()
        assert (ROBOT.reach[moved, k - 1] <= 1.9 * worst[moved] + 0.01).all()
        assert (ROBOT.reach[~moved, k - 1] == 0).all()


def test_inertia_is_the_whole_tensor():
    """Products of inertia reach pinocchio with their sign, at the joint that carries them."""
    turned = TEXT.replace(
        "com_m = [0.0, 0.01, 0.0]           # U2",
        "com_m = [0.0, 0.01, 0.0]\ninertia_products_kg_m2 = [1e-4, -2e-4, 3e-4]",
    )
    inertia = Robot.from_toml(turned, tool="robotiq_2f85").pinocchio.inertias[5].inertia
    assert inertia.tolist() == [[2.085e-3, 1e-4, -2e-4], [1e-4, 2.085e-3, 3e-4], [-2e-4, 3e-4, 2.25e-3]]


def test_limits_may_differ_either_way():
    """The room, the dynamics and the digest know both."""
    text = TEXT.replace(
        "position_limit_rad = 3.141592653589793", "position_low_rad = -2.0\nposition_limit_rad = 3.0", 1
    )
    robot = Robot.from_toml(text, tool="robotiq_2f85")
    assert [each[2] for each in robot.position_ranges_rad] == [-2.0, 3.0]
    assert robot.beyond_rad((0.0, 0.0, -2.5, 0.0, 0.0, 0.0)) == [0, 0, -0.5, 0, 0, 0]
    assert robot.beyond_rad((0.0, 0.0, 3.5, 0.0, 0.0, 0.0)) == [0, 0, 0.5, 0, 0, 0]
    assert not any(robot.beyond_rad((0.0, 0.0, 2.5, 0.0, 0.0, 0.0)))
    assert (robot.pinocchio.lowerPositionLimit[2], robot.pinocchio.upperPositionLimit[2]) == (-2.0, 3.0)
    assert robot.model_digest != ROBOT.model_digest
    assert (-ROBOT.position_ranges_rad[0]).tolist() == ROBOT.position_ranges_rad[1].tolist()


@pytest.mark.long
def test_bending_bounds_derivatives_along_random_paths():
    """Second and third differences of body ends, and second ones of the spin, stay under their bounds."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        path = NumpyPath(ROBOT, random_move(rng))
        h = 1e-3
        s = np.linspace(0, 1, 400)[:, None]
        around = [
            poses(ROBOT, path.layout, path.start + (s + k * h) * path.delta, path.delta) for k in (-2, -1, 0, 1, 2)
        ]
        a, b, c, d, e = (p.ends for p in around)
        second = np.linalg.norm(b - 2 * c + d, axis=-1).max(axis=(0, 2)) / h**2
        third = np.linalg.norm(e - 2 * d + 2 * b - a, axis=-1).max(axis=(0, 2)) / (2 * h**3)
        assert (second <= path.bending.second + 1e-6).all()
        assert (third <= path.bending.third * 1.001 + 1e-5).all()
        spin = np.stack([p.spin for p in around])
        assert (np.abs(spin[3] - spin[1]).max(axis=0) / (2 * h) <= path.bending.second.max() * 1e3).all()


def test_speed_and_spin_are_those_of_finite_differences():
    path = NumpyPath(ROBOT, random_move(np.random.default_rng(5)))
    h = 1e-6
    for s in (0.1, 0.5, 0.9):
        before, here, after = (poses(ROBOT, path.layout, path.q(s + k * h)[None], path.delta) for k in (-1, 0, 1))
        speed = np.linalg.norm(after.ends - before.ends, axis=-1).max(axis=2) / (2 * h)
        assert np.allclose(speed, here.speed, atol=1e-6)


MESHES = [  # mesh frames in link frames: vendor description, config/ur3e/visual_parameters.yaml
    ("base", 0, (0, 0, 0), (0, 0, 0)),
    ("shoulder", 1, (0, 0, 0), (0, 0, math.pi)),
    ("upperarm", 2, (0, 0, 0.12), (math.pi / 2, 0, -math.pi / 2)),
    ("forearm", 3, (0, 0, 0.027), (math.pi / 2, 0, -math.pi / 2)),
    ("wrist1", 4, (0, 0, -0.104), (math.pi / 2, 0, 0)),
    ("wrist2", 5, (0, 0, -0.08535), (0, 0, 0)),
    ("wrist3", 6, (0, 0, -0.0921), (math.pi / 2, 0, 0)),
]


def triangles_of(mesh, xyz, rpy):
    """Corners of the vendor's collision mesh in the frame of its link, shape (n, 3, 3)."""
    raw = (VENDOR / "collision" / f"{mesh}.stl").read_bytes()
    (count,) = struct.unpack_from("<I", raw, 80)
    triangles = np.frombuffer(raw, dtype=np.dtype([("n", "<3f4"), ("v", "<9f4"), ("a", "<u2")]), count=count, offset=84)
    return triangles["v"].reshape(-1, 3, 3).astype(float) @ pinocchio.rpy.rpyToMatrix(*rpy).T + np.array(xyz)


def outside(points, capsules):
    """Distance of each point from the union of the capsules, negative inside."""
    found = np.full(len(points), np.inf)
    for capsule in capsules:
        a, b = np.array(capsule.a_m), np.array(capsule.b_m)
        along = np.clip((points - a) @ (b - a) / max(((b - a) ** 2).sum(), 1e-30), 0, 1)
        found = np.minimum(found, np.linalg.norm(points - a - along[:, None] * (b - a), axis=1) - capsule.radius_m)
    return found


@needs_vendor
@pytest.mark.shared
@pytest.mark.parametrize(("mesh", "link", "xyz", "rpy"), MESHES)
def test_capsules_contain_the_vendors_mesh(mesh, link, xyz, rpy):
    """Every vertex of the vendor's collision mesh lies at least 0.5 mm deep in a capsule of its link.

    No capsule of a tool counts.

    So do the faces between them, but for the two long links: there the vendor's mesh is the convex hull over both
    housings, and the tube between them, which our capsules follow, is up to 24.6 mm thinner.
    """
    triangles = triangles_of(mesh, xyz, rpy)
    own = [c for c in ROBOT.model.capsules if c.link == link]
    assert len(triangles) >= 100
    assert outside(triangles.reshape(-1, 3), own).max() <= -0.5e-3
    weights = np.random.default_rng(7).dirichlet([1, 1, 1], (len(triangles), 20))
    faces = np.einsum("tki,tij->tkj", weights, triangles).reshape(-1, 3)
    assert outside(faces, own).max() <= (0.0246 if mesh in ("upperarm", "forearm") else -0.5e-3)


@needs_vendor
@pytest.mark.shared
@pytest.mark.parametrize(("mesh", "link", "xyz", "rpy"), MESHES)
def test_capsules_reach_no_farther_over_the_mesh_than_stated(mesh, link, xyz, rpy):
    """The capsules' surface lies at most 48.5 mm off the vendor's mesh: nothing is lost by overhang that nobody stated."""
    triangles = triangles_of(mesh, xyz, rpy)
    own = [c for c in ROBOT.model.capsules if c.link == link]
    rng = np.random.default_rng(8)
    surface = []
    for capsule in own:
        a, b = np.array(capsule.a_m), np.array(capsule.b_m)
        way = rng.normal(size=(150, 3))
        way /= np.linalg.norm(way, axis=1)[:, None]
        surface.append(np.where((way @ (b - a))[:, None] > 0, b, a) + capsule.radius_m * way)
    points = np.concatenate(surface)
    points = points[outside(points, own) >= -1e-9]
    over = np.array([distance_to(triangles, point) for point in points])
    assert len(points) >= 100
    assert over.max() <= 0.0485
    assert over.mean() <= 0.014


JOINTS_AT_M = {2: (0.0, ROBOT.model.joints[2].offset_m[0]), 3: (0.0, ROBOT.model.joints[3].offset_m[0])}
"""Places along x of the two joints' axes of each long link."""
TUBES_M = {"upper_arm_tube": 0.033, "forearm_tube": 0.027}  # radii in the vendor's visual meshes


def directions(count):
    """Directions evenly over the ball, (n, 3)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, math.pi * (1 + 5**0.5) * k
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


@needs_vendor
@pytest.mark.shared
@pytest.mark.parametrize(("mesh", "link", "xyz", "rpy"), MESHES)
def test_a_capsule_drawn_in_by_its_overhang_is_inside_the_vendors_mesh(mesh, link, xyz, rpy):
    """In no direction does it reach farther than the convex mesh; the number is within 1 mm of the least.

    Of the two long links the mesh is the hull over both housings, so a housing's capsule is held against the corners of
    its own half, also turned over its joint's axis, and a tube's against the tube.
    """
    triangles = triangles_of(mesh, xyz, rpy)
    corners = triangles.reshape(-1, 3)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals = normals[np.linalg.norm(normals, axis=1) > 1e-12]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    ways = np.concatenate([directions(8000), normals, normals * (-1, 1, 1)])
    stated = [c for c in ROBOT.model.capsules if c.link == link]
    assert [c.overhang_m is None for c in stated] == [link == 0] * len(stated)
    for capsule in stated if link else []:
        a, b = np.array(capsule.a_m), np.array(capsule.b_m)
        reached = np.maximum(ways @ a, ways @ b) + capsule.radius_m
        around = corners
        if capsule.name in TUBES_M:
            assert capsule.radius_m - capsule.overhang_m == pytest.approx(TUBES_M[capsule.name] - 0.002)
        elif link in JOINTS_AT_M:
            near, far = sorted(JOINTS_AT_M[link], key=lambda x: abs(x - a[0]))  # noqa: B023 - used at once
            half = corners[np.abs(corners[:, 0] - near) < np.abs(corners[:, 0] - far)]
            around = np.concatenate([half, half * (-1, 1, 1) + (2 * near, 0, 0)])
        over = float((reached - (ways @ around.T).max(axis=1)).max())
        assert over <= capsule.overhang_m < (over + 0.001 if capsule.name not in TUBES_M else capsule.radius_m)


def distance_to(triangles, point):
    """Distance of a point from the nearest of the triangles."""
    a, b, c = (triangles[:, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    real = np.linalg.norm(normal, axis=1) > 1e-14
    a, b, c, normal = a[real], b[real], c[real], normal[real]
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    height = ((point - a) * normal).sum(1)
    foot = point - height[:, None] * normal
    inside, nearest = np.ones(len(a), bool), np.full(len(a), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge = end - start
        inside &= (np.cross(edge, foot - start) * normal).sum(1) >= 0
        along = np.clip(((point - start) * edge).sum(1) / (edge**2).sum(1), 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(point - start - along[:, None] * edge, axis=1))
    return np.where(inside, np.abs(height), nearest).min()


HAND_E = Robot.load("ur3e", tool="robotiq_hande")


def test_the_hand_e_is_enclosed():
    """The rims of the cylinders that its sources state (G4, G6 in ur3e.toml), in the frame of the flange."""
    angle = np.linspace(0, 2 * math.pi, 100)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    stated = [
        (0.0385, -0.003, 0.0139),  # coupler
        (0.0417, 0.0112, 0.1104),  # body
        (0.0380, 0.0951, 0.1570),  # jaws at every opening
    ]
    for radius, low, high in stated:
        for z in np.linspace(low, high, 60):
            assert outside(radius * ring + [0, 0, z], HAND_E.tool.capsules).max() <= -1e-3
    assert outside(np.array([HAND_E.tool.tcp_m]), HAND_E.tool.capsules)[0] < 0


def test_the_hand_e_has_its_own_numbers():
    tool, other = HAND_E.tool, ROBOT.tool
    assert (tool.width_limit_m, tool.force_min_n, tool.force_limit_n) == (0.050, 60.0, 185.0)
    assert tool.pad_m < other.pad_m
    assert HAND_E.model_digest != ROBOT.model_digest
    assert sum(i.mass for i in HAND_E.pinocchio.inertias) == pytest.approx(8.7985 + 1.06)


@needs_vendor
@pytest.mark.shared
def test_masses_and_limits_are_the_vendors():
    masses = (VENDOR / "physical_parameters.yaml").read_text()
    for joint, name in zip(
        ROBOT.model.joints, ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"), strict=True
    ):
        assert float(re.search(rf"^  {name}_mass: ([\d.]+)", masses, re.MULTILINE)[1]) == joint.mass_kg
    limits = (VENDOR / "joint_limits.yaml").read_text()
    efforts = [float(x) for x in re.findall(r"max_effort: ([\d.]+)", limits)]
    speeds = [math.radians(float(x)) for x in re.findall(r"max_velocity: !degrees +([\d.]+)", limits)]
    assert efforts == ROBOT.torque_limits_nm.tolist()
    assert speeds == pytest.approx(ROBOT.speed_limits_rad_s.tolist())


@pytest.mark.parametrize("robot", [ROBOT, HAND_E], ids=["2F-85", "Hand-E"])
def test_pairs_left_out_do_not_come_to_touch(robot):
    """Links that are not neighbours and not in `self_pairs`: fresh random poses keep them apart."""
    listed = {(robot.bodies[body].name, inner.name) for body, inner in robot.self_pairs}
    q = np.random.default_rng(6).uniform(-math.pi, math.pi, (3000, 6))
    rotation, origin = link_frames(robot, q)

    def ends(c):
        return [rotation[:, c.link] @ np.array(p) + origin[:, c.link] for p in (c.a_m, c.b_m)]

    from pep.pit.geometry.clearance import segment_segment

    for outer in robot.capsules:
        for inner in robot.capsules:
            if outer.link - inner.link >= 2 and (outer.name, inner.name) not in listed:
                on_outer, on_inner = segment_segment(*ends(outer), *ends(inner))
                gap = np.linalg.norm(on_outer - on_inner, axis=1) - outer.radius_m - inner.radius_m
                assert gap.min() > 0, (outer.name, inner.name)


def test_the_digest_names_the_content():
    same = Robot.from_toml(TEXT + "\n# a comment\n", tool="robotiq_2f85")
    other = Robot.from_toml(TEXT.replace("radius_m = 0.069 ", "radius_m = 0.070 ", 1), tool="robotiq_2f85")
    assert same.model_digest == ROBOT.model_digest != other.model_digest
    assert re.fullmatch("[0-9a-f]{64}", ROBOT.model_digest)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("link = 4", "link = 5"),  # wrist 1 without geometry would be "all clear"
        ("link = 0", "link = 7"),
        ("radius_m = 0.069 ", "radius_m = 0.0 "),
        ("radius_m = 0.069 ", "radius_m = -0.1 "),
        ("radius_m = 0.069 ", "radius_m = nan "),
        ("radius_m = 0.069 ", "radius_m = 69.0 "),
        ("mass_kg = 1.98 ", "mass_kg = 0.0 "),
        ("mass_kg = 1.98 ", 'mass_kg = "1.98" '),
        ("mass_kg = 1.98 ", "mass_kg = true "),
        ("mass_kg = 1.98 ", "mass = 1.98 "),
        ("mass_kg = 1.98 ", "mass_kg = 1.98\nextra = 1 "),
        ("speed_limit_rad_s = 3.141592653589793 ", "speed_limit_rad_s = inf "),
        ("torque_limit_nm = 54.0 ", "torque_limit_nm = -54.0 "),
        ('name = "shoulder"', 'name = "base"'),
        ('"wrist_1", "wrist_2", "wrist_3", "tool"]   #', '"wrist_9"]   #'),
        ("schema = 1", "schema = 2"),
        ("schema = 1", f'schema = 1\nderived_from = [{{ kind = "urdf", sha256 = "{64 * "0"}" }}]'),
        ("schema = 1", "schema = "),
        ('shape = "blunt"', 'shape = "soft"'),
        ("position_limit_rad = 3.141592653589793 ", "position_low_rad = 0.1\nposition_limit_rad = 3.0 "),
        ("position_limit_rad = 3.141592653589793 ", "position_low_rad = 0.0\nposition_limit_rad = 0.0 "),
        ("inertia_kg_m2 = [2.085e-3, 2.085e-3, 2.25e-3]", "inertia_kg_m2 = [1e-3, 1e-3, 2.25e-3]"),
        ("com_m = [0.0, -0.01, 0.0] ", "inertia_products_kg_m2 = [3e-3, 0.0, 0.0]\ncom_m = [0.0, -0.01, 0.0] "),
        ("inertia_kg_m2 = [2.085e-3, 2.085e-3, 2.25e-3]", "inertia_kg_m2 = [1e308, 1e308, 1e308]"),
        ("inertia_kg_m2 = [2.085e-3, 2.085e-3, 2.25e-3]", "inertia_kg_m2 = [nan, 2.085e-3, 2.25e-3]"),
        ('name = "wrist_2"\noffset_m', 'name = "wrist_1"\noffset_m'),
        ('name = "gripper_high"', 'name = "elbow_point"'),
        ('name = "gripper_high"', 'name = "com_elbow"'),
        ("pad_m = 0.035 ", "pad_m = 0.0 "),
        ("pad_m = 0.035 ", ""),
        ("width_limit_m = 0.085 ", "width_limit_m = 85.0 "),
        ("force_min_n = 20.0 ", "force_min_n = 300.0 "),
        ("finger_speed_min_m_s = 0.020 ", "finger_speed_min_m_s = 0.0 "),
        ("finger_speed_min_m_s = 0.020 ", "finger_speed_min_m_s = 0.2 "),
        ("tcp_m = [0.0, 0.0, 0.1767] ", "tcp_m = [0.0, 0.0, 176.7] "),
    ],
)
def test_a_model_that_cannot_be_is_refused(old, new):
    assert old in TEXT
    with pytest.raises(ModelError) as caught:
        Robot.from_toml(TEXT.replace(old, new, 1), tool="robotiq_2f85")
    assert caught.value.reason == "PHYSICS_FAULT"


@pytest.mark.parametrize(
    ("name", "tool"), [("ur3", "robotiq_2f85"), ("ur3e", "claw"), ("../ur3e", "robotiq_2f85"), ("", "x")]
)
def test_an_unknown_model_or_tool_is_refused(name, tool):
    with pytest.raises(ModelError):
        Robot.load(name, tool=tool)


def test_six_joints_are_needed():
    with pytest.raises(ModelError):
        Robot.from_toml(
            TEXT.replace('[[joints]]\nname = "wrist_3"', '[[spare]]\nname = "wrist_3"'), tool="robotiq_2f85"
        )


def test_a_path_knows_no_configuration_before_it_is_asked():
    with pytest.raises(ValueError):
        NumpyPath(ROBOT, MoveJ((0,) * 6, (0,) * 6, 1.0, 1.0)).nodes(np.array([], dtype=np.int64))


@pytest.mark.parametrize("own", [0, 3])
def test_an_arm_with_few_pairs_of_its_own_stands_in_an_empty_room(own):
    bare = replace(ROBOT, self_pairs=ROBOT.self_pairs[:own])
    pairs = pairs_of(bare, Scene(), CELL, grown_m=0.0)
    assert pairs.body.tolist() == [body for body, _ in bare.self_pairs]
    assert len(pairs.solids.numbers) == len(pairs.group) == own
