"""`ztpm pit` on files: the answer, its exit status, its proof, and what is refused."""

import hashlib
import importlib.resources
import json
import sys
from pathlib import Path

import pytest
from docs import generate
from tests.pep.pit import urdfs
from policies.words.reason_table import REASONS, Reason
from ztpm.pit import PATIENCE_S, Arm, asked

from pep.pit import Robot
from pep.pit.checker import Verified, verify

pytestmark = [pytest.mark.version, pytest.mark.long]

EXAMPLES = Path(generate.__file__).parent / "examples"
FIRST = ["tier", "index", "clearance_mm", "contributions", "certificate", "model"]
OF_A_CONTRIBUTION = ["kind", "link", "object", "t_s", "index"]


def example(name):
    return EXAMPLES / name


@pytest.fixture
def pit(run):
    def pit(scene, motion, *more):
        files = [x if isinstance(x, Path) else example(x) for x in (f"{scene}", f"{motion}")]
        return run("pit", "--scene", files[0], "--motion", files[1], *more)

    return pit


@pytest.fixture
def changed(tmp_path):
    """A copy of an example, edited."""

    def changed(name, edit):
        value = json.loads(example(name).read_text())
        edit(value)
        file = tmp_path / name
        file.write_text(json.dumps(value))
        return file

    return changed


@pytest.mark.parametrize(
    ("scene", "motion", "tier", "status"),
    [
        ("c0-empty", "sweep", 1, 0),
        ("c1-glass", "sweep", 2, 0),
        ("c2-person", "sweep", 3, 4),
        ("tracked-person", "slow-sweep", 2, 0),
        ("support", "place", 2, 0),
        ("c0-empty", "unfold", 3, 4),
    ],
)
def test_the_answer_as_json(pit, scene, motion, tier, status):
    ran = pit(f"{scene}.scene.json", f"{motion}.motion.json", "--json")
    said = ran.json
    assert (ran.status, said["tier"]) == (status, tier)
    assert list(said)[: len(FIRST)] == FIRST
    assert tier - 1 < said["index"] <= tier + 1e-9
    assert all(list(each)[: len(OF_A_CONTRIBUTION)] == OF_A_CONTRIBUTION for each in said["contributions"])
    assert [each["index"] for each in said["contributions"]] == sorted(
        (each["index"] for each in said["contributions"]), reverse=True
    )
    assert said["model"] == Robot.load("ur3e").model_digest
    assert said["certificate"]["verified"] is True
    assert said["certificate"]["rows"] > 0
    assert said["violations"] == []
    if said["contributions"]:
        assert said["clearance_mm"] == pytest.approx(said["contributions"][0]["clearance_mm"], abs=1e-3)
    else:
        assert said["clearance_mm"] is None


def test_the_answer_waits_for_the_machine(changed):
    """An arm's limit is no limit here, unless the file states one."""

    def hurried(scene):
        scene["cell"]["time_limit_s"] = 0.5

    for scene, limit_s in (
        (example("c1-glass.scene.json"), PATIENCE_S),
        (changed("c1-glass.scene.json", hurried), 0.5),
    ):
        question = asked(scene, example("sweep.motion.json"), Arm("ur3e", None, None))
        assert question.situation.cell.time_limit_s == limit_s


def test_the_answer_for_people(pit):
    ran = pit("c1-glass.scene.json", "sweep.motion.json")
    assert ran.status == 0
    row = next(line.split() for line in ran.out.splitlines() if line.startswith("fragile"))
    assert row[:4] == ["fragile", "gripper_high", "glass", "ceiling-camera"]
    assert [float(number) for number in row[4:]] == pytest.approx([0.98, 66.7, 0.39, 2.0])


def test_a_scene_of_convex_shapes_is_answered_and_says_who_says_so(pit):
    said = pit("convex.scene.json", "sweep.motion.json", "--json").json
    assert (said["tier"], said["perception"]) == (2, "fresh")
    first = said["contributions"][0]
    assert (first["kind"], first["object"], first["source"]) == ("fragile", "gem", "wrist-camera")
    assert said["certificate"]["verified"]


