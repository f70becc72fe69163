"""Scene and motion files: what they spell, what they refuse and where, and the schemas that are published of them."""

import json
import math
import tomllib
from dataclasses import replace
from pathlib import Path, PurePath
from typing import get_args

import jsonschema
import pytest
from docs import generate
from pep.pit.base.errors import PitError
from pep.pit.base.motion import (
    BlendedPath,
    GripperMove,
    JointLeg,
    JointPath,
    LineLeg,
    LinePath,
    Motion,
    MoveJ,
    MoveL,
    OutputSet,
    ServoJ,
    SpeedJ,
    SpeedL,
)
from pep.pit.files.motion_file import KINDS, motion_of, seed_of
from pep.pit.files.old_files import renewed_scene
from pep.pit.files.plain_file import FILE_LIMIT_BYTES, FileError, value_of
from pep.pit.files.scene_file import situation_of
from pep.pit.files.schemas import motion_schema, world_schema
from pep.pit.scene.scene import CELL_FILE
from tests.pep.pit.scenes import CELL, FRONT, empty, sweep, with_glass, with_person

from pep.pit import Box, Convex, Region, Robot, adult_at_distance, assess, standing_adult

EXAMPLES = Path(generate.__file__).parent / "examples"
SCENES = sorted(EXAMPLES.glob("*.scene.json"))
MOTIONS = sorted(EXAMPLES.glob("*.motion.json"))
REASON_OF_A_FRAME = "FRAMES_MISMATCH"


def example(name):
    return json.loads((EXAMPLES / name).read_text())


def situation(name):
    return situation_of(example(f"{name}.scene.json"))


def motion(name):
    return motion_of(example(f"{name}.motion.json"))


def answer(scene, move, *, changed=lambda stated: None):
    """Answer of the room to two files; `changed` may edit the scene's value first."""
    stated = example(f"{scene}.scene.json")
    changed(stated)
    asked = situation_of(stated)
    said = motion(move) if isinstance(move, str) else move
    robot = Robot.load("ur3e", tool=asked.cell.tool).holding(asked.held)
    return assess(
        robot,
        asked.scene,
        said,
        asked.cell,
        perception_age_s=asked.age_s,
        touch=asked.touch,
        seed=seed_of(said),
    )


# ---- what they spell


def test_the_examples_are_the_papers_cells():
    for name, scene in (("c0-empty", empty()), ("c1-glass", with_glass()), ("c2-person", with_person())):
        read = situation(name)
        assert (read.age_s, read.held, read.touch) == (0.1, None, frozenset())
        assert (len(read.scene.people), len(read.scene.objects)) == (len(scene.people), len(scene.objects))
        assert read.cell == CELL
    assert situation("c0-empty").scene.digest == empty().digest
    near = situation("c2-person").scene.people[0]
    assert near == replace(adult_at_distance(0.5, bearing_rad=-2.6919, name="anna"), source="ceiling-camera")
    assert abs(-2.6919 - FRONT) < 1e-4
    assert motion("sweep") == sweep()


@pytest.mark.parametrize(
    ("scene", "move", "tier", "index"),
    [
        ("c0-empty", "sweep", 1, 1.00),
        ("c1-glass", "sweep", 2, 1.99),
        ("c2-person", "sweep", 3, 3.00),
        ("c0-empty", "slow-sweep", 1, 1.00),
        ("c1-glass", "slow-sweep", 2, 1.83),
        ("c2-person", "slow-sweep", 3, 2.92),
    ],
)
def test_golden_cells_through_the_files(scene, move, tier, index):
    said = answer(scene, move)
    assert (said.tier, said.violations) == (tier, ())
    assert said.index == pytest.approx(index, abs=0.02)


def test_every_motion_has_a_form():
    assert {kind.made for kind in KINDS.values()} == set(get_args(Motion))


