"""`ztpm robot fit` on files: a model and its picture, or a refusal and nothing made."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from docs import generate
from pep.pit.geometry.triangle_mesh import TRIANGLES_LIMIT
from pep.pit.robot.calibration import nominal_error_m
from pep.pit.robot.model import Model
from pep.pit.robot.mesh_cover import lines_of, uncovered
from tests.pep.pit.robot.test_meshes import box, stl
from tests.pep.pit.robot.test_urdf_left_out import TOOL
from tests.pep.pit.urdfs import inertial, joint, origin, robot

from pep.pit import NOMINAL_UNCERTAINTY_M
from ztpm.pit import Arm, asked

OUTFIT = 'schema = 1\nflange = "flange"\npayload_limit_kg = 3.0\nacceleration_limit_rad_s2 = 40.0\n'
SIZE = (0.06, 0.08, 0.2)
SCENE = generate.__file__.replace("generate.py", "examples/c0-empty.scene.json")


def arm(scale=""):
    """An arm of six boxes on a base, each a mesh in a file, and a flange."""
    parts = []
    for k in range(7):
        mesh = f'<geometry><mesh filename="package://arm/meshes/l{k}.stl"{scale}/></geometry>'
        mass = inertial(1.0, (0, 0, 0.1), (1e-2, 0, 0, 1e-2, 0, 1e-2)) if k else ""
        parts.append(f'<link name="l{k}">{mass}<collision>{origin((0, 0, 0.1))}{mesh}</collision></link>')
    parts.append('<link name="flange"/>')
    for k in range(6):
        parts.append(joint(f"j{k + 1}", f"l{k}", f"l{k + 1}", origin((0, 0, 0.22)), axis=[(0, 0, 1), (0, 1, 0)][k % 2]))
    parts.append(joint("mount", "l6", "flange", origin((0, 0.05, 0), (-np.pi / 2, 0, 0)), kind="fixed"))
    return robot(*parts, name="boxes")


@pytest.fixture
def folder(tmp_path):
    """The arm's files."""
    (tmp_path / "meshes").mkdir()
    for k in range(7):
        (tmp_path / "meshes" / f"l{k}.stl").write_bytes(stl(box(SIZE)))
    (tmp_path / "arm.urdf").write_text(arm())
    (tmp_path / "outfit.toml").write_text(OUTFIT)
    (tmp_path / "tool.toml").write_text(TOOL)
    return tmp_path


@pytest.fixture
def fit(run, folder):
    def fit(*more):
        files = ("--outfit", folder / "outfit.toml", "--tool-file", folder / "tool.toml", "--out", folder / "arm.toml")
        return run("robot", "fit", folder / "arm.urdf", *files, *more)

    return fit


def made(folder):
    """Names of all that is in the folder beside what was put there."""
    known = {"meshes", "arm.urdf", "outfit.toml", "tool.toml"}
    return {each.name for each in folder.iterdir()} - known


def test_a_model_its_picture_and_its_excess(fit, folder, run):
    pytest.importorskip("matplotlib")
    ended = fit("--picture", folder / "arm.png", "--json")
    assert ended.status == 0, ended.err
    told = json.loads(ended.out)
    assert (folder / "arm.png").read_bytes().startswith(b"\x89PNG")
    model = Model.from_toml((folder / "arm.toml").read_text())
    assert model.name == "boxes"
    assert [each["link"] for each in told["meshes"]] == [f"l{k}" for k in range(7)]
    for number, each in enumerate(told["meshes"]):
        capsules = lines_of([c for c in model.capsules if c.link == number])
        assert each["capsules"] == len(capsules)
        assert 0 < each["excess_mm"]["least"] <= each["excess_mm"]["most"] <= 60
        frames = [np.eye(3), np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]).T]  # z of a model's link is its joint's axis
        placed = box(SIZE, (0, 0, 0.1)) @ frames[number > 0 and number % 2 == 0]
        if number != 6:
            assert uncovered(placed, capsules) == 0
    # The file is a robot for the physics.
    motion = folder / "motion.json"
    shutil.copy(SCENE, folder / "scene.json")
    scene = json.loads((folder / "scene.json").read_text())
    scene["cell"] = {**scene.get("cell", {}), "tool": "stick"}
    (folder / "scene.json").write_text(json.dumps(scene))
    motion.write_text(json.dumps(MOTION))
    ended = run("pit", "--scene", folder / "scene.json", "--motion", motion, "--robot", folder / "arm.toml", "--json")
    assert json.loads(ended.out)["certificate"]["verified"] is True, ended.err