def test_the_speed_that_would_lower_the_tier_is_named_and_true(pit, changed):
    def faster(value):
        value.update(speed_rad_s=2.0, acceleration_rad_s2=3.0)

    fast = changed("sweep.motion.json", faster)
    said = pit("c1-glass.scene.json", fast, "--json").json
    assert said["tier"] == 3
    assert said["lower_tier_speed"]["unit"] == "rad/s"
    speed = said["lower_tier_speed"]["value"]
    assert f"{speed:.3f}" in said["advice"]
    assert f"{speed:.3f} rad/s" in pit("c1-glass.scene.json", fast).out
    for factor, tier in ((1, 2), (1.02, 3)):
        slower = changed(
            "sweep.motion.json", lambda v, f=factor: v.update(speed_rad_s=speed * f, acceleration_rad_s2=3.0)
        )
        assert pit("c1-glass.scene.json", slower, "--json").json["tier"] == tier


def test_tier_four_and_violations_are_refused(pit, changed):
    too_fast = changed("sweep.motion.json", lambda v: v.update(speed_rad_s=3.2))
    ran = pit("c0-empty.scene.json", too_fast, "--json")
    assert (ran.status, ran.json["tier"], ran.json["violations"]) == (3, 4, [])

    def hard(value):
        value["cell"]["zones"] = [{"name": "door", "sphere": {"center_m": [-0.27, -0.13, 0.2], "radius_m": 0.03}}]

    ran = pit(changed("c0-empty.scene.json", hard), "slow-sweep.motion.json", "--json")
    assert (ran.status, ran.json["tier"], ran.json["violations"]) == (3, 3, ["zone"])
    assert ran.json["lower_tier_speed"] is None
    assert "zone" in ran.json["advice"]


def test_without_a_fresh_view_a_person_must_answer(pit, changed):
    blind = changed("c0-empty.scene.json", lambda v: v.update(view=None))
    ran = pit(blind, "sweep.motion.json", "--json")
    assert (ran.status, ran.json["tier"], ran.json["perception"]) == (4, 3, "missing")
    old = changed("c0-empty.scene.json", lambda v: v["view"].update(age_s=3))
    ran = pit(old, "sweep.motion.json", "--json")
    assert (ran.status, ran.json["tier"], ran.json["perception"], ran.json["perception_age_s"]) == (4, 3, "stale", 3)


@pytest.mark.parametrize(
    ("name", "edit", "reason", "place"),
    [
        ("c2-person.scene.json", lambda v: v.update(frame="tool0"), "FRAMES_MISMATCH", "scene.frame"),
        ("c2-person.scene.json", lambda v: v.update(touch=["anna"]), "PARAMETERS_WRONG", "scene.touch.0"),
        ("c2-person.scene.json", lambda v: v["view"]["source"].update(signed=False), "PERCEPTION_INVALID", "scene.view"),
        ("c2-person.scene.json", lambda v: v["cell"].update(tool="claw"), "PHYSICS_FAULT", ""),
        ("c2-person.scene.json", lambda v: v.update(held={"object": "x", "sphere": {"center_m": [0, 0, 0.2], "radius_m": 9}}), "PHYSICS_FAULT", ""),
        ("c2-person.scene.json", lambda v: v["cell"].update(time_limit_s=1e-9), "PHYSICS_FAULT", "no answer in time"),
        ("sweep.motion.json", lambda v: v.update(blend_m=0.1), "PARAMETERS_WRONG", "motion"),
        ("sweep.motion.json", lambda v: v.update(speed_rad_s=1e-9), "OUT_OF_RANGE", ""),
    ],
)  # fmt: skip
def test_a_fault_is_no_tier(pit, changed, name, edit, reason, place):
    file = changed(name, edit)
    files = (file, "sweep.motion.json") if "scene" in name else ("c0-empty.scene.json", file)
    ran = pit(*files, "--json")
    assert ran.status == 3
    assert set(ran.json) == {"ok", "code", "detail", "next"}
    assert (ran.json["ok"], ran.json["code"]) == (False, reason)
    assert place in ran.json["detail"]
    spoken = pit(*files)
    assert (spoken.status, spoken.out) == (3, "")
    assert spoken.err.startswith(reason)


def test_a_line_that_is_not_proven_to_its_end_has_no_tier_and_no_proof(pit, changed, tmp_path):
    away = changed("line.motion.json", lambda v: v.update(target_m_rad=[-2.0, -0.2268, 0.2033, 1.7352, 2.6176, 0.0]))
    ran = pit("c0-empty.scene.json", away, "--json", "--proof", tmp_path / "proof.json")
    assert (ran.status, ran.json) == (
        3,
        {"ok": False, "code": "UNPROVEN", "detail": "unreachable", "next": REASONS[Reason.UNPROVEN].remedy},
    )
    assert not (tmp_path / "proof.json").exists()