@pytest.mark.parametrize(
    ("members", "made"),
    [
        (
            {"kind": "path", "start_rad": [0] * 6}
            | {
                "legs": [
                    {"target_rad": [0.1] * 6, "speed_rad_s": 0.5, "acceleration_rad_s2": 1.0, "blend_m": 0.01},
                    {"target_m_rad": [0.3, 0, 0.3, 0, 3, 0], "speed_m_s": 0.1, "acceleration_m_s2": 1.0},
                ]
            },
            BlendedPath(
                (0,) * 6,
                (JointLeg((0.1,) * 6, 0.5, 1.0, 0.01), LineLeg((0.3, 0, 0.3, 0, 3, 0), 0.1, 1.0)),
            ),
        ),
        (
            {"kind": "speed_j", "start_rad": [0] * 6, "qd_rad_s": [0.5, 0, 0, 0, 0, 0]}
            | {"acceleration_rad_s2": 1.0, "duration_s": 0.5},
            SpeedJ((0,) * 6, (0.5, 0, 0, 0, 0, 0), 1.0, 0.5),
        ),
        (
            {"kind": "gripper", "q_rad": [0.1] * 6, "width_m": 0.05, "speed_m_s": 0.1, "force_n": 30},
            GripperMove((0.1,) * 6, 0.05, 0.1, 30),
        ),
        ({"kind": "output", "pin": 3, "value": True}, OutputSet(3, True)),
        (
            {"kind": "move_l", "start_rad": [0.1] * 6, "target_m_rad": [0.2, 0.1, 0.3, 0, 3, 0]}
            | {"speed_m_s": 0.25, "acceleration_m_s2": 1.2},
            MoveL((0.1,) * 6, (0.2, 0.1, 0.3, 0, 3, 0), 0.25, 1.2),
        ),
        (
            {"kind": "speed_l", "start_rad": [0] * 6, "twist_m_s_rad_s": [0.1, 0, 0, 0, 0, 0]}
            | {"acceleration_m_s2": 0.5, "duration_s": 0.4},
            SpeedL((0,) * 6, (0.1, 0, 0, 0, 0, 0), 0.5, 0.4),
        ),
        (
            {"kind": "servo_j", "start_rad": [0] * 6, "qd_rad_s": [0] * 6, "target_rad": [0.01] * 6}
            | {"period_s": 0.002, "lookahead_s": 0.1},
            ServoJ((0,) * 6, (0,) * 6, (0.01,) * 6, 0.002, 0.1),
        ),
        (
            {"kind": "joint_path", "start_rad": [0] * 6}
            | {"legs": [{"target_rad": [a] * 6, "speed_rad_s": 1, "acceleration_rad_s2": 2} for a in (0.1, 0.2)]},
            JointPath((0,) * 6, (JointLeg((0.1,) * 6, 1, 2), JointLeg((0.2,) * 6, 1, 2))),
        ),
        (
            {"kind": "line_path", "start_rad": [0] * 6}
            | {"legs": [{"target_m_rad": [0.2] * 6, "speed_m_s": 1, "acceleration_m_s2": 2, "blend_m": 0.0}]},
            LinePath((0,) * 6, (LineLeg((0.2,) * 6, 1, 2),)),
        ),
        (
            {"kind": "move_j", "start_rad": [0] * 6, "target_rad": [1, 0, 0, 0, 0, 0]}
            | {"speed_rad_s": 0.5, "acceleration_rad_s2": 1},
            MoveJ((0,) * 6, (1, 0, 0, 0, 0, 0), 0.5, 1),
        ),
    ],
)
def test_each_motion(members, made):
    stated = {"form": "ztpm-motion/1", "frame": "base"} | members
    assert motion_of(stated) == made
    jsonschema.validate(stated, motion_schema())
    for name in members:
        without = {k: v for k, v in stated.items() if k != name}
        with pytest.raises(FileError) as error:
            motion_of(without)
        assert error.value.reason == "PARAMETERS_WRONG"


UNITS = ("_m", "_rad", "_s", "_s2", "_n")
WITHOUT_A_UNIT = {"form", "frame", "kind", "legs", "pin", "value"}


def test_every_number_of_a_motion_names_its_unit():
    for form in motion_schema()["$defs"].values():
        for name in form["properties"].keys() - WITHOUT_A_UNIT:
            assert name.endswith(UNITS), name


def test_the_seed_tells_motions_apart_to_the_last_bit():
    assert seed_of(sweep()) == seed_of(sweep())
    assert seed_of(sweep()) != seed_of(replace(sweep(), speed_rad_s=math.nextafter(1.05, 2)))


