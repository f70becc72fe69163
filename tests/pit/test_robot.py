"""The model file, what is derived from it, and what a model must not be."""

import math
import re
import struct
from importlib import resources
from pathlib import Path as File

import numpy as np
import pinocchio
import pytest

from pep.pit import ModelError, MoveJ, Robot
from pep.pit.kinematics import layout, link_frames, poses
from pep.pit.path import Path
from tests.pit.scenes import ROBOT, random_move

TEXT = (resources.files("pep.pit") / "robots" / "ur3e.toml").read_text()
VENDOR = File(__file__).parents[3] / "shared" / "data" / "ur3e"
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


def test_bending_bounds_derivatives_along_random_paths():
    """Second and third differences of body ends, and second ones of the spin, stay under their bounds."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        path = Path(ROBOT, random_move(rng))
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
    path = Path(ROBOT, random_move(np.random.default_rng(5)))
    h = 1e-6
    for s in (0.1, 0.5, 0.9):
        before, here, after = (poses(ROBOT, path.layout, path.q(s + k * h)[None], path.delta) for k in (-1, 0, 1))
        speed = np.linalg.norm(after.ends - before.ends, axis=-1).max(axis=2) / (2 * h)
        assert np.allclose(speed, here.speed, atol=1e-6)


@needs_vendor
@pytest.mark.shared
@pytest.mark.parametrize(
    ("mesh", "link", "xyz", "rpy"),
    [  # mesh frames in link frames: vendor description, config/ur3e/visual_parameters.yaml
        ("base", 0, (0, 0, 0), (0, 0, 0)),
        ("shoulder", 1, (0, 0, 0), (0, 0, math.pi)),
        ("upperarm", 2, (0, 0, 0.12), (math.pi / 2, 0, -math.pi / 2)),
        ("forearm", 3, (0, 0, 0.027), (math.pi / 2, 0, -math.pi / 2)),
        ("wrist1", 4, (0, 0, -0.104), (math.pi / 2, 0, 0)),
        ("wrist2", 5, (0, 0, -0.08535), (0, 0, 0)),
        ("wrist3", 6, (0, 0, -0.0921), (math.pi / 2, 0, 0)),
    ],
)
def test_capsules_contain_the_vendors_mesh(mesh, link, xyz, rpy):
    """Every vertex of the vendor's collision mesh lies in a capsule of its link."""
    raw = (VENDOR / "collision" / f"{mesh}.stl").read_bytes()
    (count,) = struct.unpack_from("<I", raw, 80)
    triangles = np.frombuffer(raw, dtype=np.dtype([("n", "<3f4"), ("v", "<9f4"), ("a", "<u2")]), count=count, offset=84)
    vertices = triangles["v"].reshape(-1, 3).astype(float) @ pinocchio.rpy.rpyToMatrix(*rpy).T + np.array(xyz)
    inside = np.full(len(vertices), np.inf)
    for capsule in (c for c in ROBOT.capsules if c.link == link):
        a, b = np.array(capsule.a_m), np.array(capsule.b_m)
        along = np.clip((vertices - a) @ (b - a) / max(((b - a) ** 2).sum(), 1e-30), 0, 1)
        inside = np.minimum(inside, np.linalg.norm(vertices - a - along[:, None] * (b - a), axis=1) - capsule.radius_m)
    assert inside.max() <= 0


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


def test_pairs_left_out_do_not_come_to_touch():
    """Links that are not neighbours and not in `self_pairs`: fresh random poses keep them apart."""
    listed = {(ROBOT.bodies[body].name, inner.name) for body, inner in ROBOT.self_pairs}
    q = np.random.default_rng(6).uniform(-math.pi, math.pi, (3000, 6))
    rotation, origin = link_frames(ROBOT, q)

    def ends(c):
        return [rotation[:, c.link] @ np.array(p) + origin[:, c.link] for p in (c.a_m, c.b_m)]

    from pep.pit.clearance import segment_segment

    for outer in ROBOT.capsules:
        for inner in ROBOT.capsules:
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
        ("schema = 1", "schema = "),
        ('shape = "blunt"', 'shape = "soft"'),
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
        Path(ROBOT, MoveJ((0,) * 6, (0,) * 6, 1.0, 1.0)).nodes(np.array([], dtype=np.int64))