def test_nan_and_a_doubled_key_are_faults(pit, tmp_path):
    text = example("sweep.motion.json").read_text()
    for bad, reason in (
        (text.replace("1.05", "NaN"), "NOT_FINITE"),
        (text.replace("{", '{"kind": "output",', 1), "BODY_MALFORMED"),
    ):
        file = tmp_path / "bad.motion.json"
        file.write_text(bad)
        assert pit("c0-empty.scene.json", file, "--json").json["code"] == reason


def test_usage(run, pit, tmp_path):
    assert run("pit").status == 2
    assert run("pit", "--scene", example("c0-empty.scene.json")).status == 2
    assert run("pit", "--scene", tmp_path / "none", "--motion", example("sweep.motion.json")).status == 2
    assert pit("c0-empty.scene.json", "sweep.motion.json", "--picture", "x.gif").status == 2
    assert run("pit", "verify", tmp_path / "none").status == 2
    assert pit("c0-empty.scene.json", "sweep.motion.json", "--robot", tmp_path / "none.toml").status == 2
    assert pit("c0-empty.scene.json", "sweep.motion.json", "--proof", tmp_path / "no" / "place").status == 2


def test_another_robot_by_name_or_file(pit, tmp_path):
    shipped = (importlib.resources.files("pep.pit") / "robots" / "ur3e.toml").read_text()
    file = tmp_path / "arm.toml"
    file.write_text(shipped)
    by_name, by_file = (
        pit("c1-glass.scene.json", "sweep.motion.json", "--robot", name, "--json").json for name in ("ur3e", file)
    )
    assert by_file == by_name
    file.write_text(shipped.replace("radius_m = 0.068", "radius_m = 0.069"))
    other = pit("c1-glass.scene.json", "sweep.motion.json", "--robot", file, "--json").json
    assert other["model"] != by_name["model"]
    for name in ("ur5x", "../ur3e"):
        assert pit("c0-empty.scene.json", "sweep.motion.json", "--robot", name, "--json").status in (2, 3)
    file.write_bytes(b"\xff")
    assert pit("c0-empty.scene.json", "sweep.motion.json", "--robot", file, "--json").json["code"] == "BODY_MALFORMED"


def test_an_arm_by_its_urdf_or_its_own_calibration(pit, tmp_path):
    urdf, outfit, own = (tmp_path / name for name in ("arm.urdf", "outfit.toml", "calibration.yaml"))
    shipped = (importlib.resources.files("pep.pit") / "robots" / "ur3e.toml").read_text()
    urdf.write_text(urdfs.ur3e())
    outfit.write_text(
        "schema = 1\nflange = 'wrist_3_link'\npayload_limit_kg = 3.0\nacceleration_limit_rad_s2 = 40.0\n"
        + shipped[shipped.index("[[tools]]") :]
    )
    files = ("c1-glass.scene.json", "sweep.motion.json", "--json")
    said = pit(*files, "--robot", urdf, "--outfit", outfit).json
    nominal = pit(*files).json
    assert said["model"] != nominal["model"]
    # All pairs of its parts are watched, where the shipped model knows which cannot meet; the glass is as near.
    glass = next(each for each in said["contributions"] if each["object"] == "glass")
    assert glass["index"] == pytest.approx(nominal["index"], abs=0.02)
    assert {each["kind"] for each in said["contributions"]} <= {"fragile", "self"}
    assert said["certificate"]["verified"] is True
    for more in (("--robot", urdf), ("--outfit", outfit)):
        assert pit(*files, *more).json["code"] == "PARAMETERS_WRONG"
    joints = Robot.load("ur3e").model.joints
    keys = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
    rows = "".join(
        f"  {key}:\n    x: {j.offset_m[0] + 0.0002!r}\n    y: {j.offset_m[1]!r}\n    z: {j.offset_m[2]!r}\n"
        f"    roll: {j.rpy_rad[0]!r}\n    pitch: {j.rpy_rad[1]!r}\n    yaw: {j.rpy_rad[2]!r}\n"
        for key, j in zip(keys, joints, strict=True)
    )
    own.write_text(f"kinematics:\n{rows}  hash: calib_12788084448423163542\n")
    said = pit(*files, "--calibration", own).json
    assert said["model"] not in (nominal["model"], None)
    assert said["index"] == pytest.approx(nominal["index"], abs=0.05)
    own.write_text("kinematics: [1]\n")
    assert pit(*files, "--calibration", own).status == 3