def test_toml_and_json_say_the_same():
    text = """
form = "ztpm-world/1"
frame = "base"
touch = ["tray"]
[cell]
tool = "robotiq_2f85"
warn_band_m = 0.4
objects = [{ name = "tray", box = { center_m = [0.3, 0, 0.01], half_m = [0.1, 0.1, 0.01] } }]
zones = [{ name = "shelf", tier = 3, sphere = { center_m = [0, 0.5, 0.5], radius_m = 0.1 } }]
contacts = [{ object = "tray", by = "tool" }]
workspace = { low_m = [-1, -1, -1], high_m = [1, 1, 1] }
[view]
source = { sensor = "camera", signed = true }
age_s = 0
complete = true
people = [{ id = "p", standing_adult = { x_m = 1.5, y_m = 0.2, facing_rad = 1.0 } }]
objects = [{ id = "cup", kind = "fragile", uncertainty_m = 0.02, sphere = { center_m = [0.3, 0.3, 0.1], radius_m = 0.04 } }]
[held]
object = "part"
capsule = { a_m = [0, 0, 0.15], b_m = [0, 0, 0.25], radius_m = 0.02 }
mass_kg = 0.4
"""
    read = situation_of(value_of(text.encode(), PurePath("cell.toml")))
    same = situation_of(value_of(json.dumps(tomllib.loads(text)).encode(), PurePath("cell.json")))
    assert read == same
    assert read.cell.warn_band_m == 0.4
    assert read.scene.people == (replace(standing_adult(1.5, 0.2, facing_rad=1.0, name="p"), source="camera"),)
    assert [o.id for o in read.scene.objects] == ["tray", "cup"]
    assert (read.scene.objects[1].uncertainty_m, read.scene.zones[0].tier) == (0.02, 3)
    assert (read.held.mass_kg, read.held.blunt, read.touch) == (0.4, False, frozenset({"tray"}))
    assert read.scene.workspace.high_m == (1, 1, 1)


def test_regions_of_a_person():
    stated = example("c2-person.scene.json")
    ball = {"center_m": [0.9, 0, 0.2], "radius_m": 0.1}
    stated["view"]["people"] = [{"id": "p", "regions": [{"region": "torso", "sphere": ball}]}]
    person = situation_of(stated).scene.people[0]
    assert [region for region, _ in person.regions] == [Region.TORSO]
    assert not person.limbs_tracked


def test_each_thing_may_have_a_sensor_and_an_age_of_its_own():
    scene = situation("convex").scene
    told = {each.id: (each.source, each.age_s) for each in scene.seen}
    assert told == {
        "passer-by": ("ceiling-camera", 0.3),
        "table": (CELL_FILE, 0.0),
        "ramp": (CELL_FILE, 0.0),
        "gem": ("wrist-camera", 0.0),
    }
    shapes = {each.id: type(each.shape) for each in scene.objects}
    assert shapes == {"table": Box, "ramp": Convex, "gem": Convex}


def test_without_a_view_nobody_looked():
    stated = example("c0-empty.scene.json")
    del stated["view"]
    read = situation_of(stated)
    assert (read.scene, read.age_s) == (None, None)
    assert answer("c0-empty", "sweep", changed=lambda s: s.update(view=None)).tier == 3


# ---- what they refuse, and where


def scene_with(*path, to):
    stated = example("c2-person.scene.json")
    stated["view"]["objects"] = [{"id": "cup", "kind": "fragile", "sphere": {"center_m": [1, 1, 1], "radius_m": 0.1}}]
    stated["view"]["people"].append(
        {"id": "bo", "regions": [{"region": "head", "sphere": {"center_m": [2, 2, 1], "radius_m": 0.1}}]}
    )
    at = stated
    for key in path[:-1]:
        at = at[key]
    if to is None:
        del at[path[-1]]
    else:
        at[path[-1]] = to
    return stated