MOTION = json.loads(Path(SCENE.replace("c0-empty.scene", "sweep.motion")).read_text())


def edited(name, edit):
    def change(folder):
        file = folder / name
        file.write_text(edit(file.read_text()))

    return change


def mesh(content):
    return lambda folder: (folder / "meshes" / "l3.stl").write_bytes(content)


@pytest.mark.parametrize(
    ("change", "cause", "step"),
    [
        (mesh(stl(box(SIZE)[:-1])), "l3: meshes/l3.stl", "convex hull"),
        (mesh(stl(1000 * box(SIZE))), "200 m", 'scale="0.001 0.001 0.001"'),
        (mesh(b"\0" * 80 + (1_000_000).to_bytes(4, "little") + bytes(50_000_000)), "l3", "decimate"),
        (mesh(stl(np.tile(box(SIZE), (TRIANGLES_LIMIT // 12 + 1, 1, 1)))), str(TRIANGLES_LIMIT), "decimate"),
        (lambda folder: (folder / "meshes" / "l3.stl").unlink(), "no file", "folder of meshes"),
        (edited("arm.urdf", lambda text: text.replace("meshes/l3.stl", "../l3.stl")), "outside", "folder of meshes"),
        (edited("arm.urdf", lambda text: text.replace("l3.stl", "l3.dae")), "no STL", "binary STL"),
        (edited("arm.urdf", lambda text: text.replace('axis xyz="0.0 0.0 1.0"/><limit lower', 'axis xyz="0.0 0.0 1.0"/><limit xacro:l', 1)), "xacro", "xacro X.xacro"),
        (edited("arm.urdf", lambda text: text.replace('"revolute"', '"continuous"', 1)), "j1", "ranges"),
        (edited("tool.toml", lambda text: text.replace("[[tools]]", "[[tool]]")), "tool", ""),
        (edited("outfit.toml", lambda text: text.replace("flange =", "flinge =")), "fl", ""),
    ],
    ids=["a hole", "millimetres", "a million", "too many", "no file", "outside", "another form", "a macro", "no end", "tool", "outfit"],
)  # fmt: skip
def test_what_cannot_be_fitted_is_refused_and_nothing_is_made(fit, folder, change, cause, step):
    change(folder)
    ended = fit("--picture", folder / "arm.png")
    assert ended.status == 2
    said = " ".join((ended.out + ended.err).split())
    assert cause in said
    assert step in said
    assert made(folder) == set()


def test_a_mesh_in_millimetres_is_read_by_its_scale(fit, folder):
    for k in range(7):
        (folder / "meshes" / f"l{k}.stl").write_bytes(stl(1000 * box(SIZE)))
    (folder / "arm.urdf").write_text(arm(' scale="0.001 0.001 0.001"'))
    assert fit().status == 0


def test_a_model_that_is_there_is_never_written_over(fit, folder):
    (folder / "arm.toml").write_text("mine")
    ended = fit()
    assert ended.status == 2
    assert (folder / "arm.toml").read_text() == "mine"
    assert made(folder) == {"arm.toml"}


def test_a_longer_arm_is_known_less_well():
    """Unless the scene says how well, or the arm brings its own kinematics."""
    scene, motion = Path(SCENE), Path(SCENE.replace("c0-empty.scene", "sweep.motion"))
    known = {name: asked(scene, motion, Arm(name)).situation.cell.robot_uncertainty_m for name in ("ur3e", "ur10e")}
    assert known["ur3e"] == NOMINAL_UNCERTAINTY_M
    assert known["ur10e"] == nominal_error_m(Model.shipped("ur10e")) + 0.003 > 0.012


@pytest.mark.parametrize("name", ['x"\nschema = 2 #', "ünder", "a.b"])
def test_a_name_is_one_name_whatever_it_is(fit, folder, name):
    ended = fit("--name", name)
    assert ended.status == 0, ended.err
    assert Model.from_toml((folder / "arm.toml").read_text()).name == name