def test_a_line_of_the_tool(pit, changed):
    """Over the glass in a straight line: its speed is told in the unit of a line."""
    ran = pit("c1-glass.scene.json", "line.motion.json", "--json")
    assert (ran.status, ran.json["tier"]) == (0, 2)
    fast = changed("line.motion.json", lambda v: v.update(speed_m_s=1.2, acceleration_m_s2=3))
    said = pit("c1-glass.scene.json", fast, "--json").json
    assert said["tier"] == 3
    assert said["lower_tier_speed"]["unit"] == "m/s"
    slower = changed(
        "line.motion.json", lambda v: v.update(speed_m_s=said["lower_tier_speed"]["value"], acceleration_m_s2=3)
    )
    assert pit("c1-glass.scene.json", slower, "--json").json["tier"] == 2


def test_a_path_counts_the_rows_of_all_its_legs(pit, tmp_path):
    move = json.loads(example("sweep.motion.json").read_text())
    leg = {name: move[name] for name in ("target_rad", "speed_rad_s", "acceleration_rad_s2")}
    there = {name: move[name] for name in ("form", "frame", "start_rad")} | {"kind": "joint_path", "legs": [leg]}
    back = there | {"legs": [leg, leg | {"target_rad": move["start_rad"]}]}
    said = []
    for number, path in enumerate((there, back)):
        file = tmp_path / f"{number}.motion.json"
        file.write_text(json.dumps(path))
        said.append(pit("c1-glass.scene.json", file, "--json").json)
    assert 0 < said[0]["certificate"]["rows"] < said[1]["certificate"]["rows"]
    assert [each["tier"] for each in said] == [2, 2]


# ---- the proof


@pytest.mark.parametrize("motion", ["sweep.motion.json", "line.motion.json", "around.motion.json"])
def test_a_proof_is_written_verified_and_bound_to_its_question(pit, run, tmp_path, changed, motion):
    proof = tmp_path / "proof"
    scene = changed("c2-person.scene.json", lambda v: v["cell"].update(time_limit_s=60))  # however busy the machine is
    said = pit(scene, motion, "--proof", proof, "--json").json
    assert isinstance(verify(proof.read_bytes()), Verified)
    assert said["certificate"]["sha256"] == hashlib.sha256(proof.read_bytes()).hexdigest()
    assert said["certificate"]["bytes"] == len(proof.read_bytes())
    assert said["certificate"]["verified"] is True
    files = ["--scene", scene, "--motion", example(motion)]
    for more in ([], files):
        ran = run("pit", "verify", proof, *more, "--json")
        assert ran.status == 0
        assert (ran.json["tier"], ran.json["rows"]) == (said["tier"], said["certificate"]["rows"])
        assert (ran.json["model"], ran.json["scene"]) == (said["model"], said["scene"])
        assert ran.json["index"] == said["index"]
    files[3] = example("slow-sweep.motion.json")
    ran = run("pit", "verify", proof, *files, "--json")
    assert (ran.status, ran.json["code"]) == (3, "OTHER_QUESTION")
    assert run("pit", "verify", proof, *files[:2]).status == 2


def test_a_proof_that_was_touched_is_refused(pit, run, tmp_path):
    proof = tmp_path / "proof"
    pit("c1-glass.scene.json", "sweep.motion.json", "--proof", proof)
    whole = proof.read_bytes()
    for bad in (whole[:-1], whole + b" ", whole.replace(b'"tier":2', b'"tier":1'), b"", b"{}"):
        assert bad != whole
        proof.write_bytes(bad)
        ran = run("pit", "verify", proof, "--json")
        assert (ran.status, ran.json["ok"]) == (3, False)
        assert run("pit", "verify", proof).status == 3