CORNERS = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
BALL = {"center_m": [1, 0, 0], "radius_m": 0.1}
OUT_OF_FORM = [
    (("form",), "ztpm-world/2", "PARAMETERS_WRONG", "scene.form"),
    (("frame",), "tool0", REASON_OF_A_FRAME, "scene.frame"),
    (("frame",), None, REASON_OF_A_FRAME, "scene.frame"),
    (("extra",), 1, "PARAMETERS_WRONG", "scene.extra"),
    (("touch",), "table", "PARAMETERS_WRONG", "scene.touch"),
    (("cell", "objects"), None, "PARAMETERS_WRONG", "scene.cell.objects"),
    (("cell", "colour"), "red", "PARAMETERS_WRONG", "scene.cell.colour"),
    (("cell", "warn_band_m"), "0.3", "PARAMETERS_WRONG", "scene.cell.warn_band_m"),
    (("cell", "contacts"), [{"object": "table", "by": "arm"}], "PARAMETERS_WRONG", "scene.cell.contacts.0.by"),
    (("cell", "objects", 0, "sphere"), BALL, "PARAMETERS_WRONG", "scene.cell.objects.0"),
    (("cell", "objects", 0, "box"), None, "PARAMETERS_WRONG", "scene.cell.objects.0"),
    (("cell", "zones"), [{"name": "z"}], "PARAMETERS_WRONG", "scene.cell.zones.0"),
    (("view", "age_s"), None, "PARAMETERS_WRONG", "scene.view.age_s"),
    (("view", "age_s"), -0.1, "PARAMETERS_WRONG", "scene.view.age_s"),
    (("view", "complete"), 1, "PARAMETERS_WRONG", "scene.view.complete"),
    (("view", "source"), None, "PARAMETERS_WRONG", "scene.view.source"),
    (("view", "people", 0, "id"), "", "PARAMETERS_WRONG", "scene.view.people.0.id"),
    (("view", "people", 0, "regions"), [], "PARAMETERS_WRONG", "scene.view.people.0.regions"),
    (("view", "people", 0, "adult_at_distance"), None, "PARAMETERS_WRONG", "scene.view.people.0"),
    (("view", "people", 0, "standing_adult"), {"x_m": 1, "y_m": 1}, "PARAMETERS_WRONG", "scene.view.people.0"),
    (("view", "people", 1, "regions", 0, "region"), "tail", "PARAMETERS_WRONG", "scene.view.people.1.regions.0.region"),
    (("view", "people", 1, "regions", 0, "sphere"), None, "PARAMETERS_WRONG", "scene.view.people.1.regions.0"),
    (("view", "people", 1, "regions", 0, "capsule"), {"a_m": [0, 0, 0], "b_m": [0, 0, 1], "radius_m": 0.1},
     "PARAMETERS_WRONG", "scene.view.people.1.regions.0"),
    (("view", "people", 1, "regions", 0, "sphere", "center_m"), [1, 2], "PARAMETERS_WRONG",
     "scene.view.people.1.regions.0.sphere.center_m.2"),
    (("view", "objects", 0, "age_s"), -0.1, "PARAMETERS_WRONG", "scene.view.objects.0.age_s"),
    (("view", "objects", 0, "age_s"), 3601, "PARAMETERS_WRONG", "scene.view.objects.0.age_s"),
    (("view", "people", 0, "sensor"), "", "PARAMETERS_WRONG", "scene.view.people.0.sensor"),
    (("view", "objects", 0, "convex"), {"vertices_m": CORNERS}, "PARAMETERS_WRONG", "scene.view.objects.0"),
    (("cell", "zones"), [{"name": "z", "convex": {"vertices_m": CORNERS[:3]}}], "PARAMETERS_WRONG",
     "scene.cell.zones.0.convex.vertices_m"),
    (("cell", "zones"), [{"name": "z", "convex": {"vertices_m": CORNERS * 17}}], "PARAMETERS_WRONG",
     "scene.cell.zones.0.convex.vertices_m"),
    (("view", "objects", 0, "kind"), "soft", "PARAMETERS_WRONG", "scene.view.objects.0.kind"),
    (("view", "objects", 0, "uncertainty_m"), -1, "PARAMETERS_WRONG", "scene.view.objects.0.uncertainty_m"),
    (("view", "objects", 0, "sphere", "radius_mm"), 5, "PARAMETERS_WRONG", "scene.view.objects.0.sphere.radius_mm"),
    (("held",), {"object": "x", "mass_kg": 1}, "PARAMETERS_WRONG", "scene.held"),
]  # fmt: skip
BEYOND_A_SCHEMA = [
    (("touch",), ["tabel"], "PARAMETERS_WRONG", "scene.touch.0"),
    (("touch",), ["table", "anna"], "PARAMETERS_WRONG", "scene.touch.1"),
    (("cell", "warn_band_m"), -1, "PARAMETERS_WRONG", "scene.cell"),
    (("cell", "contacts"), [{"object": "shelf", "by": "tool"}], "PARAMETERS_WRONG", "scene.cell.contacts.0.object"),
    (("cell", "zones"), [{"name": "table", "sphere": BALL}], "PARAMETERS_WRONG", "scene.cell.zones.0"),
    (("view", "source", "signed"), False, "PERCEPTION_INVALID", "scene.view.source.signed"),
    (("view", "people", 0, "id"), "bo", "PARAMETERS_WRONG", "scene.view.people.1"),
    (("view", "people", 1, "regions", 0, "sphere", "radius_m"), 0, "PERCEPTION_INVALID", "scene.view.people.1.regions.0"),
    (("view", "objects", 0, "id"), "table", "PARAMETERS_WRONG", "scene.view.objects.0"),
    (("cell", "zones"), [{"name": "z", "convex": {"vertices_m": CORNERS, "radius_m": -0.1}}], "PARAMETERS_WRONG",
     "scene.cell.zones.0.convex"),
    (("cell", "zones"), [{"name": "z", "convex": {"vertices_m": [[k, k, 0] for k in range(9)]}}], "PARAMETERS_WRONG",
     "scene.cell.zones.0.convex"),
    (("view", "objects", 0, "sphere", "center_m", 0), 1e9, "PERCEPTION_INVALID", "scene.view.objects.0.sphere"),
]  # fmt: skip
"""Scenes that a schema takes and the reader does not: repeated names, names of nothing, ranges of numbers."""
BAD_SCENES = OUT_OF_FORM + BEYOND_A_SCHEMA


@pytest.mark.parametrize(("path", "to", "reason", "place"), BAD_SCENES)
def test_a_scene_file_that_is_none(path, to, reason, place):
    with pytest.raises(FileError) as error:
        situation_of(scene_with(*path, to=to))
    assert (error.value.reason, error.value.place) == (reason, place)
    assert error.value.detail.startswith(place)


def test_the_scene_that_is_broken_above_is_whole_before():
    assert len(situation_of(scene_with("touch", to=["table"])).scene.people) == 2


def test_ten_thousand_objects_are_refused_by_number():
    many = [
        {"id": f"o{k}", "kind": "rigid", "sphere": {"center_m": [1, 0, k / 1000], "radius_m": 0.01}}
        for k in range(10_000)
    ]
    with pytest.raises(FileError) as error:
        situation_of(scene_with("view", "objects", to=many))
    assert (error.value.reason, error.value.place) == ("PARAMETERS_WRONG", "scene.view.objects")
    stood = [{"name": o["id"], "sphere": o["sphere"]} for o in many]
    with pytest.raises(FileError) as error:
        situation_of(scene_with("cell", "objects", to=stood))
    assert (error.value.reason, error.value.place) == ("PARAMETERS_WRONG", "scene.cell.objects")


@pytest.mark.parametrize(
    ("raw", "name", "reason"),
    [
        (b'{"a": 1, "a": 2}', "x.json", "BODY_MALFORMED"),
        (b'{"a": NaN}', "x.json", "NOT_FINITE"),
        (b'{"a": 1e999}', "x.json", "NOT_FINITE"),
        (b'{"a": 9007199254740993}', "x.json", "OUT_OF_RANGE"),
        (b"\xff\xfe", "x.json", "BODY_MALFORMED"),
        (b'{"a": ' + b"[" * 40 + b"]" * 40 + b"}", "x.json", "BODY_MALFORMED"),
        (b" " * (FILE_LIMIT_BYTES + 1), "x.json", "BODY_TOO_LARGE"),
        (b" " * (FILE_LIMIT_BYTES + 1), "x.toml", "BODY_TOO_LARGE"),
        (b"a = 1\na = 2", "x.toml", "BODY_MALFORMED"),
        (b"a = nan", "x.toml", "NOT_FINITE"),
        (b"a = -inf", "x.toml", "NOT_FINITE"),
        (b"a = 1979-05-27", "x.toml", "BODY_MALFORMED"),
        (b"\xff", "x.toml", "BODY_MALFORMED"),
        (b"a = " + b"[" * 40 + b"]" * 40, "x.toml", "BODY_MALFORMED"),
        (b"a = " + b"[" * 40_000 + b"]" * 40_000, "x.toml", "BODY_MALFORMED"),
    ],
)
def test_a_text_without_one_meaning(raw, name, reason):
    with pytest.raises(FileError) as error:
        value_of(raw, PurePath(name))
    assert (error.value.reason, error.value.place) == (reason, name)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"frame": "world"}, REASON_OF_A_FRAME),
        ({"kind": "move_q"}, "PARAMETERS_WRONG"),
        ({"kind": "output"}, "PARAMETERS_WRONG"),
        ({"blend_m": 0.1}, "PARAMETERS_WRONG"),
        ({"speed_rad_s": None}, "PARAMETERS_WRONG"),
        ({"speed_rad_s": True}, "PARAMETERS_WRONG"),
        ({"start_rad": [0] * 5}, "PARAMETERS_WRONG"),
        ({"start_rad": [0] * 7}, "PARAMETERS_WRONG"),
        ({"target_rad": ["0"] * 6}, "PARAMETERS_WRONG"),
        ({"form": "ztpm-scene/1"}, "PARAMETERS_WRONG"),
    ],
)
def test_a_motion_file_that_is_none(changes, reason):
    with pytest.raises(FileError) as error:
        motion_of(example("sweep.motion.json") | changes)
    assert error.value.reason == reason
    assert error.value.place.startswith("motion")