def test_what_has_no_path_has_no_proof(pit, tmp_path):
    grip = tmp_path / "grip.motion.json"
    grip.write_text(
        json.dumps({"form": "ztpm-motion/1", "frame": "base", "kind": "gripper", "q_rad": [0, -1.62, 1.25, -1.2, -1.57, 0]}
                   | {"width_m": 0.05, "speed_m_s": 0.05, "force_n": 30})
    )  # fmt: skip
    ran = pit("c0-empty.scene.json", grip, "--json")
    assert (ran.status, ran.json["tier"]) == (0, 1)
    assert (ran.json["certificate"]["verified"], ran.json["certificate"]["sha256"]) == (False, None)
    assert pit("c0-empty.scene.json", grip, "--proof", tmp_path / "proof", "--json").status == 3
    assert not (tmp_path / "proof").exists()


# ---- the picture


def test_pictures_are_written(pit, tmp_path):
    pytest.importorskip("matplotlib")
    png, html = tmp_path / "a.png", tmp_path / "a.html"
    for file, start in ((png, b"\x89PNG\r\n\x1a\n"), (html, b"<!doctype html>")):
        ran = pit("c1-glass.scene.json", "sweep.motion.json", "--picture", file)
        assert ran.status == 0
        assert file.read_bytes().startswith(start)


def test_without_matplotlib_the_png_says_so(pit, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    ran = pit("c1-glass.scene.json", "sweep.motion.json", "--picture", tmp_path / "a.png", "--json")
    assert (ran.status, ran.json["code"]) == (1, "NOT_INSTALLED")
    assert "ztpm[viz]" in ran.json["detail"]
    assert not (tmp_path / "a.png").exists()
    assert pit("c1-glass.scene.json", "sweep.motion.json", "--picture", tmp_path / "a.html").status == 0


# ---- trajectories of others


@pytest.mark.parametrize("ending", ["csv", "json", "yaml"])
def test_a_trajectory_of_a_planner_has_an_answer_a_proof_and_the_arguments_of_a_tool(pit, run, tmp_path, ending):
    proof, page = tmp_path / "plan.proof", tmp_path / "plan.html"
    file = f"plan.trajectory.{ending}"
    ran = pit("c0-empty.scene.json", file, "--json", "--proof", proof, "--picture", page)
    assert (ran.status, ran.json["tier"]) == (0, 1)
    assert ran.json["certificate"]["verified"] is True
    carried = ran.json["gateway"]
    assert (carried["carries"], carried["operation"]) == (True, "follow_trajectory")
    assert len(carried["arguments"]["times_s"]) == len(carried["arguments"]["positions_rad"])
    assert run("pit", "verify", proof, "--scene", example("c0-empty.scene.json"), "--motion", example(file)).status == 0
    assert "<html" in page.read_text()[:200]


def test_one_that_no_gateway_carries_says_why(pit, tmp_path):
    """The last wrist may turn faster than a request may say."""
    file = tmp_path / "quick.csv"
    rows = [f"{t},0,-1.6,1.2,-1.2,-1.57,{q}" for t, q in ((0, 0), (0.5, 0.6), (1.0, 3.2), (1.5, 5.8), (2.0, 6.2))]
    file.write_text("\n".join(["time_s,q0,q1,q2,q3,q4,q5", *rows]))
    ran = pit("c0-empty.scene.json", file, "--json")
    assert ran.json["gateway"]["carries"] is False
    assert "speed" in ran.json["gateway"]["why"]


@pytest.mark.parametrize(
    ("row", "reason", "place"),
    [
        ("1.0,nan,-1.6,1.2,-1.2,-1.57,0", "NOT_FINITE", "line 3"),
        ("0,0.1,-1.6,1.2,-1.2,-1.57,0", "OUT_OF_RANGE", "point 1"),
        ("0.1,2.0,-1.6,1.2,-1.2,-1.57,0", "ROBOT_LIMIT", "point 1"),
        ("9,0.1,-1.6,9,-1.2,-1.57,0", "ROBOT_LIMIT", "point 1"),
    ],
)
def test_one_that_is_refused_names_its_line_or_point(pit, tmp_path, row, reason, place):
    file = tmp_path / "bad.csv"
    file.write_text("\n".join(["time_s,q0,q1,q2,q3,q4,q5", "0,0,-1.6,1.2,-1.2,-1.57,0", row]))
    ran = pit("c0-empty.scene.json", file)
    assert ran.status == 3
    assert ran.err.startswith(reason)
    assert place in ran.err