@pytest.mark.parametrize("value", [None, [], "x", 3, {}])
def test_no_table_at_all(value):
    for read in (situation_of, motion_of):
        with pytest.raises(PitError) as error:
            read(value)
        assert error.value.reason in ("PARAMETERS_WRONG", REASON_OF_A_FRAME)


# ---- the schemas


def test_the_schemas_are_what_the_forms_generate():
    for file, text in generate.generated().items():
        assert file.read_text("utf-8") == text, "run: python -m docs.generate"
    assert json.loads((generate.SCHEMAS / "world.schema.json").read_text()) == world_schema()


@pytest.mark.long
def test_the_examples_keep_the_schemas():
    for schema, files in ((world_schema("SceneFile"), SCENES), (motion_schema(), MOTIONS)):
        jsonschema.Draft202012Validator.check_schema(schema)
        assert files
        for file in files:
            jsonschema.validate(renewed_scene(json.loads(file.read_text())), schema)


@pytest.mark.parametrize("case", BAD_SCENES)
def test_the_schema_and_the_reader_agree(case):
    path, to, _, _ = case
    stated = scene_with(*path, to=to)
    valid = jsonschema.Draft202012Validator(world_schema("SceneFile")).is_valid(stated)
    assert valid == (case in BEYOND_A_SCHEMA)


# ---- usability: what ordinary work comes to


def test_a_tracked_person_beyond_a_metre_is_tier_two_at_a_slow_speed():
    said = answer("tracked-person", "slow-sweep")
    assert (said.tier, said.violations) == (2, ())
    assert said.contributions[0].object.startswith("anna/")

    def trunk_only(stated):
        regions = [
            {"region": str(region), "capsule": {"a_m": shape.a_m, "b_m": shape.b_m, "radius_m": shape.radius_m}}
            for region, shape in adult_at_distance(1.2, bearing_rad=-2.6919).regions
            if region is Region.TORSO
        ]
        stated["view"]["people"] = [{"id": "anna", "regions": regions}]

    assert answer("tracked-person", "slow-sweep", changed=trunk_only).tier == 3


def test_pick_and_place_on_a_declared_support_is_tier_two():
    there = motion("place")
    back = replace(there, start=there.target, target=there.start)
    for move in (there, back):
        said = answer("support", move)
        assert (said.tier, said.violations, said.contributions[0].kind) == (2, (), "meant_contact")
        assert answer("support", move, changed=lambda stated: stated.pop("touch")).tier == 3
        assert (
            answer("support", move, changed=lambda stated: stated["cell"].pop("contacts") and stated.pop("touch")).tier
            == 3
        )


def test_a_folded_arm_can_get_out():
    said = answer("c0-empty", "unfold")
    assert said.tier <= 3
    assert said.violations == ()
    # Folded so far that parts overlap: turning the wrist out is a retreat; folding further is not.
    deep = (0.0, -1.62, 2.9, 0.5, -1.57, 0.0)
    out = answer("c0-empty", MoveJ(deep, (0.0, -1.62, 2.9, 0.5, -0.8, 0.0), 0.2, 1.0))
    assert (out.tier, out.violations) == (3, ())
    assert "retreat" in {c.kind for c in out.contributions}
    assert answer("c0-empty", MoveJ(deep, (0.0, -1.62, 3.0, 0.5, -1.57, 0.0), 0.2, 1.0)).violations == ("self",)
